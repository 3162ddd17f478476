"""Say what runs there are: how far each is, what it is of, its scores, and how it differs from those beside it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from kinema.evaluation.settings import EvaluationProtocol
from kinema.experiments.config import LENGTHS, plain, read_config
from kinema.experiments.replications import scored_lines
from kinema.experiments.stages import stages
from kinema.motion.skeleton import DIMS
from kinema.report.intervals import Value, means
from kinema.runs.folder import RunFolder
from kinema.runs.lines import read_lines
from kinema.runs.parts import GENERATOR

EVALUATION, DAMAGED = "evaluation", "damaged"
USUAL = DIMS[0]
"""Dims that the usual evaluators read, those of every table but the ones on evaluators themselves."""
SHARED = ("representation", "text", "data.options", "trainer.precision", "scale.protocol")
"""What a stage's run is chosen by beside its own part of the configuration."""
APART = ("paths", "logger", "callbacks", "debug", "ensure", "trainer", "stage", "seed", "scale", "data", "replications")
"""What is no choice of the method, or has a column of its own."""


@dataclass(frozen=True)
class Listed:
    """Hold one run folder and read what it says of itself."""

    folder: RunFolder

    @property
    def kind(self) -> str:
        """Name the stage, or `evaluation`."""
        return self.folder.path.parent.name

    @property
    def name(self) -> str:
        """Name the folder as commands take it."""
        return f"{self.kind}/{self.folder.path.name}"

    @cached_property
    def config(self) -> dict[str, Any]:
        """Read the configuration; an imported run has none."""
        run = self.folder.path
        return plain(read_config(run)) if (run / "config.yaml").is_file() else {}

    @cached_property
    def damage(self) -> str | None:
        """Say in one line what of it cannot be read; None for a run that is whole."""
        try:
            _ = self.folder.status, self.config, self.progress, self.scores()
        except (ValueError, OSError) as error:
            return " ".join(str(error).split())
        return None

    @cached_property
    def state(self) -> str:
        """Say how far it is; `killed` if it says running and no process is at it, `damaged` if it can't be read."""
        if self.damage is not None:
            return DAMAGED
        state = self.folder.status["state"]
        return "killed" if state == "running" and not self.folder.held else state

    @cached_property
    def lines(self) -> list[dict[str, Any]]:
        """The replications of an evaluation."""
        found = {line["replication"]: line for line in scored_lines(self.folder.path)}
        return [found[number] for number in sorted(found)]

    @property
    def progress(self) -> str:
        """Say which step it is at, and of how many: of an evaluation, replications."""
        if self.evaluates:
            return f"{len(self.lines)}/{at(self.config, 'scale.protocol.replications') or '?'}"
        status = self.folder.status
        step = status.get("step") if status["state"] == "done" else None
        if step is None:
            lines = read_lines(self.folder.path / "metrics.jsonl", {"step": int})
            step = max((line["step"] for line in lines), default=None)
        steps = at(self.config, f"{self.node}.train.steps")
        return "" if step is None else f"{step}/{steps}" if steps else str(step)

    @property
    def node(self) -> str:
        """Name the part of the configuration that describes it."""
        return stages()[self.kind].node if self.kind in stages() else GENERATOR

    @cached_property
    def settings(self) -> dict[str, Any]:
        """What was chosen for it, one value a dotted key: of a training, for its own stage."""
        parts = {key: at(self.config, key) for key in (self.node, *SHARED)}
        if self.evaluates:
            parts |= {key: value for key, value in self.config.items() if key not in APART}
        return {key: value for part, found in parts.items() for key, value in flatten(found, part).items()}

    @property
    def evaluates(self) -> bool:
        """Say whether it is an evaluation."""
        return self.kind == EVALUATION

    def scores(self) -> dict[str, Value]:
        """Return the means over an evaluation's replications with intervals; of a training its validation loss."""
        if not self.evaluates:
            loss = self.folder.status.get("val_loss")
            return {} if loss is None else {"val_loss": Value(loss, None)}
        return means([line["metrics"] for line in self.lines])

    def describe(self) -> dict[str, Any]:
        """Say all of it as plain data; nothing for a folder that is no run's."""
        if not any((self.folder.path / name).is_file() for name in ("status.json", "config.yaml")):
            return {}
        scores = {name: {"mean": value.mean, "interval": value.half} for name, value in self.scores().items()}
        found = {"state": self.state, "progress": self.progress, "scores": scores, "provenance": self.provenance}
        return {key: value for key, value in found.items() if value}

    @property
    def usual(self) -> bool:
        """Say whether an evaluation is by the usual evaluators, and of motion of its method's own lengths."""
        lengths, judge = at(self.provenance, "lengths"), at(self.provenance, "statistics.evaluator.kind")
        own = at(self.config, "method.lengths") or LENGTHS[0]
        return lengths in (None, own) and judge in (None, USUAL)

    @property
    def provenance(self) -> dict[str, Any]:
        """What an evaluation's results rest on: runs, corpus, protocol."""
        return self.lines[0]["provenance"] if self.evaluates and self.lines else {}


