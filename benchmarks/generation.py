"""Measure generation from sentences to features: milliseconds a motion by part, and their ratio to MARDM-SiT's.

    python benchmarks/generation.py [data=open_mocap scale=tiny precision=bfloat16 ...] [--methods latent_flow mdm]
        [--motions 64] [--repeats 2]

Arguments are Hydra overrides for every method (default: data=synthetic scale=tiny). Weights are those that training
begins with: what a method takes depends on sizes, samplers and lengths, which are those of test motions. Text encoder
and decoder are included, loading is not. One thread, one run; methods take turns, the least total of `repeats` counts.
`benchmarks/mar_sampling.py` and `token_sampling.py` have the published loops beside ours.
"""

from __future__ import annotations

import argparse

import torch

from kinema.data.store import PackedStore
from kinema.evaluation.latency import PARTS
from kinema.experiments.config import CONF, compose
from kinema.experiments.corpus import open_corpus
from kinema.experiments.pages.subjects import read_motions
from kinema.experiments.pages.tablea3 import time_method

BASE = "mardm_sit"
METHODS = sorted(file.stem for file in (CONF / "method").glob("*.yaml"))
VARIANTS = {  # of a method, with what they change
    "latent_flow": {"euler": ["generator.sampling.solver=euler"]},
    "latent_flow_few": {
        **{f"{n} steps": [f"shortcut.model.counts=[{n}]", f"shortcut.sampling.steps={n}"] for n in (1, 4)},
        "sentences": ["text=minilm"],
    },
}
BATCHES = (32, 1)


def main() -> None:
    """Time every method at both batch sizes, and print its parts and how many times as fast as the base it is."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("overrides", nargs="*")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=METHODS)
    parser.add_argument("--motions", type=int, default=64)
    parser.add_argument("--repeats", type=int, default=2)
    options = parser.parse_intermixed_args()
    torch.set_num_threads(1)
    shared = options.overrides or ["data=synthetic", "scale=tiny"]
    given = compose(shared, "evaluate")
    store = PackedStore.open(open_corpus(given))
    asked = read_motions(store, "test", options.motions)
    page = {"batches": BATCHES, "warmup": 1}
    timed = {BASE: [f"method={BASE}"]}
    for method in options.methods:
        variants = {"": [], **VARIANTS.get(method, {})}
        timed |= {f"{method} {name}".strip(): [f"method={method}", *own] for name, own in variants.items()}
    best: dict[tuple[str, int], dict] = {}
    for _ in range(options.repeats):
        for label, own in timed.items():
            cfg = compose([*shared, *own], "evaluate")
            for row in time_method({"key": label, "label": label}, cfg, store, asked, page):
                kept = best.setdefault((label, row["batch"]), row)
                best[label, row["batch"]] = min(kept, row, key=lambda one: one["s / motion"])
    frames = asked.lengths.float().mean()
    print(f"{len(asked.lengths)} motions of {frames:.0f} frames on average, one thread, {given.precision}")
    for size in BATCHES:
        for label in timed:
            row, base = best[label, size], best[BASE, size]
            parts = ", ".join(f"{part} {1e3 * row[f'{part} (s)']:.1f}" for part in PARTS)
            ratio = base["s / motion"] / row["s / motion"]
            print(f"batch {size:2} {label:40} {1e3 * row['s / motion']:6.1f} ms ({parts}); ratio {ratio:.1f}")


if __name__ == "__main__":
    main()
