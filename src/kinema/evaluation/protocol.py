"""Score one source of motion in one replication of the published protocol (METRICS, MARDM §8)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice

import torch
from torch import Tensor

from kinema.evaluation.benchmark import Benchmark
from kinema.evaluation.cache import EmbeddingCache, Shelf, motion_key, text_key
from kinema.evaluation.encoders.base import TextMotionEvaluator
from kinema.evaluation.metrics.finite import require_finite
from kinema.evaluation.scores import Observation, Scores
from kinema.evaluation.settings import EvaluationProtocol
from kinema.evaluation.source import Source, answers
from kinema.evaluation.together import Asked, select
from kinema.evaluation.training_set import TrainingSet
from kinema.seeds import protocol_seeds
from kinema.types import MotionBatch

__all__ = [
    "EmbeddingCache",
    "EvaluationProtocol",
    "ReplicationResult",
    "evaluate_replication",
    "select",
]

AHEAD = 8
"""Pools that a source is asked at once: enough to find motions of like length for its batches."""

Fields = Callable[[MotionBatch], dict[str, list[str]]]


@dataclass(frozen=True)
class ReplicationResult:
    """Hold one replication's metrics, the same by field and value (`n` counts rows), and a few motions to watch.

    `samples` are the source's first motions, `references` the real ones with the same captions.
    """

    metrics: dict[str, float]
    breakdowns: dict[str, dict[str, dict[str, float]]] = field(default_factory=dict)
    samples: MotionBatch | None = None
    references: MotionBatch | None = None


@torch.no_grad()
def evaluate_replication(
    source: Source,
    batches: Iterable[MotionBatch],
    evaluator: TextMotionEvaluator,
    clip_evaluator: TextMotionEvaluator | None = None,
    protocol: EvaluationProtocol | None = None,
    replication: int = 0,
    *,
    fields: Fields | None = None,
    cache: EmbeddingCache | None = None,
    training: TrainingSet | None = None,
    watch: int = 8,
) -> ReplicationResult:
    """Score a source on the test batches of one replication.

    The first `mm_texts` captions are answered `mm_repeats` times; the first answer also serves the other metrics
    (the published code takes the last), so that they are the same with and without MultiModality. `fields` names
    each row's values by which results are broken down; `training` is what the judge has embedded of the train split
    (None: memorised motion is not looked for). Raises ValueError that names the clip for NaN or infinity.
    """
    protocol = protocol or EvaluationProtocol()
    judge = _Judge(evaluator, clip_evaluator, cache, protocol.seed, replication)
    total = Scores(protocol, replication, evaluator.representation.skeleton, judge.device)
    benchmark = Benchmark(protocol, replication, judge.device, training)
    parts: dict[str, dict[str, Scores]] = {}
    samples = references = None
    n = 0
    for first, real, generated in _answered(source, _pools(batches, protocol, judge.device), protocol, replication):
        seen = judge.observe(real, generated, first, source.reconstructs)
        total.update(seen)
        benchmark.update(seen)
        _update_parts(parts, fields, seen, total)
        if source.multimodal and first < protocol.mm_texts:
            total.update_multimodality(_repeats(source, seen, judge, protocol, replication, first))
        if samples is None:
            rows = torch.arange(min(watch, len(real.lengths)), device=judge.device)
            samples, references = select(generated, rows), select(real, rows)
        n = first + len(real.lengths)
    if n == 0:
        raise ValueError(
            f"no batch holds a whole pool of {protocol.pool}; use a larger split, a smaller pool or leftover='keep'"
        )
    judge.save()
    breakdowns = {name: {v: s.compute() for v, s in sorted(values.items())} for name, values in parts.items()}
    return ReplicationResult(total.compute() | benchmark.compute(), breakdowns, samples, references)


class _Judge:
    """Hold the evaluators, and embed what is real only once."""

    def __init__(
        self,
        evaluator: TextMotionEvaluator,
        clip_evaluator: TextMotionEvaluator | None,
        cache: EmbeddingCache | None,
        seed: int,
        replication: int,
    ) -> None:
        self.evaluators = [e.eval() for e in (evaluator, clip_evaluator) if e is not None]
        self.device = evaluator.representation.mean.device
        self.shelves = [
            Shelf(None) if cache is None else cache.shelf(e.identity(), seed, replication) for e in self.evaluators
        ]

    def motion(self, batch: MotionBatch, which: int = 0) -> Tensor:
        """Embed motions by one of the evaluators."""
        return self.evaluators[which].embed_motion(batch)

    def observe(self, real: MotionBatch, generated: MotionBatch, first: int, paired: bool) -> Observation:
        """Embed everything that the metrics need of a batch."""
        index = torch.arange(first, first + len(real.lengths), device=self.device)
        clip_pair = None
        if len(self.evaluators) > 1:
            clip_pair = (self.motion(generated, 1), self._text(real, 1))
        known = self._known_motion(real)
        motion = known if generated is real else self.motion(generated)
        return Observation(index, self._text(real, 0), known, motion, clip_pair, real, generated, paired)

    def save(self) -> None:
        """Keep what was computed for the next source."""
        for shelf in self.shelves:
            shelf.save()

    def _known_motion(self, batch: MotionBatch) -> Tensor:
        return self.shelves[0].get(motion_key(batch), lambda: self.motion(batch), self.device)

    def _text(self, batch: MotionBatch, which: int) -> Tensor:
        embed = self.evaluators[which].embed_text
        return self.shelves[which].get(text_key(batch.captions), lambda: embed(batch.captions), self.device)


def _whole_pools(batch: MotionBatch, protocol: EvaluationProtocol) -> MotionBatch:
    """Leave out the rows beyond whole pools if the protocol drops them."""
    size = len(batch.lengths)
    rest = size % protocol.pool
    if protocol.leftover != "drop" or rest == 0:
        return batch
    return select(batch, torch.arange(size - rest, device=batch.lengths.device))


def _pools(batches: Iterable[MotionBatch], protocol: EvaluationProtocol, device: torch.device) -> Iterator[MotionBatch]:
    """Yield the batches of a replication without the rows that the protocol drops."""
    for batch in islice(batches, protocol.max_batches):
        real = _whole_pools(batch.to(device), protocol)
        if len(real.lengths):
            yield real


def _answered(
    source: Source, pools: Iterator[MotionBatch], protocol: EvaluationProtocol, replication: int
) -> Iterator[tuple[int, MotionBatch, MotionBatch]]:
    """Yield each pool with the number of rows before it and the source's answer."""
    first = 0
    while group := list(islice(pools, AHEAD)):
        asked, firsts = [], []
        for real in group:
            asked.append((real, protocol_seeds(protocol.seed, replication, first, len(real.lengths))))
            firsts.append(first)
            first += len(real.lengths)
        yield from zip(firsts, group, _answers(source, asked), strict=True)


