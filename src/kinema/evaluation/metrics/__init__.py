"""Measure generated motion: torchmetrics classes whose result does not depend on order or number of processes."""

from kinema.evaluation.metrics.clip_score import ClipScore
from kinema.evaluation.metrics.code_usage import CodeUsage
from kinema.evaluation.metrics.diversity import Diversity, MultiModality
from kinema.evaluation.metrics.fid import FrechetDistance
from kinema.evaluation.metrics.physical import Physical
from kinema.evaluation.metrics.reconstruction import Reconstruction
from kinema.evaluation.metrics.retrieval import Retrieval

__all__ = [
    "ClipScore",
    "CodeUsage",
    "Diversity",
    "FrechetDistance",
    "MultiModality",
    "Physical",
    "Reconstruction",
    "Retrieval",
]
