"""Measure what scoring gains where a method is asked several pools at once: motions of like length, larger batches.

    python benchmarks/together.py [data=open_mocap scale=tiny ...] [--methods mardm_sit mdm] [--motions 256]
        [--sizes 32 128]

Arguments are Hydra overrides for every method (default: data=synthetic scale=tiny). Weights are those that training
begins with; captions and lengths are those of test motions. CPU seconds a motion, pool by pool and all pools at once in
batches of each size, by turns, in one thread. The motions must be the same but for rounding (a method of codes may draw
another one where two are equal but for that): the share is printed.
"""

from __future__ import annotations

import argparse
import math
import os
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")

import torch

from kinema.data.store import PackedStore
from kinema.evaluation.sources import Generated
from kinema.evaluation.together import Asked, select
from kinema.experiments.config import CONF, compose
from kinema.experiments.corpus import open_corpus
from kinema.experiments.pages.subjects import read_motions
from kinema.experiments.pages.untrained import untrained
from kinema.experiments.sampling import build_sampling
from kinema.seeds import protocol_seeds
from kinema.types import MotionBatch

POOL, CLOSE = 32, 1e-3
METHODS = sorted(file.stem for file in (CONF / "method").glob("*.yaml"))


def timed(source: Generated, goes: list[list[Asked]]) -> tuple[float, list[MotionBatch]]:
    """Ask go by go; return CPU seconds and all answers."""
    start, made = time.process_time(), []
    for asked in goes:
        made += source.answer_all(asked)
    return time.process_time() - start, made


def same(one: MotionBatch, other: MotionBatch) -> list[bool]:
    """Tell of each motion whether both ways made it."""
    rows = zip(one.features, other.features, one.lengths.tolist(), other.lengths.tolist(), strict=True)
    return [n == m and torch.allclose(a[:n], b[:n], rtol=CLOSE, atol=CLOSE) for a, b, n, m in rows]


def main() -> None:
    """Time each method both ways."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("overrides", nargs="*")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=["mardm_sit", "t2m_gpt", "momask", "mdm"])
    parser.add_argument("--motions", type=int, default=256)
    parser.add_argument("--sizes", type=int, nargs="+", default=[POOL, 4 * POOL])
    parser.add_argument("--repeats", type=int, default=2)
    options = parser.parse_intermixed_args()
    torch.set_num_threads(1)
    shared = options.overrides or ["data=synthetic", "scale=tiny"]
    store = PackedStore.open(open_corpus(compose(shared, "evaluate")))
    motions = read_motions(store, "test", options.motions)
    rows = torch.arange(len(motions.lengths))
    pools = [(select(motions, part), protocol_seeds(0, 0, int(part[0]), len(part))) for part in rows.split(POOL)]
    print(f"{len(rows)} motions of {motions.lengths.float().mean():.0f} frames on average, pools of {POOL}, one thread")
    for method in options.methods:
        cfg = compose([*shared, f"method={method}"], "evaluate")
        model, sampling = untrained(cfg, store, motions), build_sampling(cfg)
        alone, *sizes = (
            Generated(model, lengths=cfg.lengths, sampling=sampling, batch_size=size) for size in (POOL, *options.sizes)
        )
        timed(alone, [pools[:1]])  # warm up; texts are read once
        runs = [(alone, [[pool] for pool in pools]), *((source, [pools]) for source in sizes)]
        best = [math.inf] * len(runs)
        for _ in range(options.repeats):
            found = [timed(*run) for run in runs]
            best = [min(pair) for pair in zip(best, (seconds for seconds, _ in found), strict=True)]
        each = [1e3 * seconds / len(rows) for seconds in best]
        print(f"{method}: pool by pool {each[0]:.1f} ms a motion")
        for size, took, (_, made) in zip(options.sizes, each[1:], found[1:], strict=True):
            equal = [flag for one, other in zip(found[0][1], made, strict=True) for flag in same(one, other)]
            share = 100 * sum(equal) / len(equal)
            print(f"  at once, {size:4} to a batch, {took:.1f} ms; ratio {each[0] / took:.2f}; {share:.1f} % the same")


if __name__ == "__main__":
    main()
