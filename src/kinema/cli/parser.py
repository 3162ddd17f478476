"""Say what the command line of `kinema` has: commands, options and what each is for."""

from __future__ import annotations

import argparse
from collections.abc import Callable

from kinema import __version__

TOKENIZERS = ("mardm-ae", "t2m-gpt-vq", "attt2m-vq", "mmm-vq", "momask-rvq", "frames", "mld-vae")
GENERATORS = (
    "mardm",
    "t2m-gpt",
    "attt2m",
    "mmm",
    "bad",
    "momask",
    "bamm",
    "mdm",
    "motiondiffuse",
    "remodiffuse",
    "mld",
)
KINDS = (
    *TOKENIZERS,
    *GENERATORS,
    "momask-residual",
    "length-estimator",
    "t2m-evaluator",
    "t2m-decomposition",
    "clip-evaluator",
)
SHELLS = ("bash", "zsh")
PARTS = ("upper", "lower", "body")
MOTIONS = ".html .mp4 .npz .npy .png .bvh .glb .vrma .fbx .amass.npz"
FORMATS = ("joints", "humanml3d", "kit", "synthetic", "bvh", "amc", "amass")
EXPERIMENTS = {
    "train": ("kinema.experiments.entry:train", "fit a stage of a method or evaluator: stage=generator method=..."),
    "evaluate": ("kinema.experiments.entry:evaluate", "score one row of a table: source=generation method=..."),
    "reproduce": ("kinema.experiments.reproduce:main", "run what a table lacks, and render it: table5 scale=..."),
    "figures": ("kinema.experiments.figures:main", "draw a figure of the papers: bad_masks, code_usage RUN..."),
}
"""Commands that read their own arguments (`kinema train --help`): mostly Hydra overrides."""
RUN_HELP = (
    "run folder of a generator, or of `kinema pack`; latest:METHOD for the last that finished; the name of a model of "
    "this package (`kinema models`), or OWNER/NAME on the Hugging Face hub"
)
RANGE_HELP = (
    "START:END, several with commas; frames (20:60) or seconds (1s:3s), an empty end means the clip's; or a task, "
    "named by what stays: prefix keeps the first half, suffix the second half, inbetween both end quarters, outpaint "
    "the middle half"
)
BONES_HELP = "bit by bit (joints of a body with other bones are brought to the skeleton's first; how far is said)"
REGENERATE_HELP = f"what becomes new; everything else stays {BONES_HELP}. {RANGE_HELP}"
KEEP_HELP = (
    f"what stays {BONES_HELP}; everything else becomes new. {RANGE_HELP}. A stretch that fills no latent (often 4 "
    "frames) is widened to those it touches; what stays behind new frames moves on from where they end"
)
HOLD_HELP = (
    "keyframes, 0,40,-1 or 0s,2s: they come back where they are, everything else becomes new; a frame's whole latent "
    "(often 4 frames) is held, and the root is led from one to the next"
)
PATH_HELP = (
    "way over the floor to go along: .csv of x, z (metres) and perhaps heading (degrees) and time (seconds); .npy of "
    "x, z or x, y, z; .npz of such a path and perhaps headings and times; rows without times are one a frame"
)
ALONG_HELP = (
    "way over the floor that the motion, as it is, is taken along, before anything becomes new (a file as generate "
    "--path takes); alone, nothing is generated"
)
BLEND_HELP = "seconds in which new frames leave kept ones smoothly; 0 puts them side by side (default: 0.4)"
FEET_HELP = "hold feet that stand (of what an edit keeps too); legs bend, nothing else moves"
PROMPTS_HELP = (
    "file of prompts in place of TEXT: .txt, one a line (`a person walks#120` says its frames); .csv and .jsonl with "
    "text and, if you like, frames or seconds, count, seed, name. What a prompt doesn't say the options do"
)
BATCH_HELP = "motions generated at once (default: 32); 1 gives the bits that a motion has alone"
READ_HELP = "file of motion: .npz that kinema wrote, joints (T, J, 3) or features as .npy, .bvh, .amc, our .amass.npz"
PART_HELP = "take these frames of it alone, 20:216 or 1s:10s, at the rate of the skeleton; an empty end is its own"
OUT_HELP = (
    f"file to write: {MOTIONS}; several motions are numbered, or named by a template, with a manifest.jsonl beside: "
    "'motions/{index:03d}-{slug}-{seed}.bvh', of index, slug (of the text), seed, take, name"
)
PARTS_HELP = (
    "regenerate this part of the body alone, in the whole motion or in the ranges above; upper: everything but root, "
    "legs and foot contacts; body: everything but the root's way over the floor (methods that generate frames: mdm, "
    "motiondiffuse, ...)"
)


