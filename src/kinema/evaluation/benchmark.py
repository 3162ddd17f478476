"""Hold the metrics that stand beside the papers' in every table; of a replication as a whole."""

from __future__ import annotations

import torch
from torch import Tensor
from torchmetrics import Metric

from kinema.evaluation.metrics import PRDC, HalvesDistance, NearestTraining, RetrievalShare, UnitFrechetDistance
from kinema.evaluation.scores import Observation, metric_device
from kinema.evaluation.settings import EvaluationProtocol
from kinema.evaluation.training_set import TrainingSet
from kinema.seeds import halves_seed


class Benchmark:
    """Update all of them together; `compute` gives those that the rows seen allow.

    Keys: r1_of_real r2_of_real r3_of_real; fid_halves real_fid_halves fid_l2; precision recall density coverage; and
    nearest_train memorised if there is a training set. Skating, jitter, float and penetration are in `Scores`.
    """

    def __init__(
        self,
        protocol: EvaluationProtocol,
        replication: int,
        device: torch.device,
        training: TrainingSet | None = None,
    ) -> None:
        sync = {"sync_on_compute": False}
        self.count = 0
        self.retrieval = RetrievalShare(protocol.pool, protocol.leftover, **sync)
        self.halves = HalvesDistance(halves_seed(protocol.seed, replication), **sync)
        self.prdc = PRDC(**sync)
        self.nearest = None if training is None else NearestTraining(training.embeddings, training.isolation, **sync)
        self.fid_l2: UnitFrechetDistance | None = None
        self.device = metric_device(device)
        for metric in vars(self).values():
            if isinstance(metric, Metric):
                metric.to(self.device)

    def update(self, seen: Observation) -> None:
        """Add a batch."""
        if self.fid_l2 is None:
            self.fid_l2 = UnitFrechetDistance(seen.motion.shape[1], sync_on_compute=False).to(self.device)
        self.count += len(seen.index)
        self.retrieval.update(seen.text, seen.motion, seen.reference)
        self.halves.update(seen.reference, seen.motion, seen.index)
        self.fid_l2.update(seen.reference, seen.motion)
        self.prdc.update(seen.reference, seen.motion)
        if self.nearest is not None:
            self.nearest.update(seen.motion)

    def compute(self) -> dict[str, float]:
        """Return every metric by its key."""
        out: dict[str, Tensor] = {}
        for metric in (self.retrieval, self.halves, self.prdc, self.nearest):
            out |= {} if metric is None else metric.compute()
        if self.count > 1 and self.fid_l2 is not None:
            out["fid_l2"] = self.fid_l2.compute()
        return {name: float(value) for name, value in out.items()}
