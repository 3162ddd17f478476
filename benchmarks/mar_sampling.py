"""Measure MARDM sampling: rows through the diffusion MLP, seconds per sample, share of the machine's matmul rate.

    python benchmarks/mar_sampling.py [--size tiny|s|xl] [--process ddpm|flow] [--batch 32] [--device cpu]

The rows and seconds are given for sampling only the latents that are kept (default) and all masked ones (published).
The share is the time that the MLP's matrix products take alone, same shapes and dtype in the same run, over the time of
the whole MLP.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable

# One thread unless asked otherwise: on a busy machine the threads of small products wait for each other.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import torch
from torch import nn
from torch.nn import functional as F

from kinema.diffusion.ddpm import DDPM
from kinema.diffusion.flow import Flow
from kinema.generators.mar.model import MARDM, MarSampling
from kinema.nn.diffusion_mlp import DiffusionMLP
from kinema.types import TextFeatures

SIZES = {
    "tiny": {"latent_dim": 256, "width": 256, "feedforward": 1024, "heads": 4, "mlp_width": 256, "mlp_depth": 3},
    "s": {"latent_dim": 512, "width": 384, "feedforward": 1536, "heads": 6, "mlp_width": 1024, "mlp_depth": 3},
    "xl": {"latent_dim": 512},
}


def seconds(runs: list[Callable[[], object]], device: torch.device, repeats: int) -> list[float]:
    """Give each run's shortest time, the runs taking turns so that a busy machine hits them alike."""
    shortest = [float("inf")] * len(runs)
    for _ in range(repeats):
        for i, run in enumerate(runs):
            start = time.perf_counter()
            run()
            synchronize(device)
            shortest[i] = min(shortest[i], time.perf_counter() - start)
    return shortest


def synchronize(device: torch.device) -> None:
    """Wait for the device."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def measure_sampling(model: MARDM, batch: int, resample_all: bool, device: torch.device) -> float:
    """Print rows per sample and seconds per sample of 196 frames; give the seconds."""
    rows: list[int] = []
    hook = model.mlp.final.register_forward_hook(lambda module, inputs, output: rows.append(len(output)))
    text = TextFeatures([""] * batch, torch.randn(batch, 512, device=device))
    frames, seeds = torch.full((batch,), 196, device=device), torch.arange(batch)
    sampling = MarSampling(resample_all=resample_all)
    start = time.perf_counter()
    model.sample(text, frames, seeds=seeds, sampling=sampling)
    synchronize(device)
    elapsed = time.perf_counter() - start
    hook.remove()
    name = "all masked (published)" if resample_all else "kept only (default)"
    # Two guidance halves, 50 evaluations: DDPM's steps, or 25 of the midpoint rule.
    print(
        f"{name:24} {sum(rows) / (100 * batch):6.0f} latents/sample {sum(rows) / batch:9.0f} rows/sample "
        f"{elapsed / batch:8.3f} s/sample"
    )
    return elapsed / batch


@torch.no_grad()
def measure_mlp(mlp: DiffusionMLP, batch: int, device: torch.device) -> None:
    """Print the MLP's rate at the rows of an average unmasking step, beside that of its matrix products alone."""
    rows = 2 * batch * 49 // 17
    once = {mlp.embed_condition, *mlp.time}
    linears = [m for m in mlp.modules() if isinstance(m, nn.Linear) and m not in once]
    inputs = {m.in_features: torch.randn(rows, m.in_features, device=device) for m in linears}
    x = torch.randn(rows, mlp.input_projection.in_features, device=device)
    condition = torch.randn(rows, mlp.embed_condition.out_features, device=device)
    embedded = mlp.embed_time(torch.ones(1, device=device))
    flops = sum(2 * rows * m.in_features * m.out_features for m in linears)
    whole, products = seconds(
        [
            lambda: mlp.denoise(x, embedded, condition),
            lambda: [F.linear(inputs[m.in_features], m.weight) for m in linears],
        ],
        device,
        repeats=30,
    )
    print(
        f"diffusion MLP at {rows} rows: {flops / whole / 1e9:.1f} GFLOP/s, its matrix products alone "
        f"{flops / products / 1e9:.1f} GFLOP/s: share {products / whole:.0%}"
    )


def main() -> None:
    """Measure one size."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", choices=SIZES, default="tiny")
    parser.add_argument("--process", choices=("ddpm", "flow"), default="ddpm")
    parser.add_argument("--batch", type=int, default=32)
    parser.add_argument("--device", default="cpu")
    arguments = parser.parse_args()
    device = torch.device(arguments.device)
    torch.manual_seed(0)
    process = DDPM() if arguments.process == "ddpm" else Flow()
    model = MARDM(text_dim=512, process=process, **SIZES[arguments.size]).to(device).eval()
    parameters = sum(p.numel() for p in model.parameters()) / 1e6
    print(
        f"{arguments.size}: {parameters:.1f} M parameters, batch {arguments.batch}, {torch.get_num_threads()} threads"
    )
    kept, published = (measure_sampling(model, arguments.batch, every, device) for every in (False, True))
    print(f"ratio {published / kept:.1f} of the published way's seconds to ours")
    measure_mlp(model.mlp, arguments.batch, device)


if __name__ == "__main__":
    main()
