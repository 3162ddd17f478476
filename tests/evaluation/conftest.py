"""Make small evaluators and batches."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from kinema.evaluation.encoders.clip_style import ContrastiveEvaluator
from kinema.evaluation.encoders.t2m import MatchingEvaluator
from kinema.motion.representation import Representation
from kinema.motion.statistics import Statistics
from kinema.text.tokens import clip_tokens
from kinema.text.words import word_vectors
from kinema.types import Caption, MotionBatch

VERBS = ("walk", "run", "jump", "sit", "turn", "kick", "dance", "wave", "crawl", "bow")


def representation(kind="essential", skeleton="humanml3d", variant="raw"):
    """Make a fitted representation."""
    rng = np.random.default_rng(0)
    made = Representation(kind, skeleton, variant)
    width = made.skeleton.feature_width
    return made.fit(Statistics(0.1 * rng.normal(size=width), 0.5 + rng.random(width)))


def matching(**options):
    """Make a small matching evaluator with hashed words."""
    torch.manual_seed(1)
    words = word_vectors("hashed")
    sizes = {"movement_width": 12, "movement_dim": 10, "motion_hidden": 16, "text_hidden": 12, "embedding": 8}
    options = {"representation": representation()} | sizes | options
    return MatchingEvaluator(options.pop("representation"), word_width=words.width, **options).attach(words)


def contrastive(**options):
    """Make a small contrastive evaluator with hashed tokens."""
    torch.manual_seed(2)
    table = clip_tokens("hashed")
    sizes = {"width": 16, "layers": 2, "heads": 2, "feedforward": 24, "dropout": 0.0, "embedding": 8}
    options = {"representation": representation(), "token_width": table.embedding.shape[1]} | sizes | options
    return ContrastiveEvaluator(options.pop("representation"), **options).attach(table)


def batch(size=8, frames=40, seed=0, width=263, lengths=None):
    """Make a batch of random motions of several lengths, each with its own caption."""
    rng = np.random.default_rng(seed)
    if lengths is None:
        lengths = rng.integers(4, frames // 4 + 1, size) * 4
    features = 0.1 * rng.normal(size=(size, frames, width)).astype(np.float32)
    lengths = torch.tensor(np.asarray(lengths))
    features = torch.from_numpy(features) * (torch.arange(frames) < lengths[:, None])[..., None]
    captions = [caption(i + 97 * seed) for i in range(size)]
    names = [f"clip{seed}-{i:03d}" for i in range(size)]
    return MotionBatch(features, lengths, torch.arange(size), torch.zeros(size, dtype=torch.int64), captions, names)


def caption(number):
    """Make a caption that no other number has."""
    words = [VERBS[int(d)] for d in f"{number:04d}"]
    return Caption(" ".join(words), tuple(f"{w}/VERB" for w in words))


@pytest.fixture(scope="session")
def make():
    """Give the makers above: make.matching(...), make.contrastive(...), make.batch(...), make.representation(...)."""
    from types import SimpleNamespace

    return SimpleNamespace(
        matching=matching, contrastive=contrastive, batch=batch, representation=representation, caption=caption
    )