def command_line() -> argparse.ArgumentParser:
    """Return the parser of all commands; it imports nothing of what they do, so that --help answers at once."""
    parser = argparse.ArgumentParser(
        prog="kinema", description="Train and compare text-to-motion methods; generate and edit motion from text."
    )
    parser.add_argument("--version", action="version", version=__version__)
    parser.set_defaults(set=[])  # of commands that have no --set
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    def add(name: str, what: str, command: str | None = None) -> argparse.ArgumentParser:
        made = commands.add_parser(name, help=what, description=what)
        made.add_argument("--debug", action="store_true", help="show the traceback of an error")
        made.set_defaults(command=command or name)
        return made

    for name, (_, what) in EXPERIMENTS.items():
        commands.add_parser(name, help=what)
    make = add("generate", "generate one motion per text")
    make.add_argument("text", nargs="*", help="what the person does; several texts give several motions")
    make.add_argument("--prompts", metavar="FILE", help=PROMPTS_HELP)
    make.add_argument("--seconds", type=float, help="length; estimated from the text if the run has an estimator")
    make.add_argument("--frames", type=int, help="length in frames")
    make.add_argument(
        "--count", type=int, default=1, metavar="N", help="motions of each text, each with a seed of its own"
    )
    make.add_argument("--batch-size", type=int, metavar="N", help=BATCH_HELP)
    make.add_argument("--chain", action="store_true", help="join the texts to one long motion by generated transitions")
    make.add_argument("--path", metavar="FILE", help=PATH_HELP)
    change = add("edit", "regenerate a part of a motion to a text")
    change.add_argument("--motion", required=True, help=READ_HELP)
    change.add_argument("--part", metavar="START:END", help=PART_HELP)
    change.add_argument("--text", help="what the person does in what becomes new")
    change.add_argument("--path", metavar="FILE", help=ALONG_HELP)
    which = change.add_mutually_exclusive_group()
    which.add_argument("--regenerate", metavar="RANGES", help=REGENERATE_HELP)
    which.add_argument("--keep", metavar="RANGES", help=KEEP_HELP)
    which.add_argument("--hold", metavar="FRAMES", help=HOLD_HELP)
    change.add_argument("--parts", choices=PARTS, help=PARTS_HELP)
    change.add_argument("--raw", action="store_true", help="give the raw decoding instead of pasting the kept frames")
    change.add_argument("--blend", type=float, metavar="SECONDS", help=BLEND_HELP)
    _add_export(add("export", "write a motion in another format", "exporting:export"))
    for one in (make, change):
        one.add_argument("--run", help=f"{RUN_HELP}; left out: the model of this package")
        one.add_argument("--length", metavar="RUN", help="run folder of a length estimator")
        one.add_argument("--out", required=True, help=OUT_HELP if one is make else f"file to write: {MOTIONS}")
        one.add_argument("--seed", type=int, help="the same seed gives the same motion; drawn and printed if left out")
        one.add_argument("--lock-feet", action="store_true", help=FEET_HELP)
        one.add_argument("--device", help="cpu, cuda, mps; the best there is if left out")
        _add_settings(one, "sampling field, e.g. guidance=2.5 or solver_steps=10")
    _add_convention(change)
    read = add("import", "turn a published checkpoint into a run folder", "import_checkpoint")
    read.add_argument("kind", choices=KINDS)
    read.add_argument("file", help="published .tar, .pth, .pt or .safetensors")
    read.add_argument("--out", required=True, metavar="RUN", help="run folder to write")
    read.add_argument(
        "--statistics",
        nargs="+",
        metavar="PATH",
        help="what it was trained with: a folder with Mean.npy and Std.npy, or the two files, mean first",
    )
    read.add_argument("--tokenizer", metavar="RUN", help="run folder of the tokenizer; every generator needs it")
    read.add_argument("--residual", metavar="RUN", help="run folder of the residual transformer (momask, bamm)")
    read.add_argument("--retrieval", metavar="RUN", help="run folder of a database to retrieve from (remodiffuse)")
    read.add_argument("--length", metavar="RUN", help="run folder of a length estimator (generators)")
    read.add_argument("--text", default="clip_b32", help="text encoder it was trained with (default clip_b32)")
    read.add_argument("--text-path", help="local folder of the text encoder")
    _add_settings(read, "importer option, e.g. variant=sit")
    pack = add("prepare", "turn a corpus into a packed store")
    pack.add_argument("source", nargs="?", help="folder of the corpus (none for synthetic)")
    pack.add_argument("--format", required=True, choices=FORMATS)
    pack.add_argument("--out", required=True, metavar="STORE", help="folder to write")
    pack.add_argument("--name", help="name that results carry (default: the format)")
    pack.add_argument("--skeleton", default="humanml3d", help="skeleton of joints and synthetic (default humanml3d)")
    pack.add_argument("--no-mirror", action="store_true", help="don't add left-right mirrored clips")
    pack.add_argument("--processes", type=int, help="processes that extract features")
    captured = pack.add_argument_group("captures", "--format bvh, amc or amass: a folder of takes")
    table = "CSV of file, start, end (seconds), caption, split; left out: pieces of nine seconds without captions"
    captured.add_argument("--captions", metavar="FILE", help=table)
    captured.add_argument(
        "--smplh", metavar="FOLDER", help="body models, needed by AMASS (male/model.npz, ...), not by our .amass.npz"
    )
    _add_convention(pack)
    _add_settings(pack, "reader option, e.g. size=400 of synthetic; max_missing or max_unusable, shares of clips")
    _add_corpora(add("corpus", "build a corpus anew from what its owners publish", "corpora:corpus"))
    check = add("doctor", "examine a corpus, a packed store or a file of motion")
    check.add_argument(
        "what",
        nargs="+",
        metavar="PATH | KEY=VALUE...",
        help="corpus folder, packed store or file of motion (.npy, .npz); or overrides that name a corpus of the "
        "configuration (data=open_mocap), which is prepared first",
    )
    check.add_argument("--source", metavar="FOLDER", help="the folder that the store was made from")
    check.add_argument("--strict", action="store_true", help="exit with 1 for warnings too")
    check.add_argument("--sheet", metavar="FILE", help="a page (.html) to write: clips as they were understood")
    _add_convention(check)
    site = add("site", "write the site over all reports of a folder: index.html, gallery.html")
    site.add_argument("reports", nargs="?", default="reports", help="folder of the reports (default: reports)")
    _add_gallery(add("gallery", "show files of motion on one page, side by side and in step", "gallery:gallery"))
    _add_demo(add("demo", "open a page to try a model in the browser (extra: kinema[demo])", "showing:demo"))
    _add_runs(add)
    _add_models(add)
    describe = add("info", "describe a run folder or a weights file, or what is installed")
    describe.add_argument("run", nargs="?", help="run folder or weights file; left out: versions and system")
    return parser


