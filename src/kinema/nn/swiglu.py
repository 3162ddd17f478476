"""Transform each position by a gated layer (SwiGLU, Shazeer 2020)."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F


class SwiGLU(nn.Module):
    """Multiply a SiLU-activated half by a linear half; no biases."""

    def __init__(self, width: int, hidden: int) -> None:
        super().__init__()
        self.spread = nn.Linear(width, 2 * hidden, bias=False)
        self.gather = nn.Linear(hidden, width, bias=False)

    def forward(self, x: Float[Tensor, "*b w"]) -> Float[Tensor, "*b w"]:
        gate, value = self.spread(x).chunk(2, dim=-1)
        return self.gather(F.silu(gate) * value)
