"""Tabulate noise schedules of discrete diffusion, in float64 on the CPU, and respace them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate

import torch
from jaxtyping import Float, Int
from torch import Tensor

HOME = "cpu"
"""Where tables are, also those of a model that is built without memory, whose sampling is checked all the same."""


def cosine_betas(steps: int) -> Float[Tensor, " t"]:
    """Tabulate beta_i = min(1 - abar((i+1)/T) / abar(i/T), 0.999), abar(u) = cos^2((u+0.008)/1.008 pi/2)."""
    time = torch.arange(steps + 1, dtype=torch.float64, device=HOME) / steps
    alpha_bar = torch.cos((time + 0.008) / 1.008 * math.pi / 2) ** 2
    return (1 - alpha_bar[1:] / alpha_bar[:-1]).clamp(max=0.999)


def linear_betas(steps: int) -> Float[Tensor, " t"]:
    """Tabulate betas from 1e-4 to 0.02, scaled by 1000/T so that any T ends at about the same noise."""
    scale = 1000 / steps
    return torch.linspace(scale * 1e-4, scale * 0.02, steps, dtype=torch.float64, device=HOME)


def scaled_linear_betas(steps: int) -> Float[Tensor, " t"]:
    """Tabulate betas from 0.00085 to 0.012, equally spaced in their roots, scaled by 1000/T (MLD §2)."""
    scale = 1000 / steps
    return (
        torch.linspace((scale * 0.00085) ** 0.5, (scale * 0.012) ** 0.5, steps, dtype=torch.float64, device=HOME) ** 2
    )


BETAS = {"cosine": cosine_betas, "linear": linear_betas, "scaled_linear": scaled_linear_betas}


def make_schedule(name: str, steps: int) -> Schedule:
    """Make a schedule by name ("cosine", "linear" or "scaled_linear")."""
    if name not in BETAS:
        raise ValueError(f"schedule {name!r} is unknown; choose one of {', '.join(BETAS)}")
    if steps < 1:
        raise ValueError(f"a diffusion needs at least 1 step, got {steps}")
    betas = BETAS[name](steps)
    if betas.max() >= 1:
        raise ValueError(f"schedule {name!r} leaves no signal in {steps} steps; give more than 20, or take 'cosine'")
    return Schedule(betas, torch.arange(steps, device=HOME))


@dataclass(frozen=True)
class Schedule:
    """Hold the betas of a diffusion and what follows from them.

    `timesteps` are the times that the network sees: 0..T-1, or a subset of them after respacing. `end` is the abar
    that sampling ends at: 1, clean data, or a little less.
    """

    betas: Float[Tensor, " t"]
    timesteps: Int[Tensor, " t"]
    end: float = 1.0

    @cached_property
    def alphas_cumprod(self) -> Float[Tensor, " t"]:
        return self.end * torch.cumprod(1 - self.betas, dim=0)

    @cached_property
    def alphas_cumprod_prev(self) -> Float[Tensor, " t"]:
        return torch.cat((self.betas.new_tensor([self.end]), self.alphas_cumprod[:-1]))

    @cached_property
    def amplification(self) -> Float[Tensor, " t"]:
        """What an error of epsilon is multiplied by in the estimate of the clean data: sigma / signal."""
        return (1 / self.alphas_cumprod - 1).sqrt()

    @cached_property
    def posterior_variance(self) -> Float[Tensor, " t"]:
        return self.betas * (1 - self.alphas_cumprod_prev) / (1 - self.alphas_cumprod)

    @cached_property
    def posterior_log_variance_clipped(self) -> Float[Tensor, " t"]:
        """The log variance with that of step 0 (which is 0, and never used) replaced by that of step 1."""
        second = self.posterior_variance[1:2] if len(self.betas) > 1 else self.betas[:1]
        return torch.cat((second, self.posterior_variance[1:])).log()

    @cached_property
    def posterior_mean_coef1(self) -> Float[Tensor, " t"]:
        """The weight of x0 in the posterior mean."""
        return self.betas * self.alphas_cumprod_prev.sqrt() / (1 - self.alphas_cumprod)

    @cached_property
    def posterior_mean_coef2(self) -> Float[Tensor, " t"]:
        """The weight of x_t in the posterior mean."""
        return (1 - self.alphas_cumprod_prev) * (1 - self.betas).sqrt() / (1 - self.alphas_cumprod)

    def respace(self, steps: int | str) -> Schedule:
        """Keep the timesteps of `spaced_timesteps`; "leading" ones end at the noise of timestep 0 (MLD §2)."""
        kept = spaced_timesteps(len(self.betas), steps)
        return self.keep(kept, self.alphas_cumprod[0].item() if str(steps).startswith("leading") else self.end)

    def below(self, amplification: float) -> Schedule:
        """Keep the timesteps that multiply an error of epsilon by at most this (timestep 0 in any case)."""
        return self.keep(torch.arange(max(1, int((self.amplification <= amplification).sum())), device=HOME), self.end)

    def keep(self, kept: Int[Tensor, " s"], end: float = 1.0) -> Schedule:
        """Keep some timesteps, with the betas that leave their alphas_cumprod as they are."""
        alphas_cumprod = self.alphas_cumprod[kept]
        before = torch.cat((alphas_cumprod.new_tensor([end]), alphas_cumprod[:-1]))
        return Schedule(1 - alphas_cumprod / before, self.timesteps[kept], end)


def spaced_timesteps(total: int, steps: int | str) -> Int[Tensor, " s"]:
    """Choose timesteps out of 0..total-1.

    A count (10 or "10") spaces them evenly, both ends included; counts per section ("20,5") do so in as many equal
    sections; "ddim10" takes the integer stride that gives 10, "leading10" the stride total / 10 from 1 on. A single
    step is the last one, as sampling starts from noise.
    """
    text = str(steps)
    try:
        if text.startswith("ddim"):
            return _strided(total, int(text.removeprefix("ddim")))
        if text.startswith("leading"):
            return _leading(total, int(text.removeprefix("leading")))
        counts = [int(part) for part in text.split(",")]
    except ValueError:
        raise _bad_steps(total, steps) from None
    sizes = [total // len(counts) + (i < total % len(counts)) for i in range(len(counts))]
    if any(not 1 <= count <= size for count, size in zip(counts, sizes, strict=True)):
        raise _bad_steps(total, steps)
    if counts == [1]:
        return torch.tensor([total - 1], device=HOME)
    kept, start = [], 0
    for size, count in zip(sizes, counts, strict=True):
        stride = (size - 1) / (count - 1) if count > 1 else 1.0
        # A running sum, as published: its float error decides where a half is rounded (12 * 49 / 24 gives 25, not 24).
        kept += [start + round(position) for position in accumulate([0.0] + [stride] * (count - 1))]
        start += size
    return torch.tensor(kept, device=HOME)


def _strided(total: int, count: int) -> Int[Tensor, " s"]:
    for stride in range(1, total + 1):
        if len(range(0, total, stride)) == count:
            return torch.arange(0, total, stride, device=HOME)
    raise ValueError(count)


def _leading(total: int, count: int) -> Int[Tensor, " s"]:
    if not 2 <= count <= total // 2 or total % count:
        raise ValueError(count)
    return torch.arange(1, total, total // count, device=HOME)


def _bad_steps(total: int, steps: int | str) -> ValueError:
    return ValueError(
        f"cannot take {steps!r} steps out of {total}; give a count from 1 to {total}, counts per section such as "
        f'"20,5" (each at most the section\'s size), "ddimN" where an integer stride gives N, or "leadingN" where N '
        f"from 2 to {total // 2} divides {total}"
    )
