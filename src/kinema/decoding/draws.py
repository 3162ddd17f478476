"""Draw what a discrete generation takes: numbers that are functions of (seed, step, position), for all samples at once.

A counter-based generator needs no state and no loop over samples: a sample's numbers depend on its own seed only,
whatever its batch, padding or device.
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float, Int
from torch import Tensor

ORDER = -1
"""The step under which the order of positions is drawn."""

_GOLDEN, _MIX1, _MIX2 = -0x61C8864680B583EB, -0x40A7B892E31B1A47, -0x6B2FB644ECCEEE15
LARGEST = 1 - 2.0**-22
"""Numbers stay this far below 1, so that their product with a sum of probabilities stays below the sum."""

BLOCK = 1 << 22
"""Probabilities that are worked on at once: fresh memory costs more than the arithmetic on it."""


@runtime_checkable
class TokenDraws(Protocol):
    """Everything random in the generation of tokens (tests inject recorded draws)."""

    def order(self, size: int) -> Float[Tensor, "b n"]:
        """Return one number per position, from which a method derives its order of decoding."""

    def pick(self, step: int, logits: Float[Tensor, "b n k"]) -> Int[Tensor, "b n"]:
        """Draw one class per position from softmax(logits)."""


class SeededDraws:
    """Draw by one seed per sample; `stream` keeps the draws of several stages of one sample apart."""

    def __init__(self, seeds: Int[Tensor, " b"], stream: int = 0) -> None:
        self.seeds = _mix(seeds.cpu().long() + torch.tensor(stream) * _GOLDEN)

    def order(self, size: int) -> Float[Tensor, "b n"]:
        """Return uniform numbers (on the CPU, where orders are made)."""
        return uniform(self.seeds, ORDER, size)

    def pick(self, step: int, logits: Float[Tensor, "b n k"]) -> Int[Tensor, "b n"]:
        """Invert the distribution at one uniform number per position."""
        return categorical(logits, uniform(self.seeds, step, logits.shape[1]).to(logits.device))


class Greedy:
    """Take the likeliest class; the order comes from the seeds."""

    def __init__(self, seeds: Int[Tensor, " b"]) -> None:
        self.order = SeededDraws(seeds).order

    def pick(self, step: int, logits: Float[Tensor, "b n k"]) -> Int[Tensor, "b n"]:
        """Return the argmax."""
        return logits.argmax(-1)


def uniform(seeds: Int[Tensor, " b"], step: int, size: int) -> Float[Tensor, "b n"]:
    """Hash (seed, step, position) to numbers in (0, 1); the first `size` are the same whatever `size` is."""
    stepped = _mix(seeds.cpu()[:, None] ^ _mix(torch.tensor(step + 2)))
    bits = _mix(stepped + torch.arange(1, size + 1) * _GOLDEN)
    return ((_shift(bits, 40).float() + 0.5) * 2.0**-24).clamp(max=LARGEST)


def categorical(logits: Float[Tensor, "*b k"], uniform: Float[Tensor, "*b"]) -> Int[Tensor, "*b"]:
    """Draw a class of softmax(logits) by the inverse of its distribution function; -inf is never drawn."""
    # Samples stay whole: flattening a slice of a network's output would copy it.
    size = max(1, BLOCK // logits[0].numel())
    return torch.cat([_invert(*part) for part in zip(logits.split(size), uniform.split(size), strict=True)])


def _invert(logits: Float[Tensor, "*b k"], uniform: Float[Tensor, "*b"]) -> Int[Tensor, "*b"]:
    total = logits.float().softmax(-1).cumsum_(-1)
    target = uniform[..., None] * total[..., -1:]
    return torch.searchsorted(total, target, right=True)[..., 0].clamp(max=logits.shape[-1] - 1)


def _shift(x: Int[Tensor, "*b"], bits: int) -> Int[Tensor, "*b"]:
    """Shift right without the sign."""
    return (x >> bits) & ((1 << (64 - bits)) - 1)


def _mix(x: Int[Tensor, "*b"]) -> Int[Tensor, "*b"]:
    """Scramble 64 bits (the finaliser of splitmix64; products wrap around)."""
    x = (x ^ _shift(x, 30)) * _MIX1
    x = (x ^ _shift(x, 27)) * _MIX2
    return x ^ _shift(x, 31)
