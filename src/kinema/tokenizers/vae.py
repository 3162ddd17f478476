"""Say a whole motion in a few latents: MLD's variational autoencoder (MLD §1)."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn

from kinema.motion.recovery import recover_joints
from kinema.motion.representation import Representation
from kinema.nn.ranks import largest
from kinema.nn.rows import Rows
from kinema.nn.skip import SkipTransformer
from kinema.options import Depth, NonNegative, OpenShare, Size, checked
from kinema.registry import buildable
from kinema.tokenizers.posterior import PosteriorTokenizer, split, standard_noise
from kinema.types import Latents, LatentSpace, Losses, MotionBatch, frame_mask


@buildable
class VAE(PosteriorTokenizer):
    """Encode motion (b, t, d) to `latents` normal distributions of `width` dims, whatever its length, and back.

    Published with 1 (for generation), 2, 5, 7 (for reconstruction) and 10 latents. `log_variance` is added to the log
    variances (published: 0): they come out of the same LayerNorm as the means, so their average starts at 0 and only a
    long training moves it. `positions` bounds the frames: the table of the encoder holds two tokens per latent too.
    """

    @checked
    def __init__(
        self,
        representation: Representation,
        *,
        latents: Size = 1,
        width: Size = 256,
        feedforward: Size = 1024,
        layers: Depth = 9,
        heads: Size = 4,
        dropout: OpenShare = 0.1,
        joint_weight: NonNegative = 1.0,
        kl_weight: NonNegative = 1e-4,
        log_variance: float = 0.0,
        positions: Size = 500,
    ) -> None:
        super().__init__()
        self.representation = representation
        self.space = LatentSpace("continuous", width, latents, unit=None)
        self.input_projection = nn.Linear(representation.width, width)
        self.tokens = nn.Parameter(torch.randn(2 * latents, width))
        self.encoder_positions = nn.Parameter(torch.rand(positions, width))
        self.encoder = SkipTransformer(width, heads, feedforward, layers, dropout)
        self.decoder_positions = nn.Parameter(torch.rand(positions, width))
        self.decoder = SkipTransformer(width, heads, feedforward, layers, dropout, cross=True)
        self.output = nn.Linear(width, representation.width)
        self.joint_weight, self.kl_weight, self.log_variance = joint_weight, kl_weight, log_variance

    def loss(
        self,
        motion: MotionBatch,
        *,
        generator: torch.Generator | None = None,
        shard: tuple[int, int] = (0, 1),
        noise: Float[Tensor, "b n c"] | None = None,
    ) -> Losses:
        """Return SmoothL1 of features and of joints (metres), and the divergence from N(0, 1), weighted (MLD §1).

        As published, all are means over the padded batch: past a clip's end its features have no error, its joints
        that of its last frame. `noise` replaces what is drawn (tests).
        """
        features, lengths = motion.features, motion.lengths
        missing = largest(features.shape[1], shard[1], features.device) - features.shape[1]
        target = self.representation.normalize(F.pad(features, (0, 0, 0, missing)), lengths)
        moments = self._moments(target, lengths)
        mean, log_variance = split(moments)
        noise = standard_noise(mean, generator, shard) if noise is None else noise
        output = self._decode(mean + (log_variance / 2).exp() * noise, lengths, target.shape[1])
        reconstruction = F.smooth_l1_loss(output, target)
        joints = F.smooth_l1_loss(self._joints(output), self._joints(target))
        divergence = (mean.square() + log_variance.exp() - 1 - log_variance).mean() / 2
        loss = reconstruction + self.joint_weight * joints + self.kl_weight * divergence
        return {"loss": loss, "reconstruction": reconstruction, "joints": joints, "kl": divergence}

    def moments(self, motion: MotionBatch) -> Latents:
        """Encode a batch; padding changes nothing. Raises ValueError for more frames than there are positions."""
        return self._moments(self.representation.normalize(motion.features, motion.lengths), motion.lengths)

    def decode(self, latents: Latents) -> MotionBatch:
        """Decode to de-normalised features of `latents.frames` frames, zero past them."""
        values = latents.values
        if values is None or values.shape[1:] != (self.space.most, self.space.width):
            found = "codes" if values is None else f"values {tuple(values.shape)}"
            raise ValueError(
                f"this tokenizer decodes values (samples, {self.space.most}, {self.space.width}), not {found}; use the "
                "tokenizer that made them"
            )
        output = self._decode(values, latents.frames, int(latents.frames.max()))
        return MotionBatch(self.representation.denormalize(output, latents.frames), latents.frames)

    def _moments(self, x: Float[Tensor, "b t d"], lengths: Int[Tensor, " b"]) -> Latents:
        heads = len(self.tokens)
        sequence = torch.cat((self.tokens.expand(len(x), -1, -1), self.input_projection(x)), dim=1)
        sequence = sequence + _first(self.encoder_positions, sequence.shape[1], heads)
        rows = Rows.behind(heads, frame_mask(lengths, x.shape[1]))
        mean, log_variance = rows.pad(self.encoder(rows.pack(sequence), rows))[:, :heads].chunk(2, dim=1)
        values = torch.cat((mean, log_variance + self.log_variance), dim=-1)
        return Latents(self.space.latents_of(lengths), lengths, values=values)

    def _decode(self, z: Float[Tensor, "b n c"], lengths: Int[Tensor, " b"], size: int) -> Float[Tensor, "b t d"]:
        """Decode normalised features, zero past the lengths."""
        rows = Rows(frame_mask(lengths, size))
        queries = _first(self.decoder_positions, size).index_select(0, rows.place)
        return rows.pad(self.output(self.decoder(queries, rows, z)))

    def _joints(self, x: Float[Tensor, "b t d"]) -> Float[Tensor, "b t j 3"]:
        """Place the joints of normalised features, in metres."""
        skeleton = self.representation.skeleton
        return recover_joints(self.representation.denormalize(x), skeleton) * skeleton.meters


def _first(table: Float[Tensor, "n w"], size: int, tokens: int = 0) -> Float[Tensor, "m w"]:
    if size > len(table):
        taken = f" less {tokens} tokens" if tokens else ""
        raise ValueError(f"{size - tokens} frames exceed positions={len(table)}{taken}; crop the motion")
    return table[:size]
