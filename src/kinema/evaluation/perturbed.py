"""Alter some dims of captured motion by noise: what an evaluator weighs shows in what it minds (MARDM Table 3)."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor

from kinema.evaluation.source import Source, answer
from kinema.motion.representation import Representation
from kinema.motion.skeleton import DIMS, Skeleton
from kinema.motion.statistics import Statistics
from kinema.types import MotionBatch

HOW = ("add", "replace")


class Perturbed(Source):
    """Answer with the captured motion, its essential or its redundant dims altered.

    `how`: "add" adds noise of `level` deviations, "replace" puts the mean and such noise in place of what was there.
    `statistics` of all columns say what a deviation is: the judge's own or the corpus' (`judged` makes the former). The
    same seed draws the same noise whichever dims are altered, at whatever level.
    """

    label, dims = "perturbed", "redundant"

    def __init__(self, skeleton: Skeleton, statistics: Statistics, *, altered: str, how: str, level: float) -> None:
        if altered not in DIMS or how not in HOW or not level >= 0:
            raise ValueError(
                f"perturb: dims={altered!r} how={how!r} level={level}; allowed: dims {', '.join(DIMS)}; how "
                f"{', '.join(HOW)}; level of at least 0"
            )
        split = skeleton.essential_width
        self.columns = slice(split) if altered == "essential" else slice(split, skeleton.feature_width)
        self.how, self.level = how, level
        self.mean = torch.from_numpy(statistics.mean[self.columns]).float()
        self.std = torch.from_numpy(statistics.std[self.columns]).float()

    def __call__(self, batch: MotionBatch, seeds: Int[Tensor, " b"]) -> MotionBatch:
        """Alter every motion by the noise of its seed."""
        features = batch.features.clone()
        for row, length, seed in zip(features, batch.lengths.tolist(), seeds.tolist(), strict=True):
            row[:length, self.columns] = self._altered(row[:length, self.columns], seed, row.shape[1])
        return answer(batch, features, batch.lengths)

    def _altered(self, values: Float[Tensor, "t d"], seed: int, width: int) -> Float[Tensor, "t d"]:
        # Drawn for all columns, so that essential and redundant ones have their own numbers.
        drawn = torch.randn(len(values), width, generator=torch.Generator().manual_seed(seed))[:, self.columns]
        noise = (self.level * drawn * self.std).to(values)
        return noise + (values if self.how == "add" else self.mean.to(values))


def judged(representation: Representation, corpus: Statistics) -> Statistics:
    """Return the statistics that a judge normalises by, and the corpus' of columns that it doesn't read."""
    width = representation.width
    mean, std = corpus.mean.copy(), corpus.std.copy()
    mean[:width], std[:width] = representation.mean.cpu().numpy(), representation.std.cpu().numpy()
    return Statistics(mean, std)
