"""Hold the generators: text features to latents, knowing nothing of joints."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, Protocol, runtime_checkable

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from kinema.tokenizers import MotionTokenizer
from kinema.types import Known, Latents, LatentSpace, Losses, TextFeatures


@runtime_checkable
class TrainingLatents(Protocol):
    """What can be asked of a corpus' latents before training."""

    def range(self) -> tuple[Float[Tensor, " c"], Float[Tensor, " c"]]:
        """Return the least and the greatest value of each channel."""


class LatentModel(nn.Module, ABC):
    """What is trained on latents and their text: a generator, or a part that stands beside one.

    `space` is the latents it is for (None: it reads their lengths alone), `spec` what rebuilds the module. `text_dim`
    and `token_dim` are the widths of the pooled text vector and the token features that it reads (None: it reads none).
    """

    space: LatentSpace | None = None
    text_dim: int | None = None
    token_dim: int | None = None
    spec: dict[str, Any] | None = None

    @property
    def lacks_empty_text(self) -> bool:
        """Whether it needs the features of the empty text and has none; most models need none."""
        return False

    @property
    def codebook(self) -> Float[Tensor, "k d"] | None:
        """The copy of the tokenizer's code vectors that this model reads; None if it reads none."""
        return None

    def prepare(self, tokenizer: MotionTokenizer, latents: TrainingLatents) -> None:
        """Take what the model keeps of its tokenizer and their range, and weights to start from, before training."""

    def take_empty_text(self, text: TextFeatures) -> None:
        """Take the features of one empty text; raises ValueError for a model that reads none."""
        raise ValueError(f"{type(self).__name__} reads no empty text")

    @abstractmethod
    def loss(
        self,
        latents: Latents,
        text: TextFeatures,
        *,
        generator: torch.Generator | None = None,
        shard: tuple[int, int] = (0, 1),
    ) -> Losses:
        """Return the losses, `loss` first; draws come from `generator`, for the batch that `shard` is of."""


class Generator(LatentModel):
    """Turn text into latents.

    `sampling` is a frozen dataclass of the family's options, `predicts_length` says that it ends its sequences itself,
    `parts` names the runs that it can have beside it (residual, retrieval, ...) and takes by `attach`.
    """

    space: LatentSpace
    sampling: Any
    predicts_length: bool = False
    parts: tuple[str, ...] = ()

    @property
    def networks(self) -> dict[str, nn.Module]:
        """The modules whose calls are what sampling costs, by name: `denoiser` is a diffusion's."""
        return {}

    def attach(self, part: str, module: nn.Module) -> None:
        """Take a part, neither saved nor trained with this module; raises ValueError for one it has no use for."""
        takes = ", ".join(self.parts) or "no other part"
        raise ValueError(f"{type(self).__name__} takes no {part!r}; it takes {takes}")

    def check_sampling(self, sampling: Any) -> None:
        """Raise ValueError for options of another family, or that this model cannot sample by."""
        if type(sampling) is not type(self.sampling):
            raise ValueError(
                f"{type(self).__name__} samples by {type(self.sampling).__name__}, not by {type(sampling).__name__}; "
                "choose the method= of the run"
            )

    @abstractmethod
    def sample(
        self,
        text: TextFeatures,
        frames: Int[Tensor, " b"] | None,
        *,
        seeds: Int[Tensor, " b"],
        known: Known | None = None,
        sampling: Any | None = None,
    ) -> Latents:
        """Generate latents for `frames` frames of motion per text, one seed per sample.

        A sample depends on its own seed only. `frames` None takes the lengths of `known`, or leaves them to a model
        that ends its sequences itself.
        """
