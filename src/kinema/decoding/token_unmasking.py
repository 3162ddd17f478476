"""Decode masked tokens in parallel: predict all of them, keep some, predict the others again."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from kinema.decoding.draws import TokenDraws
from kinema.masking import lowest

PART = 2**22
"""Numbers that are worked on at once (16 MB)."""

Predict = Callable[[Int[Tensor, "b n"], Bool[Tensor, "b n"], int], Float[Tensor, "b n k"]]
"""Return logits from (codes, masked, step); what the codes hold at masked positions means nothing."""

Choose = Callable[[int, Float[Tensor, "b n k"]], Int[Tensor, "b n"]]
"""Choose one code per position from the logits of a step."""


def choice(draws: TokenDraws, temperature: float = 1.0) -> Choose:
    """Draw from softmax(logits / temperature); temperature 0 takes the likeliest code."""
    if temperature == 0:
        return lambda step, logits: logits.argmax(-1)
    if temperature == 1:
        return draws.pick
    return lambda step, logits: draws.pick(step, logits / temperature)


def unmask_tokens(
    codes: Int[Tensor, "b n"],
    free: Bool[Tensor, "b n"],
    counts: Int[Tensor, "s b"],
    predict: Predict,
    choose: Choose,
    order: Float[Tensor, "b n"] | None = None,
) -> Iterator[tuple[Bool[Tensor, "b n"], Int[Tensor, "b n"]]]:
    """Decode the `free` positions; yield, per step, what was masked and the codes after it.

    Step 0 sees all free positions masked; before step i > 0 the counts[i] least confident ones of those just decoded
    are masked again, confidence being softmax(logits) of the chosen code, and the others stay for good (MMM, MoMask,
    BAD's CBS). With an `order` those stay first that are lowest in it (BAD's OAAS; a random order: RS). Counts must not
    grow. After the last step all positions hold codes.
    """
    masked, scores = free, None if order is None else -order.to(codes.device)
    for step, count in enumerate(counts):
        masked = free if scores is None or step == 0 else lowest(scores, masked, count)
        logits = predict(codes, masked, step)
        chosen = choose(step, logits)
        codes = torch.where(masked, chosen, codes)
        if order is None:
            scores = _log_probability(logits, chosen)
        yield masked, codes


def _log_probability(logits: Float[Tensor, "b n k"], chosen: Int[Tensor, "b n"]) -> Float[Tensor, "b n"]:
    # In parts: temporaries as large as all logits would cost more in fresh memory than in arithmetic.
    parts = logits.split(max(1, PART // logits[0].numel()))
    total = torch.cat([part.logsumexp(-1) for part in parts])
    return logits.gather(-1, chosen[..., None])[..., 0] - total
