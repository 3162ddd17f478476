"""Measure training steps of MARDM with the tokenizer's latents looked up, and with every batch encoded anew.

    python benchmarks/latent_cache.py [--clips 64] [--steps 8] [--batch 32] [--ae-width 128] [--mlp-width 512]

The sizes are those of scale=tiny; the corpus is synthetic. Both ways take the same batches in turns, so a busy machine
hits them alike; CPU time is counted. A step is forward, backward and optimiser. The latents of both are compared.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import torch

from kinema.data.collate import collate
from kinema.data.datasets import ClipDataset
from kinema.data.prepare import prepare_store
from kinema.data.sampler import StepSampler
from kinema.data.store import PackedStore
from kinema.diffusion.flow import Flow
from kinema.generators.mar.model import MARDM
from kinema.motion.representation import Representation
from kinema.text.hashed import HashedTextEncoder
from kinema.tokenizers.autoencoder import AutoEncoder
from kinema.training.latents import EncodeEachTime, LatentCache
from kinema.training.modules import GeneratorModule
from kinema.training.recipe import Recipe
from kinema.types import MotionBatch

TURNS = 4


def make_tokenizer(store: PackedStore, width: int) -> AutoEncoder:
    """Make an untrained autoencoder: its weights cost no other time than trained ones."""
    representation = Representation("essential", "humanml3d").fit(store.statistics)
    return AutoEncoder(representation, width=width, latent_dim=width, dropout=0.0).eval().requires_grad_(False)


def make_trainer(source, latent_dim: int, mlp_width: int, batch: int) -> GeneratorModule:
    """Make a generator's module that reads its latents from `source`."""
    torch.manual_seed(0)
    text = HashedTextEncoder(64)
    model = MARDM(
        latent_dim=latent_dim,
        text_dim=64,
        process=Flow(),
        width=256,
        feedforward=1024,
        heads=4,
        dropout=0.1,
        mlp_width=mlp_width,
        mlp_depth=3,
    )
    return GeneratorModule(model, Recipe(steps=1, batch_size=batch), 0, source, text)


def cpu_seconds(trainer: GeneratorModule, optimizer: torch.optim.Optimizer, work: list[MotionBatch]) -> float:
    """Train on the batches; give the CPU time it takes."""
    start = time.process_time()
    for step, batch in enumerate(work):
        optimizer.zero_grad()
        trainer.losses(batch, torch.Generator().manual_seed(step), (0, 1))["loss"].backward()
        optimizer.step()
    return time.process_time() - start


def main() -> None:
    """Prepare a corpus, cache its latents and train both ways."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clips", type=int, default=64, help="of the synthetic corpus (default 64)")
    parser.add_argument("--steps", type=int, default=8, help="timed steps each way (default 8)")
    parser.add_argument("--batch", type=int, default=32)
    parser.add_argument("--ae-width", type=int, default=128, help="of the autoencoder and its latents (default 128)")
    parser.add_argument("--mlp-width", type=int, default=512, help="of the diffusion MLP of 3 layers (default 512)")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = prepare_store("synthetic", None, folder, name="synthetic", mirror=False, size=arguments.clips, seed=0)
        measure(PackedStore.open(path), Path(folder), arguments)


def measure(store: PackedStore, folder: Path, arguments: argparse.Namespace) -> None:
    """Print the cost of the cache, the rates and their ratio."""
    tokenizer = make_tokenizer(store, arguments.ae_width)
    clips = ClipDataset(store, "train")
    batch = min(arguments.batch, len(clips))
    sampler = StepSampler(len(clips), batch, seed=0, steps=arguments.steps + 1)
    work = [collate([clips[item] for item in step]) for step in sampler]
    start = time.process_time()
    cached = LatentCache.ensure(folder / "latents", tokenizer, [clips], "cpu")
    building = time.process_time() - start
    each = EncodeEachTime(tokenizer)
    error = max((cached(b).values - each(b).values).abs().max().item() for b in work[:3])
    print(f"{len(clips)} clips, {len(cached.rows)} crops: cached in {building:.2f} s; latents differ by {error:.0e}")
    trainers = [make_trainer(source, arguments.ae_width, arguments.mlp_width, batch) for source in (each, cached)]
    optimizers = [torch.optim.AdamW(t.parameters(), lr=1e-4) for t in trainers]
    seconds = [0.0, 0.0]
    for turn in range(TURNS + 1):
        part = work[:1] if turn == 0 else work[turn::TURNS]  # the first, a warm-up, is not counted
        for i, (trainer, optimizer) in enumerate(zip(trainers, optimizers, strict=True)):
            seconds[i] += cpu_seconds(trainer, optimizer, part) * (turn > 0)
    timed = sum(len(work[turn::TURNS]) for turn in range(1, TURNS + 1))
    slow, fast = (timed / s for s in seconds)
    print(f"encode each batch {slow:.2f} steps/s, look up {fast:.2f} steps/s (batch {batch}, one core)")
    print(f"ratio {fast / slow:.2f}; the cache is paid off after {building / (1 / slow - 1 / fast):.0f} steps")


if __name__ == "__main__":
    main()
