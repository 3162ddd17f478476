"""Quantise in layers, each what the layers before it left over: the residual quantiser of MoMask (MoMask §1)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from kinema.options import Classes, NonNegative, OneOf, Share, Size, checked
from kinema.registry import buildable
from kinema.tokenizers.codebook import RESETS, CodebookDraws, EMACodebook, Quantized


@buildable
class ResidualQuantizer(nn.Module):
    """Sum the codes of `quantizers` layers with a codebook each.

    In training, with probability `quantizer_dropout` a batch uses only its first layers, one to all with equal chance;
    codes are drawn by `temperature`. Each active layer passes the gradient straight through, so the encoder receives it
    as many times as layers are active. `commit`, `perplexity` and `dead_codes` are means over the active layers.
    """

    @checked
    def __init__(
        self,
        codebook_size: Classes = 512,
        code_dim: Size = 512,
        *,
        quantizers: Size = 6,
        quantizer_dropout: Share = 0.2,
        temperature: NonNegative = 0.5,
        reset: Annotated[str, OneOf(RESETS)] = "always",
        decay: Share = 0.99,
        threshold: NonNegative = 1.0,
    ) -> None:
        super().__init__()
        self.codebook_size, self.code_dim, self.quantizers = codebook_size, code_dim, quantizers
        self.quantizer_dropout = quantizer_dropout
        self.layers = nn.ModuleList(
            EMACodebook(codebook_size, code_dim, reset=reset, decay=decay, threshold=threshold, temperature=temperature)
            for _ in range(quantizers)
        )

    @property
    def codebook(self) -> Float[Tensor, "k d"]:
        """The code vectors of the first layer."""
        return self._codebooks()[0].codebook

    @property
    def codebooks(self) -> Float[Tensor, "q k d"]:
        """The code vectors of all layers."""
        return torch.stack([layer.codebook for layer in self._codebooks()])

    def forward(
        self,
        z: Float[Tensor, "b n d"],
        real: Bool[Tensor, "b n"],
        generator: torch.Generator | None = None,
        shard: tuple[int, int] = (0, 1),
        active: int | None = None,
        draws: Sequence[CodebookDraws] | None = None,
    ) -> Quantized:
        """Quantise by the active layers (codes of the others are -1) and, in training mode, teach them.

        `active` and `draws`, one per layer, replace what is drawn (tests).
        """
        active = active or self._active(generator, z.device)
        residual, results = z, []
        for i, layer in enumerate(self._codebooks()[:active]):
            results.append(layer(residual, real, generator, shard, draws[i] if draws else None))
            residual = residual - results[-1].values.detach()
        codes = [result.codes for result in results]
        codes += [torch.full_like(codes[0], -1).masked_fill(~real[..., None], 0)] * (self.quantizers - active)
        return Quantized(
            values=torch.stack([result.values for result in results]).sum(0),
            codes=torch.cat(codes, dim=-1),
            commit=torch.stack([result.commit for result in results]).mean(),
            perplexity=torch.stack([result.perplexity for result in results]).mean(),
            dead_codes=torch.stack([result.dead_codes for result in results]).mean(),
        )

    def lookup(self, codes: Int[Tensor, "b n q"]) -> Float[Tensor, "b n d"]:
        """Sum the vectors of the codes of the first layers, as many as given; -1 adds nothing."""
        if not 1 <= codes.shape[-1] <= self.quantizers:
            raise ValueError(f"{codes.shape[-1]} codes per position; this tokenizer has 1 to {self.quantizers}")
        vectors = [layer.lookup(codes[..., i, None]) for i, layer in enumerate(self._codebooks()[: codes.shape[-1]])]
        return torch.stack(vectors).sum(0)

    def _codebooks(self) -> list[EMACodebook]:
        """Return the layers as what they are: a ModuleList knows modules only."""
        return [layer for layer in self.layers if isinstance(layer, EMACodebook)]

    def _active(self, generator: torch.Generator | None, device: torch.device) -> int:
        """Draw how many layers a batch uses: the same on all ranks, whose generators are in the same state."""
        if not self.training or not self.quantizer_dropout:
            return self.quantizers
        drop, share = torch.rand(2, generator=generator, device=device).tolist()
        return 1 + int(share * self.quantizers) if drop < self.quantizer_dropout else self.quantizers
