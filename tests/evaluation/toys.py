"""Hold a tokenizer, generators and a text encoder that do something plain, as one model."""

from __future__ import annotations

import torch

from kinema.generators import Generator
from kinema.motion.representation import Representation
from kinema.pipeline import TextToMotion
from kinema.tokenizers import MotionTokenizer
from kinema.types import Latents, LatentSpace, MotionBatch, TextFeatures, frame_mask


class Halves(MotionTokenizer):
    """Tokenize by keeping every fourth frame of the essential columns."""

    space = LatentSpace("continuous", 67, 49, 4)
    representation = Representation("essential", "humanml3d")

    def loss(self, motion, *, generator=None, shard=(0, 1)):
        raise ValueError("nothing to learn")

    def encode(self, batch, *, generator=None):
        lengths = batch.lengths // 4
        return Latents(lengths, lengths * 4, batch.features[:, ::4, :67])

    def decode(self, latents):
        features = latents.values.repeat_interleave(4, 1)
        features = features * frame_mask(latents.frames, features.shape[1])[..., None]
        return MotionBatch(features, latents.frames)


class Echo(Generator):
    """Generate each row from its text feature and seed."""

    space = Halves.space
    sampling = 1.0

    def __init__(self, predicts_length=False):
        super().__init__()
        self.predicts_length = predicts_length
        self.anchor = torch.nn.Parameter(torch.zeros(()))

    def loss(self, latents, text, *, generator=None, shard=(0, 1)):
        raise ValueError("nothing to learn")

    def sample(self, text, frames, *, seeds, known=None, sampling=None):
        frames = torch.full_like(seeds, 12) if frames is None else frames
        values = torch.zeros(len(frames), int(frames.max()) // 4, 67)
        values += text.pooled[:, :1, None] * sampling + seeds[:, None, None]
        return Latents(frames // 4, frames, values)


class Letters:
    """Count letters: equal texts are nearest to each other."""

    identity, dim, token_dim = "letters", 26, 0

    def __call__(self, texts):
        counts = [[t.count(c) + 1e-3 for c in "abcdefghijklmnopqrstuvwxyz"] for t in texts]
        return TextFeatures(texts, torch.tensor(counts))

    def empty(self):
        return self([""])


letters = Letters()


def model(generator=None, **parts):
    return TextToMotion(Halves(), generator or Echo(), letters, parts)


def seeds(size):
    return torch.arange(size) + 5


class Doubling(torch.nn.Module):
    def forward(self, x):
        return 2 * x


class Evaluated(Echo):
    """Call a network three times per batch, with two rows for each motion, as guidance does."""

    def __init__(self):
        super().__init__()
        self.network = Doubling()

    @property
    def networks(self):
        return {"denoiser": self.network}

    def sample(self, text, frames, *, seeds, known=None, sampling=None):
        for _ in range(3):
            self.network(torch.cat((text.pooled, text.pooled)))
        return super().sample(text, frames, seeds=seeds, known=known, sampling=2.0)
