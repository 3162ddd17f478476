"""Refine a text's words: self-attention, gated by the text and, as published, the diffusion time (FRONTIER §2.2)."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional as F

from kinema.nn.embeddings import timestep_embedding


def masked_mean(x: Float[Tensor, "b l w"], mask: Bool[Tensor, "b l"]) -> Float[Tensor, "b w"]:
    """Average over the positions that the mask shows; zero where it shows none."""
    weights = mask[..., None].to(x.dtype)
    return (x * weights).sum(dim=1) / weights.sum(dim=1).clamp(min=1)


class RefinerLayer(nn.Module):
    """Attend among words, then transform each; a condition gates both branches, closed at the start."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.norm1, self.norm2 = nn.LayerNorm(width), nn.LayerNorm(width)
        self.qkv = nn.Linear(width, 3 * width)
        self.query_norm, self.key_norm = nn.LayerNorm(width // heads), nn.LayerNorm(width // heads)
        self.proj = nn.Linear(width, width)
        self.mlp = nn.Sequential(nn.Linear(width, 4 * width), nn.SiLU(), nn.Linear(4 * width, width))
        self.gates = nn.Linear(width, 2 * width)

    def close(self) -> None:
        """Close both branches."""
        nn.init.zeros_(self.gates.weight)
        nn.init.zeros_(self.gates.bias)

    def forward(
        self, x: Float[Tensor, "b l w"], condition: Float[Tensor, "b w"], pairs: Bool[Tensor, "b 1 l l"]
    ) -> Float[Tensor, "b l w"]:
        """Transform the words; `pairs` is True where both words are real."""
        gate1, gate2 = self.gates(F.silu(condition))[:, None].chunk(2, dim=-1)
        query, key, value = self.qkv(self.norm1(x)).unflatten(-1, (3, self.heads, -1)).permute(2, 0, 3, 1, 4)
        attended = F.scaled_dot_product_attention(self.query_norm(query), self.key_norm(key), value, attn_mask=pairs)
        x = x + gate1 * self.proj(attended.transpose(1, 2).flatten(2))
        return x + gate2 * self.mlp(self.norm2(x))


class Refiner(nn.Module):
    """Layers over the words of a text, conditioned on the words' mean and, if `timed`, on the time."""

    def __init__(self, width: int, heads: int, layers: int, *, timed: bool = True) -> None:
        super().__init__()
        self.width = width
        self.inputs = nn.Linear(width, width)
        self.time = nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width)) if timed else None
        self.text = nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width))
        self.layers = nn.ModuleList(RefinerLayer(width, heads) for _ in range(layers))

    def reset_parameters(self) -> None:
        """Start as the identity, its gates closed."""
        nn.init.eye_(self.inputs.weight)
        nn.init.zeros_(self.inputs.bias)
        for layer in self.layers:
            if isinstance(layer, RefinerLayer):
                layer.close()

    def forward(
        self, words: Float[Tensor, "b l w"], mask: Bool[Tensor, "b l"], time: Tensor | None = None
    ) -> Float[Tensor, "b l w"]:
        """Refine the words, at one time for all rows or one per row where it is timed."""
        condition = self.text(masked_mean(words, mask))
        if self.time is not None and time is not None:
            condition = condition + self.time(timestep_embedding(time.reshape(-1), self.width).to(words.dtype))
        pairs = (mask[:, None, :] & mask[:, :, None])[:, None]
        # A row that may see nothing sees itself: some kernels give NaN for an empty row, and its gradient spreads.
        pairs = pairs | torch.eye(mask.shape[1], dtype=torch.bool, device=mask.device)
        x = self.inputs(words)
        for layer in self.layers:
            x = layer(x, condition, pairs)
        return x
