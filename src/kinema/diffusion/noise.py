"""Draw the noise of whole sequences from one seed per sample."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import torch
from jaxtyping import Float, Int
from torch import Tensor


def sequence_noise(
    seeds: Int[Tensor, " b"], lengths: Int[Tensor, " b"], width: int, device: torch.device | str = "cpu"
) -> Iterator[Float[Tensor, "b t d"]]:
    """Yield standard normal sequences without end, zero past each length: the start, then one for each step.

    Each sample has a generator on the CPU that draws rows for its own length only, so that nothing depends on the
    batch, its padding or the device. Samples are drawn side by side in as many threads as torch computes with: one
    would keep a GPU waiting.
    """
    generators = [torch.Generator().manual_seed(seed) for seed in seeds.tolist()]
    sizes = lengths.tolist()
    count = min(torch.get_num_threads(), len(sizes))

    def draw(noise: Tensor, first: int) -> None:
        for row, size, generator in zip(
            noise[first::count], sizes[first::count], generators[first::count], strict=True
        ):
            row[:size] = torch.randn(size, width, generator=generator)

    with ThreadPoolExecutor(count) as pool:
        while True:
            noise = torch.zeros(len(sizes), max(sizes), width)
            others = [pool.submit(draw, noise, first) for first in range(1, count)]
            draw(noise, 0)
            for other in others:
                other.result()
            yield noise.to(device)
