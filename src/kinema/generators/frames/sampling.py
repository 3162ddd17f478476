"""Hold the options of sampling by diffusion on frames, the noise that a seed draws, and what an edit holds fixed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional as F

from kinema.decoding.unmasking import SampleDraws
from kinema.diffusion.ddpm import DDPM
from kinema.diffusion.flow import Flow
from kinema.diffusion.guidance import Predict
from kinema.generators.values import check_known
from kinema.types import Known


@dataclass(frozen=True)
class FrameSampling:
    """Choose how frames are sampled.

    `guidance` extrapolates from no text (0) over the text (1). `solver` and `solver_steps` choose how the diffusion
    process samples (None: its defaults), `temperature` scales the noise of its steps.
    """

    guidance: float = 1.0
    solver: str | None = None
    solver_steps: int | str | None = None
    temperature: float = 1.0


def seeded_noise(seeds: Int[Tensor, " b"], drawn: Bool[Tensor, "b n"], width: int) -> Iterator[Float[Tensor, "b n c"]]:
    """Yield normal noise at the frames that are `drawn`, zeros elsewhere: each sample's from its own seed."""
    for rows in SampleDraws(seeds, drawn.sum(dim=1), width, drawn.device).noise(0, drawn):
        noise = rows.new_zeros(*drawn.shape, width)
        noise[drawn] = rows
        yield noise


@dataclass(frozen=True)
class Kept:
    """Hold the features that an edit keeps: their values and where they are (True)."""

    values: Float[Tensor, "b n c"]
    mask: Bool[Tensor, "b n c"]

    @classmethod
    def of(cls, known: Known, lengths: Int[Tensor, " b"], real: Bool[Tensor, "b n"], width: int) -> Kept:
        """Check what is known, whole frames or single features, and lay it over the frames that are generated."""
        check_known(known, lengths, width, features=True)
        values, mask = known.latents.values, known.mask
        mask = (mask if mask.ndim == 3 else mask[..., None]).expand_as(values).to(real.device)
        size = real.shape[1]
        values, mask = (_sized(x.to(real.device), size) for x in (values, mask))
        mask = mask & real[..., None]
        return cls(values.masked_fill(~mask, 0.0), mask)

    def impose(self, x: Float[Tensor, "b n c"]) -> Float[Tensor, "b n c"]:
        """Put the kept features in their places."""
        return torch.where(self.mask, self.values.to(x.dtype), x)

    def imputed(self, predict: Predict, process: DDPM | Flow) -> Predict:
        """Let every (guided) estimate of the clean frames have the kept features in their places (MDM §5)."""

        def fixed(x: Tensor, time: Tensor) -> Tensor:
            return torch.where(self.mask, process.output_for(self.values.to(x.dtype), x, time), predict(x, time))

        return fixed


def _sized(x: Tensor, size: int) -> Tensor:
    return F.pad(x[:, :size], (0, 0, 0, max(0, size - x.shape[1])))
