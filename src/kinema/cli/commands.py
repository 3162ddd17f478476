"""Do what the `kinema` command is asked; each function takes the parsed options."""

from __future__ import annotations

import argparse
import json
import os
import platform
from pathlib import Path

import numpy as np
import torch

from kinema.cli.control import chained, follow_path, hold_frames, take_along, tell_seams, tell_strayed
from kinema.cli.convention import told
from kinema.cli.exporting import read_part, stand
from kinema.cli.takes import Batch, check_made
from kinema.data import doctor as examine
from kinema.data.captures import SUFFIXES
from kinema.data.prepare import check_reader, read_corpus, takes
from kinema.data.prepare import prepare as write_store
from kinema.data.store import PackedStore
from kinema.experiments.config import compose
from kinema.experiments.corpus import open_corpus
from kinema.experiments.listing import Listed
from kinema.interop.runs import LINKS, import_run
from kinema.motion import export
from kinema.motion.representation import Representation
from kinema.motion.skeleton import Skeleton
from kinema.motion.view.html import save_html
from kinema.options import Threads, check, check_value
from kinema.pipeline import TextToMotion
from kinema.pipeline.arguments import BATCH, CHAIN_HINT, frame_counts
from kinema.pipeline.editing import largest_seam, parse_ranges
from kinema.pipeline.models import DEFAULT, find_model
from kinema.pipeline.naming import is_template
from kinema.pipeline.requests import Take, frames_of, takes_of
from kinema.report.index import write_site
from kinema.runs import weights
from kinema.runs.console import printable
from kinema.runs.folder import RunFolder, read_about
from kinema.runs.latest import find_run
from kinema.runs.parts import LENGTH
from kinema.runs.versions import versions
from kinema.text.prompts import Prompt, is_file_name, read_prompts
from kinema.types import Motion


def generate(options: argparse.Namespace) -> None:
    """Generate the motions of each text, or one long motion of all."""
    if options.chain and options.count > 1:
        raise ValueError(f"--count {options.count} with --chain, which makes one motion of all texts")
    if options.chain and options.batch_size is not None:
        raise ValueError(f"--batch-size {options.batch_size} with --chain, which makes all parts at once: leave it out")
    options.batch_size = BATCH if options.batch_size is None else options.batch_size
    prompts = _prompts(options)
    if options.chain and any(prompt.count or prompt.seed is not None for prompt in prompts):
        raise ValueError("--chain makes one motion of all prompts, of one --seed: leave out their seed and count")
    asked = takes_of(prompts, count=options.count, seed=options.seed)
    many = is_template(options.out)
    if many and (options.chain or options.path is not None):
        raise ValueError(f"--out {options.out}: name one file without braces with --chain and --path")
    files = _files(options.out, 1 if options.chain or many else len(asked))
    batch = Batch.named(options.out, asked) if many else None
    model = _model(options)
    model.changed_sampling(options.set)  # before its names can stand for other arguments
    check_made(asked, model, options)
    export.check(options.out, model.skeleton)
    if batch is not None:
        batch.write(model, _lengths(model, asked, options), options)
        return
    made = _made(model, asked, options)
    made = stand(made) if options.lock_feet else made
    _write(made, files)
    if options.chain:
        tell_seams(made[0], model.skeleton)


def _made(model: TextToMotion, asked: list[Take], options: argparse.Namespace) -> list[Motion]:
    """Generate what is asked for along a path, as one motion, or each by itself."""
    if options.path is not None:
        return follow_path(model, asked, options)
    if options.chain:
        return [chained(model, asked, options)]
    texts, seeds = [take.prompt.text for take in asked], [take.seed for take in asked]
    lengths = _lengths(model, asked, options)
    return model.generate(texts, lengths, seed=seeds, batch_size=options.batch_size, **options.set)


def _lengths(model: TextToMotion, asked: list[Take], options: argparse.Namespace) -> list[int | None]:
    """Return the frames of each motion: a prompt's own, else those of the command line; None is the model's to say."""
    fps = model.skeleton.fps
    (usual,) = frame_counts(options.frames, options.seconds, 1, fps=fps, maximum=model.max_frames)
    return model.lengths(frames_of(asked, usual, fps=fps, maximum=model.max_frames, fix=CHAIN_HINT), None, len(asked))


