"""Quantise without a codebook to learn: finite scalar quantisation, for ablations (arXiv 2309.15505)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated

import torch
from annotated_types import Interval, Len
from jaxtyping import Bool, Float
from torch import Tensor, nn

from kinema.nn.ranks import gather_rows
from kinema.options import Classes, NonNegative, Share, Size, check_value, checked
from kinema.registry import buildable
from kinema.tokenizers.codebook import EMACodebook, Quantized, perplexity

FEWEST = 3
"""Least number of levels: two lie unevenly about zero."""
Level = Annotated[int, Interval(ge=FEWEST, le=2**16)]


@buildable
class FiniteScalarQuantizer(nn.Module):
    """Round each of a few bounded numbers to its levels; the codes are all their combinations.

    `code_dim` numbers are projected to len(levels) and back. There is nothing to commit to and nothing to reset:
    `commit` is 0; `dead_codes` counts as EMACodebook does, codes whose running count is below `threshold`. The
    arithmetic is vector-quantize-pytorch's.
    """

    quantizers = 1
    counts: Float[Tensor, " k"]

    @checked
    def __init__(
        self,
        levels: Annotated[Sequence[Level], Len(1)],
        code_dim: Size = 512,
        *,
        decay: Share = 0.99,
        threshold: NonNegative = 1.0,
    ) -> None:
        super().__init__()
        levels = list(levels)
        check_value(math.prod(levels), Classes, "the product of levels")
        try:
            from vector_quantize_pytorch import FSQ
        except ImportError as error:
            raise ImportError(
                "finite scalar quantisation needs vector-quantize-pytorch: pip install 'kinema[vq]'"
            ) from error
        self.codebook_size, self.code_dim = math.prod(levels), code_dim
        self.decay, self.threshold = decay, threshold
        with torch.device("cpu"):  # it reads its own numbers, which a model without memory has not
            self.fsq = FSQ(levels, dim=code_dim)
        self.register_buffer("counts", torch.ones(self.codebook_size))

    @property
    def codebook(self) -> Float[Tensor, "k d"]:
        """The code vectors, computed anew: the output projection of all combinations."""
        device = next(self.fsq.buffers()).device
        return self.fsq.indices_to_codes(torch.arange(self.codebook_size, device=device)).detach()

    @property
    def codebooks(self) -> Float[Tensor, "1 k d"]:
        """The code vectors of the one layer."""
        return self.codebook[None]

    def forward(
        self,
        z: Float[Tensor, "b n d"],
        real: Bool[Tensor, "b n"],
        generator: torch.Generator | None = None,
        shard: tuple[int, int] = (0, 1),
    ) -> Quantized:
        """Quantise; nothing is drawn, and in training mode only the counts are kept."""
        with torch.autocast(z.device.type, enabled=False):
            values, codes = self.fsq(z.float())
        codes = codes.long().masked_fill(~real, 0)
        chosen = gather_rows(codes[real], shard[1] if self.training else 1)
        if self.training:
            fresh = torch.bincount(chosen, minlength=self.codebook_size)
            self.counts.mul_(self.decay).add_(fresh, alpha=1 - self.decay)
        return Quantized(
            values=values * real[..., None],
            codes=codes[..., None],
            commit=values.new_zeros(()),
            perplexity=perplexity(chosen, self.codebook_size),
            dead_codes=(self.counts < self.threshold).float().mean(),
        )

    lookup = EMACodebook.lookup  # it reads the codebook and its size alone
