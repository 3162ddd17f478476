"""Choose how a causal transformer samples its tokens."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from kinema.decoding.draws import Greedy, SeededDraws, TokenDraws
from kinema.registry import buildable


@buildable
@dataclass(frozen=True)
class GptSampling:
    """Choose how tokens are sampled.

    `temperature` 0 takes the likeliest token (greedy decoding, by which the published T2M-GPT is selected). `top_k`
    keeps the likeliest tokens, `top_p` the fewest of them that hold this probability (neither is published). `cache`
    keeps the keys and values of earlier positions: the same tokens, less work.
    """

    temperature: float = 1.0
    top_k: int | None = None
    top_p: float | None = None
    cache: bool = True

    def __post_init__(self) -> None:
        if self.temperature < 0:
            raise ValueError(f"sampling.temperature is {self.temperature}; give 0 (greedy) or more")
        if self.top_k is not None and self.top_k < 1:
            raise ValueError(f"sampling.top_k is {self.top_k}; give at least 1, or None for all")
        if self.top_p is not None and not 0 < self.top_p <= 1:
            raise ValueError(f"sampling.top_p is {self.top_p}; give a share in (0, 1], or None for all")

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
