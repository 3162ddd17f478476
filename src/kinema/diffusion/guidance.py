"""Guide predictions without a classifier.

Whether the outputs are epsilon, x0 or velocity makes no difference: each is an affine function of the others, and the
weights of the two passes sum to 1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

Predict = Callable[[Tensor, Tensor], Tensor]
"""predict(x, t) -> output: `x` rows, `t` one time for all rows or one per row."""


@dataclass(frozen=True)
class Guidance:
    """Choose the scale along the way from noise (0) to data (1): `scale` inside `interval`, 1 outside.

    `growing`: from 1 at the interval's start to `scale` at its end.
    """

    scale: float = 1.0
    interval: tuple[float, float] = (0.0, 1.0)
    growing: bool = False

    def __post_init__(self) -> None:
        start, end = self.interval
        if not 0 <= start < end <= 1:
            raise ValueError(
                f"guidance interval {tuple(self.interval)} is none; give (start, end) with 0 <= start < end <= 1, "
                "where 0 is noise and 1 is data"
            )

    def at(self, progress: float) -> float:
        """Return the scale at a share of the way."""
        start, end = self.interval
        if not start <= progress <= end:
            return 1.0
        return 1 + (self.scale - 1) * (progress - start) / (end - start) if self.growing else self.scale

    def along(self, progress: Callable[[Tensor], float]) -> float | Callable[[Tensor], float]:
        """Return what `guided` takes: a number where the scale is the same everywhere, else a function of time."""
        constant = not self.growing and tuple(self.interval) == (0, 1)
        return self.scale if constant else lambda t: self.at(progress(t))


def guided(
    predict: Callable[[Tensor, Tensor, Tensor], Tensor],
    condition: Float[Tensor, "n *z"],
    empty: Float[Tensor, "n *z"] | None,
    scale: float | Callable[[Tensor], float],
) -> Predict:
    """Close `predict(x, t, condition)` over guidance: empty + scale * (conditional - empty), both halves in one batch.

    `scale` may be a function of time. Where it is 1 it needs no empty condition and costs one pass.
    """
    if scale == 1:
        return lambda x, t: predict(x, t, condition)
    if empty is None:
        raise ValueError(f"guidance of scale {scale} needs an empty condition; pass one, or scale 1")
    both = torch.cat((condition, empty))

    def combine(x: Tensor, t: Tensor) -> Tensor:
        weight = scale(t) if callable(scale) else scale
        if weight == 1:
            return predict(x, t, condition)
        conditional, unconditional = predict(torch.cat((x, x)), t, both).chunk(2)
        return unconditional + weight * (conditional - unconditional)

    return combine
