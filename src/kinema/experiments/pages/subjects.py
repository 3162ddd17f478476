"""Find or make the runs that a page reads, and load them with the motions that it looks at."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig

from kinema.data.datamodule import MotionDataModule
from kinema.data.store import PackedStore
from kinema.evaluation.sources import encode_captions
from kinema.experiments import instantiate
from kinema.experiments.config import compose, plain
from kinema.experiments.jobs import Job, missing_runs
from kinema.experiments.launching import launch
from kinema.experiments.request import Request
from kinema.experiments.run import stage_folder
from kinema.experiments.stages import get_stage
from kinema.experiments.stages.tokenizer import TokenizerStage
from kinema.pipeline import TextToMotion
from kinema.runs.build import build
from kinema.runs.console import console
from kinema.runs.folder import RunFolder
from kinema.seeds import protocol_seeds
from kinema.tokenizers import MotionTokenizer
from kinema.types import Latents, MotionBatch, TextFeatures

POOL = 32


@dataclass(frozen=True)
class Wanted:
    """Name a run: what the page calls it, its configuration and its folder, finished or not."""

    key: str
    label: str
    cfg: DictConfig
    run: RunFolder


def want(specs: list[dict[str, Any]], stage: str, overrides: list[str]) -> list[Wanted]:
    """Compose each configuration and find its run of a stage."""
    found = []
    for spec in specs:
        cfg = compose([f"stage={stage}", *overrides, *_own(spec)])
        folder = stage_folder(cfg, get_stage(stage))
        found.append(Wanted(spec["key"], spec["label"], cfg, folder))
    return found


def make(specs: dict[str, list[dict[str, Any]]], request: Request) -> None:
    """Train what is missing of the stages' runs."""
    found = [
        (one.cfg, get_stage(stage), _own(spec))
        for stage, some in specs.items()
        for spec, one in zip(some, want(some, stage, request.shared), strict=True)
    ]

    def lacking(shared: list[str]) -> list[Job]:
        return missing_runs([(cfg, stage, [*shared, *own]) for cfg, stage, own in found])

    if lacking([]):
        launch(lacking, request.shared, request, found[0][0])


def finished(wanted: list[Wanted]) -> list[Wanted]:
    """Leave out, with a note, the runs that aren't there."""
    for one in wanted:
        if not one.run.done:
            console.print(f"[yellow]empty[/]     no finished run for {one.label}: {one.run.path}")
    return [one for one in wanted if one.run.done]


def _own(spec: dict[str, Any]) -> list[str]:
    return [f"method={spec['method']}", *spec.get("overrides", [])]


@dataclass(frozen=True)
class Subject:
    """Hold a loaded generator with its texts, the real motions of the split and its own answers to their captions."""

    key: str
    label: str
    run: Path
    model: TextToMotion
    text: TextFeatures
    real: MotionBatch
    sampling: dict[str, Any]

    def latents(self, count: int | None = None) -> tuple[Latents, TextFeatures]:
        """Encode the first `count` real motions, and return their texts beside them."""
        real, text = head(self.real, count), self.text
        rows = slice(count)
        tokens, mask = (None if value is None else value[rows] for value in (text.tokens, text.token_mask))
        part = TextFeatures(text.texts[rows], text.pooled[rows], tokens, mask, text.clip_ids[rows])
        with torch.no_grad():
            return self.model.tokenizer.encode(real), part

    @torch.no_grad()
    def generate(self) -> MotionBatch:
        """Answer all captions by the run's own sampling, the real lengths given."""
        seeds = protocol_seeds(0, 0, 0, len(self.real.lengths))
        return self.model.sample(self.text, self.real.lengths, seeds=seeds, sampling=build(self.sampling))


def load(one: Wanted, real: MotionBatch, store: PackedStore, split: str) -> Subject:
    """Load a generator's run, and encode the captions of the motions by its text encoder."""
    device = instantiate.machine_of(one.cfg).device()
    model = TextToMotion.from_run(one.run.path, device).eval()
    encoder = instantiate.encode_captions(instantiate.cached(one.cfg, model.text_encoder), store, split)
    text = encode_captions(encoder, real).to(device)
    return Subject(one.key, one.label, one.run.path, model, text, real.to(device), plain(one.cfg.generator.sampling))


def load_tokenizer(one: Wanted) -> MotionTokenizer:
    """Load a tokenizer's run."""
    return instantiate.read_model(one.run.path, TokenizerStage.name).to(instantiate.machine_of(one.cfg).device()).eval()


def read_motions(store: PackedStore, split: str, count: int) -> MotionBatch:
    """Read the first motions of a split's first replication, in one batch."""
    data = MotionDataModule(store.path, kind="clips", batch_size=POOL, steps=1)
    drawn = list(islice(data.test_batches(split, 0, seed=0, batch_size=POOL, leftover="keep"), -(-count // POOL)))
    size = max(batch.features.shape[1] for batch in drawn)
    features = [torch.nn.functional.pad(b.features, (0, 0, 0, size - b.features.shape[1])) for b in drawn]
    whole = MotionBatch(
        torch.cat(features),
        torch.cat([batch.lengths for batch in drawn]),
        captions=[caption for batch in drawn for caption in batch.captions],
        clip_ids=[name for batch in drawn for name in batch.clip_ids],
    )
    return head(whole, count)


def head(batch: MotionBatch, count: int | None) -> MotionBatch:
    """Take the first motions of a batch."""
    rows, lengths = slice(count), batch.lengths[:count]
    longest = int(lengths.max())
    return MotionBatch(
        batch.features[rows, :longest], lengths, captions=batch.captions[rows], clip_ids=batch.clip_ids[rows]
    )
