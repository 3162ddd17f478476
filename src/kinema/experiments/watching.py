"""Score a generator on validation captions while it trains."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from omegaconf import DictConfig

from kinema.data.datamodule import MotionDataModule
from kinema.data.datasets import ClipDataset
from kinema.data.store import PackedStore
from kinema.evaluation.changed import Lifted
from kinema.evaluation.protocol import EvaluationProtocol, evaluate_replication
from kinema.evaluation.source import Source
from kinema.evaluation.sources import Generated
from kinema.experiments.instantiate import read_model
from kinema.experiments.run import stage_folder
from kinema.experiments.stages.matching import MatchingStage
from kinema.generators import Generator
from kinema.motion.skeleton import DIMS
from kinema.pipeline import TextToMotion
from kinema.runs.parts import TOKENIZER
from kinema.text.cache import CachedTextEncoder

SPLIT = "val"
"""Never the one that tables are of."""


@dataclass(frozen=True)
class Watched:
    """Hold what a generator in training needs to make motion: its tokenizer's run, texts, and parts `beside` it."""

    tokenizer: Path
    text: CachedTextEncoder
    beside: Mapping[str, Path]

    def pipeline(self, model: Generator) -> TextToMotion:
        """Complete the model; what it attaches stays attached."""
        parts = {name: read_model(run, name) for name, run in self.beside.items()}
        pipeline = TextToMotion(read_model(self.tokenizer, TOKENIZER), model, self.text, parts)
        return pipeline.to(next(model.parameters()).device)


class ValidationScores:
    """Generate for the captions of the validation split, by the generator's own sampling, and score what comes out.

    The evaluator is the T2M-style one that the configuration describes, its protocol one replication of the tables'
    without MultiModality. Motion of essential dims alone is lifted for an evaluator of all of them.
    """

    def __init__(self, cfg: DictConfig, store: PackedStore, watched: Watched) -> None:
        stage, numbers = MatchingStage(), cfg.scale.protocol
        self.store, self.watched = store, watched
        self.judge = read_model(stage_folder(cfg, stage).path, stage.name).attach(stage.vocabulary(cfg))
        ends_itself = cfg.method.lengths == "predicted" and cfg.generator.get("predicts_length")
        self.lengths = "predicted" if ends_itself else "real"
        clips = len(ClipDataset(store, SPLIT))
        pools = min(clips, cfg.callbacks.score_clips or clips) // numbers.pool
        if not pools:
            raise ValueError(
                f"callbacks.score_clips={cfg.callbacks.score_clips} of the {clips} in split {SPLIT!r} make no pool of "
                f"{numbers.pool}; give more, or set callbacks.score_every=0"
            )
        own = {"pool": numbers.pool, "leftover": numbers.leftover, "seed": numbers.seed}
        self.protocol = EvaluationProtocol(**own, split=SPLIT, mm_texts=0, max_batches=pools)
        self.source: Source | None = None

    def __call__(self, model: Generator) -> dict[str, float]:
        """Return FID, R-precision, matching score and what else the protocol measures."""
        if self.source is None:  # the model is the same object every time, only its weights are new
            self.source = self._source(model)
        protocol, dims = self.protocol, max(self.source.dims, self.judge.representation.kind, key=DIMS.index)
        data = MotionDataModule(self.store.path, kind="clips", batch_size=protocol.pool, steps=1, dims=dims)
        batches = data.test_batches(SPLIT, 0, protocol.seed, protocol.pool, protocol.leftover)
        return evaluate_replication(self.source, batches, self.judge, protocol=protocol).metrics

    def _source(self, model: Generator) -> Source:
        pipeline = self.watched.pipeline(model)
        self.judge.to(pipeline.device)
        source = Generated(pipeline, lengths=self.lengths)
        made = pipeline.tokenizer.representation.kind
        lacking = DIMS.index(made) < DIMS.index(self.judge.representation.kind)
        return Lifted(source, self.store.skeleton) if lacking else source
