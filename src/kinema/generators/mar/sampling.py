"""Set up a masked autoregressive generation or edit: its options, its start and its order of work."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from kinema.decoding.unmasking import UnmaskingStep, plan_unmasking
from kinema.diffusion.choices import Solver, SolverGrid, SolverSteps
from kinema.generators.values import check_known
from kinema.masking import cosine_counts, lowest, masked_count
from kinema.options import FullShare, NonNegative, Options, Steps
from kinema.registry import buildable
from kinema.types import Known, Latents, LatentSpace, frame_mask


@buildable
@dataclass(frozen=True)
class MarSampling(Options):
    """Choose how latents are sampled.

    `solver` and `solver_steps` choose how the diffusion process samples (None: its defaults), `solver_grid` where a
    flow's steps lie. `resample_all` samples every masked position at every step instead of those that are kept (as
    published: 11 times the work, the same distribution). `clip_latents` holds predicted latents inside the range of
    those of training and validation. `pseudo_reorder` sorts known positions first inside the transformer (paper Fig.
    3c; no effect but rounding). `edit_fraction` makes an edit mask-free (published: 0.16): of a motion of which nothing
    is kept only this share, chosen by the seed, is regenerated, all at once.
    """

    steps: Steps = 18
    guidance: NonNegative = 4.5
    solver: Solver | None = None
    solver_steps: SolverSteps | None = None
    solver_grid: SolverGrid = "uniform"
    resample_all: bool = False
    temperature: NonNegative = 1.0
    clip_latents: bool = False
    pseudo_reorder: bool = False
    edit_fraction: FullShare | None = None


def start(
    space: LatentSpace, lengths: Int[Tensor, " b"], known: Known | None, sampling: MarSampling
) -> tuple[Latents, Tensor]:
    """Make the latents to start from (known ones, zeros elsewhere) and the mask of the positions that are free.

    Raises ValueError for a mask-free edit without a whole motion to edit.
    """
    positions, width = int(lengths.max()), space.width
    assert width is not None  # values have a width
    real = frame_mask(lengths, positions)
    values = torch.zeros(len(lengths), positions, width, device=lengths.device)
    free = real
    if known is not None:
        source = check_known(known, lengths, width)
        values = torch.where(real[:, :, None], source[:, :positions].to(values), values)
        free = real & ~known.mask[:, :positions].to(real.device)
    if sampling.edit_fraction is not None and (known is None or not torch.equal(free, real)):
        # Kept stretches are encoded by themselves: between them there are no latents that could stay as they are.
        raise ValueError(
            f"edit_fraction={sampling.edit_fraction} regenerates a share of a motion of which nothing is kept; "
            "edit all of its frames (kinema edit --regenerate 0:), or leave it out"
        )
    return Latents(lengths=lengths, frames=space.frames_of(lengths), values=values), free


def plan(order: Float[Tensor, "b n"], free: Bool[Tensor, "b n"], sampling: MarSampling) -> list[UnmaskingStep]:
    """Plan the unmasking of the free positions over the cosine counts, or of a fixed share of them (mask-free edit)."""
    order, free = order.cpu(), free.cpu()
    lengths = free.sum(dim=1)
    if sampling.edit_fraction is None:
        counts = cosine_counts(lengths, sampling.steps)
    else:
        fixed = masked_count(lengths, torch.tensor(sampling.edit_fraction))
        free, counts = lowest(order, free, fixed), fixed.expand(sampling.steps, -1)
    return plan_unmasking(order, free, counts, sampling.resample_all)
