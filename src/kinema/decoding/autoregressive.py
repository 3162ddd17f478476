"""Decode tokens from left to right over a `predict` callable."""

from __future__ import annotations

from collections.abc import Callable

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from kinema.decoding.draws import TokenDraws


def decode_left_to_right(
    predict: Callable[[int, Int[Tensor, "b n"]], Float[Tensor, "b k"]],
    ids: Int[Tensor, "b n"],
    lengths: Int[Tensor, " b"],
    draws: TokenDraws,
    *,
    keep: Bool[Tensor, "b n"] | None = None,
    end: int | None = None,
) -> tuple[Int[Tensor, "b n"], Int[Tensor, " b"]]:
    """Fill the slots below each length from left to right; give the ids and the lengths.

    `predict(step, ids)` gives the logits of slot `step`; slots before it are decided. `ids` is what the slots hold at
    the start: those in `keep` and those behind a sample's end still hold it at the end. Drawing the class `end` (none
    if None) at a free slot makes that slot the sample's length; when all samples have ended no step follows.
    """
    ids, lengths = ids.clone(), lengths.clone()
    for step in range(ids.shape[1]):
        if end is not None and not (lengths > step).any():
            break
        token = draws.pick(step, predict(step, ids)[:, None])[:, 0]
        free = lengths > step if keep is None else (lengths > step) & ~keep[:, step]
        if end is not None:
            ended = free & (token == end)
            lengths, free = lengths.masked_fill(ended, step), free & ~ended
        ids[:, step] = torch.where(free, token, ids[:, step])
    return ids, lengths
