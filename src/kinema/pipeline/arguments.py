"""Check what is asked of a pipeline, and spread it over the samples: lengths, texts, batches."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from kinema.text.frozen import check_texts
from kinema.types import Motion


def frame_counts(frames: Any, seconds: Any, size: int, *, fps: float, maximum: int) -> list[int] | None:
    """Return the frames of each of `size` samples from one value or one per sample; None if no length is asked for."""
    if frames is not None and seconds is not None:
        raise ValueError(f"got frames={frames} and seconds={seconds}; give one of them")
    if frames is None and seconds is None:
        return None
    asked = _spread(frames if seconds is None else seconds, size)
    for length in asked:
        if not np.isfinite(length):
            raise ValueError(
                f"length {length:g} is no length; give at most {maximum / fps:g} seconds ({maximum} frames)"
            )
    counts = asked if seconds is None else [round(a * fps) for a in asked]
    for count in counts:
        if count != int(count):
            raise ValueError(f"frames={count} is no whole number; give whole frames, or seconds=")
        check_length(count, maximum, fps)
    return [int(count) for count in counts]


def check_length(count: int, maximum: int, fps: float) -> None:
    """Refuse a length that training never saw."""
    if not 1 <= count <= maximum:
        raise ValueError(
            f"length {count} is out of range; allowed: 1 to {maximum} frames "
            f"({maximum / fps:g} seconds at {fps:g} frames per second)"
        )


def batches(size: int, batch_size: int) -> Iterator[slice]:
    if batch_size < 1:
        raise ValueError(f"batch_size is {batch_size}; give at least 1")
    return (slice(i, i + batch_size) for i in range(0, size, batch_size))


def _spread(values: Any, size: int) -> list[Any]:
    """Repeat one value, or check that there is one per text."""
    values = [values] * size if np.ndim(values) == 0 else list(values)
    if len(values) != size:
        raise ValueError(f"got {len(values)} lengths for {size} texts; give one, or one per text")
    return values


def paired(motions: Motion | Sequence[Motion], texts: str | Sequence[str]) -> tuple[list[Motion], list[str]]:
    """Return motions and texts of one length; a single one goes with all of the others."""
    motions = [motions] if isinstance(motions, Motion) else list(motions)
    texts = check_texts(texts)
    size = max(len(motions), len(texts))
    motions = motions * size if len(motions) == 1 else motions
    texts = texts * size if len(texts) == 1 else texts
    if len(motions) != len(texts):
        raise ValueError(f"got {len(motions)} motions and {len(texts)} texts; give one text, or one per motion")
    return motions, texts
