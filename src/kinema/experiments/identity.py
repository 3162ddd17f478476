"""Return every run its identity: a hash of all that can change its result, and of nothing else."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from kinema.experiments.config import plain
from kinema.experiments.stages import STAGES, Stage
from kinema.runs.folder import RunFolder
from kinema.runs.parts import TEXT, upstream

IDENTITY_VERSION = 1
"""Raised when a change of the code changes what a config means: old runs are then not taken for new ones."""

PACE = ("validate_every", "checkpoint_every", "val_batches")
"""Keys of a recipe that can't change the weights where the last ones are kept."""


def fingerprint(value: Any) -> str:
    """Hash plain data to 12 hex digits."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def stage_identity(cfg: DictConfig, stage: Stage, corpus_hash: str) -> dict[str, Any]:
    """Collect what determines a stage's weights: its config, the corpus, the seed and its upstream runs."""
    own = plain(stage.config(cfg))
    train = dict(own["train"])
    if train.get("select", "last") == "last":
        train = {k: v for k, v in train.items() if k not in PACE}
    else:
        train.pop("checkpoint_every", None)
    return {
        "version": IDENTITY_VERSION,
        "stage": stage.name,
        "corpus": corpus_hash,
        "seed": cfg.seed,
        "model": own["model"],
        "train": train,
        "precision": cfg.trainer.precision,
        "debug": cfg.debug.steps,
        "reads": {key: plain(OmegaConf.select(cfg, key)) for key in stage.reads},
        "upstream": {name: _upstream(cfg, STAGES[name], corpus_hash) for name in stage.upstream},
    }


def _upstream(cfg: DictConfig, stage: Stage, corpus_hash: str) -> str:
    if stage.name == "tokenizer" and cfg.get("tokenizer_run"):
        return fingerprint(run_identity(Path(cfg.tokenizer_run)))
    return fingerprint(stage_identity(cfg, stage, corpus_hash))


def run_identity(run: Path) -> str:
    """Identify a run: one of ours by its name, which ends in its fingerprint, an imported one by its weights."""
    weights = RunFolder(run).weights
    if (run / "config.yaml").exists() or not weights.exists():
        return run.name
    digest = hashlib.sha256(weights.read_bytes())
    if (run / TEXT).exists():
        digest.update((run / TEXT).read_bytes())
    for link in upstream(run).values():
        digest.update(run_identity(link).encode())
    return digest.hexdigest()