def root_of(given: str | Path | None = None) -> Path:
    """Return the folder of runs: the given one, KINEMA_RUNS, or runs; raises FileNotFoundError if it isn't there."""
    root = Path(given or os.environ.get("KINEMA_RUNS", "runs"))
    if not root.is_dir():
        raise FileNotFoundError(
            f"there is no folder of runs at {root.absolute()}; go to the folder that training was started from, or set "
            "KINEMA_RUNS"
        )
    return root


def find(root: Path, words: Sequence[str] = ()) -> list[Listed]:
    """Return the runs below a folder whose names hold all words, in the order of stages and names."""
    order = [*stages(), EVALUATION]
    found = [Listed(RunFolder(file.parent)) for file in root.glob("*/*/status.json")]
    found = [one for one in found if all(word in f"{one.name} {one.state}" for word in words)]
    return sorted(found, key=lambda one: (order.index(one.kind) if one.kind in order else len(order), one.name))


def judged(root: Path) -> dict[str, Listed]:
    """Return the evaluation of each generator's own motion, by the name of its run; where there are several, the last.

    Edits, other evaluators than the usual ones, other lengths than the method's and splits other than the tables' are
    evaluations of their own.
    """
    found = {}
    for file in sorted((root / EVALUATION).glob("generation-*/replications.jsonl"), key=lambda f: f.stat().st_mtime_ns):
        one = Listed(RunFolder(file.parent))
        name = at(one.provenance, f"runs.{GENERATOR}") if one.damage is None else None
        split = at(one.provenance, "protocol.split") if isinstance(name, str) else None
        if isinstance(name, str) and split in (None, EvaluationProtocol.split) and one.usual:
            found[name] = one
    return found


def differences(runs: Sequence[Listed]) -> list[dict[str, Any]]:
    """Return of each run the settings in which not all are alike; None where it has no such setting."""
    keys = sorted({key for run in runs for key in run.settings})
    unlike = [key for key in keys if len({repr(run.settings.get(key)) for run in runs}) > 1]
    return [{key: run.settings.get(key) for key in unlike} for run in runs]


def flatten(value: Any, prefix: str = "") -> dict[str, Any]:
    """Return one value for each dotted key of nested dicts."""
    if not isinstance(value, dict):
        return {prefix: value}
    found: dict[str, Any] = {}
    for key, inner in value.items():
        found |= flatten(inner, f"{prefix}.{key}" if prefix else str(key))
    return found


def at(config: dict[str, Any], key: str) -> Any:
    """Return what stands under a dotted key; None where nothing does."""
    value: Any = config
    for word in key.split("."):
        value = value.get(word) if isinstance(value, dict) else None
    return value
