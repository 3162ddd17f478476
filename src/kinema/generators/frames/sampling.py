"""Hold the options of sampling by diffusion on whole sequences, and what an edit keeps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import torch
from annotated_types import Len
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional as F

from kinema.diffusion.choices import Holding, Solver, SolverGrid, SolverSteps
from kinema.diffusion.guidance import Guidance
from kinema.generators.values import check_known
from kinema.options import NonNegative, Options, Share
from kinema.registry import buildable
from kinema.types import Known


@dataclass(frozen=True)
class DiffusionSampling(Options):
    """Choose how whole sequences are sampled.

    `guidance` extrapolates from no text (0) over the text (1): inside `guidance_interval`, shares of the way from noise
    (0) to data (1), and with `guidance_growing` rising to it from 1. `solver` and `solver_steps` choose how the
    diffusion process samples (None: its defaults), `solver_grid` where a flow's steps lie, `temperature` scales the
    noise of its steps. An edit by a flow is held by the `holding` "path", a velocity that leads to what is kept, or
    "projection" with its `renewal` (`kinema.diffusion.projection`).
    """

    guidance: NonNegative = 1.0
    guidance_interval: Annotated[Sequence[Share], Len(2, 2)] = (0.0, 1.0)
    guidance_growing: bool = False
    solver: Solver | None = None
    solver_steps: SolverSteps | None = None
    solver_grid: SolverGrid = "uniform"
    temperature: NonNegative = 1.0
    holding: Holding = "path"
    renewal: Share | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        self.weights()  # refuses a wrong interval

    def weights(self) -> Guidance:
        """Return the guidance along the way from noise to data."""
        start, end = self.guidance_interval
        return Guidance(self.guidance, (start, end), self.guidance_growing)


@buildable
@dataclass(frozen=True)
class FrameSampling(DiffusionSampling):
    """Choose how frames are sampled, as any sequence."""


@dataclass(frozen=True)
class Kept:
    """Hold the features that an edit keeps: their values and where they are (True)."""

    values: Float[Tensor, "b n c"]
    mask: Bool[Tensor, "b n c"]

    @classmethod
    def of(cls, known: Known, lengths: Int[Tensor, " b"], real: Bool[Tensor, "b n"], width: int) -> Kept:
        """Check what is known, whole frames or single features, and lay it over the frames that are generated."""
        values, mask = check_known(known, lengths, width, features=True), known.mask
        mask = (mask if mask.ndim == 3 else mask[..., None]).expand_as(values).to(real.device)
        size = real.shape[1]
        values, mask = (_sized(x.to(real.device), size) for x in (values, mask))
        mask = mask & real[..., None]
        return cls(values.masked_fill(~mask, 0.0), mask)

    def impose(self, x: Float[Tensor, "b n c"]) -> Float[Tensor, "b n c"]:
        """Put the kept features in their places."""
        return torch.where(self.mask, self.values.to(x.dtype), x)


def _sized(x: Tensor, size: int) -> Tensor:
    return F.pad(x[:, :size], (0, 0, 0, max(0, size - x.shape[1])))
