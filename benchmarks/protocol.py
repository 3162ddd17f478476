"""Measure one replication for several sources, with real motion and captions embedded once or by every source.

    python benchmarks/protocol.py [--sources 4] [--width 256] [--batches 8]

Random motion, small evaluators, and a source that costs nothing: what is left is the evaluation itself. CPU time is
counted, so a busy machine does not matter; the numbers of both ways are compared.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import torch

from kinema.evaluation.encoders.clip_style import ContrastiveEvaluator
from kinema.evaluation.encoders.t2m import MatchingEvaluator
from kinema.evaluation.protocol import EmbeddingCache, EvaluationProtocol, evaluate_replication
from kinema.evaluation.source import answer
from kinema.motion.representation import Representation
from kinema.motion.statistics import Statistics
from kinema.text.tokens import clip_tokens
from kinema.text.words import word_vectors
from kinema.types import Caption, MotionBatch

FRAMES, POOL = 120, 32
WORDS = ("walk", "run", "jump", "sit", "turn", "kick", "dance", "wave")


class Shifted:
    """Answer with the real motion, a little off."""

    label, multimodal, reconstructs = "shifted", False, False

    def __init__(self, by: float) -> None:
        self.by = by

    def __call__(self, batch: MotionBatch, seeds: torch.Tensor) -> MotionBatch:
        return answer(batch, (batch.features + self.by) * batch.mask[..., None], batch.lengths)


def judges(width: int):
    torch.manual_seed(0)
    statistics = Statistics(np.zeros(263), np.ones(263))
    representations = [Representation("essential", "humanml3d").fit(statistics) for _ in range(2)]
    words, tokens = word_vectors("hashed"), clip_tokens("hashed")
    sizes = {"movement_width": width, "movement_dim": width, "motion_hidden": width, "text_hidden": width}
    matching = MatchingEvaluator(representations[0], word_width=words.width, embedding=width, **sizes).attach(words)
    token_width = tokens.embedding.shape[1]
    contrastive = ContrastiveEvaluator(
        representations[1], token_width=token_width, width=width // 2, layers=2, heads=4, feedforward=width
    )
    return matching, contrastive.attach(tokens)


def motions(number: int) -> MotionBatch:
    rng = np.random.default_rng(number)
    lengths = torch.from_numpy(rng.integers(10, FRAMES // 4 + 1, POOL) * 4)
    features = torch.from_numpy(0.1 * rng.normal(size=(POOL, FRAMES, 263)).astype(np.float32))
    features *= (torch.arange(FRAMES) < lengths[:, None])[..., None]
    captions = []
    for words in rng.choice(WORDS, (POOL, 10)):
        captions.append(Caption(" ".join(words), tuple(f"{w}/VERB" for w in words)))
    return MotionBatch(features, lengths, captions=captions, clip_ids=[f"{number}-{i}" for i in range(POOL)])


def evaluate(count: int, work: list[MotionBatch], evaluators, cache: EmbeddingCache | None):
    start = time.process_time()
    found = [
        evaluate_replication(Shifted(0.01 * i), work, *evaluators, EvaluationProtocol(), cache=cache).metrics
        for i in range(count)
    ]
    return time.process_time() - start, found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sources", type=int, default=4, help="rows of a table that share a replication (default 4)")
    parser.add_argument("--width", type=int, default=256, help="of the evaluators (default 256)")
    parser.add_argument("--batches", type=int, default=8, help="of 32 motions (default 8)")
    arguments = parser.parse_args()
    work, evaluators = [motions(i) for i in range(arguments.batches)], judges(arguments.width)
    evaluate(1, work[:1], evaluators, None)  # warm up
    plain, expected = evaluate(arguments.sources, work, evaluators, None)
    with tempfile.TemporaryDirectory() as folder:
        first, _ = evaluate(1, work, evaluators, EmbeddingCache(folder))
        later, found = evaluate(arguments.sources, work, evaluators, EmbeddingCache(folder))
    each, hit = plain / arguments.sources, later / arguments.sources
    print(f"{arguments.sources} sources, {len(work)} batches of {POOL}, evaluators of width {arguments.width}")
    print(f"without cache {each:.2f} s a source; with it the first {first:.2f} s, the others {hit:.2f} s")
    print(f"ratio {each / hit:.2f}")
    if found != expected:
        sys.exit("the cached numbers differ")


if __name__ == "__main__":
    main()
