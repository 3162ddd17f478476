"""Plan a generation of BAD: its options, the order of every position and how many are masked at each step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from kinema.decoding.draws import SeededDraws, TokenDraws
from kinema.generators.tokens.request import TokenRequest
from kinema.masking import SLOTS, paper_counts, ranks, shrinking_counts
from kinema.options import NonNegative, OneOf, Options, Steps
from kinema.registry import buildable

SAMPLERS = ("oaas", "cbs", "rs")
ORDERS = ("random", "arranged")
SCHEDULES = ("shrinking", "paper")
RANDOM_SAMPLING = 1
"""The stream of the order in which RS keeps tokens, apart from the order that the mask tokens name."""


@buildable
@dataclass(frozen=True)
class BadSampling(Options):
    """Choose how tokens are sampled (BAD §4).

    sampler="oaas" (order-agnostic autoregressive) keeps tokens in their permutation's order, "cbs" the most confident
    ones, "rs" random ones. `temperature` None is 0 (the likeliest codes) for oaas and 1 for the others, as published.
    `orders` is the permutation: "random", or "arranged" from left to right. `schedule` "shrinking", as published, takes
    fewer steps for a shorter motion, "paper" all of them for every length. `official_inference_mask` reproduces the
    published samplers: their attention mask, edits with orders and counts of the free positions less one, and the early
    stop of a batch of one.
    """

    sampler: Annotated[str, OneOf(SAMPLERS)] = "oaas"
    steps: Steps = 10
    temperature: NonNegative | None = None
    orders: Annotated[str, OneOf(ORDERS)] = "random"
    schedule: Annotated[str, OneOf(SCHEDULES)] = "shrinking"
    official_inference_mask: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.official_inference_mask and self.schedule != "shrinking":
            raise ValueError(
                f"sampling.schedule {self.schedule!r} is not what the published samplers do; set "
                "official_inference_mask=false, or schedule=shrinking"
            )

    @property
    def effective_temperature(self) -> float:
        """The temperature, the sampler's own where none is set."""
        if self.temperature is None:
            return 0.0 if self.sampler == "oaas" else 1.0
        return self.temperature


@dataclass(frozen=True)
class BadPlan:
    """Hold what is fixed before the first step.

    `orders` are the permutation's, `priority` is lowest where a token is to stay first (None: by confidence), `counts`
    are the masked positions of each step, `official` chooses the published samplers' attention mask.
    """

    lengths: Int[Tensor, " b"]
    free: Bool[Tensor, "b n"]
    orders: Int[Tensor, "b n"]
    priority: Float[Tensor, "b n"] | None
    counts: Int[Tensor, "s b"]
    official: bool


def plan(
    request: TokenRequest,
    sampling: BadSampling,
    draws: TokenDraws,
    seeds: Int[Tensor, " b"],
    *,
    editing: bool,
    direction: str,
) -> BadPlan:
    """Plan a checked request; the permutation is over all positions, in published edits over the free ones."""
    free, size, device = request.real & ~request.keep, request.keep.shape[1], request.keep.device
    arranged = sampling.orders == "arranged"
    drawn = torch.arange(float(size)).expand(free.shape) if arranged else draws.order(size)
    ordered = free if sampling.official_inference_mask else request.real
    orders = ranks(drawn.to(device).masked_fill(~ordered, torch.inf))
    priority = {
        "oaas": orders.float() if direction == "ge" else -orders.float(),
        "rs": SeededDraws(seeds, RANDOM_SAMPLING).order(size).to(device),
        "cbs": None,
    }[sampling.sampler]
    lengths, masked = request.lengths.cpu(), free.sum(dim=1).cpu()
    if sampling.official_inference_mask:
        counts = _official_counts(lengths, masked, sampling, editing, direction)
    elif sampling.schedule == "paper":
        counts = paper_counts(masked, sampling.steps)
    else:
        counts = shrinking_counts(lengths, sampling.steps, masked)
    return BadPlan(request.lengths, free, orders, priority, counts.to(device), sampling.official_inference_mask)


def _official_counts(
    lengths: Int[Tensor, " b"],
    masked: Int[Tensor, " b"],
    sampling: BadSampling,
    editing: bool,
    direction: str,
) -> Int[Tensor, "s b"]:
    """Count as published: edits schedule one position less, of which OAAS keeps one less; a batch of one stops early.

    There `step - 1 / S` stands for `(step - 1) / S`: S steps, but 1 for S = 2, 2 for S = 1 and all for S = 0 (BAD §4).
    """
    counts = shrinking_counts(lengths, sampling.steps, masked - int(editing))
    if editing and sampling.sampler == "oaas" and direction == "ge":
        counts = counts + 1
    if len(lengths) == 1:
        steps = int((sampling.steps / SLOTS * lengths).round())
        counts = counts[: {0: sampling.steps, 1: 2, 2: 1}.get(steps, steps)]
    return counts
