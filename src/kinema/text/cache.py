"""Encode every text once: a cache on disk in front of a frozen text encoder, shared by processes and runs."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import torch

from kinema.text.frozen import FrozenTextEncoder, check_texts
from kinema.text.packed import PackedFeatures
from kinema.types import TextFeatures, frame_mask

CHUNK = 256


class CachedTextEncoder:
    """Answer like the encoder it wraps, on the CPU, and run it only for texts that the cache lacks.

    Each encoder identity has its own folder below `directory`. A writer holds the folder's lock while it encodes, so no
    text is encoded twice, whatever the number of processes. `encoded` counts the texts this object had encoded.

    Args:
        tokens: "float32", "float16" (half the disk, rounded to 3 digits) or None (pooled vectors only: 2 kB a text
            instead of 30, for methods that read no token features).
    """

    def __init__(
        self, encoder: FrozenTextEncoder, directory: str | Path, tokens: str | None = "float32", chunk: int = CHUNK
    ) -> None:
        if tokens not in ("float32", "float16", None):
            raise ValueError(f"tokens={tokens!r} is not 'float32', 'float16' or None (pooled vectors only)")
        self.encoder, self.token_dtype, self.chunk = encoder, tokens, chunk
        self.identity, self.dim, self.token_dim = encoder.identity, encoder.dim, encoder.token_dim
        self.folder = Path(directory) / (re.sub(r"[^\w.-]+", "_", encoder.identity) + f"-{tokens or 'pooled'}")
        self.encoded = 0
        self._features: PackedFeatures | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Leave the maps behind: another process opens the folder itself."""
        return self.__dict__ | {"_features": None}

    @property
    def features(self) -> PackedFeatures:
        """Open the folder at first use."""
        if self._features is None:
            self._features = PackedFeatures(self.folder, self.identity, self.dim, self.token_dim, self.token_dtype)
        return self._features

    def __call__(self, texts: list[str] | str) -> TextFeatures:
        texts = [texts] if isinstance(texts, str) else texts
        index = self.features.index
        try:
            rows = [index[text] for text in texts]
        except (KeyError, TypeError):  # a text is new, or no string at all
            rows = []
        if not rows:
            self.ensure(texts)
            rows = [index[text] for text in texts]
        return self._gather(list(texts), np.array(rows))

    def empty(self) -> TextFeatures:
        """Encode the empty text anew: it is asked for once in a training."""
        return self.encoder.empty().to("cpu")

    def ensure(self, texts: list[str]) -> None:
        """Encode what the cache lacks, in chunks that are each on disk when the next begins."""
        missing = [text for text in dict.fromkeys(check_texts(texts)) if text not in self.features.index]
        missing.sort(key=len)
        for start in range(0, len(missing), self.chunk):
            with self.features.writing():
                new = [text for text in missing[start : start + self.chunk] if text not in self.features.index]
                if new:
                    self._encode(new)

    def _encode(self, texts: list[str]) -> None:
        found = self.encoder(texts)
        pooled = found.pooled.detach().float().cpu().numpy()
        if not np.isfinite(pooled).all():
            raise ValueError(f"{self.identity} gave features that are not finite; check its weights file")
        tokens = [np.zeros((0, self.token_dim), np.float32)] * len(texts)
        if self.token_dtype is not None:
            if found.tokens is None or found.token_mask is None:
                raise ValueError(f"{self.identity} gives no token features; cache its pooled vectors with tokens=None")
            values, lengths = found.tokens.detach().float().cpu().numpy(), found.token_mask.sum(1).tolist()
            tokens = [row[:length] for row, length in zip(values, lengths, strict=True)]
        self.features.append(texts, pooled, tokens)
        self.encoded += len(texts)

    def _gather(self, texts: list[str], rows: np.ndarray) -> TextFeatures:
        store = self.features
        pooled = torch.from_numpy(store.pooled[rows])
        if self.token_dtype is None:
            return TextFeatures(texts, pooled)
        starts, lengths = store.ends[rows], store.ends[rows + 1] - store.ends[rows]
        values = np.zeros((len(rows), int(lengths.max()), self.token_dim), store.token_dtype)
        for value, start, length in zip(values, starts, lengths, strict=True):
            value[:length] = store.tokens[start : start + length]
        mask = frame_mask(torch.from_numpy(lengths), values.shape[1])
        return TextFeatures(texts, pooled, torch.from_numpy(values).float(), mask)
