"""Say which positions of text and motion see which (FRONTIER §2.2)."""

from __future__ import annotations

import torch
from jaxtyping import Bool
from torch import Tensor

MASKS = ("bidirectional", "causal")


def sees(
    words: Bool[Tensor, "b l"], real: Bool[Tensor, "b n"], *, causal: bool = False, block: int = 1
) -> Bool[Tensor, "b 1 #q k"]:
    """Return who sees whom over (text, motion); nobody sees padding.

    Bidirectional: all see all. Causal: motion sees the text and the motion up to its own block of `block` positions,
    text sees the text alone.
    """
    keys = torch.cat((words, real), dim=1)[:, None, None, :]
    if not causal:
        return keys
    length, total = words.shape[1], words.shape[1] + real.shape[1]
    place = torch.arange(total, device=real.device) - length
    turn = torch.where(place < 0, -1, place.clamp(min=0) // block)
    return keys & (turn[None, :] <= turn[:, None])
