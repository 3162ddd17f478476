"""Do what the `kinema` command is asked; each function takes the parsed options."""

from __future__ import annotations

import argparse
import importlib
import json
import multiprocessing
import os
import platform
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import torch
from rich.progress import track

from kinema.data import doctor as examine
from kinema.data.corpora.humanml3d import Report, Sources, build_humanml3d
from kinema.data.corpora.open_mocap import OWNERS, Rebuilt, rebuild
from kinema.data.prepare import READERS
from kinema.data.prepare import prepare as write_store
from kinema.data.store import PackedStore
from kinema.experiments.config import compose
from kinema.experiments.corpus import open_corpus
from kinema.interop.runs import LINKS, import_run
from kinema.motion import export
from kinema.motion.captures.amass import BodyModels
from kinema.motion.features import extract
from kinema.motion.formats.arrays import load_npy, load_npz
from kinema.motion.recovery import recover_joints
from kinema.motion.representation import Representation
from kinema.motion.skeleton import Skeleton
from kinema.motion.view.html import save_html
from kinema.pipeline import TextToMotion
from kinema.pipeline.editing import complement, parse_ranges
from kinema.report.index import write_site
from kinema.runs import weights
from kinema.runs.folder import RunFolder, read_json
from kinema.runs.latest import find_run
from kinema.runs.parts import LENGTH
from kinema.runs.versions import versions
from kinema.types import Motion


def generate(options: argparse.Namespace) -> None:
    """Generate one motion per text, or one long motion of all."""
    files = _files(options.out, 1 if options.chain else len(options.text))
    model = _model(options)
    lengths = {"frames": options.frames, "seconds": options.seconds}
    if options.chain:
        _write([model.chain(options.text, **lengths, seed=options.seed, **options.set)], files)
        return
    _write(model.generate(options.text, **lengths, seed=options.seed, **options.set), files)


def edit(options: argparse.Namespace) -> None:
    """Regenerate a part of a motion to a text."""
    files, given = _files(options.out, 1), options.regenerate or options.keep
    if given is None and options.parts is None:
        raise ValueError("nothing to regenerate: give --regenerate RANGES, --keep RANGES or --parts upper|lower")
    model = _model(options)
    motion = read_motion(options.motion, model.skeleton, model.tokenizer.representation.width)
    frames = None
    if given is not None:
        size = len(motion.features)
        ranges = parse_ranges(given, size, model.skeleton.fps)
        frames = [complement(ranges, size) if options.keep else ranges]
    made = model.edit(
        motion,
        options.text,
        frames,
        parts=options.parts,
        seed=options.seed,
        paste=not options.raw,
        **options.set,
    )
    _write(made, files)


def read_motion(path: str | Path, skeleton: Skeleton, width: int) -> Motion:
    """Read a motion; features of `width` columns are extracted from its joints where it has none so wide.

    Extraction gives one frame less than there are joints (HUMANML3D_DATA §3) and puts the clip at the origin.
    """
    path = Path(path)
    if path.suffix == ".npz":
        motion = load_npz(path)
        if motion.features.ndim == 2 and motion.features.shape[1] >= width:
            return motion
        joints, text = motion.joints, motion.text
    elif path.suffix == ".npy":
        joints, text = load_npy(path), ""
    else:
        raise ValueError(f"cannot read a motion from {path}; give .npz or joints (frames, joints, 3) as .npy")
    lengths = None if skeleton.bone_lengths is None else "skeleton"  # as corpora are prepared
    features = extract(joints, skeleton, target_bone_lengths=lengths)
    joints = recover_joints(torch.from_numpy(features), skeleton).numpy()
    return Motion(joints, features, text, skeleton.name, skeleton.fps)


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
    module, _, function = READERS["official" if official else options.format].partition(":")
    settings = options.set | ({"skeleton": skeleton} if options.format != "joints" else {})
    if (options.source is None) != (options.format == "synthetic"):
        needs = "takes no SOURCE" if options.source else "needs SOURCE, the corpus' folder"
        raise ValueError(f"--format {options.format} {needs}")
    source = [] if options.source is None else [options.source]
    catalog = getattr(importlib.import_module(module), function)(*source, **settings)
    path = write_store(
        catalog,
        options.out,
        name=options.name or options.format,
        skeleton=skeleton,
        mirror=not official and not options.no_mirror,
        processes=options.processes or min(4, os.cpu_count() or 1),
    )
    store = PackedStore.open(path)
    print(f"wrote {path}: {store!r}")


