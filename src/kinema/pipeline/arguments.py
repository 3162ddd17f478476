"""Check what is asked of a pipeline, and spread it over the samples: lengths, texts, batches."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from torch import Tensor

from kinema.motion.representation import Representation
from kinema.options import Count, check_value
from kinema.text.frozen import check_texts
from kinema.types import Motion

BATCH = 32
"""Motions that are generated at once, unless another number is asked for."""

ENDLESS = 10**9
"""Frames that nobody means; more are not counted."""

CHAIN_HINT = "; longer ones are made of parts (--chain, TextToMotion.chain)"
"""What to do about a motion that is to be longer than a model's longest."""


def frame_counts(
    frames: Any, seconds: Any, size: int, *, fps: float, maximum: int, fix: str = CHAIN_HINT
) -> list[int | None]:
    """Return the frames of each of `size` samples from one value or one per sample; None where none are asked for.

    Raises ValueError for a length out of range; `fix` is told of one that is too long.
    """
    if frames is not None and seconds is not None:
        raise ValueError(f"got frames={frames} and seconds={seconds}; give one of them")
    name, kind, given = ("frames", int, frames) if seconds is None else ("seconds", float, seconds)
    asked: list[Any] = [
        value.item() if isinstance(value, np.generic | Tensor) else value for value in _spread(given, size)
    ]
    for value in asked:
        if value is not None:
            check_value(value, kind, name)
    counts = [value if value is None or seconds is None else frames_in(value, fps) for value in asked]
    for count in counts:
        if count is not None:
            check_length(count, maximum, fps, fix)
    return counts


def frames_in(seconds: float, fps: float) -> int:
    """Return the frames of a duration, at most ENDLESS."""
    return round(min(seconds * fps, ENDLESS))


def check_length(count: int, maximum: int, fps: float, fix: str = "", where: str = "") -> None:
    """Refuse a length that training never saw; `fix` is told of a longer one, `where` said in front."""
    if not 1 <= count <= maximum:
        told = count if count < ENDLESS else f"of more than {ENDLESS:,} frames"
        raise ValueError(
            f"{where}length {told} is out of range; allowed: 1 to {maximum} frames "
            f"({maximum / fps:g} seconds at {fps:g} frames per second){fix if count > maximum else ''}"
        )


def batches(size: int, batch_size: int) -> Iterator[slice]:
    check_value(batch_size, Count, "batch_size")
    return (slice(i, i + batch_size) for i in range(0, size, batch_size))


def batches_by_length(counts: Sequence[int | None], batch_size: int) -> Iterator[list[int]]:
    """Give the places of samples batch by batch: those with a length first, then those without."""
    for wanted in (False, True):
        places = [i for i, count in enumerate(counts) if (count is None) is wanted]
        yield from (places[part] for part in batches(len(places), batch_size))


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


def check_sources(motions: Sequence[Motion], representation: Representation, maximum: int) -> None:
    """Refuse motions that a model of this representation can't edit."""
    skeleton = representation.skeleton
    for i, motion in enumerate(motions):
        if motion.skeleton != skeleton.name:
            raise ValueError(f"motion {i} has the skeleton {motion.skeleton!r}, the model {skeleton.name!r}")
        if motion.features.shape[1] < representation.width:
            raise ValueError(
                f"motion {i} has {motion.features.shape[1]} feature columns, this model ({representation.kind}) "
                f"needs {representation.width}; extract them from its joints with kinema.motion.features.extract"
            )
        if not np.isfinite(motion.features).all():
            raise ValueError(f"motion {i} holds NaN or infinite features; repair it before editing")
        check_length(len(motion.features), maximum, skeleton.fps, f"; cut a part of it out (--part 0:{maximum})")
