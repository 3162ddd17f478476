"""Compute, save and name the mean and the grouped standard deviation of a corpus (HUMANML3D_DATA §6)."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinema.atomic import replacing
from kinema.files.arrays import Wanted, read_npy, read_npz
from kinema.motion.skeleton import Skeleton

PUBLISHED_DIVISOR = 25.0
"""The T2M family's feat_bias of 5, applied twice to one shared array."""

VECTOR = Wanted(shape=(None,))
FIX = "give an .npz of Statistics.save or a folder with Mean.npy, Std.npy"


@dataclass(frozen=True, eq=False)
class Statistics:
    """Hold the per-column mean and the standard deviation averaged inside each column group."""

    mean: np.ndarray
    std: np.ndarray

    def __post_init__(self) -> None:
        if self.mean.ndim != 1 or self.mean.shape != self.std.shape:
            raise ValueError(f"mean {self.mean.shape} and std {self.std.shape} must be two vectors of one length")
        if not (np.isfinite(self.mean).all() and np.isfinite(self.std).all() and (self.std > 0).all()):
            raise ValueError("statistics hold NaN, infinite or non-positive values; compute them from checked clips")

    @classmethod
    def compute(cls, chunks: Iterable[np.ndarray], skeleton: Skeleton) -> Statistics:
        """Compute them over all rows of all chunks (n, width), in float64, with the population deviation.

        The width is the skeleton's full or essential one. A constant group keeps the deviation 1. Raises ValueError
        for chunks of another width, with NaN, or without any row.
        """
        mean, std = moments(_checked(chunks, skeleton))
        return cls(mean=mean, std=_grouped(std, skeleton))

    def published(self, skeleton: Skeleton) -> Statistics:
        """Return the T2M family's variant: deviation of root and contact columns divided by 25 (HUMANML3D_DATA §6)."""
        std = self.std.copy()
        std[: skeleton.groups["root_height"].stop] /= PUBLISHED_DIVISOR
        std[skeleton.groups["contacts"]] /= PUBLISHED_DIVISOR
        return Statistics(self.mean, std)

    def digest(self) -> str:
        """Name the values by 12 hex digits of the SHA-256 of their float32 bytes."""
        values = np.concatenate([self.mean, self.std]).astype("<f4")
        return hashlib.sha256(values.tobytes()).hexdigest()[:12]

    def save(self, path: str | Path) -> None:
        """Write both vectors to one .npz, whole or not at all."""
        with replacing(path) as temporary, temporary.open("wb") as file:
            np.savez(file, mean=self.mean, std=self.std)

    @classmethod
    def load(cls, path: str | Path) -> Statistics:
        """Read an .npz written by `save`, or a folder with the published `Mean.npy` and `Std.npy`."""
        path = Path(path)
        if path.is_dir():
            mean, std = (read_npy(path / name, VECTOR, fix=FIX) for name in ("Mean.npy", "Std.npy"))
        else:
            mean, std = read_npz(path, {"mean": VECTOR, "std": VECTOR}, fix=FIX).values()
        try:
            return cls(mean.astype(np.float64), std.astype(np.float64))
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None


def moments(chunks: Iterable[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and population deviation of every column over all rows of all chunks (n, d), in float64.

    Raises ValueError where there is no row.
    """
    count, mean, squares = 0, np.empty(0), np.empty(0)
    for chunk in chunks:
        rows = np.asarray(chunk, dtype=np.float64)
        if len(rows) == 0:
            continue
        chunk_mean = rows.mean(0)
        chunk_squares = np.square(rows - chunk_mean).sum(0)
        if count == 0:
            count, mean, squares = len(rows), chunk_mean, chunk_squares
            continue
        # Chan's merge: exact however long the corpus, unlike a running sum of squares.
        total = count + len(rows)
        delta = chunk_mean - mean
        squares = squares + chunk_squares + np.square(delta) * count * len(rows) / total
        mean = mean + delta * len(rows) / total
        count = total
    if count == 0:
        raise ValueError("no rows to compute statistics from; is the corpus empty?")
    return mean, np.sqrt(squares / count)


def _checked(chunks: Iterable[np.ndarray], skeleton: Skeleton) -> Iterator[np.ndarray]:
    """Refuse chunks of another width or with NaN."""
    for index, chunk in enumerate(chunks):
        rows = np.asarray(chunk, dtype=np.float64)
        if rows.ndim != 2 or rows.shape[1] not in (skeleton.feature_width, skeleton.essential_width):
            raise ValueError(
                f"chunk {index} has shape {rows.shape}; skeleton {skeleton.name!r} needs "
                f"(n, {skeleton.feature_width}) or (n, {skeleton.essential_width})"
            )
        if not np.isfinite(rows).all():
            raise ValueError(f"chunk {index} holds NaN or infinite values; leave such clips out (see motion.checks)")
        yield rows


def _grouped(std: np.ndarray, skeleton: Skeleton) -> np.ndarray:
    """Replace each deviation by the mean over its group."""
    grouped = std.copy()
    for columns in skeleton.groups.values():
        if columns.stop <= len(std):
            grouped[columns] = std[columns].mean() or 1.0
    return grouped