def edit(options: argparse.Namespace) -> None:
    """Regenerate a part of a motion to a text."""
    files = _files(options.out, 1)
    given = options.keep if options.regenerate is None else options.regenerate
    anew = any(asked is not None for asked in (given, options.parts, options.hold))
    if not anew and options.path is None:
        raise ValueError(
            "nothing to regenerate: give --regenerate RANGES, --keep RANGES, --hold FRAMES or --parts upper|lower; or "
            "--path FILE for another way over the floor"
        )
    if anew is (options.text is None):
        lacks = "--text is missing: say what the person does in what becomes new"
        raise ValueError(
            lacks if anew else "--text without a part that becomes new: give --regenerate, or leave it out"
        )
    made_anew = {"--seed": options.seed, "--set": options.set or None, "--length": options.length}
    made_anew |= {"--raw": options.raw or None, "--blend": options.blend}
    if not anew and (idle := [name for name, value in made_anew.items() if value is not None]):
        raise ValueError(f"{', '.join(idle)} without a part that becomes new: leave it out, or give --regenerate")
    if options.raw and options.blend is not None:
        raise ValueError("--blend with --raw: nothing is pasted that could be blended; leave one out")
    model = _model(options)
    model.changed_sampling(options.set)
    export.check(options.out, model.skeleton)
    recording = read_part(options)
    motion = recording.motion(model.skeleton, model.tokenizer.representation.width)
    print(f"read {recording.path}: {recording.note}")
    if anew:
        tell_strayed(motion, model.skeleton)
    if options.path is not None:
        motion = take_along(motion, options.path)
    made = [motion]
    if options.hold is not None:
        made = [hold_frames(model, motion, options)]
    elif anew:
        made = _edited(model, motion, given, options)
    made = stand(made) if options.lock_feet else made
    _write(made, files)
    if (kept := made[0].kept) is not None:
        print(_stayed(made[0], kept, model.skeleton, " (but for feet that were held)" if options.lock_feet else ""))


def _edited(model: TextToMotion, motion: Motion, given: str | None, options: argparse.Namespace) -> list[Motion]:
    """Regenerate ranges of frames, a part of the body, or both."""
    frames = None
    if given is not None:
        size = len(motion.features)
        frames = [parse_ranges(given, size, model.skeleton.fps, kept=options.keep is not None)]
    return model.edit(
        motion,
        options.text,
        frames,
        parts=options.parts,
        seed=options.seed,
        paste=not options.raw,
        **({} if options.blend is None else {"blend": options.blend}),
        **options.set,
    )


def import_checkpoint(options: argparse.Namespace) -> None:
    """Turn a published checkpoint into a run folder."""
    settings = dict(options.set)
    if options.statistics:
        settings["statistics"] = options.statistics[0] if len(options.statistics) == 1 else options.statistics
    links = {part: find_run(run) for part, run in vars(options).items() if part in LINKS and run}
    text = {"text": options.text, "text_path": options.text_path}
    module = import_run(options.kind, options.file, options.out, links=links, options=settings, **text)
    size = sum(p.numel() for p in module.parameters())
    print(f"wrote {options.out} ({type(module).__name__}, {size:,} parameters)")
    if any(isinstance(part, Representation) and not part.fitted for part in module.modules()):
        print("note: its mean and std are unknown; import it with --statistics PATH to use it")


def prepare(options: argparse.Namespace) -> None:
    """Turn a corpus into a packed store."""
    official = options.format in ("humanml3d", "kit")
    skeleton = options.format if official else options.skeleton
    reader = "official" if official else "captures" if options.format in SUFFIXES else options.format
    written = vars(told(options)) | {"captions": options.captions, "smplh": options.smplh}
    written = {name: value for name, value in written.items() if value is not None}
    limits = {name: options.set.pop(name) for name in ("max_missing", "max_unusable") if name in options.set}
    check(write_store, limits, "--set")
    check_reader(reader, written)
    check_reader(reader, options.set, "--set")
    processes = min(4, os.cpu_count() or 1) if options.processes is None else options.processes
    check_value(processes, Threads, "--processes")
    settings = written | options.set | ({"skeleton": skeleton} if takes(reader, "skeleton") else {})
    settings |= {"format": options.format} if takes(reader, "format") else {}
    if (options.source is None) != (options.format == "synthetic"):
        needs = "takes no SOURCE" if options.source else "needs SOURCE, the corpus' folder"
        raise ValueError(f"--format {options.format} {needs}")
    path = write_store(
        read_corpus(reader, options.source, **settings),
        options.out,
        name=options.name or options.format,
        skeleton=skeleton,
        mirror=not official and not options.no_mirror,
        processes=processes,
        **limits,
    )
    store = PackedStore.open(path)
    print(printable(f"wrote {path}: {store!r}"))


