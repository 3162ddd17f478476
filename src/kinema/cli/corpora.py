"""Do what `kinema corpus` is asked: build a corpus anew from what its owners publish."""

from __future__ import annotations

import argparse
import multiprocessing
import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from rich.progress import track

from kinema.data.corpora.humanml3d import Report, Sources, build_humanml3d
from kinema.data.corpora.open_mocap import OWNERS, Rebuilt, rebuild
from kinema.motion.captures.amass import BodyModels
from kinema.options import Threads, check_value


def corpus(options: argparse.Namespace) -> int:
    """Build a corpus from what its owners publish; exit code 1 if clips are missing."""
    processes, out = min(4, os.cpu_count() or 1) if options.processes is None else options.processes, Path(options.out)
    check_value(processes, Threads, "--processes")
    with ProcessPoolExecutor(processes, mp_context=multiprocessing.get_context("spawn")) as pool:
        work = {"pool": pool, "watch": lambda takes, total: track(takes, "takes", total)}
        report = MADE[options.corpus](options, out, work)
    print(report)
    return 0 if report.whole else 1


def _open_mocap(options: argparse.Namespace, out: Path, work: dict[str, Any]) -> Rebuilt:
    return rebuild({owner: [Path(f) for f in getattr(options, owner)] for owner in OWNERS}, out, **work)


def _humanml3d(options: argparse.Namespace, out: Path, work: dict[str, Any]) -> Report:
    models = BodyModels(Path(options.smplh), Path(options.dmpls) if options.dmpls else None)
    sources = Sources(Path(options.amass), models, Path(options.humanact12))
    return build_humanml3d(sources, Path(options.lists), out, **work)


MADE: dict[str, Callable[[argparse.Namespace, Path, dict[str, Any]], Rebuilt | Report]] = {
    "open-mocap": _open_mocap,
    "humanml3d": _humanml3d,
}
