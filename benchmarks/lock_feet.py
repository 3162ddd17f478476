"""Measure what holding feet does and takes, by the speed below which a low toe stands: how `SLOW` was chosen.

    python benchmarks/lock_feet.py [--store STORE] [--run RUN] [--clips 96] [--slow 0.5 0.7 0.9 1.2]

Clips are those of the store's validation split, or synthetic ones; with a run, motion generated for their captions and
of their lengths is measured too. Without one, the clips are measured again with 0.5 m/s added to the root's velocity.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
import torch

from kinema.data.store import PackedStore
from kinema.data.synthetic import synthetic_catalog
from kinema.motion import feet
from kinema.motion.cleaning import UNITS, Held, floor_of, lock_rows
from kinema.motion.features import extract
from kinema.motion.recovery import recover_joints
from kinema.motion.skeleton import HUMANML3D
from kinema.types import Motion


def motion(rows: np.ndarray, text: str = "") -> Motion:
    """Make a motion of its rows."""
    joints = recover_joints(torch.from_numpy(rows), HUMANML3D).numpy()
    return Motion(joints, rows, text, HUMANML3D.name, HUMANML3D.fps)


def clips_of(store: str | None, count: int) -> list[Motion]:
    """Return captured motion of at most 196 frames and its first caption."""
    if store is None:
        catalog = synthetic_catalog(size=count, seed=0)
        return [motion(extract(clip.joints(), HUMANML3D)) for clip in catalog]
    packed = PackedStore.open(store)
    entries = [int(e) for e in packed.split_entries("val") if packed.entry_captions(int(e))]
    chosen = [entries[i] for i in np.linspace(0, len(entries) - 1, min(count, len(entries))).astype(int)]
    rows = [np.array(packed.frames_of(e))[:196, : HUMANML3D.essential_width] for e in chosen]
    return [motion(r, packed.entry_captions(e)[0].text) for r, e in zip(rows, chosen, strict=True)]


def slid(source: Motion) -> Motion:
    """Let feet slide."""
    rows = source.features.copy()
    rows[:, 2] += 0.5 / HUMANML3D.fps
    return motion(rows)


def tell(name: str, motions: list[Motion], slow: float | None) -> None:
    """Print the means over motions, before (slow None) or after, with what holding the rows of one takes."""
    feet.SLOW = feet.SLOW if slow is None else slow
    held = [Held.of(one, floor_of(one)) for one in motions]
    figures = [one.figures(one.before if slow is None else one.after) for one in held]
    means = " ".join(f"{key} {np.mean([f[key] for f in figures]):.2f} {unit}" for key, unit in UNITS.items())
    began = time.process_time()
    for one in motions:
        lock_rows(one.features, HUMANML3D)
    took = f"; {1e3 * (time.process_time() - began) / len(motions):.2f} ms a motion"
    moved = f"; moved {np.mean([one.farthest for one in held]):.1f} cm, mean of the farthest{took}"
    print(f"{name:<10}{'before' if slow is None else f'{slow:g} m/s':<9}{means}{'' if slow is None else moved}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--store")
    parser.add_argument("--run")
    parser.add_argument("--clips", type=int, default=96)
    parser.add_argument("--slow", type=float, nargs="+", default=[0.5, 0.7, 0.9, 1.2])
    options = parser.parse_args()
    real = clips_of(options.store, options.clips)
    if options.run and options.store:
        from kinema.pipeline import TextToMotion

        model = TextToMotion.from_run(options.run)
        lengths = [max(len(one.joints) // 4 * 4, 4) for one in real]
        made = model.generate([one.text for one in real], lengths, seed=0)
    else:
        made = [slid(one) for one in real]
    for name, motions in (("captured", real), ("generated" if options.run else "slid", made)):
        for slow in (None, *options.slow):
            tell(name, motions, slow)


if __name__ == "__main__":
    main()