def corpus(options: argparse.Namespace) -> int:
    """Build a corpus from what its owners publish; exit code 1 if clips are missing."""
    processes, out = options.processes or min(4, os.cpu_count() or 1), Path(options.out)
    with ProcessPoolExecutor(processes, mp_context=multiprocessing.get_context("spawn")) as pool:
        work = {"pool": pool, "watch": lambda takes, total: track(takes, "takes", total)}
        report = _humanml3d(options, out, work) if options.corpus == "humanml3d" else _open_mocap(options, out, work)
    print(report)
    return 0 if report.whole else 1


def _open_mocap(options: argparse.Namespace, out: Path, work: dict[str, Any]) -> Rebuilt:
    return rebuild({owner: [Path(f) for f in getattr(options, owner)] for owner in OWNERS}, out, **work)


def _humanml3d(options: argparse.Namespace, out: Path, work: dict[str, Any]) -> Report:
    models = BodyModels(Path(options.smplh), Path(options.dmpls) if options.dmpls else None)
    sources = Sources(Path(options.amass), models, Path(options.humanact12))
    return build_humanml3d(sources, Path(options.lists), out, **work)


def doctor(options: argparse.Namespace) -> int:
    """Examine a corpus, a store, one file of joints or what overrides name; exit code 1 if something is wrong."""
    path, source = options.what[0], options.source
    if all("=" in word for word in options.what):
        cfg = compose(options.what)
        path, source = open_corpus(cfg), source or cfg.data.source
    elif len(options.what) > 1:
        raise ValueError(f"doctor takes one path, or KEY=VALUE overrides, not {' '.join(options.what)}")
    findings = examine.diagnose(path, source=source)
    print(examine.format(findings))
    return examine.exit_code(findings, strict=options.strict)


def site(options: argparse.Namespace) -> None:
    """Write the site over all tables and studies of a folder."""
    written = write_site(options.reports)
    print(f"wrote {written[0]} and {len(written) - 1} more pages")


def info(options: argparse.Namespace) -> None:
    """Describe a run folder or a weights file; without one, what a bug report should say."""
    if options.run is None:
        print(json.dumps({**versions(), "system": platform.platform(), "cuda": torch.version.cuda}, indent=2))
        return
    path = find_run(options.run)
    file = RunFolder(path).weights if path.is_dir() else path
    meta = weights.read_meta(file)
    parts = {"weights": f"{file} ({file.stat().st_size / 1e6:.1f} MB)", "artifact": meta}
    for name in ("status", "upstream", "text") if path.is_dir() else ():
        if found := read_json(path / f"{name}.json"):
            parts[name] = found
    print(json.dumps(parts, indent=2))


def _model(options: argparse.Namespace) -> TextToMotion:
    parts = {} if options.length is None else {LENGTH: options.length}
    return TextToMotion.from_run(options.run, options.device, **parts)


def _files(out: str, count: int) -> list[Path]:
    """Name the files of `count` motions; all go into one .html, else several are numbered."""
    path = Path(out)
    if path.suffix not in export.FORMATS:
        raise ValueError(f"--out {out} has no known suffix; choose one of {', '.join(export.FORMATS)}")
    if count == 1 or path.suffix == ".html":
        return [path]
    return [path.with_stem(f"{path.stem}-{i}") for i in range(1, count + 1)]


def _write(motions: list[Motion], files: list[Path]) -> None:
    if len(files) < len(motions):
        save_html(motions, files[0])
    else:
        for motion, file in zip(motions, files, strict=True):
            export.save(motion, file)
    frames = ", ".join(str(len(m.joints)) for m in motions)
    print(f"wrote {', '.join(map(str, files))} ({frames} frames, seed {motions[0].seed})")
