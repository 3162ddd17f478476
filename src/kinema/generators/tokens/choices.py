"""Choose codes among the likeliest classes."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor

from kinema.decoding.draws import TokenDraws
from kinema.decoding.token_unmasking import Choose, choice


def likely_choice(draws: TokenDraws, temperature: float, dropped: float) -> Choose:
    """Draw among the likeliest ceil((1 - dropped) * classes) classes.

    In Python floats as published, which leave 3 of 30 classes for 0.9, not 4 (COMMON §8).
    """
    choose = choice(draws, temperature)

    def among_the_likeliest(step: int, logits: Float[Tensor, "b n k"]) -> Int[Tensor, "b n"]:
        least = logits.topk(math.ceil((1 - dropped) * logits.shape[-1])).values[..., -1:]
        return choose(step, logits.masked_fill(logits < least, -torch.inf))

    return among_the_likeliest
