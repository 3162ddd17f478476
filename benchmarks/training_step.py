"""Measure a training step of every generator: milliseconds, and how many times as long it takes if padding is computed.

    python benchmarks/training_step.py [data=open_mocap scale=tiny ...] [--methods mdm momask] [--batches 6]

Arguments are Hydra overrides for every method (default: data=synthetic scale=tiny). A step is the loss of a batch of
the method's own size and its gradients. "padded" is the same batch with each clip repeated up to the longest one's
length: what a step takes whose layers compute padding too. Process time of one thread; the two take turns.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import torch

from kinema.data.store import PackedStore
from kinema.experiments.config import CONF, compose
from kinema.experiments.corpus import open_corpus
from kinema.experiments.pages.subjects import head, read_motions
from kinema.experiments.pages.untrained import untrained
from kinema.types import MotionBatch

METHODS = sorted(file.stem for file in (CONF / "method").glob("*.yaml"))


def lengthened(batch: MotionBatch) -> MotionBatch:
    """Repeat each clip up to the length of the longest."""
    longest = int(batch.lengths.max())
    places = torch.arange(longest) % batch.lengths[:, None]
    features = batch.features.gather(1, places[..., None].expand(-1, -1, batch.features.shape[-1]))
    return replace(batch, features=features, lengths=torch.full_like(batch.lengths, longest))


def cut(batch: MotionBatch, start: int, size: int) -> MotionBatch:
    """Take some of the motions, as long as the longest of them."""
    rows = slice(start, start + size)
    kept = {"captions": batch.captions[rows], "clip_ids": batch.clip_ids[rows]}
    return head(replace(batch, features=batch.features[rows], lengths=batch.lengths[rows], **kept), size)


def main() -> None:
    """Time every method."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("overrides", nargs="*")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=METHODS)
    parser.add_argument("--batches", type=int, default=6)
    options = parser.parse_intermixed_args()
    torch.set_num_threads(1)
    shared = options.overrides or ["data=synthetic", "scale=tiny"]
    for method in options.methods:
        cfg = compose([*shared, f"method={method}", "trainer.accelerator=cpu"], "train")
        store = PackedStore.open(open_corpus(cfg))
        size = cfg.generator.train.batch_size
        asked = read_motions(store, "test", size * (1 + options.batches))
        model = untrained(cfg, store, asked)
        model.generator.train()
        spent, starts = {"rows": 0.0, "padded": 0.0}, range(0, len(asked.lengths) - size + 1, size)
        if len(starts) < 2:
            raise SystemExit(f"{method}: {len(asked.lengths)} test motions make no two batches of {size}")
        for start in starts:
            batch = cut(asked, start, size)
            text = replace(model.text_encoder(batch.texts), clip_ids=batch.clip_ids)
            for name, own in (("rows", batch), ("padded", lengthened(batch))):
                latents = model.tokenizer.encode(own)
                begin = time.process_time()
                model.generator.loss(latents, text)["loss"].backward()
                spent[name] += (time.process_time() - begin) * (start > 0)  # the first one warms up
        ms = 1e3 * spent["rows"] / (len(starts) - 1)
        print(f"{method:24} batch {size:3} {ms:7.1f} ms; padded x {spent['padded'] / spent['rows']:.2f}")


if __name__ == "__main__":
    main()
