"""Compose configurations and build their models without memory, for the tests beside."""

from __future__ import annotations

from functools import cache

import pytest
import torch
from omegaconf import DictConfig

from kinema.experiments.config import CONF, compose, plain, validate
from kinema.experiments.stages import get_stage
from kinema.runs.build import build

METHODS = sorted(file.stem for file in (CONF / "method").glob("*.yaml"))
CORPORA = ("humanml3d", "kit_ml")
OFFLINE = ("evaluator.words=hashed", "evaluator.tokens=hashed")
FSQ = "tokenizers.fsq"  # cannot be built without memory
LIBRARIES = {FSQ: "vector_quantize_pytorch", "generators.motiongpt": "transformers"}

composed = cache(lambda *overrides: compose(list(overrides)))


def resolved(*overrides: str) -> dict:
    cfg = composed(*overrides)
    validate(cfg)
    return plain(cfg)


def stage_model(stage: str, *overrides: str, cfg: DictConfig | None = None) -> torch.nn.Module:
    """Build a stage's model, without memory where it can be, or skip if its library is not installed."""
    spec = get_stage(stage).spec(cfg or composed(*OFFLINE, *overrides))
    for name, library in LIBRARIES.items():
        if name in str(spec):
            pytest.importorskip(library, reason="needs the extra kinema[text] or kinema[vq]")
    with torch.device("cpu" if FSQ in str(spec) else "meta"):
        return build(spec)


def size(model: torch.nn.Module) -> int:
    return sum(p.numel() for p in model.parameters())
