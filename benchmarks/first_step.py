"""Measure how an error of epsilon at the noisiest timesteps reaches the samples of each DDPM solver.

    python benchmarks/first_step.py [--error 0.03]

The model is the best possible one for Gaussian data, plus a constant error per dimension. "from 49" starts at the last
timestep of the cosine schedule, whose x0 holds the error 1015 times, "from 47" where it holds it 16 times. Given is the
Fréchet distance per dimension over the data's variance: 0 for the data, 1 where means are off by one deviation. x0 is
clipped to so many deviations on either side of the mean, or not at all.
"""

from __future__ import annotations

import argparse
import os
import warnings

os.environ.setdefault("OMP_NUM_THREADS", "1")

import torch
from torch import Tensor

from kinema.diffusion.ddpm import DDPM

DIMS, SAMPLES = 64, 2000
CHOICES = {
    "ancestral, 50 steps": {"solver": "ancestral"},
    "ancestral, 16": {"solver": "ancestral", "steps": 16},
    "ancestral, 10": {"solver": "ancestral", "steps": 10},
    "ancestral, 10 from 45": {"solver": "ancestral", "steps": "ddim10"},
    "ddim, 50 from 49": {"solver": "ddim"},
    "ddim, 5 + 5 from 49": {"solver": "ddim", "steps": "5,5"},
    "ddim, 10 from 47": {"solver": "ddim", "steps": 10},
    "heun, 5 from 47": {"solver": "heun", "steps": 5},
    "dpmpp_2m, 10 from 47": {"solver": "dpmpp_2m", "steps": 10},
}
CLIPS = (4.0, 10.0, None)


def distance(process: DDPM, deviation: float, error: float, clip: float | None, options: dict) -> float:
    """Sample, and return the Fréchet distance of the dims' means and deviations over the variance."""
    draw = torch.Generator().manual_seed(0)
    mean = 0.6 * deviation * torch.randn(DIMS, generator=draw, dtype=torch.float64)
    wrong = error * torch.randn(DIMS, generator=draw, dtype=torch.float64)

    def predict(x: Tensor, t: Tensor) -> Tensor:
        alpha_bar = process.schedule.alphas_cumprod[t.long()]
        variance = alpha_bar * deviation**2 + 1 - alpha_bar
        return (1 - alpha_bar).sqrt() * (x - alpha_bar.sqrt() * mean) / variance + wrong

    def noise():
        while True:
            yield torch.randn(SAMPLES, DIMS, generator=draw, dtype=torch.float64)

    limits = None if clip is None else (mean - clip * deviation, mean + clip * deviation)
    x = process.sample(predict, noise(), clip=limits, **options)
    off = (x.mean(0) - mean).square() + (x.std(0) - deviation).square()
    return off.mean().item() / deviation**2


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--error", type=float, default=0.03, help="deviation of the error of epsilon over the dims")
    error = parser.parse_args().error
    warnings.simplefilter("ignore")
    process = DDPM()
    for deviation in (0.5, 2.0):
        print(f"\ndata of deviation {deviation}, error {error}; x0 clipped to " + ", ".join(map(str, CLIPS)))
        for name, options in CHOICES.items():
            row = [distance(process, deviation, error, clip, options) for clip in CLIPS]
            print(f"{name:22s}" + "".join(f"{value:9.3f}" for value in row))


if __name__ == "__main__":
    main()
