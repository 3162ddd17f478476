"""Tell the overrides that change what is trained from those that are about scoring or sampling."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

from omegaconf import OmegaConf

from kinema.experiments.config import CONF
from kinema.experiments.stages import stages


def for_training(overrides: Iterable[str]) -> list[str]:
    """Leave out what is about scoring alone: `kinema train` has no such option."""
    return [one for one in overrides if _word(one).partition("=")[0].partition(".")[0] not in _scoring()]


def without_sampling(overrides: Iterable[str]) -> list[str]:
    """Leave out how motion is sampled, which changes no weights unless they are selected by the scores of motion."""
    nodes = tuple(f"{stage.node}.sampling." for stage in stages().values())
    return [one for one in overrides if not _word(one).startswith((*nodes, "sampling="))]


def _word(override: str) -> str:
    return override.lstrip("+~")


@cache
def _scoring() -> frozenset[str]:
    """Name the keys of conf/evaluate.yaml: those that every entry point has stand in conf/base.yaml."""
    return frozenset({*OmegaConf.load(CONF / "evaluate.yaml")} - {"defaults", "hydra"})
