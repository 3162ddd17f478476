"""Score replications of one row: the judges, the source and the corpus, live."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from omegaconf import DictConfig

from kinema.atomic import replacing
from kinema.data.datamodule import MotionDataModule
from kinema.data.labels import shown_by
from kinema.data.leakage import Nearness
from kinema.data.store import PackedStore
from kinema.evaluation import sources
from kinema.evaluation.changed import FeetLocked, Lifted
from kinema.evaluation.controlled import Controlled
from kinema.evaluation.oracle import Oracle
from kinema.evaluation.perturbed import Perturbed, judged
from kinema.evaluation.protocol import EmbeddingCache, EvaluationProtocol, ReplicationResult, evaluate_replication
from kinema.evaluation.remembered import Remembered
from kinema.evaluation.training_set import TrainingSet
from kinema.experiments.config import SOURCES, plain
from kinema.experiments.evaluation import Row
from kinema.experiments.identity import fingerprint
from kinema.experiments.instantiate import cached, encode_captions, machine_of, read_model, text_encoder
from kinema.experiments.sampling import build_sampling, sampling_spec
from kinema.experiments.stages import judges
from kinema.motion.recovery import recover_joints
from kinema.motion.skeleton import DIMS
from kinema.pipeline.identity import fingerprint as model_fingerprint
from kinema.text.cache import CachedTextEncoder
from kinema.types import MotionBatch

SAMPLES = 6
"""Motions of the first replication that are kept to be watched, the same clips for every source."""


MOST_VALUES = 12
"""Values of a field up to which results are broken down by value."""


class Scorer:
    """Hold everything that the replications of one row share."""

    def __init__(self, cfg: DictConfig, row: Row, store_path: Path) -> None:
        self.cfg = cfg
        machine = machine_of(cfg)
        machine.limit_threads()
        self.device = machine.device()
        self.store = PackedStore.open(store_path)
        self.protocol = EvaluationProtocol(**plain(cfg.scale.protocol))
        asked = {key: stage for key, stage in judges().items() if stage.name in row.judges}
        words = {key: stage.vocabulary(cfg) for key, stage in asked.items()}
        models = {
            key: read_model(row.judges[stage.name], stage.name).to(self.device).attach(words[key])
            for key, stage in asked.items()
        }
        self.matching, self.contrastive = models["t2m"], models.get("clip")
        self.cache = EmbeddingCache(Path(cfg.paths.cache) / "real", self.store.hash)
        self.training = TrainingSet.embedded(self.store, self.matching, self.cache)
        source = self._source(row)
        source = FeetLocked(source, self.store.skeleton) if cfg.lock_feet else source
        self.source = Lifted(source, self.store.skeleton) if cfg.lift else source
        judged = (model.representation.kind for model in models.values())
        self.data = self._clips(self.source.dims, *judged)
        self.trained, self.tested = self._values("train"), self._values(self.protocol.split)
        self.nearness = Nearness.of(self.store)
        sampling = sampling_spec(cfg) if cfg.source == "generation" else None
        self.provenance = {
            "source": cfg.source,
            "runs": {k: v.name for k, v in sorted(row.runs.items())},
            "evaluators": {stage.name: models[key].identity() for key, stage in asked.items()},
            "corpus": {"name": self.store.name, "hash": self.store.hash},
            "statistics": {
                "corpus": self.store.statistics.digest(),
                "evaluator": self.matching.representation.identity(),
            },
            "words": words["t2m"].identity,
            "tokens": words["clip"].identity if "clip" in words else None,
            "text_encoder": self.source.text_encoder.identity if self.source.text_encoder else None,
            "sampling": sampling,
            "lengths": cfg.lengths if cfg.source == "generation" and cfg.task == "generation" else "real",
            "lift": cfg.lift,
            "lock_feet": cfg.lock_feet,
            "precision": cfg.precision,
            "batch_size": cfg.batch_size,
            "perturb": plain(cfg.perturb) if cfg.source == "perturbed" else None,
            "oracle": plain(cfg.oracle) if cfg.source == "oracle" else None,
            "edit": plain(cfg.edit) if cfg.task == "editing" else None,
            "control": plain(cfg.control) if cfg.task == "control" else None,
            "protocol": plain(cfg.scale.protocol),
            "seed": cfg.seed,
            "device": str(self.device),
        }

    def replicate(self, replication: int) -> ReplicationResult:
        """Score one replication; its captions, crops and noise follow from the protocol's seed and its number."""
        result = evaluate_replication(
            self.source,
            self._batches(replication),
            self.matching,
            self.contrastive,
            self.protocol,
            replication,
            fields=self._fields,
            cache=self.cache,
            training=self.training,
        )
        if self.cfg.source == "real" and "real_fid_halves" in result.metrics:
            result.metrics["half_fid"] = result.metrics["real_fid_halves"]  # the name in results of before
        result.metrics.update(self.source.measured())
        return result

    def _clips(self, *dims: str) -> MotionDataModule:
        """Serve the columns that all of several readers read."""
        widest = max(dims, key=DIMS.index)
        return MotionDataModule(self.store.path, kind="clips", batch_size=self.protocol.pool, steps=1, dims=widest)

    def _batches(self, replication: int) -> Iterator[MotionBatch]:
        protocol = self.protocol
        batches = self.data.test_batches(
            protocol.split, replication, seed=protocol.seed, batch_size=protocol.pool, leftover=protocol.leftover
        )
        return (batch.to(self.device) for batch in batches)

    def save_samples(self, path: Path, result: ReplicationResult) -> None:
        """Keep a few motions of the replication as joints, of edits with the frames that were kept."""
        batch = result.samples
        if batch is None:
            return
        count = min(SAMPLES, len(batch.lengths))
        joints = recover_joints(batch.features[:count].float().cpu(), self.store.skeleton).numpy()
        arrays = {f"joints{i}": joints[i, : int(batch.lengths[i])].astype(np.float32) for i in range(count)}
        arrays |= {"texts": np.array(batch.texts[:count]), "skeleton": np.array(self.store.skeleton.name)}
        kept = self.source.kept(batch.lengths[:count])
        if kept is not None:
            arrays |= {f"kept{i}": row[: int(batch.lengths[i])].cpu().numpy() for i, row in enumerate(kept)}
        with replacing(path) as temporary:
            np.savez(temporary, allow_pickle=False, **arrays)

    def _source(self, row: Row) -> sources.Source:
        name, cfg = self.cfg.source, self.cfg
        if name == "real":
            return sources.RealMotion()
        if name == "perturbed":
            altered, how, level = cfg.perturb.dims, cfg.perturb.how, cfg.perturb.level
            statistics = self.store.statistics
            if cfg.perturb.space == "evaluator":
                statistics = judged(self.matching.representation, statistics)
            return Perturbed(self.store.skeleton, statistics, altered=altered, how=how, level=level)
        if name == "shuffled":
            return sources.ShuffledCaptions()
        if name == "nearest":
            train = self.store.split_entries("train")
            return sources.NearestTrainingCaption(self.store, train, self._text("train", self.protocol.split))
        if name == "oracle":
            train, shown = self.store.split_entries("train"), partial(shown_by, self.store)
            return Oracle(self.store, train, shown, **plain(cfg.oracle))
        if name == "generation":
            from kinema.pipeline import TextToMotion

            # The parts that the row is named by, whatever the generator's run links to.
            (run,) = row.subject.values()
            model = TextToMotion.from_run(run, device=self.device, **row.beside)
            sampling = build_sampling(cfg)
            model.generator.check_sampling(sampling)
            model = model.bfloat16() if cfg.precision == "bfloat16" else model
            # The run's own text encoder, which need not be the configuration's (an imported run).
            model.text_encoder = encode_captions(cached(cfg, model.text_encoder), self.store, self.protocol.split)
            if cfg.task == "editing":
                return sources.Edited(
                    model,
                    task=cfg.edit.task,
                    paste=cfg.edit.paste,
                    sampling=sampling,
                    batch_size=cfg.batch_size,
                )
            if cfg.task == "control":
                return Controlled(model, **plain(cfg.control), sampling=sampling)
            generated = sources.Generated(model, lengths=cfg.lengths, sampling=sampling, batch_size=cfg.batch_size)
            return self._remembered(generated) if cfg.keep_motions else generated
        ((part, run),) = row.subject.items()
        tokenizer = read_model(run, part).to(self.device)
        if name == "reconstruction":
            return sources.Reconstruction(tokenizer)
        if name != "noise":
            raise ValueError(f"source={name} is not made by evaluation; it is one of {', '.join(SOURCES)}")
        if tokenizer.space.kind == "codes":
            return sources.NoiseCodes(tokenizer, self._code_shares(tokenizer))
        return sources.NoiseLatents(tokenizer, *self._latent_statistics(tokenizer))

    def _remembered(self, source: sources.Generated) -> Remembered:
        """Keep motions below the cache, by all that they depend on but what is asked."""
        cfg = self.cfg
        how = [model_fingerprint(source.model), sampling_spec(cfg), cfg.lengths, cfg.precision]
        return Remembered(source, Path(cfg.paths.cache) / "motions" / fingerprint(how))

    def _text(self, *splits: str) -> CachedTextEncoder:
        """Return the cached text encoder: no caption is encoded twice, not over twenty replications."""
        return encode_captions(text_encoder(self.cfg, self.device), self.store, *splits)

    @torch.no_grad()
    def _training_latents(self, tokenizer: Any, batches: int = 16) -> torch.Tensor:
        """Return the values or codes of a part of the training clips, one row per position."""
        data = self._clips(tokenizer.representation.kind)
        drawn = data.test_batches("train", 0, seed=self.protocol.seed, batch_size=self.protocol.pool)
        rows = []
        for _, batch in zip(range(batches), drawn, strict=False):
            latents = tokenizer.encode(batch.to(self.device))
            rows.append(latents.content[latents.mask])
        return torch.cat(rows)

    def _latent_statistics(self, tokenizer: Any) -> tuple[torch.Tensor, torch.Tensor]:
        """Return mean and std of each latent dim."""
        rows = self._training_latents(tokenizer)
        return rows.mean(0), rows.std(0)

    def _code_shares(self, tokenizer: Any) -> torch.Tensor:
        """Return how often each layer's codes are used."""
        rows = self._training_latents(tokenizer)
        counts = [torch.bincount(layer, minlength=tokenizer.space.codebook_size) for layer in rows.T]
        return torch.stack(counts) / len(rows)

    def _fields(self, batch: MotionBatch) -> dict[str, list[str]]:
        """Return the manifest's fields of each clip; of one with many values, whether training saw the value.

        Last what training has of the clip itself and of the caption drawn for it.
        """
        found = {}
        entries = [entry for entry, _, _ in batch.crops]
        for field in self.store.fields:
            if field == "licence":
                continue
            values = [self.store.entry_field(entry, field) for entry in entries]
            if len(self.tested[field]) > MOST_VALUES:
                seen = ["seen" if value in self.trained[field] else "unseen" for value in values]
                found[f"{field} seen in training"] = seen
            else:
                found[field] = values
        return found | self.nearness.fields(entries, batch.texts)

    def _values(self, split: str) -> dict[str, set[str]]:
        entries = [int(e) for e in self.store.split_entries(split)]
        return {field: {self.store.entry_field(e, field) for e in entries} for field in self.store.fields}
