"""Compress motion four-fold in time into continuous latents: MARDM's autoencoder (MARDM §3)."""

from __future__ import annotations

from typing import Annotated

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor

from kinema.motion.representation import Representation
from kinema.nn.conv import ConvDecoder, ConvEncoder
from kinema.options import Depth, Levels, NonNegative, OneOf, OpenShare, Size, checked
from kinema.registry import buildable
from kinema.tokenizers import MotionTokenizer
from kinema.types import Latents, LatentSpace, Losses, MotionBatch, frame_mask

ROOT = 4
"""Dims of the root: yaw velocity, velocity x and z, height; they come first in every representation."""

ERRORS = {"smooth_l1": F.smooth_l1_loss, "l1": F.l1_loss, "l2": F.mse_loss}
"""How far two rows are apart: the published codes' SmoothL1, or what the papers' equations say."""


@buildable
class AutoEncoder(MotionTokenizer):
    """Encode motion (b, t, d) to raw latents (b, t // 4, latent_dim) and back, without a bottleneck regulariser.

    `mask_padding` makes a clip's result independent of the padding of its batch: equal to the clip alone. False is
    what the published code does (padding past a clip's end leaks into its last frames). `error` is one of `ERRORS`:
    "l1" with joint_weight=0 is the paper's loss (Eq. 8). The encoder gives `outputs` numbers for each latent dim.
    """

    outputs = 1

    @checked
    def __init__(
        self,
        representation: Representation,
        *,
        width: Size = 512,
        latent_dim: Size = 512,
        depth: Depth = 3,
        dilation_growth: Size = 3,
        down_levels: Levels = 2,
        dropout: OpenShare = 0.2,
        joint_weight: NonNegative = 1.0,
        root_weight: NonNegative = 0.0,
        error: Annotated[str, OneOf(ERRORS)] = "smooth_l1",
        mask_padding: bool = True,
    ) -> None:
        super().__init__()
        self.error = ERRORS[error]
        net = {"width": width, "levels": down_levels, "depth": depth, "dilation_growth": dilation_growth}
        self.representation = representation
        self.encoder = ConvEncoder(representation.width, self.outputs * latent_dim, **net, dropout=dropout)
        self.decoder = ConvDecoder(latent_dim, representation.width, **net, dropout=dropout)
        unit = 2**down_levels
        self.space = LatentSpace("continuous", latent_dim, (representation.skeleton.max_frames - 1) // unit, unit)
        self.joint_weight = joint_weight
        self.root_weight = root_weight
        self.mask_padding = mask_padding

    def loss(
        self, motion: MotionBatch, *, generator: torch.Generator | None = None, shard: tuple[int, int] = (0, 1)
    ) -> Losses:
        """Return the error over all dims plus `joint_weight` times that over the joint positions (MARDM §3).

        The paper's Eq. 8 is L1; the published code and the defaults take SmoothL1 and add the joints' term.
        `root_weight` adds the same term for the four root dims (not published: 0): a small autoencoder spends little on
        4 of 67 dims, and an error of the yaw velocity adds up to drift. Means run over real frames.
        """
        target = self.representation.normalize(motion.features, motion.lengths)
        return self._losses(self._encode(target, motion.lengths), target, motion.lengths)

    def _losses(
        self, z: Float[Tensor, "b n c"], target: Float[Tensor, "b t d"], lengths: Int[Tensor, " b"]
    ) -> dict[str, Tensor]:
        """Decode latents and compare with the normalised features."""
        output = self._decode(z, self.space.latents_of(lengths))
        real = frame_mask(self.space.covered(lengths), output.shape[1])
        error = self.error(output, target[:, : output.shape[1]], reduction="none")
        reconstruction = mean_of_real(error, real)
        joints = mean_of_real(error[..., self.representation.groups["joints"]], real)
        loss = reconstruction + self.joint_weight * joints
        losses = {"reconstruction": reconstruction, "joints": joints}
        if self.root_weight:
            losses["root"] = mean_of_real(error[..., :ROOT], real)
            loss = loss + self.root_weight * losses["root"]
        return {"loss": loss, **losses}

    def encode(self, motion: MotionBatch, *, generator: torch.Generator | None = None) -> Latents:
        """Encode a batch; a tail of fewer than four frames has no latent of its own and is dropped.

        Raises ValueError if the padded batch is shorter than one latent.
        """
        require_frames(motion, self.space)
        values = self._encode(self.representation.normalize(motion.features, motion.lengths), motion.lengths)
        lengths, frames = self.space.latents_of(motion.lengths), self.space.covered(motion.lengths)
        return Latents(lengths=lengths, frames=frames, values=values)

    def decode(self, latents: Latents) -> MotionBatch:
        """Decode to de-normalised features (b, 4n, representation.width), zero past `latents.frames`."""
        if latents.values is None:
            raise ValueError("this tokenizer decodes continuous values, not codes; use the tokenizer that made them")
        normalized = self._decode(latents.values, latents.lengths)
        frames = torch.minimum(latents.frames, self.space.frames_of(latents.lengths))
        return MotionBatch(self.representation.denormalize(normalized, frames), frames)

    def _encode(self, x: Float[Tensor, "b t d"], lengths: Int[Tensor, " b"]) -> Float[Tensor, "b n c"]:
        return self.encoder(x, self._padded(lengths, x.shape[1]))

    def _decode(self, z: Float[Tensor, "b n c"], lengths: Int[Tensor, " b"]) -> Float[Tensor, "b t d"]:
        return self.decoder(z, self._padded(lengths, z.shape[1]))

    def _padded(self, lengths: Int[Tensor, " b"], size: int) -> Int[Tensor, " b"] | None:
        """Return the lengths if something has to be masked."""
        return lengths if self.mask_padding and bool((lengths < size).any()) else None


def require_frames(motion: MotionBatch, space: LatentSpace) -> None:
    """Raise ValueError if the padded batch is shorter than one latent."""
    least = space.frames_of(1)
    if motion.features.shape[1] < least:
        raise ValueError(f"motion of {motion.features.shape[1]} frames is too short to encode; give at least {least}")


def mean_of_real(error: Float[Tensor, "b t d"], real: Bool[Tensor, "b t"]) -> Float[Tensor, ""]:
    """Average over the columns of real frames."""
    return (error * real[..., None]).sum() / (real.sum() * error.shape[-1]).clamp(min=1)
