"""Measure parallel decoding of tokens: seconds of sampling over those of its forward passes alone, training ms/step.

    python benchmarks/token_sampling.py [--methods mmm bad momask] [--codes 512 8192] [--batch 32] [--device cpu]

A batch of clips of 196 frames (49 tokens) is sampled with the published steps by networks of width 256 and three blocks
(fewer than tiny ones have, which makes the ratio larger). The forward passes alone are those of the same sampling,
recorded and run again: what the ratio exceeds 1 by is the price of choosing codes and positions. Methods that this
checkout lacks are left out.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import time
from collections.abc import Callable

# One thread unless asked otherwise: on a busy machine the threads of small products wait for each other.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import torch
from torch import nn

from kinema.types import Latents, TextFeatures

POSITIONS, WORDS, TEXT_DIM = 49, 20, 384
SIZES = {"width": 256, "heads": 4, "feedforward": 1024, "text_dim": TEXT_DIM}
LAYERS = {"cross_layers": 1, "base_layers": 1, "head_layers": 1, "token_dim": TEXT_DIM}


def make_mmm(codes: int) -> nn.Module:
    """Make MMM, which draws its codes."""
    from kinema.generators.mmm import MMM

    return MMM(codebook_size=codes, code_dim=32, **SIZES, **LAYERS)


def make_bad(codes: int) -> nn.Module:
    """Make BAD, its confidence-based sampler drawing codes."""
    from kinema.generators.bad.model import BAD
    from kinema.generators.bad.sampling import BadSampling

    sampling = BadSampling(sampler="cbs")
    return BAD(codebook_size=codes, code_dim=32, sampling=sampling, **SIZES, **LAYERS)


def make_momask(codes: int) -> nn.Module:
    """Make MoMask's first transformer."""
    from kinema.generators.momask.model import MoMask

    return MoMask(codebook_size=codes, code_dim=128, layers=3, **SIZES)


MAKERS = {"mmm": make_mmm, "bad": make_bad, "momask": make_momask}


def shortest(runs: list[Callable[[], object]], device: torch.device, repeats: int) -> list[float]:
    """Give each run's shortest time, the runs taking turns so that a busy machine hits them alike."""
    times = [float("inf")] * len(runs)
    for _ in range(repeats):
        for i, run in enumerate(runs):
            start = time.perf_counter()
            run()
            if device.type == "cuda":
                torch.cuda.synchronize(device)
            times[i] = min(times[i], time.perf_counter() - start)
    return times


def make_text(batch: int, device: torch.device) -> TextFeatures:
    """Draw text features of 20 words."""
    pooled, words = torch.randn(batch, TEXT_DIM, device=device), torch.randn(batch, WORDS, TEXT_DIM, device=device)
    return TextFeatures([""] * batch, pooled, words, torch.ones(batch, WORDS, dtype=torch.bool, device=device))


def measure_sampling(model: nn.Module, batch: int, device: torch.device, repeats: int) -> tuple[int, float, float]:
    """Give the forward passes of one sampling, their seconds alone and those of the sampling."""
    text, seeds = make_text(batch, device), torch.arange(batch)
    frames = torch.full((batch,), model.space.frames_of(POSITIONS), device=device)
    calls: list[tuple[tuple, dict]] = []

    def sample() -> None:
        calls.clear()
        hook = model.register_forward_pre_hook(lambda _, args, named: calls.append((args, named)), with_kwargs=True)
        model.sample(text, frames, seeds=seeds)
        hook.remove()

    @torch.no_grad()
    def forward_alone() -> None:
        for args, named in calls:
            model.forward(*args, **named)

    sampling, forward = shortest([sample, forward_alone], device, repeats)
    return len(calls), forward, sampling


def measure_training(model: nn.Module, codes: int, batch: int, device: torch.device, repeats: int) -> float:
    """Give the seconds of a training step, AdamW included."""
    lengths = torch.full((batch,), POSITIONS, device=device)
    tokens = torch.randint(codes, (batch, POSITIONS, 1), device=device)
    latents, text = Latents(lengths, model.space.frames_of(lengths), codes=tokens), make_text(batch, device)
    optimizer = torch.optim.AdamW(model.parameters())

    def step() -> None:
        optimizer.zero_grad()
        model.loss(latents, text)["loss"].backward()
        optimizer.step()

    model.train()
    return shortest([step], device, repeats)[0]


def main() -> None:
    """Measure the methods at the sizes of the codebook; MoMask's has 512 codes whatever is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--methods", nargs="+", choices=MAKERS, default=list(MAKERS))
    parser.add_argument("--codes", nargs="+", type=int, default=[512, 8192])
    parser.add_argument("--batch", type=int, default=32)
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--device", default="cpu")
    arguments = parser.parse_args()
    device = torch.device(arguments.device)
    print(f"batch {arguments.batch} x {POSITIONS} tokens, {torch.get_num_threads()} threads")
    print("method  codes  parameters  passes  forward s  sampling s  ratio  training ms/step")
    for method in arguments.methods:
        if importlib.util.find_spec(f"kinema.generators.{method}") is None:
            continue
        for codes in arguments.codes if method != "momask" else [512]:
            torch.manual_seed(0)
            model = MAKERS[method](codes).to(device).eval()
            size = sum(p.numel() for p in model.parameters()) / 1e6
            passes, forward, sampling = measure_sampling(model, arguments.batch, device, arguments.repeats)
            training = measure_training(model, codes, arguments.batch, device, arguments.repeats)
            print(
                f"{method:7} {codes:5d} {size:9.1f} M {passes:7d} {forward:10.2f} {sampling:11.2f} "
                f"{sampling / forward:6.2f} {1000 * training:17.0f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
