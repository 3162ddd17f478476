"""Measure generated motion: torchmetrics classes whose result does not depend on order or number of processes."""

from kinema.evaluation.metrics.clip_score import ClipScore
from kinema.evaluation.metrics.code_usage import CodeUsage
from kinema.evaluation.metrics.diversity import Diversity, MultiModality
from kinema.evaluation.metrics.fid import FrechetDistance
from kinema.evaluation.metrics.fid_l2 import UnitFrechetDistance
from kinema.evaluation.metrics.halves import HalvesDistance
from kinema.evaluation.metrics.nearest_training import NearestTraining
from kinema.evaluation.metrics.physical import Physical
from kinema.evaluation.metrics.prdc import PRDC
from kinema.evaluation.metrics.reconstruction import Reconstruction
from kinema.evaluation.metrics.retrieval import Retrieval
from kinema.evaluation.metrics.retrieval_share import RetrievalShare

__all__ = [
    "PRDC",
    "ClipScore",
    "CodeUsage",
    "Diversity",
    "FrechetDistance",
    "HalvesDistance",
    "MultiModality",
    "NearestTraining",
    "Physical",
    "Reconstruction",
    "Retrieval",
    "RetrievalShare",
    "UnitFrechetDistance",
]
