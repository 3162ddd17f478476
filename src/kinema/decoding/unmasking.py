"""Unmask positions in random order, and draw what that takes from one seed per sample."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from kinema.masking import ranks

NOISE_BLOCK = 8


@runtime_checkable
class Draws(Protocol):
    """Everything random in a generation: the order of the positions and the noise of the sampled ones."""

    def order(self) -> Float[Tensor, "b n"]:
        """Return one number per position; the highest is decoded first."""

    def noise(self, step: int, mask: Bool[Tensor, "b n"]) -> Iterator[Float[Tensor, "m c"]]:
        """Yield, for unmasking step `step`, noise rows of the positions in `mask` (row-major): start, step 1, 2 ..."""


class SampleDraws:
    """Draw on the CPU from one generator per sample: nothing depends on batch, padding or device."""

    def __init__(
        self, seeds: Int[Tensor, " b"], lengths: Int[Tensor, " b"], width: int, device: torch.device | str = "cpu"
    ) -> None:
        self.generators = [torch.Generator().manual_seed(seed) for seed in seeds.tolist()]
        self.lengths = lengths.tolist()
        self.width = width
        self.device = device

    def order(self) -> Float[Tensor, "b n"]:
        """Return uniform numbers; padding gets 2."""
        order = torch.full((len(self.lengths), max(self.lengths)), 2.0)
        for row, length, generator in zip(order, self.lengths, self.generators, strict=True):
            row[:length] = torch.rand(length, generator=generator)
        return order

    def noise(self, step: int, mask: Bool[Tensor, "b n"]) -> Iterator[Float[Tensor, "m c"]]:
        """Yield standard normal rows, the steps' in blocks (fewer small draws and copies)."""
        rows = [(count, g) for count, g in zip(mask.sum(dim=1).tolist(), self.generators, strict=True) if count]
        block = 1
        while True:
            drawn = [torch.randn(block, count, self.width, generator=generator) for count, generator in rows]
            yield from torch.cat(drawn, dim=1).to(self.device)
            block = NOISE_BLOCK


@dataclass(frozen=True)
class UnmaskingStep:
    """Hold what one step sees as masked and which of these positions it samples (CPU masks)."""

    index: int
    masked: Bool[Tensor, "b n"]
    sampled: Bool[Tensor, "b n"]


def plan_unmasking(
    order: Float[Tensor, "b n"],
    free: Bool[Tensor, "b n"],
    counts: Int[Tensor, "s b"],
    resample_all: bool = False,
) -> list[UnmaskingStep]:
    """Plan which positions are masked and sampled at each step: before step i the counts[i] free ones of lowest order.

    The order is fixed up front, so the positions that leave the masked set at a step are known: only these are sampled,
    and steps that release nothing are left out. `resample_all` samples all masked ones at every step (as published).
    """
    rank = ranks(order.masked_fill(~free, torch.inf))
    masked = (rank < counts[:, :, None]) & free
    following = torch.cat((masked[1:], torch.zeros_like(masked[:1])))
    sampled = masked if resample_all else masked & ~following
    steps = [UnmaskingStep(i, m, s) for i, (m, s) in enumerate(zip(masked, sampled, strict=True))]
    return [step for step in steps if step.sampled.any()]


def unmask(
    latents: Float[Tensor, "b n c"],
    mask_latent: Float[Tensor, " c"],
    plan: list[UnmaskingStep],
    predict: Callable[[UnmaskingStep, Tensor, tuple[Tensor, Tensor]], Float[Tensor, "m c"]],
) -> Iterator[tuple[UnmaskingStep, Float[Tensor, "b n c"]]]:
    """Walk through the plan: mask, let `predict(step, latents, (rows, positions))` sample, write; yield each state."""
    for step in plan:
        latents = torch.where(step.masked[:, :, None].to(latents.device), mask_latent, latents)
        rows, positions = (index.to(latents.device) for index in step.sampled.nonzero(as_tuple=True))
        where = (rows, positions)
        latents[where] = predict(step, latents, where).to(latents.dtype)
        yield step, latents
