"""Predict how many frames a text asks for."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.nn import functional as F

from kinema.generators import LatentModel
from kinema.options import Classes, OpenShare, Size, checked
from kinema.registry import buildable
from kinema.types import Latents, Losses, TextFeatures

HIDDEN = (512, 256, 128)


@buildable
class LengthEstimator(LatentModel):
    """Classify the number of latents from the pooled text (MARDM §6); class 0 is never predicted."""

    @checked
    def __init__(self, text_dim: Size, classes: Classes = 50, downsample: Size = 4, dropout: OpenShare = 0.2) -> None:
        super().__init__()
        self.text_dim = text_dim
        self.classes = classes
        self.downsample = downsample
        layers: list[nn.Module] = []
        for inputs, outputs in zip((text_dim, *HIDDEN[:-1]), HIDDEN, strict=True):
            layers += [nn.Linear(inputs, outputs), nn.LayerNorm(outputs), nn.LeakyReLU(0.2), nn.Dropout(dropout)]
        self.layers = nn.Sequential(*layers[:-1], nn.Linear(HIDDEN[-1], classes))

    def forward(self, text: Float[Tensor, "b t"]) -> Float[Tensor, "b classes"]:
        """Return the logits of 0 .. classes-1 latents."""
        return self.layers(text)

    def loss(
        self,
        latents: Latents,
        text: TextFeatures,
        *,
        generator: torch.Generator | None = None,
        shard: tuple[int, int] = (0, 1),
    ) -> Losses:
        """Return the cross entropy of the latents' counts; nothing is drawn from `generator`."""
        counts = latents.frames // self.downsample
        longest = int(counts.max())
        if longest >= self.classes:
            raise ValueError(
                f"a motion of {longest} latents exceeds the {self.classes - 1} that this estimator predicts"
            )
        return {"loss": F.cross_entropy(self(text.pooled), counts)}

    @torch.no_grad()
    def predict(self, text: TextFeatures, seeds: Int[Tensor, " b"]) -> Int[Tensor, " b"]:
        """Draw frames from the predicted distribution, each sample by its own seed."""
        if len(seeds) != len(text.pooled):
            raise ValueError(f"{len(text.pooled)} texts but {len(seeds)} seeds; give one seed per text")
        weights = self(text.pooled)[:, 1:].float().softmax(dim=1).cpu()
        generators = (torch.Generator().manual_seed(seed) for seed in seeds.tolist())
        uniform = torch.stack([torch.rand(1, generator=generator) for generator in generators])
        latents = 1 + torch.searchsorted(weights.cumsum(dim=1), uniform).clamp(max=self.classes - 2)
        return latents[:, 0].to(text.pooled.device) * self.downsample
