"""Say what runs there are: how far each is, what it is of, its scores, and how it differs from those beside it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import yaml

from kinema.experiments.replications import scored_lines
from kinema.experiments.stages import stages
from kinema.locks import attempt
from kinema.report.intervals import Value, means
from kinema.runs.folder import RunFolder
from kinema.runs.lines import read_lines
from kinema.runs.parts import GENERATOR

EVALUATION = "evaluation"
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
        return read_config(self.folder.path)

    @cached_property
    def state(self) -> str:
        """Say how far it is; `killed` where it says running and no process is at it."""
        state = self.folder.status["state"]
        return "killed" if state == "running" and not _held(self.folder.path) else state

    @cached_property
    def lines(self) -> list[dict[str, Any]]:
        """The replications of an evaluation."""
        found = {line["replication"]: line for line in scored_lines(self.folder.path)}
        return [found[number] for number in sorted(found)]

    @property
    def progress(self) -> str:
        """Say which step it is at, and of how many: of an evaluation, replications."""
        if self.evaluates:
            return f"{len(self.lines)}/{_at(self.config, 'scale.protocol.replications') or '?'}"
        step = self.folder.status.get("step") if self.state == "done" else None
        if step is None:
            step = max((line["step"] for line in read_lines(self.folder.path / "metrics.jsonl")), default=None)
        steps = _at(self.config, f"{self.node}.train.steps")
        return "" if step is None else f"{step}/{steps}" if steps else str(step)

    @property
    def node(self) -> str:
        """Name the part of the configuration that describes it."""
        return stages()[self.kind].node if self.kind in stages() else GENERATOR

    @cached_property
    def settings(self) -> dict[str, Any]:
        """What was chosen for it, one value a dotted key: of a training, for its own stage."""
        parts = {key: _at(self.config, key) for key in (self.node, *SHARED)}
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
    found = [one for one in found if all(word in f"{one.name} {one.folder.status['state']}" for word in words)]
    return sorted(found, key=lambda one: (order.index(one.kind) if one.kind in order else len(order), one.name))


def judged(root: Path) -> dict[str, Listed]:
    """Return the evaluation of each generator's own motion, by the name of its run; where there are several, the last.

    Edits, predicted lengths and the like are evaluations of their own.
    """
    found = {}
    for file in sorted((root / EVALUATION).glob("generation-*/replications.jsonl"), key=lambda f: f.stat().st_mtime_ns):
        one = Listed(RunFolder(file.parent))
        if one.lines and (name := one.lines[0]["provenance"]["runs"].get(GENERATOR)):
            found[name] = one
    return found


def differences(runs: Sequence[Listed]) -> list[dict[str, Any]]:
    """Return of each run the settings in which not all are alike; None where it has no such setting."""
    keys = sorted({key for run in runs for key in run.settings})
    unlike = [key for key in keys if len({repr(run.settings.get(key)) for run in runs}) > 1]
    return [{key: run.settings.get(key) for key in unlike} for run in runs]


def read_config(run: Path) -> dict[str, Any]:
    """Read a run's config.yaml as plain data; an empty one where there is none.

    Raises ValueError for a file that is damaged, or uses aliases: no run writes them, and few of them can stand for
    more data than fits in memory.
    """
    path = run / "config.yaml"
    if not path.is_file():
        return {}
    try:
        text = path.read_text(encoding="utf-8")
        if any(isinstance(event, yaml.AliasEvent) for event in yaml.parse(text, yaml.SafeLoader)):
            raise ValueError("it holds YAML aliases")
        config = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise ValueError(f"{path} is damaged ({' '.join(str(error).split())}); no run writes such a file") from None
    if not isinstance(config, dict):
        raise ValueError(f"{path} is damaged (it holds {type(config).__name__}, no options); no run writes such a file")
    return config


def flatten(value: Any, prefix: str = "") -> dict[str, Any]:
    """Return one value for each dotted key of nested dicts."""
    if not isinstance(value, dict):
        return {prefix: value}
    found: dict[str, Any] = {}
    for key, inner in value.items():
        found |= flatten(inner, f"{prefix}.{key}" if prefix else str(key))
    return found


def _at(config: dict[str, Any], key: str) -> Any:
    value: Any = config
    for word in key.split("."):
        value = value.get(word) if isinstance(value, dict) else None
    return value


def _held(run: Path) -> bool:
    """Say whether a process works on a run: it holds one of its locks."""
    for lock in (run / ".lock", *run.glob(".replication-*.lock")):
        if lock.exists():
            try:
                with attempt(lock) as free:
                    if not free:
                        return True
            except OSError:  # a folder of somebody else's
                return True
    return False
