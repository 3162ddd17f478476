"""Compute, save and name the mean and the grouped standard deviation of a corpus (HUMANML3D_DATA §6)."""

from __future__ import annotations

import hashlib
import zipfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinema.atomic import replacing
from kinema.motion.skeleton import Skeleton

PUBLISHED_DIVISOR = 25.0
"""The T2M family's feat_bias of 5, applied twice to one shared array."""


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
        count, mean, squares = 0, np.empty(0), np.empty(0)
        for index, chunk in enumerate(chunks):
            rows = np.asarray(chunk, dtype=np.float64)
            if rows.ndim != 2 or rows.shape[1] not in (skeleton.feature_width, skeleton.essential_width):
                raise ValueError(
                    f"chunk {index} has shape {rows.shape}; skeleton {skeleton.name!r} needs "
                    f"(n, {skeleton.feature_width}) or (n, {skeleton.essential_width})"
                )
            if len(rows) == 0:
                continue
            if not np.isfinite(rows).all():
                raise ValueError(
                    f"chunk {index} holds NaN or infinite values; leave such clips out (see motion.checks)"
                )
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
        return cls(mean=mean, std=_grouped(np.sqrt(squares / count), skeleton))

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
        files = [path / "Mean.npy", path / "Std.npy"] if path.is_dir() else [path]
        arrays = {name: values for file in files for name, values in _read(file).items()}
        if not {"mean", "std"} <= arrays.keys():
            raise ValueError(f"{path} holds no 'mean' and 'std'; give a file of Statistics.save")
        return cls(arrays["mean"].astype(np.float64), arrays["std"].astype(np.float64))


def _read(path: Path) -> dict[str, np.ndarray]:
    """Read an .npz, or an .npy as one array of the file's name; neither executes code."""
    if not path.is_file():
        raise FileNotFoundError(f"{path} is absent; give an .npz of Statistics.save or a folder with Mean.npy, Std.npy")
    try:
        loaded = np.load(path, allow_pickle=False)
    except (ValueError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(f"{path} is no .npy or .npz of plain numbers ({error}); write it again") from None
    if isinstance(loaded, np.ndarray):
        return {path.stem.lower(): loaded}
    with loaded:
        return dict(loaded)


def _grouped(std: np.ndarray, skeleton: Skeleton) -> np.ndarray:
    """Replace each deviation by the mean over its group."""
    grouped = std.copy()
    for columns in skeleton.groups.values():
        if columns.stop <= len(std):
            grouped[columns] = std[columns].mean() or 1.0
    return grouped
