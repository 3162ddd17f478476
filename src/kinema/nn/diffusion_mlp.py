"""Denoise single latents: a residual MLP with adaptive layer norm over (time + condition) (MARDM §5)."""

from __future__ import annotations

from collections.abc import Iterator

from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from kinema.nn.embeddings import timestep_embedding
from kinema.nn.modulation import modulate

FREQUENCIES = 256


class ResidualBlock(nn.Module):
    """Gated residual block: modulated layer norm, Linear, SiLU, Linear."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(width, eps=1e-6)
        self.mlp = nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width))
        self.modulation = nn.Linear(width, 3 * width)

    def forward(self, h: Float[Tensor, "n w"], y: Float[Tensor, "#n w"]) -> Float[Tensor, "n w"]:
        """Add the branch; `y` is the activated sum of time and condition embeddings."""
        shift, scale, gate = self.modulation(y).chunk(3, dim=-1)
        return h + gate * self.mlp(modulate(self.norm(h), shift, scale))


class FinalLayer(nn.Module):
    """Modulated layer norm without weights of its own, then the output Linear."""

    def __init__(self, width: int, outputs: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(width, eps=1e-6, elementwise_affine=False)
        self.modulation = nn.Linear(width, 2 * width)
        self.linear = nn.Linear(width, outputs)

    def forward(self, h: Float[Tensor, "n w"], y: Float[Tensor, "#n w"]) -> Float[Tensor, "n d"]:
        shift, scale = self.modulation(y).chunk(2, dim=-1)
        return self.linear(modulate(self.norm(h), shift, scale))


class DiffusionMLP(nn.Module):
    """Predict epsilon or velocity of latent rows from their noisy values, the time and a condition vector.

    An untrained model outputs exactly 0. `embed_condition` and `embed_time` are apart from `denoise`, so that a sampler
    computes the first once and the second once per step: one row of time serves all latents.
    """

    def __init__(self, latent_dim: int, condition_dim: int, width: int = 1792, depth: int = 16) -> None:
        super().__init__()
        self.embed_condition = nn.Linear(condition_dim, width)
        self.time = nn.Sequential(nn.Linear(FREQUENCIES, width), nn.SiLU(), nn.Linear(width, width))
        self.input_projection = nn.Linear(latent_dim, width)
        self.blocks = nn.ModuleList(ResidualBlock(width) for _ in range(depth))
        self.final = FinalLayer(width, latent_dim)
        self.reset_parameters()

    def reset_parameters(self) -> None:
        """Initialise: Xavier-uniform Linears, N(0, 0.02) time weights, zero modulations, output and biases."""
        for layer in _linears(self):
            nn.init.xavier_uniform_(layer.weight)
            nn.init.zeros_(layer.bias)
        for layer in _linears(self.time):
            nn.init.normal_(layer.weight, std=0.02)
        modulations = [block.modulation for block in self.modules() if isinstance(block, ResidualBlock)]
        for layer in (*modulations, self.final.modulation, self.final.linear):
            nn.init.zeros_(layer.weight)

    def embed_time(self, time: Tensor) -> Float[Tensor, "n w"]:
        """Embed a single time (one row, broadcast later) or one time per row."""
        return self.time(timestep_embedding(time.reshape(-1), FREQUENCIES).to(self.input_projection.weight.dtype))

    def denoise(
        self, x: Float[Tensor, "n d"], time: Float[Tensor, "#n w"], condition: Float[Tensor, "n w"]
    ) -> Float[Tensor, "n d"]:
        """Predict from embedded time and condition."""
        # SiLU acts on the sum, so the modulations cannot be shared between rows or steps; the SiLU itself is shared.
        y = F.silu(time + condition)
        h = self.input_projection(x)
        for block in self.blocks:
            h = block(h, y)
        return self.final(h, y)

    def forward(self, x: Float[Tensor, "n d"], time: Tensor, condition: Float[Tensor, "n z"]) -> Float[Tensor, "n d"]:
        """Predict from raw time and condition."""
        return self.denoise(x, self.embed_time(time), self.embed_condition(condition))


def _linears(module: nn.Module) -> Iterator[nn.Linear]:
    return (layer for layer in module.modules() if isinstance(layer, nn.Linear))
