"""Draw the noise of whole sequences from one seed per sample."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from jaxtyping import Float, Int
from torch import Tensor


def sequence_noise(
    seeds: Int[Tensor, " b"], lengths: Int[Tensor, " b"], width: int, device: torch.device | str = "cpu"
) -> Iterator[Float[Tensor, "b t d"]]:
    """Yield standard normal sequences without end, zero past each length: the start, then one for each step.

    Each sample has a generator on the CPU that draws rows for its own length only, so that nothing depends on the
    batch, its padding or the device.
    """
    generators = [torch.Generator().manual_seed(seed) for seed in seeds.tolist()]
    sizes = lengths.tolist()
    while True:
        noise = torch.zeros(len(sizes), max(sizes), width)
        for row, size, generator in zip(noise, sizes, generators, strict=True):
            row[:size] = torch.randn(size, width, generator=generator)
        yield noise.to(device)
