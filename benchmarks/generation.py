"""Measure generation from sentences to features: milliseconds a motion by part, and the ratio to MARDM-SiT.

    python benchmarks/generation.py [data=open_mocap scale=tiny precision=bfloat16 ...] [--motions 96] [--repeats 2]

Arguments are Hydra overrides for every method (default: data=synthetic scale=tiny). Weights are those that training
begins with: what a method takes depends on sizes, samplers and lengths, which are those of test motions. Text encoder
and decoder are included, loading is not. One thread, one run; methods take turns, the least total of `repeats` counts.
"""

from __future__ import annotations

import argparse

import torch

from kinema.data.store import PackedStore
from kinema.evaluation.latency import PARTS
from kinema.experiments.config import compose
from kinema.experiments.corpus import open_corpus
from kinema.experiments.pages.subjects import read_motions
from kinema.experiments.pages.tablea3 import time_method

FEW = "shortcut.sampling.steps="
METHODS = (
    ("MARDM-SiT", ["method=mardm_sit"]),
    ("latent_flow", ["method=latent_flow"]),
    *((f"latent_flow_few, {n} steps", ["method=latent_flow_few", f"{FEW}{n}"]) for n in (4, 2, 1)),
    ("latent_flow_few, 2 steps, words alone", ["method=latent_flow_few", f"{FEW}2", "text=minilm_words"]),
)
BATCHES = (32, 1)


def main() -> None:
    """Time every method at both batch sizes, and print the shares of its parts and how many times as fast it is."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("overrides", nargs="*")
    parser.add_argument("--motions", type=int, default=96)
    parser.add_argument("--repeats", type=int, default=2)
    options = parser.parse_intermixed_args()
    torch.set_num_threads(1)
    shared = options.overrides or ["data=synthetic", "scale=tiny"]
    given = compose(shared, "evaluate")
    store = PackedStore.open(open_corpus(given))
    asked = read_motions(store, "test", options.motions)
    page = {"batches": BATCHES, "warmup": 1}
    best: dict[tuple[str, int], dict] = {}
    for _ in range(options.repeats):
        for label, own in METHODS:
            cfg = compose([*shared, *own], "evaluate")
            for row in time_method({"key": label, "label": label}, cfg, store, asked, page):
                kept = best.setdefault((label, row["batch"]), row)
                best[label, row["batch"]] = min(kept, row, key=lambda one: one["s / motion"])
    frames = asked.lengths.float().mean()
    print(f"{len(asked.lengths)} motions of {frames:.0f} frames on average, one thread, {given.precision}")
    for size in BATCHES:
        for label, _ in METHODS:
            row, base = best[label, size], best["MARDM-SiT", size]
            parts = ", ".join(f"{part} {1e3 * row[f'{part} (s)']:.1f}" for part in PARTS)
            ratio = base["s / motion"] / row["s / motion"]
            print(f"batch {size:2} {label:40} {1e3 * row['s / motion']:6.1f} ms ({parts}); ratio {ratio:.1f}")


if __name__ == "__main__":
    main()
