"""Score replications of one row: the judges, the source and the corpus, live."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from omegaconf import DictConfig

from kinema.build import build
from kinema.data.datamodule import MotionDataModule
from kinema.data.store import PackedStore
from kinema.evaluation import sources
from kinema.evaluation.protocol import EmbeddingCache, EvaluationProtocol, ReplicationResult, evaluate_replication
from kinema.experiments.config import plain
from kinema.experiments.instantiate import attach_text, encode_captions, read_model, text_encoder
from kinema.experiments.stages import STAGES
from kinema.motion.recovery import recover_joints
from kinema.text.cache import CachedTextEncoder
from kinema.training.fit import devices_available
from kinema.types import MotionBatch

SAMPLES = 6
"""Motions of the first replication that are kept to be watched, the same clips for every source."""


class Scorer:
    """Hold everything that the replications of one row share."""

    def __init__(self, cfg: DictConfig, runs: dict[str, Path], store_path: Path) -> None:
        self.cfg = cfg
        self.device = devices_available() if cfg.trainer.accelerator == "auto" else cfg.trainer.accelerator
        self.store = PackedStore.open(store_path)
        self.protocol = EvaluationProtocol(**plain(cfg.scale.protocol))
        self.data = MotionDataModule(store_path, kind="clips", batch_size=self.protocol.pool, steps=1, seed=cfg.seed)
        judges = {name: read_model(runs[name])[0].to(self.device) for name in ("matching", "contrastive")}
        words = {name: attach_text(cfg, STAGES[name], model) for name, model in judges.items()}
        self.matching, self.contrastive = judges["matching"], judges["contrastive"]
        self.cache = EmbeddingCache(Path(cfg.paths.cache) / "real", self.store.hash)
        self.source = self._source(runs)
        self.seen = self._labels_seen()
        sampling = plain(cfg.generator.sampling) if cfg.source == "generation" else None
        self.provenance = {
            "source": cfg.source,
            "runs": {k: v.name for k, v in sorted(runs.items())},
            "corpus": {"name": self.store.name, "hash": self.store.hash},
            "statistics": {
                "corpus": self.store.statistics.digest(),
                "evaluator": self.matching.representation.identity(),
            },
            "words": words["matching"],
            "tokens": words["contrastive"],
            "text_encoder": getattr(getattr(self.source, "text_encoder", None), "identity", None),
            "sampling": sampling,
            "protocol": plain(cfg.scale.protocol),
            "seed": cfg.seed,
            "device": str(self.device),
        }

    def replicate(self, replication: int) -> ReplicationResult:
        """Score one replication; its captions, crops and noise follow from the protocol's seed and its number."""
        batches = self.data.test_batches(
            self.protocol.split,
            replication,
            seed=self.protocol.seed,
            batch_size=self.protocol.pool,
            leftover=self.protocol.leftover,
        )
        return evaluate_replication(
            self.source,
            (batch.to(self.device) for batch in batches),
            self.matching,
            self.contrastive,
            self.protocol,
            replication,
            fields=self._fields,
            cache=self.cache,
        )

    def save_samples(self, path: Path, result: ReplicationResult) -> None:
        """Keep a few motions of the replication as joints."""
        batch: MotionBatch = result.samples
        count = min(SAMPLES, len(batch.lengths))
        joints = recover_joints(batch.features[:count].float().cpu(), self.store.skeleton).numpy()
        arrays = {f"joints{i}": joints[i, : int(batch.lengths[i])].astype(np.float32) for i in range(count)}
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = path.with_name("." + path.name)
        np.savez(temporary, texts=np.array(batch.texts[:count]), skeleton=np.array(self.store.skeleton.name), **arrays)
        temporary.replace(path)

    def _source(self, runs: dict[str, Path]) -> Any:
        name, cfg = self.cfg.source, self.cfg
        if name == "real":
            return sources.RealMotion()
        if name == "shuffled":
            return sources.ShuffledCaptions()
        if name == "nearest":
            return sources.NearestTrainingCaption.from_store(self.store, self._text("train", self.protocol.split))
        if name == "generation":
            from kinema.pipeline import TextToMotion

            pipeline = TextToMotion.from_run(runs["generator"], device=self.device)
            sampling = build(plain(cfg.generator.sampling))
            text = self._text(self.protocol.split)
            return sources.Generated(pipeline.generator, pipeline.tokenizer, text, sampling=sampling)
        tokenizer = read_model(runs["tokenizer"])[0].to(self.device)
        if name == "reconstruction":
            return sources.Reconstruction(tokenizer)
        return sources.NoiseLatents(tokenizer, *self._latent_statistics(tokenizer))

    def _text(self, *splits: str) -> CachedTextEncoder:
        """Give the cached text encoder: no caption is encoded twice, not over twenty replications."""
        return encode_captions(text_encoder(self.cfg, self.device), self.store, *splits)

    @torch.no_grad()
    def _latent_statistics(self, tokenizer: Any, batches: int = 16) -> tuple[torch.Tensor, torch.Tensor]:
        """Give mean and std of each latent dim over a part of the training clips."""
        drawn = self.data.test_batches("train", 0, seed=self.protocol.seed, batch_size=self.protocol.pool)
        values = []
        for _, batch in zip(range(batches), drawn, strict=False):
            latents = tokenizer.encode(batch.to(self.device))
            values.append(latents.values[latents.mask])
        stacked = torch.cat(values)
        return stacked.mean(0), stacked.std(0)

    def _labels_seen(self) -> set[str]:
        if "label" not in self.store.fields:
            return set()
        return {self.store.entry_field(int(e), "label") for e in self.store.split_entries("train")}

    def _fields(self, batch: MotionBatch) -> dict[str, list[str]]:
        """Give the manifest's fields of each clip by which results are broken down."""
        entries = batch.entries.tolist()
        found = {}
        if "source" in self.store.fields:
            found["source"] = [self.store.entry_field(e, "source") for e in entries]
        if "label" in self.store.fields:
            labels = [self.store.entry_field(e, "label") for e in entries]
            found["label seen in training"] = ["seen" if x in self.seen else "unseen" for x in labels]
        return found
