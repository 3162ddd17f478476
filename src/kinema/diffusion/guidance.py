"""Guide predictions without a classifier."""

from __future__ import annotations

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

Predict = Callable[[Tensor, Tensor], Tensor]
"""predict(x, t) -> output: `x` rows, `t` one time for all rows or one per row."""


def guided(
    predict: Callable[[Tensor, Tensor, Tensor], Tensor],
    condition: Float[Tensor, "n *z"],
    empty: Float[Tensor, "n *z"] | None,
    scale: float,
) -> Predict:
    """Close `predict(x, t, condition)` over guidance: empty + scale * (conditional - empty), both halves in one batch.

    Scale 1 needs no empty condition and costs one pass.
    """
    if scale == 1:
        return lambda x, t: predict(x, t, condition)
    if empty is None:
        raise ValueError(f"guidance of scale {scale} needs an empty condition; give one, or take scale 1")
    both = torch.cat((condition, empty))

    def combine(x: Tensor, t: Tensor) -> Tensor:
        conditional, unconditional = predict(torch.cat((x, x)), t, both).chunk(2)
        return unconditional + scale * (conditional - unconditional)

    return combine
