"""Say by which options motion is sampled: the generator's, or those of a run that completes the generator."""

from __future__ import annotations

from typing import Any

from omegaconf import DictConfig

from kinema.experiments.config import plain
from kinema.experiments.stages import completions_of
from kinema.experiments.stages.base import Stage
from kinema.experiments.stages.generator import GeneratorStage
from kinema.runs.build import build


def sampling_spec(cfg: DictConfig) -> dict[str, Any]:
    """Return the spec of the sampling."""
    return plain(_sampler(cfg).config(cfg).sampling)


def build_sampling(cfg: DictConfig) -> Any:
    """Build the sampling; raises ValueError naming the key of a wrong option."""
    return build(sampling_spec(cfg), at=f"{_sampler(cfg).node}.sampling")


def _sampler(cfg: DictConfig) -> Stage:
    generator = GeneratorStage()
    return next((stage for stage in completions_of(generator) if stage.beside(cfg)), generator)