def doctor(options: argparse.Namespace) -> int:
    """Examine a corpus, a store, one file of joints or what overrides name; exit code 1 if something is wrong."""
    path, source = options.what[0], options.source
    if options.sheet is not None and Path(options.sheet).suffix != ".html":
        raise ValueError(f"--sheet {options.sheet} is a page of players: name an .html file")
    if all("=" in word for word in options.what):
        cfg = compose(options.what)
        path, source = open_corpus(cfg), source or cfg.data.source
    elif len(options.what) > 1:
        raise ValueError(f"doctor takes one path, or KEY=VALUE overrides, not {' '.join(options.what)}")
    findings = examine.diagnose(path, source=source, convention=told(options), sheet=options.sheet)
    print(printable(examine.format(findings)))
    if options.sheet is not None and Path(options.sheet).is_file():
        print(printable(f"wrote {options.sheet}"))
    return examine.exit_code(findings, strict=options.strict)


def site(options: argparse.Namespace) -> None:
    """Write the site over all tables and studies of a folder."""
    written = write_site(options.reports)
    print(f"wrote {written[0]} and {len(written) - 1} more pages")


def info(options: argparse.Namespace) -> None:
    """Describe a run folder, whatever its state, or a weights file; without one, what a bug report should say."""
    if options.run is None:
        print(json.dumps({**versions(), "system": platform.platform(), "cuda": torch.version.cuda}, indent=2))
        return
    path = find_model(options.run)
    file = RunFolder(path).weights if path.is_dir() else path
    parts = Listed(RunFolder(path)).describe() if path.is_dir() else {}
    if file.exists() or not parts:
        meta = weights.read_meta(file)
        parts |= {"weights": f"{file} ({file.stat().st_size / 1e6:.1f} MB)", "artifact": meta}
    for name in ("status", "upstream", "text") if path.is_dir() else ():
        if found := read_about(path / f"{name}.json", dict):
            parts[name] = found
    print(json.dumps(parts, indent=2))


def _prompts(options: argparse.Namespace) -> list[Prompt]:
    """Return what is to be generated: the texts of the command line, or those of a file."""
    if bool(options.text) == (options.prompts is not None):
        raise ValueError("give TEXT, one or several, or --prompts FILE (.txt, .csv, .jsonl), and not both")
    if options.prompts is not None:
        return read_prompts(options.prompts)
    for text in options.text:
        if is_file_name(text):
            raise ValueError(f"{text} is the name of a file, not what a person does; give --prompts {text}")
    return [Prompt(text) for text in options.text]


def _model(options: argparse.Namespace) -> TextToMotion:
    parts = {} if options.length is None else {LENGTH: options.length}
    return TextToMotion.from_pretrained(options.run or DEFAULT, options.device, **parts)


def _files(out: str, count: int) -> list[Path]:
    """Name the files of `count` motions; all go into one .html, else several are numbered."""
    path = Path(out)
    ending = export.format_of(path)
    if count == 1 or ending == ".html":
        return [path]
    return [path.with_name(f"{path.name.removesuffix(ending)}-{i}{ending}") for i in range(1, count + 1)]


def _stayed(motion: Motion, kept: np.ndarray, skeleton: Skeleton, but: str) -> str:
    """Say which frames an edit kept, and how far a joint moves where the new ones begin or end."""
    inside = np.pad(kept, 1)
    borders = np.flatnonzero(inside[1:] != inside[:-1]).reshape(-1, 2)
    ranges = ", ".join(f"{start}:{end}" for start, end in borders)
    said = f"kept frames {ranges}{but}" if ranges else "kept no frame"
    seam = largest_seam(motion)
    return said if seam is None else f"{said}; largest step at a seam {seam[1]:.3g} {skeleton.unit} (frame {seam[0]})"


def _write(motions: list[Motion], files: list[Path]) -> None:
    if len(files) < len(motions):
        save_html(motions, files[0])
    else:
        for motion, file in zip(motions, files, strict=True):
            export.save(motion, file)
    frames = ", ".join(str(len(m.joints)) for m in motions)
    seeds = list(dict.fromkeys(str(m.seed) for m in motions if m.seed is not None))
    drawn = f", seed{'s' * (len(seeds) > 1)} {', '.join(seeds)}" if seeds else ""
    print(f"wrote {', '.join(map(str, files))} ({frames} frames{drawn})")
