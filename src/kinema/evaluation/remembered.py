"""Keep generated motion on disk: a row that shows it to another judge, or lifts it, needn't generate it again."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Int
from torch import Tensor

from kinema.atomic import replacing
from kinema.evaluation.cache import text_key
from kinema.evaluation.source import Together, answer
from kinema.evaluation.sources import Generated
from kinema.evaluation.together import Asked
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


class Remembered(Together):
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

    def answer_all(self, questions: Sequence[Asked]) -> list[MotionBatch]:
        """Give the motions that are there, or generate and keep them; of two that ask at once one generates."""
        files = [self.folder / f"{asked(batch, seeds)}.npz" for batch, seeds in questions]
        with ExitStack() as held:
            for name in sorted({file.stem for file in files}):  # in one order: no two wait for each other
                held.enter_context(hold(self.folder / f".{name}.lock"))
            found = {file: Made.read(file) for file in files}
            missing = {file: one for file, one in zip(files, questions, strict=True) if found[file] is None}
            for file, made in zip(missing, self._make(list(missing.values())), strict=True):
                made.save(file)
                found[file] = made
        return [self._give(found[file], batch) for file, (batch, _) in zip(files, questions, strict=True)]

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

    def _make(self, questions: Sequence[Asked]) -> list[Made]:
        motions = self.source.answer_all(questions)
        if not motions:
            return []
        seconds, measured = self.source.seconds(), self.source.measured()
        assert seconds is not None  # of the call above
        arrays = [(motion.features.float().cpu().numpy(), motion.lengths.cpu().numpy()) for motion in motions]
        return [Made(features, lengths, seconds, measured) for features, lengths in arrays]

    def _give(self, made: Made | None, batch: MotionBatch) -> MotionBatch:
        assert made is not None
        self._given.append((len(made.lengths), made.seconds, made.measured))
        device = batch.features.device
        return answer(batch, torch.from_numpy(made.features).to(device), torch.from_numpy(made.lengths).to(device))


def asked(batch: MotionBatch, seeds: Int[Tensor, " b"]) -> str:
    """Name what a source is asked for: captions, clips, lengths and seeds of a batch."""
    numbers = [batch.lengths.tolist(), seeds.tolist()]
    return hashlib.sha256(repr([text_key(batch.captions), batch.clip_ids, numbers]).encode()).hexdigest()[:24]
