"""Metrics and contrastive losses give on two processes what they give on one."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import torch.distributed as dist
import torch.multiprocessing as mp
from torch.nn.parallel import DistributedDataParallel

from kinema.evaluation.encoders.clip_style import ContrastiveEvaluator
from kinema.evaluation.encoders.t2m import MatchingEvaluator
from kinema.evaluation.metrics import (
    PRDC,
    ClipScore,
    Diversity,
    FrechetDistance,
    HalvesDistance,
    MultiModality,
    NearestTraining,
    Physical,
    Reconstruction,
    RetrievalShare,
    UnitFrechetDistance,
)
from kinema.evaluation.metrics.retrieval import Retrieval
from kinema.motion.representation import Representation
from kinema.motion.skeleton import HUMANML3D
from kinema.motion.statistics import Statistics
from kinema.types import Caption, MotionBatch

ROWS, POOL, WIDTH = 24, 4, 6


def rows(seed, *size):
    return torch.from_numpy(np.random.default_rng(seed).normal(size=size).astype(np.float32))


def motions(part):
    lengths = torch.arange(ROWS) % 4 * 8 + 8
    features = 0.1 * rows(9, ROWS, 32, 67) * (torch.arange(32) < lengths[:, None])[..., None]
    captions = [Caption(str(i % 20)) for i in range(ROWS)]
    return MotionBatch(features[part], lengths[part], captions=captions[part])


class Rows:
    """Give every caption words and tokens by its number."""

    identity = "rows"
    embedding, positional = rows(5, 30, 8), rows(6, 5, 8)

    def __call__(self, captions, device=None):
        if device is None:
            return torch.tensor([[int(c), 1, 2, 3, 29] for c in captions])
        numbers = [int(c.text) for c in captions]
        return rows(7, 30, 4, 5)[numbers], rows(8, 30, 4, 15)[numbers], torch.tensor([4 - n % 3 for n in numbers])

    def end_positions(self, ids):
        return ids.argmax(1)


def evaluators():
    stats = Statistics(np.zeros(67), np.full(67, 0.1))
    made = {}
    for name, kind, options in (
        ("margin", MatchingEvaluator, {}),
        ("legacy", MatchingEvaluator, {"negative_shift": "legacy"}),
        ("infonce", MatchingEvaluator, {"objective": "infonce"}),
        ("contrastive", ContrastiveEvaluator, {"mask_duplicates": True}),
    ):
        torch.manual_seed(0)
        sizes = {"token_width": 8, "width": 8, "layers": 1, "heads": 2, "feedforward": 8, "dropout": 0.0}
        if kind is MatchingEvaluator:
            sizes = {"word_width": 5, "movement_width": 6, "movement_dim": 6, "motion_hidden": 6, "text_hidden": 6}
        representation = Representation("essential", "humanml3d").fit(stats)
        made[name] = kind(representation, embedding=WIDTH, **sizes, **options).attach(Rows()).train()
    return made


class Step(torch.nn.Module):
    """Make the loss the forward, as a LightningModule under DDP does."""

    def __init__(self, model):
        super().__init__()
        self.model = model

    def forward(self, batch):
        shard = (dist.get_rank(), dist.get_world_size()) if dist.is_initialized() else (0, 1)
        return self.model.loss(batch, generator=torch.Generator().manual_seed(3), shard=shard)["loss"]


def measure(rank, world):
    """Give all metrics, losses and gradients; this process has every second update."""
    metrics = SimpleNamespace(
        fid=FrechetDistance(WIDTH),
        retrieval=Retrieval(POOL),
        diversity=Diversity(10),
        multimodality=MultiModality(2),
        clip=ClipScore(),
        reconstruction=Reconstruction(HUMANML3D),
        physical=Physical(HUMANML3D),
        share=RetrievalShare(POOL),
        halves=HalvesDistance(),
        sphere=UnitFrechetDistance(WIDTH),
        prdc=PRDC(2),
        nearest=NearestTraining(rows(10, 40, WIDTH), rows(11, 40).abs()),
    )
    text, real, made, repeats = (
        rows(1, ROWS, WIDTH),
        rows(2, ROWS, WIDTH),
        rows(3, ROWS, WIDTH),
        rows(4, ROWS, 5, WIDTH),
    )
    for step in range(rank, 3, world):
        part = slice(8 * step, 8 * step + 8)
        batch = motions(part)
        metrics.fid.update(real[part], made[part])
        metrics.retrieval.update(text[part], made[part])
        metrics.diversity.update(made[part], torch.arange(ROWS)[part])
        metrics.multimodality.update(repeats[part])
        metrics.clip.update(made[part], text[part])
        noisy = MotionBatch(batch.features + 0.01 * rows(step, 8, 32, 67), batch.lengths)
        metrics.reconstruction.update(noisy.features, batch.features, batch.lengths)
        metrics.physical.update(noisy, batch)
        metrics.share.update(text[part], made[part], real[part])
        metrics.halves.update(real[part], made[part], torch.arange(ROWS)[part])
        metrics.sphere.update(real[part], made[part])
        metrics.prdc.update(real[part], made[part])
        metrics.nearest.update(made[part])
    out = {name: metric.compute() for name, metric in vars(metrics).items()}
    # Ranks hold different numbers of rows: 15 and 9.
    mine = slice(0, ROWS) if world == 1 else (slice(0, 15), slice(15, ROWS))[rank]
    for name, model in evaluators().items():
        # Kept until after backward: with the wrapper would go the reduction of its gradients.
        step = DistributedDataParallel(Step(model)) if world > 1 else Step(model)
        loss = step(motions(mine))
        loss.backward()
        out[f"loss {name}"] = loss.detach()
        out[f"gradients {name}"] = {k: p.grad for k, p in model.named_parameters() if p.requires_grad}
    return out


def work(rank, folder):
    torch.set_num_threads(1)
    dist.init_process_group("gloo", init_method=f"file://{folder}/meet", rank=rank, world_size=2)
    torch.save(measure(rank, 2), folder / f"{rank}.pt")
    dist.barrier()
    dist.destroy_process_group()


@pytest.mark.slow
def test_two_processes_measure_and_learn_what_one_does(tmp_path, monkeypatch):
    # The spawned processes import this file by the name that pytest gave it.
    monkeypatch.syspath_prepend(str(Path(__file__).resolve().parents[2]))
    mp.spawn(work, args=(tmp_path,), nprocs=2)
    alone = measure(0, 1)
    for rank in range(2):
        found = torch.load(tmp_path / f"{rank}.pt", weights_only=True)
        assert found.keys() == alone.keys()
        torch.testing.assert_close(found, alone, rtol=1e-4, atol=1e-5)
