"""Read the words of a text as positions to attend to."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional as F

from kinema.types import TextFeatures


class Words(nn.Module):
    """Project the features of each word; `null_tokens` learnt positions stand in front of them (0: none).

    With these a text whose words are hidden is they alone, whatever its length was (FRONTIER §9.9).
    """

    def __init__(self, token_dim: int, width: int, null_tokens: int = 0) -> None:
        super().__init__()
        self.project = nn.Linear(token_dim, width)
        self.null = nn.Parameter(torch.zeros(null_tokens, width)) if null_tokens else None

    def reset_parameters(self) -> None:
        """Start the learnt positions at N(0, .02)."""
        if self.null is not None:
            nn.init.normal_(self.null, std=0.02)

    def forward(self, text: TextFeatures) -> tuple[Float[Tensor, "b l w"], Bool[Tensor, "b l"]]:
        """Return positions and which of them may be seen; raises ValueError for text features without words."""
        if text.tokens is None or text.token_mask is None:
            raise ValueError(
                "this model reads words, but the text features hold the pooled vector alone; encode the text with "
                "token features (reads_tokens: true)"
            )
        words, mask = self.project(text.tokens), text.token_mask
        if self.null is None:
            return words, mask
        front = self.null.to(words.dtype).expand(len(words), -1, -1)
        return torch.cat((front, words), dim=1), F.pad(mask, (len(self.null), 0), value=True)
