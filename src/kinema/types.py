"""Hold the values that cross module boundaries: dataclasses only, no behaviour beyond moving, indexing and counting."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal, Self, TypeVar

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
    """Hold de-normalised motion features, all columns or the essential ones; frames past the length are zero.

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
    def crops(self) -> list[tuple[int, int, int]]:
        """Entry, first frame and length of every crop; raises ValueError for a batch that isn't cut from a corpus."""
        if self.entries is None or self.starts is None:
            raise ValueError("this batch names no crops of a corpus (entries and starts)")
        return list(zip(self.entries.tolist(), self.starts.tolist(), self.lengths.tolist(), strict=True))

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
        return frame_mask(self.lengths, self.content.shape[1])

    @property
    def content(self) -> Float[Tensor, "b n c"] | Int[Tensor, "b n q"]:
        """The values or the codes, whichever there are."""
        held = self.values if self.codes is None else self.codes
        if held is None:
            raise ValueError("these latents hold neither values nor codes; give one of them")
        return held

    def holding(
        self,
        content: Float[Tensor, "b2 n2 c"] | Int[Tensor, "b2 n2 q"],
        lengths: Int[Tensor, " b2"],
        frames: Int[Tensor, " b2"],
    ) -> Latents:
        """Return latents of the same kind, values or codes, with other content."""
        return Latents(lengths, frames, **{"values" if self.codes is None else "codes": content})


Count = TypeVar("Count", int, Int[Tensor, " b"])


@dataclass(frozen=True)
class LatentSpace:
    """Say what a tokenizer makes and a generator is for, and how many latents stand for how many frames.

    `width` counts the channels of a latent, of a code vector or of a frame (None: a generator of codes that reads no
    code vectors). `unit` is the frames per latent; None says that every motion has the same `most` latents, whatever
    its length. `most` is the longest sequence of latents; codes come `quantizers` to a position.
    """

    kind: Literal["continuous", "codes", "frames"]
    width: int | None
    most: int
    unit: int | None = 4
    codebook_size: int | None = None
    quantizers: int = 1

    @property
    def classes(self) -> int:
        """The number of codes; raises ValueError where latents are no codes."""
        if self.codebook_size is None:
            raise ValueError(f"latents of kind {self.kind!r} are no codes; choose a tokenizer of codes")
        return self.codebook_size

    def latents_of(self, frames: Count) -> Count:
        """Count the whole latents in `frames`."""
        return frames * 0 + self.most if self.unit is None else frames // self.unit

    def frames_of(self, latents: Count) -> Count:
        """Count the frames of `latents`; raises ValueError where latents say nothing of time."""
        return latents * self.in_time("counting frames")

    def covered(self, frames: Count) -> Count:
        """Round down to the frames that whole latents stand for."""
        return frames if self.unit is None else frames // self.unit * self.unit

    def whole(self, frames: Count) -> Count:
        """Round up to the frames that whole latents stand for."""
        return frames if self.unit is None else (frames + self.unit - 1) // self.unit * self.unit

    def in_time(self, purpose: str) -> int:
        """Return the frames per latent; raises ValueError where latents have no place in time."""
        if self.unit is None:
            raise ValueError(
                f"{purpose} needs latents in time, but here {self.most} latents stand for the whole of a motion; "
                "choose a method whose tokenizer has a unit of frames"
            )
        return self.unit

    def in_frames(self, purpose: str) -> None:
        """Raise ValueError where latents aren't frames, whose features have a meaning each."""
        if self.kind != "frames":
            raise ValueError(
                f"{purpose} needs a method that generates frames (mdm, motiondiffuse, ...), but here latents are "
                f"{self.kind}: a part of one is no part of the body"
            )


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
    """Hold what an edit keeps: the source's latents and a mask that is True at what is kept.

    The mask is over positions, or for methods on frames over (frames, features): a part of the body.
    """

    latents: Latents
    mask: Bool[Tensor, "b n"] | Bool[Tensor, "b n c"]


@dataclass
class Motion:
    """Hold one generated or captured motion as a user handles it.

    `joints` are positions (frames, joints, 3), Y up, in the skeleton's unit; `features` their rows, which know neither
    where the motion stands nor which way it faces (an edit has that from its source's joints); `kept` is True at the
    frames (frames,) that an edit kept whole, or of a chain's parts (None: it is neither, or of a part of the body).
    """

    joints: np.ndarray
    features: np.ndarray
    text: str
    skeleton: str
    fps: float
    seed: int | None = None
    kept: np.ndarray | None = None


def frame_mask(lengths: Int[Tensor, " b"], size: int) -> Bool[Tensor, "b t"]:
    """Make a mask that is True at positions below each length."""
    return torch.arange(size, device=lengths.device)[None, :] < lengths[:, None]
