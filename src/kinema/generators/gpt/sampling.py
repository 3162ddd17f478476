"""Choose how a causal transformer samples its tokens."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from kinema.decoding.draws import Greedy, SeededDraws, TokenDraws
from kinema.options import Count, FullShare, NonNegative, Options
from kinema.registry import buildable


@buildable
@dataclass(frozen=True)
class GptSampling(Options):
    """Choose how tokens are sampled.

    `temperature` 0 takes the likeliest token (greedy decoding, by which the published T2M-GPT is selected). `top_k`
    keeps the likeliest tokens, `top_p` the fewest of them that hold this probability (neither is published). `cache`
    keeps the keys and values of earlier positions: the same tokens, less work.
    """

    temperature: NonNegative = 1.0
    top_k: Count | None = None
    top_p: FullShare | None = None
    cache: bool = True

    @property
    def greedy(self) -> bool:
        """Say whether the likeliest token is taken."""
        return self.temperature == 0

    def draws(self, seeds: Int[Tensor, " b"]) -> TokenDraws:
        """Make what draws the tokens of these seeds."""
        return Greedy(seeds) if self.greedy else SeededDraws(seeds)

    def narrow(self, logits: Float[Tensor, "*b k"]) -> Float[Tensor, "*b k"]:
        """Return the logits of the distribution to draw from: -inf for classes left out; the likeliest stays."""
        if self.greedy:
            return logits
        logits = logits / self.temperature
        if self.top_k is None and self.top_p is None:
            return logits
        ordered, order = logits.sort(dim=-1, descending=True, stable=True)
        out = torch.arange(logits.shape[-1], device=logits.device) >= (self.top_k or logits.shape[-1])
        if self.top_p is not None:
            share = ordered.masked_fill(out, -torch.inf).softmax(-1)
            out = out | (share.cumsum(-1) - share >= self.top_p)
        left_out = torch.zeros_like(logits, dtype=torch.bool).scatter(-1, order, out.expand_as(order))
        return logits.masked_fill(left_out, -torch.inf)