def _add_runs(add: Callable[[str, str, str], argparse.ArgumentParser]) -> None:
    """Add what looks at runs and at the command itself."""
    listing = add("runs", "list runs: state, step, scores, and what tells them apart", "runs:runs")
    listing.add_argument("words", nargs="*", help="words that stage, name or state hold: generator tiny failed")
    listing.add_argument("--root", metavar="FOLDER", help="folder of runs (default: KINEMA_RUNS, else runs)")
    two = add("compare", "say in what runs differ: settings, progress, scores", "runs:compare")
    two.add_argument("runs", nargs="+", metavar="RUN", help=RUN_HELP)
    what = 'print what completes `kinema`: eval "$(kinema completion bash)"'
    shell = add("completion", what, "completion:completion")
    shell.add_argument("shell", choices=SHELLS)


def _add_models(add: Callable[[str, str, str], argparse.ArgumentParser]) -> None:
    """Add what makes models portable and lists them."""
    made = add("pack", "write a run as one folder that works anywhere, with a model card", "models:pack")
    made.add_argument("run", help="run folder of a generator, or latest:METHOD")
    made.add_argument("--out", required=True, metavar="FOLDER", help="folder to write; its name is the model's")
    made.add_argument("--half", action="store_true", help="weights in half precision: half the size")
    made.add_argument("--licence", help="licence of the weights (default: the strictest of the corpus' sources)")
    made.add_argument("--replace", action="store_true", help="in place of a model that is there")
    listing = add("models", "list models: of this package, and of the hub's cache", "models:models")
    listing.add_argument("name", nargs="?", help="say what one is, and which actions and styles it knows")


