"""Collect what a report shows of the runs behind a table: facts, configuration and training curves."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from kinema.experiments.config import plain, read_config
from kinema.experiments.stages import stages
from kinema.experiments.tables import TableRow
from kinema.runs.folder import RunFolder
from kinema.runs.lines import read_lines
from kinema.runs.parts import read_text_encoder, upstream

POINTS = 120
"""Points of a curve that are kept."""

FACTS = ("parameters", "step", "val_loss", "seconds", "device")
"""What is shown of a run's status."""

SHARED = ("representation", "scale", "seed")
CORPUS = ("name", "reader", "skeleton", "fps", "mirror", "options")
"""What is shown of every run's configuration, beside its stage's own node: no path of this machine."""


def run_cards(rows: Iterable[TableRow]) -> list[dict[str, Any]]:
    """Return the runs that the complete rows read, and those these were made from, each once, by stage and name."""
    behind: dict[Path, list[str]] = {}
    judging: set[Path] = set()
    for row in rows:
        if row.place is None or not row.complete:
            continue
        for name, path in row.place.runs.items():
            for one in (path.resolve(), *upstream(path).values()):
                labels = behind.setdefault(one, [])
                if row.label not in labels:
                    labels.append(row.label)
                if name in row.place.judges:
                    judging.add(one)
    ordered = sorted(behind.items(), key=lambda item: item[0].parts[-2:])
    return [_card(path, labels, path in judging) for path, labels in ordered]


def _card(path: Path, labels: list[str], judge: bool) -> dict[str, Any]:
    status, stage = RunFolder(path).status, path.parent.name
    cfg = read_config(path) if (path / "config.yaml").is_file() else OmegaConf.create()
    facts: dict[str, Any] = {key: status[key] for key in FACTS if key in status}
    facts |= {"seed": cfg.seed} if "seed" in cfg else {}
    facts |= {f"from {part}": run.name for part, run in sorted(upstream(path).items())}
    facts |= {"text encoder": text["encoder"]} if (text := read_text_encoder(path)) else {}
    facts |= {"versions": status["versions"]} if "versions" in status else {}
    return {
        "name": path.name,
        "stage": stage,
        "rows": labels,
        "judge": judge,
        "facts": facts,
        "config": _shown(cfg, stage),
        "curves": _curves(path),
    }


def _shown(cfg: Any, stage: str) -> dict[str, Any]:
    nodes = (*SHARED, *([stages()[stage].node] if stage in stages() else []))
    found = {node: plain(value) for node in nodes if (value := OmegaConf.select(cfg, node)) is not None}
    if "data" in cfg:
        found["data"] = {key: value for key, value in plain(cfg.data).items() if key in CORPUS}
    return found


def _curves(path: Path) -> dict[str, list[tuple[int, float]]]:
    lines = read_lines(path / "metrics.jsonl")
    found = {}
    for name in ("train/loss", "val/loss"):
        points = [(line["step"], float(f"{line[name]:.5g}")) for line in lines if line.get(name) is not None]
        stride = -(-len(points) // POINTS) or 1
        if points:
            found[name] = points[::stride]
    return found
