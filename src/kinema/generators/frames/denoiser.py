"""Say what a network owes that denoises whole sequences of frames."""

from __future__ import annotations

from abc import ABC, abstractmethod

from jaxtyping import Bool, Float
from torch import Tensor, nn

from kinema.types import TextFeatures

Read = tuple[Float[Tensor, "b l w"], Bool[Tensor, "b m"] | None]
"""What was read of the text, and the mask of the tokens that frames may see (None: all)."""


class Denoiser(nn.Module, ABC):
    """Predict clean frames, their noise or their velocity from noisy ones, the time and the text.

    `read` is apart from `forward`, so that a sampler reads the text once for all steps.
    """

    @abstractmethod
    def read(self, text: TextFeatures) -> Read:
        """Read the text; zeroed features are the empty condition."""

    @abstractmethod
    def forward(
        self,
        x: Float[Tensor, "b t d"],
        time: Tensor,
        condition: Float[Tensor, "b l w"],
        seen: Bool[Tensor, "b m"] | None = None,
        real: Bool[Tensor, "b t"] | None = None,
    ) -> Float[Tensor, "b t d"]:
        """Predict at one time for all rows or one per row; no frame sees those that `real` says are padding.

        What is predicted for these is nobody's to read.
        """
