"""Score replications of one row: the judges, the source and the corpus, live."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from omegaconf import DictConfig

from kinema.atomic import replacing
from kinema.data.datamodule import MotionDataModule
from kinema.data.leakage import Nearness
from kinema.data.store import PackedStore
from kinema.evaluation.changed import FeetLocked, Lifted
from kinema.evaluation.protocol import EmbeddingCache, EvaluationProtocol, ReplicationResult, evaluate_replication
from kinema.evaluation.training_set import TrainingSet
from kinema.experiments.config import plain
from kinema.experiments.evaluation import Row
from kinema.experiments.instantiate import encode_captions, machine_of, read_model, text_encoder
from kinema.experiments.sources import source_of, sources
from kinema.experiments.stages import judges
from kinema.motion.recovery import recover_joints
from kinema.motion.skeleton import DIMS
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
        kind = source_of(cfg)
        source = kind.open(self, row)
        source = FeetLocked(source, self.store.skeleton) if cfg.lock_feet else source
        self.source = Lifted(source, self.store.skeleton) if cfg.lift else source
        judged = (model.representation.kind for model in models.values())
        self.data = self.clips(self.source.dims, *judged)
        self.trained, self.tested = self._values("train"), self._values(self.protocol.split)
        self.nearness = Nearness.of(self.store)
        groups = {group for one in sources().values() for group in one.groups}
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
            "sampling": kind.sampling(cfg),
            "lengths": kind.lengths(cfg),
            "lift": cfg.lift,
            "lock_feet": cfg.lock_feet,
            "precision": cfg.precision,
            "batch_size": cfg.batch_size,
            **dict.fromkeys(sorted(groups)),
            **kind.settings(cfg),
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
        result.metrics.update(source_of(self.cfg).completed(result.metrics))
        result.metrics.update(self.source.measured())
        return result

    def clips(self, *dims: str) -> MotionDataModule:
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

    def text(self, *splits: str) -> CachedTextEncoder:
        """Return the cached text encoder: no caption is encoded twice, not over twenty replications."""
        return encode_captions(text_encoder(self.cfg, self.device), self.store, *splits)

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
