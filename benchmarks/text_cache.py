"""Measure the text encoder and its cache: python benchmarks/text_cache.py [encoder] [texts in the cache]."""

from __future__ import annotations

import os
import sys
import tempfile
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import torch

from kinema.text.cache import CachedTextEncoder
from kinema.text.encoders import build_text_encoder
from kinema.text.hashed import HashedTextEncoder

BATCH, ROUNDS, WORDS = 64, 300, 12


def texts_of(count: int) -> list[str]:
    words = "a person walk run jump slowly forward left right then turn sit".split()  # noqa: SIM905
    draw = np.random.default_rng(0).integers(0, len(words), (count, WORDS))
    return [" ".join(words[i] for i in row) + f" {n}" for n, row in enumerate(draw)]


def clock(name: str, count: int, call) -> float:
    start = time.perf_counter()
    call()
    seconds = time.perf_counter() - start
    print(f"{name:32s} {seconds:8.3f} s {count / seconds:12,.0f} texts/s {1e6 * seconds / count:9.2f} us/text")
    return seconds / count


def main() -> None:
    name = sys.argv[1] if len(sys.argv) > 1 else "minilm"
    count = int(sys.argv[2]) if len(sys.argv) > 2 else 100_000
    encoder = build_text_encoder(name)
    encoder(["load the weights"])
    print(f"{torch.get_num_threads()} threads, {count} texts in the cache")
    encoding = clock(f"{name}: encode", 512, lambda: encoder(texts_of(512)))
    texts = texts_of(count)
    order = np.random.default_rng(1).integers(0, count, (ROUNDS, BATCH))
    batches = [[texts[i] for i in row] for row in order]
    with tempfile.TemporaryDirectory() as folder:
        for tokens in (None, "float16", "float32"):
            wide = HashedTextEncoder(384)
            clock(
                f"tokens={tokens}: fill (hashed)",
                count,
                lambda w=wide, t=tokens: CachedTextEncoder(w, folder, t).ensure(texts),
            )
            cache = CachedTextEncoder(wide, folder, tokens)
            clock(f"tokens={tokens}: open", count, lambda c=cache: c.features)
            for attempt in ("first", "again"):
                called = f"tokens={tokens}: look up {attempt}"
                looking = clock(called, ROUNDS * BATCH, lambda c=cache: [c(b) for b in batches])
            print(f"ratio {encoding / looking:,.0f} of encoding to looking up")


if __name__ == "__main__":
    main()
