"""Turn motion into codes, four frames each: the VQ-VAE of T2M-GPT and, by its arguments, of all that followed it."""

from __future__ import annotations

from typing import Annotated

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from kinema.motion.representation import Representation
from kinema.nn.conv import ConvDecoder, ConvEncoder
from kinema.options import Classes, Depth, Levels, NonNegative, OneOf, OpenShare, Size, checked
from kinema.registry import buildable
from kinema.tokenizers import MotionTokenizer
from kinema.tokenizers.autoencoder import ERRORS, ROOT, mean_of_real, require_frames
from kinema.tokenizers.codebook import EMACodebook, Quantizer
from kinema.types import Latents, LatentSpace, Losses, MotionBatch, frame_mask

AUXILIARIES = ("joints", "velocities")


@buildable
class VQVAE(MotionTokenizer):
    """Encode motion (b, t, d) to codes (b, t // 4, q) and back (COMMON §3, §4; T2M-GPT, Tokenizer).

    `quantizer` (kinema.tokenizers.codebook.Quantizer; default T2M-GPT's codebook) has `codebook_size` codes of
    `code_dim` numbers. `encoder` maps (normalised rows b t d, lengths or None) to (b, t // 2**down_levels, code_dim);
    default is the published conv net. `auxiliary` names the columns whose error counts once more, by `joint_weight`:
    the joint positions (which T2M-GPT calls velocities) or, in AttT2M, the velocities. `root_weight`, `error` and
    `mask_padding` are those of AutoEncoder.
    """

    @checked
    def __init__(
        self,
        representation: Representation,
        *,
        codebook_size: Classes = 512,
        code_dim: Size = 512,
        quantizer: Quantizer | None = None,
        encoder: nn.Module | None = None,
        width: Size = 512,
        depth: Depth = 3,
        dilation_growth: Size = 3,
        down_levels: Levels = 2,
        dropout: OpenShare = 0.0,
        auxiliary: Annotated[str, OneOf(AUXILIARIES)] = "joints",
        joint_weight: NonNegative = 0.5,
        commit_weight: NonNegative = 0.02,
        root_weight: NonNegative = 0.0,
        error: Annotated[str, OneOf(ERRORS)] = "smooth_l1",
        mask_padding: bool = True,
    ) -> None:
        super().__init__()
        self.error = ERRORS[error]
        quantizer = quantizer or EMACodebook(codebook_size, code_dim)
        check(representation, quantizer, codebook_size, code_dim, auxiliary)
        net = {"width": width, "levels": down_levels, "depth": depth, "dilation_growth": dilation_growth}
        self.representation = representation
        self.encoder = encoder or ConvEncoder(representation.width, code_dim, **net, dropout=dropout)
        self.quantizer = quantizer
        self.decoder = ConvDecoder(code_dim, representation.width, **net, dropout=dropout)
        unit = 2**down_levels
        most = (representation.skeleton.max_frames - 1) // unit
        self.space = LatentSpace("codes", code_dim, most, unit, codebook_size, quantizer.quantizers)
        self.auxiliary = auxiliary
        self.joint_weight = joint_weight
        self.commit_weight = commit_weight
        self.root_weight = root_weight
        self.mask_padding = mask_padding

    @property
    def codebook(self) -> Float[Tensor, "k d"]:
        """The code vectors (of the first layer)."""
        return self.quantizer.codebooks[0]

    @property
    def codebooks(self) -> Float[Tensor, "q k d"]:
        """The code vectors of all layers."""
        return self.quantizer.codebooks

    def loss(
        self, motion: MotionBatch, *, generator: torch.Generator | None = None, shard: tuple[int, int] = (0, 1)
    ) -> Losses:
        """Return the error over all dims plus weighted terms: the auxiliary columns' and the commitment (COMMON §4).

        Beside them stand `perplexity` and `dead_codes`, which nothing minimises. In training mode the quantiser learns.
        Means run over real frames and positions; draws are made for the global batch, as in the protocol.
        """
        target = self.representation.normalize(motion.features, motion.lengths)
        counts = self.space.latents_of(motion.lengths)
        z = self._encode(target, motion.lengths)
        quantized = self.quantizer(z, frame_mask(counts, z.shape[1]), generator, shard)
        output = self._decode(quantized.values, counts)
        real = frame_mask(self.space.covered(motion.lengths), output.shape[1])
        error = self.error(output, target[:, : output.shape[1]], reduction="none")
        reconstruction = mean_of_real(error, real)
        auxiliary = mean_of_real(error[..., self.representation.groups[self.auxiliary]], real)
        losses = {"reconstruction": reconstruction, self.auxiliary: auxiliary, "commit": quantized.commit}
        loss = reconstruction + self.joint_weight * auxiliary + self.commit_weight * quantized.commit
        if quantized.embedding is not None:
            losses["embedding"] = quantized.embedding
            loss = loss + quantized.embedding
        if self.root_weight:
            losses["root"] = mean_of_real(error[..., :ROOT], real)
            loss = loss + self.root_weight * losses["root"]
        return {"loss": loss, **losses, "perplexity": quantized.perplexity, "dead_codes": quantized.dead_codes}

    def encode(self, motion: MotionBatch, *, generator: torch.Generator | None = None) -> Latents:
        """Encode a batch, codes 0 at padding; a tail of fewer frames than one code stands for is dropped.

        Raises ValueError if the padded batch is shorter than one code.
        """
        require_frames(motion, self.space)
        counts = self.space.latents_of(motion.lengths)
        training = self.quantizer.training
        self.quantizer.train(False)  # looking never teaches the codebook
        z = self._encode(self.representation.normalize(motion.features, motion.lengths), motion.lengths)
        codes = self.quantizer(z, frame_mask(counts, z.shape[1])).codes
        self.quantizer.train(training)
        return Latents(lengths=counts, frames=self.space.covered(motion.lengths), codes=codes)

    def decode(self, latents: Latents) -> MotionBatch:
        """Decode to de-normalised features (b, 4n, representation.width), zero past `latents.frames`.

        A code of -1 and all codes past the length are zero vectors. Raises ValueError for ids out of range.
        """
        if latents.codes is None:
            raise ValueError("this tokenizer decodes codes, not continuous values; use the tokenizer that made them")
        codes = latents.codes.masked_fill(~latents.mask[..., None], -1)
        normalized = self._decode(self.quantizer.lookup(codes), latents.lengths)
        frames = torch.minimum(latents.frames, self.space.frames_of(latents.lengths))
        return MotionBatch(self.representation.denormalize(normalized, frames), frames)

    def _encode(self, x: Float[Tensor, "b t d"], lengths: Int[Tensor, " b"]) -> Float[Tensor, "b n c"]:
        return self.encoder(x, self._padded(lengths, x.shape[1]))

    def _decode(self, z: Float[Tensor, "b n c"], lengths: Int[Tensor, " b"]) -> Float[Tensor, "b t d"]:
        return self.decoder(z, self._padded(lengths, z.shape[1]))

    def _padded(self, lengths: Int[Tensor, " b"], size: int) -> Int[Tensor, " b"] | None:
        """Return the lengths if something has to be masked."""
        return lengths if self.mask_padding and bool((lengths < size).any()) else None


def check(
    representation: Representation, quantizer: Quantizer, codebook_size: int, code_dim: int, auxiliary: str
) -> None:
    """Raise ValueError for columns that aren't there, or a quantiser of other sizes than the tokenizer's."""
    if auxiliary not in representation.groups:
        raise ValueError(
            f"auxiliary={auxiliary!r}: choose one of {', '.join(a for a in AUXILIARIES if a in representation.groups)}"
        )
    for name, size, theirs in (
        ("codebook_size", codebook_size, quantizer.codebook_size),
        ("code_dim", code_dim, quantizer.code_dim),
    ):
        if theirs != size:
            raise ValueError(f"{name}={size}, but the quantizer's is {theirs}; give both the same")
