"""Do what `kinema gallery` is asked: show files of motion on one page, side by side and in step."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

import numpy as np

from kinema.cli.convention import told
from kinema.motion.convention import Convention
from kinema.motion.recording import read_recording
from kinema.motion.view.html import save_html
from kinema.runs.console import printable
from kinema.text import manifest
from kinema.types import Motion


def gallery(options: argparse.Namespace) -> None:
    """Write a page of the motions that files hold; texts and seeds come from the files or a manifest beside them."""
    if Path(options.out).suffix != ".html":
        raise ValueError(f"--out {options.out} is a page of players: name an .html file")
    files = list(_files(options.files))
    if not files:
        raise ValueError(f"no motion is left of {', '.join(options.files)}: the files that the manifest names are gone")
    shown = [(_read(file, told(options)), label) for file, label in zip(files, _labels(files), strict=True)]
    texts = [motion.text for motion, _ in shown]
    takes = 2 * len(set(texts)) <= len(texts) and "" not in texts
    if takes:  # those of one text stand below it, side by side
        shown.sort(key=lambda one: texts.index(one[0].text))
    motions = [motion for motion, _ in shown]
    path = save_html(
        motions,
        options.out,
        options.title or "Motions",
        labels=[label for _, label in shown],
        groups=[motion.text for motion in motions] if takes else None,
        sync=True,
    )
    print(printable(f"wrote {path} ({len(motions)} motions, {path.stat().st_size / 1e6:.1f} MB)"))


def _files(named: Sequence[str]) -> Iterator[Path]:
    """Give each file of motion once; a manifest stands for those of its files that are there."""
    seen: set[Path] = set()
    for path in map(Path, named):
        lines = manifest.read_manifest(path) if path.suffix == ".jsonl" else None
        found = [path] if lines is None else [path.parent / entry.file for entry in lines]
        there = found if lines is None else [file for file in found if file.is_file()]
        if len(there) < len(found):
            print(printable(f"note: {len(found) - len(there)} files that {path} names are gone"))
        for file in there:
            if file.resolve() not in seen:
                seen.add(file.resolve())
                yield file


def _read(file: Path, convention: Convention) -> Motion:
    """Read what is shown of a file: its joints, and what it or a manifest says of them."""
    recording = read_recording(file, convention)
    ours, entry = recording.ours, _noted(file)
    rows = np.zeros((len(recording.joints), 0), np.float32)
    return Motion(
        recording.joints,
        rows,
        recording.text or (entry.text if entry else ""),
        recording.skeleton.name,
        recording.skeleton.fps,
        seed=ours.seed if ours else entry.seed if entry else None,
        kept=ours.kept if ours else None,
    )


def _noted(file: Path) -> manifest.Entry | None:
    """Look a file up in the nearest manifest at or above its folder."""
    for folder in file.parents[:3]:
        if (folder / manifest.NAME).is_file():
            try:
                return _manifest(folder).get(file.relative_to(folder).as_posix())
            except ValueError:  # somebody else's file of that name, which nobody asked for
                return None
    return None


@cache
def _manifest(folder: Path) -> dict[str, manifest.Entry]:
    return {entry.file: entry for entry in manifest.read_manifest(folder / manifest.NAME)}


def _labels(files: Sequence[Path]) -> list[str]:
    """Name files as short as tells them apart: from the folder that they share."""
    shared = os.path.commonpath([file.resolve().parent for file in files])
    return [os.path.relpath(file.resolve(), shared) for file in files]