def _answers(source: Source, asked: Sequence[Asked]) -> list[MotionBatch]:
    """Ask the source, and refuse NaN and infinity by the clip's name."""
    made = answers(source, asked)
    for (real, _), generated in zip(asked, made, strict=True):
        names = real.clip_ids or [c.text for c in real.captions]
        require_finite(real.features, "real features", names)
        require_finite(generated.features, f"features by {source.label!r}", names)
    return made


def _update_parts(parts: dict[str, dict[str, Scores]], fields: Fields | None, seen: Observation, total: Scores) -> None:
    """Add a batch's rows to the scores of the values they have."""
    for name, values in (fields(seen.real) if fields else {}).items():
        known = parts.setdefault(name, {})
        for value in sorted(set(values)):
            if value not in known:
                known[value] = total.empty()
            known[value].update(seen, torch.tensor([v == value for v in values], device=seen.index.device))


def _repeats(
    source: Source, seen: Observation, judge: _Judge, protocol: EvaluationProtocol, replication: int, first: int
) -> Tensor:
    """Embed all answers to the batch's share of the first `mm_texts` captions, (texts, repeats, e)."""
    count = min(protocol.mm_texts - first, len(seen.index))
    head = select(seen.real, torch.arange(count, device=seen.index.device))
    seeds = [protocol_seeds(protocol.seed, replication, first, count, n) for n in range(1, protocol.mm_repeats)]
    asked, embeddings = iter([(head, drawn) for drawn in seeds]), [seen.motion[:count]]
    while group := list(islice(asked, AHEAD)):
        embeddings += [judge.motion(motions) for motions in _answers(source, group)]
    return torch.stack(embeddings, dim=1)
