"""Say what a row's motion cost to learn: the parameters of what makes it, and the rows that they were trained on."""

from __future__ import annotations

from omegaconf import OmegaConf

from kinema.experiments.config import read_config
from kinema.experiments.evaluation import Row
from kinema.experiments.stages import get_stage, stages
from kinema.runs.folder import RunFolder
from kinema.runs.parts import upstream


def spent(place: Row) -> dict[str, float]:
    """Return STAGE_parameters_m (millions) and STAGE_trained_k (thousands) of what is scored: of every stage a run.

    What stands beside it, such as a shortcut that was tuned from it, is among them. Trained rows are optimiser steps
    times the batch of all ranks: clips of a generator, windows of a tokenizer. A run that needed no training has 0; an
    imported one doesn't say.
    """
    runs = {name: path for run in place.subject.values() for name, path in upstream(run).items()} | place.subject
    runs |= {name: run for name, run in place.beside.items() if run is not None}
    found: dict[str, float] = {}
    for name, run in runs.items():
        status = RunFolder(run).status
        if name not in stages() or not (run / "config.yaml").is_file() or "parameters" not in status:
            continue
        batch = OmegaConf.select(read_config(run), f"{get_stage(name).node}.train.batch_size")
        found[f"{name}_parameters_m"] = status["parameters"] / 1e6
        found[f"{name}_trained_k"] = (status.get("step") or 0) * (batch or 0) / 1e3
    return found
