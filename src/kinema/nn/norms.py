"""Normalise rows."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor, nn


class RMSNorm(nn.RMSNorm):
    """Divide each row by its root mean square, in the precision of the gain whatever mixed precision hands in.

    torch's own takes a slow way, and warns, for a bfloat16 row under an fp32 gain.
    """

    def __init__(self, width: int) -> None:
        super().__init__(width, eps=1e-6)

    def forward(self, x: Float[Tensor, "*b w"]) -> Float[Tensor, "*b w"]:
        """Return the rows normalised."""
        return super().forward(x.to(self.weight.dtype))
