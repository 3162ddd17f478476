"""Encode texts by fixed random vectors of their words: no weights, for tests and smoke runs only."""

from __future__ import annotations

import functools
import re

import numpy as np
import torch

from kinema.seeds import word_seed
from kinema.text.frozen import check_texts, standardise
from kinema.types import TextFeatures, frame_mask

_WORD = re.compile(r"[^\W_]+(?:'[^\W_]+)*")


class HashedTextEncoder:
    """Encode each word by a Gaussian vector seeded by its hash; texts that share words are similar.

    Pooled is the standardised sum of the word vectors. The same on every machine and in every process.
    """

    def __init__(self, dim: int = 64, device: torch.device | str = "cpu") -> None:
        self.dim = self.token_dim = dim
        self.device = torch.device(device)
        self.identity = f"hashed-{dim}"

    def __call__(self, texts: list[str]) -> TextFeatures:
        return self._encode(check_texts(texts))

    def empty(self) -> TextFeatures:
        """Encode the empty text as a word of its own."""
        return self._encode([""])

    def _encode(self, texts: list[str]) -> TextFeatures:
        rows = [np.stack([word_vector(w, self.dim) for w in split_words(text)]) for text in texts]
        lengths = torch.tensor([len(r) for r in rows])
        tokens = torch.zeros(len(texts), int(lengths.max()), self.dim)
        for i, row in enumerate(rows):
            tokens[i, : len(row)] = torch.from_numpy(row)
        pooled = standardise(tokens.sum(1))
        return TextFeatures(texts, pooled, tokens, frame_mask(lengths, tokens.shape[1])).to(self.device)


def split_words(text: str) -> list[str]:
    """Split a text into lower-case words; a text without any is its own word."""
    return _WORD.findall(text.lower()) or [text.strip()]


@functools.lru_cache(maxsize=1 << 16)
def word_vector(word: str, dim: int) -> np.ndarray:
    """Draw the Gaussian vector of a word, seeded by its SHA-256 (the built-in hash differs between processes)."""
    return np.random.default_rng(word_seed(word)).standard_normal(dim).astype(np.float32)
