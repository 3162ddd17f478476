"""Hold the metrics of one set of rows: a replication's, or those of its rows that share a field's value."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torchmetrics import Metric

from kinema.evaluation.metrics import (
    ClipScore,
    Diversity,
    FrechetDistance,
    MultiModality,
    Physical,
    Reconstruction,
    Retrieval,
)
from kinema.evaluation.settings import EvaluationProtocol
from kinema.motion.skeleton import Skeleton
from kinema.seeds import pairs_seed
from kinema.types import MotionBatch


@dataclass(frozen=True)
class Observation:
    """Hold a batch as the metrics see it; `paired`: row i of `generated` is meant to equal row i of `real`.

    `index` is each row's place in the replication; `clip_pair` the contrastive evaluator's (motion, text) embeddings.
    """

    index: Int[Tensor, " b"]
    text: Float[Tensor, "b e"]
    reference: Float[Tensor, "b e"]
    motion: Float[Tensor, "b e"]
    clip_pair: tuple[Tensor, Tensor] | None
    real: MotionBatch
    generated: MotionBatch
    paired: bool


def metric_device(device: torch.device) -> torch.device:
    """Return the device, or the CPU where it has no float64, which FID needs."""
    return torch.device("cpu") if device.type == "mps" else device


class Scores:
    """Update all metrics together; `compute` gives those that the rows seen allow.

    Keys: r1 r2 r3 matching fid diversity; clip_score with a contrastive evaluator; multimodality; of reconstructions
    mpjpe_mm mpjpe_heading_mm heading_error_deg; and foot_skating jitter float_mm penetration_mm with their
    real_*, turn_ratio root_speed_ratio.
    """

    def __init__(
        self, protocol: EvaluationProtocol, replication: int, skeleton: Skeleton, device: torch.device
    ) -> None:
        self.settings = (protocol, replication, skeleton, device)
        self.count = 0
        # A replication is one process' work; one that alone evaluates within a group must not wait for the others.
        sync = {"sync_on_compute": False}
        seed = pairs_seed(protocol.seed, replication)
        self.retrieval = Retrieval(protocol.pool, protocol.leftover, **sync)
        self.diversity = Diversity(protocol.diversity_pairs, seed, **sync)
        self.multimodality = MultiModality(protocol.mm_pairs, seed, **sync)
        self.clip_score = ClipScore(**sync)
        self.reconstruction = Reconstruction(skeleton, **sync)
        self.physical = Physical(skeleton, **sync)
        self.fid: FrechetDistance | None = None
        self.device = metric_device(device)
        for metric in self._metrics():
            metric.to(self.device)

    def empty(self) -> Scores:
        """Make scores for a part of the rows."""
        return Scores(*self.settings)

    def update(self, seen: Observation, keep: Bool[Tensor, " b"] | None = None) -> None:
        """Add the rows of a batch (those to keep); retrieval is against their whole pools in any case."""
        self.retrieval.update(seen.text, seen.motion, keep)
        if keep is not None:
            seen = _subset(seen, keep)
        self.count += len(seen.index)
        if self.fid is None:
            self.fid = FrechetDistance(seen.motion.shape[1], sync_on_compute=False).to(self.device)
        self.fid.update(seen.reference, seen.motion)
        self.diversity.update(seen.motion, seen.index)
        self.physical.update(seen.generated, seen.real)
        if seen.clip_pair is not None:
            self.clip_score.update(*seen.clip_pair)
        if seen.paired:
            self.reconstruction.update(seen.generated.features, seen.real.features, seen.generated.lengths)

    def update_multimodality(self, embeddings: Float[Tensor, "b r e"]) -> None:
        """Add all answers to some captions."""
        self.multimodality.update(embeddings)

    def compute(self) -> dict[str, float]:
        """Return every metric by its key; `n` counts the rows."""
        out: dict[str, Tensor | float] = {"n": self.count}
        out |= self.retrieval.compute()
        if self.count > 1 and self.fid is not None:
            out |= {"fid": self.fid.compute(), "diversity": self.diversity.compute()}
        optional = {"multimodality": self.multimodality, "clip_score": self.clip_score}
        out |= {name: metric.compute() for name, metric in optional.items() if metric.update_called}
        if self.reconstruction.update_called:
            out |= self.reconstruction.compute()
        out |= self.physical.compute()
        return {name: float(value) for name, value in out.items()}

    def _metrics(self) -> list[Metric]:
        return [value for value in vars(self).values() if isinstance(value, Metric)]


def _subset(seen: Observation, keep: Bool[Tensor, " b"]) -> Observation:
    rows = keep.nonzero().flatten()
    return replace(
        seen,
        index=seen.index[rows],
        text=seen.text[rows],
        reference=seen.reference[rows],
        motion=seen.motion[rows],
        clip_pair=None if seen.clip_pair is None else (seen.clip_pair[0][rows], seen.clip_pair[1][rows]),
        real=_motions(seen.real, rows),
        generated=_motions(seen.generated, rows),
    )


def _motions(batch: MotionBatch, rows: Int[Tensor, " n"]) -> MotionBatch:
    """Take the motions of some rows; metrics need no captions."""
    return MotionBatch(batch.features[rows], batch.lengths[rows])
