"""Measure what no table shows: `kinema reproduce NAME` for a file of conf/study, carried out by the module NAME."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from kinema.experiments.config import CONF, plain


def studies() -> list[str]:
    """Name the studies there are."""
    return sorted(path.stem for path in (CONF / "study").glob("*.yaml"))


def load_study(name: str) -> dict[str, Any]:
    """Read conf/study/NAME.yaml."""
    return {"name": name, **plain(OmegaConf.load(CONF / "study" / f"{name}.yaml"))}


def reproduce_study(name: str, overrides: list[str], **options: Any) -> list[Path]:
    """Carry out a study, and return what it wrote; options as of `kinema reproduce`."""
    module = importlib.import_module(f"{__name__}.{name}")
    return module.carry_out(load_study(name), overrides, **options)
