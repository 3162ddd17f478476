"""Return every run its identity: a hash of all that can change its result, and of nothing else."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from kinema.experiments.config import plain
from kinema.experiments.stages import companions_of, needs_of
from kinema.experiments.stages.base import Stage
from kinema.runs.folder import RunFolder
from kinema.runs.parts import TEXT, upstream

IDENTITY_VERSION = 2
"""Raised when a change of the code changes what a config means: old runs are then not taken for new ones."""


def fingerprint(value: Any) -> str:
    """Hash plain data to 12 hex digits."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


Corpora = Callable[[Stage], str]
"""The hash of the corpus that a stage learns from."""


def corpora(cfg: DictConfig) -> Corpora:
    """Return the corpora of a configuration, each split opened once."""
    known: dict[str | None, str] = {}

    def corpus_of(stage: Stage) -> str:
        split = stage.split(cfg)
        if split not in known:
            known[split] = stage.corpus(cfg).hash
        return known[split]

    return corpus_of


def stage_identity(cfg: DictConfig, stage: Stage, corpus_of: Corpora) -> dict[str, Any]:
    """Collect what determines a stage's weights: its config, its corpus, its seed and its upstream runs."""
    return {
        "version": IDENTITY_VERSION,
        "stage": stage.name,
        "corpus": corpus_of(stage),
        "seed": stage.seed(cfg),
        "settings": stage.settings(cfg),
        "reads": {key: plain(OmegaConf.select(cfg, key)) for key in stage.reads},
        "upstream": {other.name: _upstream(cfg, other, corpus_of) for other in needs_of(stage) if other.present(cfg)},
        **({"selection": _selection(cfg, stage, corpus_of)} if stage.selects(cfg) else {}),
    }


def _selection(cfg: DictConfig, stage: Stage, corpus_of: Corpora) -> dict[str, Any]:
    """Collect what chooses a stage's weights: how motion is scored, and the runs that judge and complete it."""
    behind = [other for other in (*stage.watched_by(cfg), *companions_of(stage)) if other.present(cfg)]
    return {
        "scores": {key: cfg.callbacks[key] for key in ("score_every", "score_clips")},
        "sampling": plain(OmegaConf.select(cfg, f"{stage.node}.sampling")),
        "protocol": {key: cfg.scale.protocol[key] for key in ("pool", "leftover", "seed")},
        "runs": {other.name: fingerprint(stage_identity(cfg, other, corpus_of)) for other in behind},
    }


def _upstream(cfg: DictConfig, stage: Stage, corpus_of: Corpora) -> str:
    given = stage.given(cfg)
    return fingerprint(stage_identity(cfg, stage, corpus_of) if given is None else run_identity(given))


def run_identity(run: Path) -> str:
    """Identify a run: ours by its name, which ends in its fingerprint, an imported or renamed one by its weights."""
    weights, own = RunFolder(run).weights, re.search(r"-([0-9a-f]{12})$", run.name)
    if own and ((run / "config.yaml").exists() or not weights.exists()):
        return own[1]
    if not weights.exists():
        return run.name  # of no run: who reads it says so
    digest = hashlib.sha256(weights.read_bytes())
    if (run / TEXT).exists():
        digest.update((run / TEXT).read_bytes())
    for link in upstream(run).values():
        digest.update(run_identity(link).encode())
    return digest.hexdigest()
