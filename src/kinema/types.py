"""Hold the values that cross module boundaries: dataclasses only, no behaviour beyond moving and indexing."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Any, Self

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

Losses = dict[str, Tensor]
"""Named scalar losses; the first key is `loss`, the one that is minimised."""


@dataclass(frozen=True)
class Caption:
    """Hold one caption and its `word/POS` tokens (empty where the corpus has none)."""

    text: str
    tokens: tuple[str, ...] = ()


@dataclass
class _Movable:
    """Move every tensor field (also of nested values) to a device."""

    def to(self, device: torch.device | str, non_blocking: bool = False) -> Self:
        moved: dict[str, Any] = {}
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(value, Tensor | _Movable):
                moved[f.name] = value.to(device, non_blocking=non_blocking)
        return replace(self, **moved)


@dataclass
class MotionBatch(_Movable):
    """Hold full-width, de-normalised motion features; frames past the length are zero.

    `entries` and `starts` name the crop (row of the corpus index, first frame), so that what is computed from a crop
    can be cached. `captions` and `clip_ids` are empty for windows without text.
    """

    features: Float[Tensor, "b t d"]
    lengths: Int[Tensor, " b"]
    entries: Int[Tensor, " b"] | None = None
    starts: Int[Tensor, " b"] | None = None
    captions: list[Caption] = field(default_factory=list)
    clip_ids: list[str] = field(default_factory=list)

    @property
    def mask(self) -> Bool[Tensor, "b t"]:
        """True at real frames."""
        return frame_mask(self.lengths, self.features.shape[1])

    @property
    def texts(self) -> list[str]:
        """The caption strings."""
        return [c.text for c in self.captions]


@dataclass
class Latents(_Movable):
    """Hold what a tokenizer makes of motion: continuous `values` or discrete `codes`, never both.

    `lengths` counts latents, `frames` the motion frames they stand for (the two need not be proportional).
    """

    lengths: Int[Tensor, " b"]
    frames: Int[Tensor, " b"]
    values: Float[Tensor, "b n c"] | None = None
    codes: Int[Tensor, "b n q"] | None = None

    @property
    def mask(self) -> Bool[Tensor, "b n"]:
        """True at real positions."""
        held = self.codes if self.values is None else self.values
        if held is None:
            raise ValueError("these latents hold neither values nor codes; give one of them")
        return frame_mask(self.lengths, held.shape[1])


@dataclass
class TextFeatures(_Movable):
    """Hold everything a method may want of its text: strings, clip names, a pooled vector, token features and mask."""

    texts: list[str]
    pooled: Float[Tensor, "b c"]
    tokens: Float[Tensor, "b l k"] | None = None
    token_mask: Bool[Tensor, "b l"] | None = None
    clip_ids: list[str] = field(default_factory=list)


@dataclass
class Known(_Movable):
    """Hold what an edit keeps: the source's latents and a mask that is True at the positions to keep."""

    latents: Latents
    mask: Bool[Tensor, "b n"]


@dataclass
class Motion:
    """Hold one generated or captured motion as a user handles it.

    `joints` are positions (frames, joints, 3), Y up, in the skeleton's unit; `features` the rows they came from.
    """

    joints: np.ndarray
    features: np.ndarray
    text: str
    skeleton: str
    fps: float
    seed: int | None = None


def frame_mask(lengths: Int[Tensor, " b"], size: int) -> Bool[Tensor, "b t"]:
    """Make a mask that is True at positions below each length."""
    return torch.arange(size, device=lengths.device)[None, :] < lengths[:, None]
