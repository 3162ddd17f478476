"""Tell the overrides that training knows from those that scoring has alone."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

from omegaconf import OmegaConf

from kinema.experiments.config import CONF
from kinema.experiments.stages import stages


def for_training(overrides: Iterable[str]) -> list[str]:
    """Leave out what is about scoring or sampling: `kinema train` has no such option."""
    sampling = tuple(f"{stage.node}.sampling." for stage in stages().values())
    words = ((override, override.lstrip("+~")) for override in overrides)
    return [
        override
        for override, word in words
        if not word.startswith(sampling) and word.partition("=")[0].partition(".")[0] not in _scoring()
    ]


@cache
def _scoring() -> frozenset[str]:
    """Name the keys of conf/evaluate.yaml: those that every entry point has stand in conf/base.yaml."""
    return frozenset({*OmegaConf.load(CONF / "evaluate.yaml"), "sampling"} - {"defaults", "hydra"})
