"""Compress every joint's way four-fold in time, each by itself: ACMDM's causal autoencoder (FRONTIER §3)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor

from kinema.motion.representation import Representation
from kinema.motion.rows import turned
from kinema.motion.statistics import moments
from kinema.nn.causal import CausalDecoder, CausalEncoder
from kinema.nn.mode import inference
from kinema.options import Depth, Levels, OneOf, OpenShare, Size, checked
from kinema.registry import buildable
from kinema.tokenizers.autoencoder import mean_of_real
from kinema.tokenizers.placed import STATISTICS, PlacedTokenizer
from kinema.tokenizers.posterior import standard_noise
from kinema.types import Latents, LatentSpace, Losses, MotionBatch, frame_mask


@buildable
class JointAutoEncoder(PlacedTokenizer):
    """Encode joints (b, t, j, 3) to latents (b, t // 4, j * channels), those of a joint side by side, and back.

    Convolutions run along time, never across joints, and see the past alone. Latents are standardised by their own
    moments over the training clips (`finish`), pooled as those of the joints are: `statistics` "shared_axis" or
    "per_joint". `scatter` turns and places every window of the training at random: rows don't tell where in its clip
    it stood, and clips go farther than windows.
    """

    latent_mean: Float[Tensor, "j c"]
    latent_std: Float[Tensor, "j c"]

    @checked
    def __init__(
        self,
        representation: Representation,
        *,
        statistics: Annotated[str, OneOf(STATISTICS)] = "shared_axis",
        width: Size = 512,
        channels: Size = 4,
        depth: Depth = 3,
        dilation_growth: Size = 3,
        down_levels: Levels = 2,
        dropout: OpenShare = 0.2,
        scatter: bool = True,
    ) -> None:
        super().__init__(representation, statistics)
        self.scatter = scatter
        joints, unit = representation.skeleton.num_joints, 2**down_levels
        net = {"width": width, "levels": down_levels, "depth": depth, "growth": dilation_growth}
        self.encoder = CausalEncoder(3, channels, **net, dropout=dropout)
        self.decoder = CausalDecoder(channels, 3, **net, dropout=dropout)
        most = (representation.skeleton.max_frames - 1) // unit
        self.space = LatentSpace("continuous", joints * channels, most, unit)
        self.register_buffer("latent_mean", torch.zeros(joints, channels))
        self.register_buffer("latent_std", torch.ones(joints, channels))

    def loss(
        self, motion: MotionBatch, *, generator: torch.Generator | None = None, shard: tuple[int, int] = (0, 1)
    ) -> Losses:
        """Return SmoothL1 of the normalised joints over real frames; only training scatters."""
        joints = self.recovered(motion)
        if self.scatter and self.training:
            reach = (self.mean.square() + self.std.square()).sqrt()[0, [0, 2]]
            joints = scattered(joints, standard_noise(joints[:, :1, 0], generator, shard)[:, 0], reach)
        target = self.normalize(joints, motion.mask)
        output = self._decode(self._encode(target))
        real = frame_mask(self.space.covered(motion.lengths), output.shape[1])
        error = F.smooth_l1_loss(output, target[:, : output.shape[1]], reduction="none")
        return {"loss": mean_of_real(error.flatten(2), real)}

    def finish(self, clips: Iterable[np.ndarray]) -> None:
        """Take the moments of the latents."""
        skeleton, device = self.representation.skeleton, self.mean.device
        self.latent_mean.zero_()
        self.latent_std.fill_(1)

        def latents(rows: np.ndarray) -> np.ndarray:
            features = torch.from_numpy(rows[None, :, : skeleton.essential_width].astype(np.float32)).to(device)
            motion = MotionBatch(features, torch.tensor([len(rows)], device=device))
            return self._encode(self.place(motion))[0].flatten(1).cpu().numpy()

        with inference(self):
            found = moments(latents(rows) for rows in clips if len(rows) >= self.space.frames_of(1))
        mean, std = self.pooled(*(values.reshape(skeleton.num_joints, -1) for values in found))
        self.latent_mean.copy_(mean)
        self.latent_std.copy_(std)

    def encode_joints(self, values: Float[Tensor, "b t j 3"], lengths: Int[Tensor, " b"]) -> Latents:
        """Encode; a tail of fewer than four frames has no latent of its own and is dropped.

        Raises ValueError if the padded batch is shorter than one latent.
        """
        least = self.space.frames_of(1)
        if values.shape[1] < least:
            raise ValueError(f"motion of {values.shape[1]} frames is too short to encode; give at least {least}")
        z = (self._encode(values) - self.latent_mean) / self.latent_std
        counts = self.space.latents_of(lengths)
        z = z.flatten(2).masked_fill(~frame_mask(counts, z.shape[1])[..., None], 0.0)
        return Latents(lengths=counts, frames=self.space.covered(lengths), values=z)

    def decode(self, latents: Latents) -> MotionBatch:
        """Decode and describe by essential rows (b, 4n, representation.width), zero past `latents.frames`."""
        if latents.values is None:
            raise ValueError("this tokenizer decodes continuous values, not codes; use the tokenizer that made them")
        z = latents.values.unflatten(2, self.latent_mean.shape) * self.latent_std + self.latent_mean
        return self.describe(self._decode(z), torch.minimum(latents.frames, self.space.frames_of(latents.lengths)))

    def _encode(self, x: Float[Tensor, "b t j 3"]) -> Float[Tensor, "b n j c"]:
        return _by_joint(self.encoder, x)

    def _decode(self, z: Float[Tensor, "b n j c"]) -> Float[Tensor, "b t j 3"]:
        return _by_joint(self.decoder, z)


def _by_joint(net: CausalEncoder | CausalDecoder, x: Float[Tensor, "b t j c"]) -> Float[Tensor, "b n j d"]:
    """Send every joint through as a sequence of its own."""
    columns = x.permute(0, 2, 3, 1)
    return net(columns.flatten(0, 1)).unflatten(0, columns.shape[:2]).permute(0, 3, 1, 2)


def scattered(
    joints: Float[Tensor, "b t j 3"], noise: Float[Tensor, "b 3"], reach: Float[Tensor, " 2"]
) -> Float[Tensor, "b t j 3"]:
    """Turn motions about the origin by any angle, and move them over the floor as far as `reach` (deviations of x, z).

    `noise` is standard normal: one number for the angle, two for the place.
    """
    angle = torch.pi * torch.special.erf(noise[:, 0] / 2**0.5)
    step = F.pad(noise[:, 1:] * reach, (0, 1))[:, [0, 2, 1]]
    return turned(joints, angle[:, None, None]) + step[:, None, None]
