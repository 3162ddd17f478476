"""Keep generated motion on disk: a row that shows it to another judge, or lifts it, needn't generate it again."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Int
from torch import Tensor

from kinema.atomic import replacing
from kinema.evaluation.cache import text_key
from kinema.evaluation.sources import Generated, Source, answer
from kinema.files.arrays import Wanted, read_npz
from kinema.files.kinds import DamagedError
from kinema.locks import hold
from kinema.runs.console import console
from kinema.types import MotionBatch

FILE = {
    "features": Wanted("f", (None, None, None)),
    "lengths": Wanted("i", (None,)),
    "seconds": Wanted("f", ()),
    "names": Wanted("U", (None,)),
    "values": Wanted("f", (None,)),
}


@dataclass(frozen=True)
class Made:
    """Hold one answer: motion, the seconds that each took, and what the source measured of itself, by name."""

    features: np.ndarray
    lengths: np.ndarray
    seconds: float
    measured: dict[str, float]

    def save(self, file: Path) -> None:
        """Write it, whole or not at all."""
        arrays = {"features": self.features, "lengths": self.lengths, "seconds": np.array(self.seconds)}
        arrays |= {"names": np.array(list(self.measured), "U"), "values": np.array(list(self.measured.values()), "f8")}
        with replacing(file) as temporary, temporary.open("wb") as stream:
            np.savez(stream, allow_pickle=False, **arrays)

    @classmethod
    def read(cls, file: Path) -> Made | None:
        """Read it back; None where there is none, or a damaged one, which is said."""
        if not file.is_file():
            return None
        try:
            held = read_npz(file, FILE, fix="it is generated anew")
        except DamagedError as error:
            console.print(f"[yellow]note[/]      {error!s}")
            return None
        measured = dict(zip(held["names"].tolist(), held["values"].tolist(), strict=True))
        return cls(held["features"], held["lengths"], float(held["seconds"]), measured)


class Remembered(Source):
    """Answer as a generating source does, from a folder where it has answered the same before.

    The folder is of one model and one way to sample it; inside, an answer is found by what was asked: captions, clips'
    names, lengths and seeds. What the source measured of itself is that of when the motion was made.
    """

    def __init__(self, source: Generated, folder: Path) -> None:
        self.source, self.folder = source, folder
        self.label, self.multimodal, self.text_encoder = source.label, source.multimodal, source.text_encoder
        self.dims = source.dims
        self._given: list[tuple[int, float, dict[str, float]]] = []
        self._seconds: float | None = None

    def __call__(self, batch: MotionBatch, seeds: Int[Tensor, " b"]) -> MotionBatch:
        """Give the motions that are there, or generate and keep them; of two that ask at once one generates."""
        file = self.folder / f"{asked(batch, seeds)}.npz"
        with hold(self.folder / f".{file.stem}.lock"):
            made = Made.read(file)
            if made is None:
                made = self._make(batch, seeds)
                made.save(file)
        self._given.append((len(made.lengths), made.seconds, made.measured))
        device = batch.features.device
        return answer(batch, torch.from_numpy(made.features).to(device), torch.from_numpy(made.lengths).to(device))

    def measured(self) -> dict[str, float]:
        """Return the means over all motions since the last call of what was measured when they were made."""
        given, self._given, self._seconds = self._given, [], None
        if not given:
            return {}
        sizes, took, counted = zip(*given, strict=True)
        self._seconds = float(np.average(took, weights=sizes))
        return {name: float(np.average([each[name] for each in counted], weights=sizes)) for name in counted[0]}

    def seconds(self) -> float | None:
        """Return how long one of the motions that were `measured` last took to make."""
        return self._seconds

    def _make(self, batch: MotionBatch, seeds: Int[Tensor, " b"]) -> Made:
        motion = self.source(batch, seeds)
        features, lengths = motion.features.float().cpu().numpy(), motion.lengths.cpu().numpy()
        seconds = self.source.seconds()
        assert seconds is not None  # of the call above
        return Made(features, lengths, seconds, self.source.measured())


def asked(batch: MotionBatch, seeds: Int[Tensor, " b"]) -> str:
    """Name what a source is asked for: captions, clips, lengths and seeds of a batch."""
    numbers = [batch.lengths.tolist(), seeds.tolist()]
    return hashlib.sha256(repr([text_key(batch.captions), batch.clip_ids, numbers]).encode()).hexdigest()[:24]
