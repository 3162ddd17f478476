"""Choose how a causal transformer samples its tokens."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Int
from torch import Tensor

from kinema.decoding.autoregressive import narrow
from kinema.decoding.draws import Greedy, SeededDraws, TokenDraws


@dataclass(frozen=True)
class GptSampling:
    """Choose how tokens are sampled.

    `temperature` 0 takes the likeliest token (greedy decoding, which the published models are selected with). `top_k`
    and `top_p` leave unlikely tokens out (not published). `cache` keeps the keys and values of earlier positions:
    the same tokens, less work.
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

    def narrow(self, logits: Tensor) -> Tensor:
        """Give the logits of the distribution to draw from."""
        if self.greedy:
            return logits
        return narrow(logits, temperature=self.temperature, top_k=self.top_k, top_p=self.top_p)
