"""Keep embeddings of real motion and captions on disk: they are the same for every source of a replication."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from kinema.atomic import replacing
from kinema.files.arrays import Wanted, read_npz
from kinema.files.kinds import DamagedError
from kinema.runs.console import console
from kinema.types import Caption, MotionBatch


class EmbeddingCache:
    """Hold one .npz per (evaluator, corpus, seed, replication) in a folder, and one of the training motions.

    Inside, embeddings are found by what was embedded (its SHA-256), so a changed crop, caption or order is computed
    anew, never served; training motions are those of the corpus. `corpus` (its manifest hash) keeps corpora apart.
    """

    def __init__(self, directory: str | Path, corpus: str = "") -> None:
        self.directory = Path(directory)
        self.corpus = corpus

    def shelf(self, evaluator: str, seed: int, replication: int) -> Shelf:
        """Open what is known for an evaluator (by its identity) and a replication."""
        name = "-".join(part for part in (self.corpus, f"s{seed}", f"r{replication:03d}") if part)
        return Shelf(self.directory / evaluator / f"{name}.npz")

    def training(self, evaluator: str) -> Shelf:
        """Open what is known of the corpus' training motions for an evaluator."""
        name = "-".join(part for part in (self.corpus, "train") if part)
        return Shelf(self.directory / evaluator / f"{name}.npz")


class Shelf:
    """Hold arrays of one replication, or of the training motions; `path=None` keeps nothing beyond the process."""

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self.computed = 0
        self._known: dict[str, np.ndarray] = {}
        if path is not None and path.is_file():
            try:
                self._known = read_npz(path, Wanted("f"), fix="it is computed anew")
            except DamagedError as error:
                console.print(f"[yellow]note[/]      {error!s}")

    def get(self, key: str, compute: Callable[[], Tensor], device: torch.device) -> Tensor:
        """Return the embeddings under a key; compute them once."""
        if key not in self._known:
            self._known[key] = compute().detach().float().cpu().numpy()
            self.computed += 1
        return torch.from_numpy(self._known[key]).to(device)

    def save(self) -> None:
        """Write everything known, whole or not at all, if something was added."""
        if self.path is None or not self.computed:
            return
        with replacing(self.path) as temporary, temporary.open("wb") as file:
            np.savez(file, allow_pickle=False, **self._known)
        self.computed = 0


def motion_key(batch: MotionBatch) -> str:
    """Name a batch of motions by its content."""
    digest = hashlib.sha256(repr(tuple(batch.features.shape)).encode())
    for tensor in (batch.features, batch.lengths):
        digest.update(tensor.detach().cpu().contiguous().numpy().data)
    return f"motion-{digest.hexdigest()[:24]}"


def text_key(captions: list[Caption]) -> str:
    """Name a batch of captions by its content, tokens included."""
    content = repr([(c.text, tuple(c.tokens)) for c in captions])
    return f"text-{hashlib.sha256(content.encode()).hexdigest()[:24]}"
