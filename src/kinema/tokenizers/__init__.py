"""Turn motion into latents and back: what a tokenizer owes and, one file each, what implements it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from kinema.motion.representation import Representation
from kinema.types import Latents, LatentSpace, Losses, MotionBatch, frame_mask


class MotionTokenizer(nn.Module, ABC):
    """Map motion to latents and back; owns the representation that it was trained on.

    `space` says what it makes. `deterministic`: the same motion always has the same latents, so that they can be
    cached; if not, `encode` draws from its `generator`, and without one gives the likeliest. `copies`: latents are the
    motion's own numbers, which a cache would only multiply. `placed`: latents say where in space a motion stands, so
    that they can't be laid one behind the other. `holds_joints`: single joints of a frame can be known by their places
    (`joint_numbers`). `spec` rebuilds it.
    """

    space: LatentSpace
    representation: Representation
    deterministic: bool = True
    copies: bool = False
    placed: bool = False
    holds_joints: bool = False
    spec: dict[str, Any] | None = None

    @property
    def codebook(self) -> Float[Tensor, "k d"] | None:
        """The code vectors (of the first layer); None where latents are no codes."""
        return None

    @property
    def groups(self) -> dict[str, slice]:
        """Name the groups of a latent's numbers: of frames those of the feature row, of any other all as one."""
        return self.representation.groups if self.space.kind == "frames" else {"latents": slice(0, self.space.width)}

    def identity(self) -> dict[str, str]:
        """Name what the numbers mean that latents are made of; raises ValueError without statistics."""
        return self.representation.identity()

    def prepare(self, clips: Iterable[np.ndarray]) -> None:
        """Take what is needed of the training clips, feature rows of full width, before training or in its place.

        The representation has the corpus' statistics already; most tokenizers need no more.
        """

    def finish(self, clips: Iterable[np.ndarray]) -> None:
        """Take what is needed of the training clips once the weights are trained."""

    @abstractmethod
    def loss(
        self, motion: MotionBatch, *, generator: torch.Generator | None = None, shard: tuple[int, int] = (0, 1)
    ) -> Losses:
        """Return the training losses, `loss` first; draws come from `generator`, for the batch that `shard` is of."""

    @abstractmethod
    def encode(self, motion: MotionBatch, *, generator: torch.Generator | None = None) -> Latents:
        """Encode de-normalised features of the representation's width or more."""

    @abstractmethod
    def decode(self, latents: Latents) -> MotionBatch:
        """Decode to de-normalised features of the representation's width; frames past `frames` are zero."""

    def joints(self, values: Float[Tensor, "b n c"]) -> Float[Tensor, "b n j 3"]:
        """Place the joints of latents that are frames, in the skeleton's unit, so that gradients reach the values.

        Raises ValueError where a latent is no frame.
        """
        raise ValueError(f"{type(self).__name__} places no joints: its latents are {self.space.kind}, not frames")

    def encode_pieces(
        self, motion: MotionBatch, rows: Int[Tensor, " p"], starts: Int[Tensor, " p"], lengths: Int[Tensor, " p"]
    ) -> Latents:
        """Encode pieces of motions by themselves: of motion `rows[i]`, `lengths[i]` frames from `starts[i]` on."""
        return self.encode(MotionBatch(pieces(motion.features, rows, starts, lengths), lengths))

    def known_numbers(self, keep: Bool[Tensor, "b t d"]) -> Bool[Tensor, "b t c"]:
        """Say which numbers of its frames are known where these columns of feature rows are kept.

        Raises ValueError where latents aren't frames.
        """
        self.space.in_frames("regenerating a part of the body")
        return keep

    def joint_numbers(self, keep: Bool[Tensor, "b t j"]) -> Bool[Tensor, "b t c"]:
        """Say which numbers of its frames are the places of these joints; raises ValueError where none are."""
        raise ValueError(
            f"{type(self).__name__} holds no joints by their places; choose a method whose frames are joints, such as "
            "method=msflow"
        )

    def described(
        self,
        made: MotionBatch,
        source: Float[Tensor, "b t d"],
        keep: Bool[Tensor, "b t"] | Bool[Tensor, "b t d"],
    ) -> MotionBatch:
        """Describe decoded motion so that the rows of its source can be put back into it, where they are kept."""
        return made


def pieces(
    values: Float[Tensor, "b t *c"], rows: Int[Tensor, " p"], starts: Int[Tensor, " p"], lengths: Int[Tensor, " p"]
) -> Float[Tensor, "p n *c"]:
    """Cut pieces out of sequences, zero past their lengths."""
    offsets = torch.arange(int(lengths.max()), device=values.device)
    found = values[rows[:, None], (starts[:, None] + offsets).clamp(max=values.shape[1] - 1)]
    return found * frame_mask(lengths, len(offsets)).view(*found.shape[:2], *[1] * (found.ndim - 2))
