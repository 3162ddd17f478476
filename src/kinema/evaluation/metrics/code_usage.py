"""Count how a tokenizer's codes are used (MARDM, Figure 2; COMMON §4)."""

from __future__ import annotations

import torch
from jaxtyping import Int
from torch import Tensor
from torchmetrics import Metric

from kinema.types import Latents

LEAST = 1e-12
"""A share that is not zero is larger: the logarithm of zero must stay finite."""


class CodeUsage(Metric):
    """Count every code of every layer over an epoch.

    perplexity: exponential of the entropy of the codes' shares, about how many codes are used evenly. used, dead:
    codes that were chosen at least once, and never. The three are means over layers; `layer_...` has each layer's
    (q,; torchmetrics makes it a scalar where there is one), and `histogram` (q, k) its counts, the most used first.
    """

    is_differentiable, higher_is_better, full_state_update = False, True, False
    counts: Int[Tensor, "q k"]

    def __init__(self, codebook_size: int, quantizers: int = 1, **kwargs: object) -> None:
        super().__init__(**kwargs)
        self.codebook_size, self.quantizers = codebook_size, quantizers
        self.add_state("counts", torch.zeros(quantizers, codebook_size, dtype=torch.int64), dist_reduce_fx="sum")

    def update(self, latents: Latents) -> None:
        """Add a batch's codes; those at padding and -1 (a layer that was left out) are not counted."""
        codes = latents.codes
        if codes is None or codes.shape[-1] != self.quantizers:
            found = "continuous values" if codes is None else f"{codes.shape[-1]} codes per position"
            raise ValueError(f"the latents hold {found}, this metric counts {self.quantizers} codes per position")
        first = self.codebook_size * torch.arange(self.quantizers, device=codes.device)
        kept = latents.mask[..., None] & (codes >= 0)
        wrong = codes[kept & (codes >= self.codebook_size)]
        if len(wrong):
            raise ValueError(f"code {wrong[0].item()} is out of range: codebook_size={self.codebook_size}")
        counts = torch.bincount((codes + first)[kept], minlength=self.counts.numel())
        self.counts += counts.reshape(self.counts.shape).to(self.device)

    def compute(self) -> dict[str, Tensor]:
        """Return the measures; a layer without any code counts as dead, with a perplexity of 0."""
        counts, total = self.counts, self.counts.sum(1, keepdim=True)
        share = counts / total.clamp(min=1)
        perplexity = torch.exp(-(share * share.clamp(min=LEAST).log()).sum(1)) * (total[:, 0] > 0)
        used = (counts > 0).sum(1)
        layers = {"perplexity": perplexity, "used": used, "dead": self.codebook_size - used}
        means = {name: value.float().mean() for name, value in layers.items()}
        histogram = counts.sort(dim=1, descending=True).values
        return means | {f"layer_{name}": value for name, value in layers.items()} | {"histogram": histogram}
