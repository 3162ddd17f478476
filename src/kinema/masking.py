"""Choose positions at random: mask schedules, ranks and masks, every random draw handed in."""

from __future__ import annotations

import math

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn.functional import pad

from kinema.types import frame_mask


def cosine_ratio(time: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    """Return the share of positions masked at time 0..1: cos(pi t / 2)."""
    return torch.cos(time * math.pi * 0.5)


def masked_count(lengths: Int[Tensor, "..."], ratio: Float[Tensor, "..."]) -> Int[Tensor, "..."]:
    """Count the positions to mask: max(1, round half to even (length * ratio)); the shapes broadcast."""
    return (lengths * ratio).round().clamp(min=1).long()


def cosine_counts(lengths: Int[Tensor, " b"], steps: int) -> Int[Tensor, "s b"]:
    """Count the masked positions before each of `steps` unmasking steps (MARDM §6, in float32 as published)."""
    return masked_count(lengths, cosine_ratio(torch.linspace(0, 1, steps, device=lengths.device))[:, None])


SLOTS = 49
"""The positions over which MMM's and BAD's schedule shrinks: a constant, whatever the model's longest motion."""


def shrinking_counts(
    lengths: Int[Tensor, " b"], steps: int, free: Int[Tensor, " b"] | None = None
) -> Int[Tensor, "s b"]:
    """Count the masked positions before each of `steps` unmasking steps of MMM and BAD (BAD §4).

    A sample of 49 positions shrinks over all steps, a shorter one over S = round(steps / 49 * length), after which one
    position is decoded again and again: max(1, floor(cos(pi / 2 min(1, i / S)) * count)), where count is the length, or
    what an edit leaves `free`. In float32 as published: on another device than the CPU ties may fall apart.
    """
    step = torch.arange(steps, device=lengths.device)[:, None]
    time = (step / (steps / SLOTS * lengths).round()).nan_to_num(0.0, posinf=1.0).clamp(max=1)
    return ((lengths if free is None else free) * cosine_ratio(time)).floor().clamp(min=1).long()


def paper_counts(free: Int[Tensor, " b"], steps: int) -> Int[Tensor, "s b"]:
    """Count the masked positions before each of `steps` unmasking steps as BAD's paper has it: T cos(pi i / 2I).

    Rounded (the paper doesn't say how), at least 1; every length takes all steps.
    """
    step = torch.arange(steps, device=free.device)[:, None]
    return masked_count(free, cosine_ratio(step / steps))


def ranks(scores: Float[Tensor, "b n"]) -> Int[Tensor, "b n"]:
    """Rank each row's scores, 0 for the lowest."""
    return scores.argsort(dim=-1, stable=True).argsort(dim=-1)


def lowest(
    scores: Float[Tensor, "b n"], eligible: Bool[Tensor, "b n"], count: Int[Tensor, " b"]
) -> Bool[Tensor, "b n"]:
    """Mark the `count` eligible positions of lowest score in each row, all of them where they are fewer."""
    return (ranks(scores.masked_fill(~eligible, torch.inf)) < count[:, None]) & eligible


DIRECTIONS = ("ge", "le")


def hybrid_mask(
    orders: Int[Tensor, "b n"],
    masked: Bool[Tensor, "b n"],
    lengths: Int[Tensor, " b"],
    *,
    conditions: int,
    direction: str = "ge",
    unmasked_see_masks: bool = False,
) -> Bool[Tensor, "b m m"]:
    """Say which column each row of [sentence, time?, tokens, END, PAD...] may see: bidirectional and permuted causal.

    Everybody sees the conditions, the unmasked tokens and END (position `lengths`), nobody the padding. A masked row
    sees the masked tokens of its own or a higher order ("ge"; "le": own or lower, BAD's z_0_attend_to_all off). The
    time row sees all masks; the sentence and unmasked rows none, or all with `unmasked_see_masks` (BAD §3.6).
    """
    if direction not in DIRECTIONS:
        raise ValueError(f"direction {direction!r} is unknown; choose one of {', '.join(DIRECTIONS)}")
    ahead = (conditions, 0)
    valid = pad(frame_mask(lengths + 1, orders.shape[1]), ahead, value=True)
    hidden, orders = pad(masked, ahead), pad(orders, ahead)
    rows, columns = orders[:, :, None], orders[:, None, :]
    ordered = columns >= rows if direction == "ge" else columns <= rows
    sees_masks = torch.where(hidden[:, :, None], ordered, unmasked_see_masks)
    sees_masks[:, 1:conditions] = True
    return valid[:, None] & (~hidden[:, None] | sees_masks)


def official_inference_mask(
    orders: Int[Tensor, "b n"],
    free: Bool[Tensor, "b n"],
    masked: Bool[Tensor, "b n"],
    lengths: Int[Tensor, " b"],
    *,
    conditions: int,
    direction: str = "ge",
    unmasked_see_masks: bool = False,
) -> Bool[Tensor, "b m m"]:
    """Make the mask of BAD's published samplers, which differs from training once tokens are decoded (BAD §4).

    It is that of the start, where all `free` tokens were masked: only the columns of decoded ones become visible, their
    rows stay as they were. Column lengths + 1 is visible too: END, or the last token where a time token stands ahead.
    """
    start = hybrid_mask(
        orders, free, lengths, conditions=conditions, direction=direction, unmasked_see_masks=unmasked_see_masks
    )
    shown = pad(free & ~masked, (conditions, 0)).scatter(1, lengths[:, None] + 1, True)
    return start | shown[:, None]