def _add_convention(parser: argparse.ArgumentParser) -> None:
    """Add what can be told of foreign joints (`kinema.motion.convention.Convention`)."""
    told = parser.add_argument_group("how joints are written", "what is not told is checked, what is told is believed")
    told.add_argument("--up", metavar="AXIS", help="axis that points up: x, y, z, -x, -y, -z")
    told.add_argument("--handed", choices=("left", "right"), help="left for left-handed coordinates (Unity, Unreal)")
    told.add_argument("--scale", type=float, help="factor to metres (KIT: its own mm): 0.01 for centimetres")
    told.add_argument(
        "--order", help="order of joints: swapped, limbs, limbs-right, trunk, trunk-right, or their names"
    )
    told.add_argument("--fps", type=float, help="their frame rate; they are resampled to the skeleton's")
    told.add_argument("--mapping", metavar="FILE", help="which joint of a .bvh or .amc is which (docs/own_motion.md)")


def _add_export(parser: argparse.ArgumentParser) -> None:
    """Add what a motion may be changed by on its way out."""
    parser.add_argument("motion", help=READ_HELP)
    parser.add_argument("--out", required=True, help=f"file to write: {MOTIONS}")
    parser.add_argument("--part", metavar="START:END", help=PART_HELP)
    parser.add_argument("--lock-feet", action="store_true", help=FEET_HELP)
    rigs = parser.add_argument_group("changes of .bvh, .glb, .vrma, .fbx and .amass.npz", "formats of rotations")
    rigs.add_argument("--rate", type=float, metavar="FPS", help="frames per second to write (turns are interpolated)")
    rigs.add_argument("--in-place", action="store_true", help="stay over one spot")
    rigs.add_argument("--facing", type=float, metavar="DEGREES", help="start at the origin, so far from +Z towards +X")
    rigs.add_argument("--loop", action="store_true", help="let the last half second become the first pose")
    rigs.add_argument("--z-up", action="store_true", help="Z up, facing -Y (.bvh; .amass.npz always is)")
    rigs.add_argument("--unit", choices=("cm", "m"), default="cm", help="unit of lengths (.bvh; others are metres)")
    _add_convention(parser)


def _add_gallery(parser: argparse.ArgumentParser) -> None:
    """Add which motions are shown, and where."""
    what = "files of motion (.npz, .npy, .bvh, .amc), or a manifest.jsonl: the files that it names, with their texts"
    parser.add_argument("files", nargs="+", metavar="FILE", help=what)
    parser.add_argument("--out", required=True, metavar="PAGE", help="page (.html) to write; it needs no other file")
    parser.add_argument("--title", help="heading of the page")
    _add_convention(parser)


def _add_demo(parser: argparse.ArgumentParser) -> None:
    """Add where the page is served, and with what."""
    parser.add_argument("--run", help=f"{RUN_HELP}; left out: the model of this package")
    parser.add_argument("--port", type=int, help="port of this machine; a free one from 7860 on if left out")
    parser.add_argument("--device", help="cpu, cuda, mps; the best there is if left out")
    parser.add_argument("--share", action="store_true", help="a public address too, through gradio's servers")


def _add_corpora(parser: argparse.ArgumentParser) -> None:
    """Add one command per corpus: its owners' folders, each searched for files by name."""
    made = parser.add_subparsers(required=True, metavar="CORPUS", dest="corpus")
    what = "open-mocap from the captures of Bandai Namco, CMU and HDM05 (docs/data.md); a missing one leaves a subset"
    one = made.add_parser("open-mocap", help=what, description=what)
    what = "HumanML3D from AMASS, the SMPL-H models, HumanAct12 and the published lists (docs/data.md); it resumes"
    other = made.add_parser("humanml3d", help=what, description=what)
    other.add_argument(
        "--amass", required=True, metavar="FOLDER", help="AMASS' sets, unpacked (ACCAD, BMLrub, CMU, ...)"
    )
    other.add_argument("--smplh", required=True, metavar="FOLDER", help="body models: male/model.npz, female/model.npz")
    other.add_argument(
        "--dmpls", metavar="FOLDER", help="soft-tissue models alike, as published (left out: stiff bodies)"
    )
    other.add_argument(
        "--humanact12", required=True, metavar="FOLDER", help="pose_data/humanact12 of the lists' repository"
    )
    other.add_argument("--lists", required=True, metavar="FOLDER", help="HumanML3D's repository: index.csv, HumanML3D/")
    for owner in ("bandai", "cmu", "hdm05"):
        one.add_argument(
            f"--{owner}", nargs="+", default=[], metavar="FOLDER", help=f"folders below which {owner}'s files are"
        )
    for corpus in (one, other):
        corpus.add_argument("--out", required=True, metavar="FOLDER", help="folder to write")
        corpus.add_argument("--processes", type=int, help="processes that read captures")
        corpus.add_argument("--debug", action="store_true", help="show the traceback of an error")


def _add_settings(parser: argparse.ArgumentParser, what: str) -> None:
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help=what)
