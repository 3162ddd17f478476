"""Score one row: build its source and the judges, append the replications that are missing."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from kinema.experiments.config import plain, validate
from kinema.experiments.corpus import manifest, open_corpus, require_captions
from kinema.experiments.identity import fingerprint, run_identity
from kinema.experiments.run import check_parts, command, run_stage, stage_folder
from kinema.experiments.stages import STAGES
from kinema.runs.console import console
from kinema.runs.folder import RunFolder
from kinema.runs.lines import append_line, read_lines
from kinema.runs.parts import upstream
from kinema.runs.versions import versions

NEEDS = {"real": (), "shuffled": (), "nearest": (), "noise": ("tokenizer",), "reconstruction": ("tokenizer",)}
"""The runs a source reads beside the judges'; generation reads the generator's, which knows its tokenizer, the residual
transformer's where the method has one, and the length estimator's where lengths are predicted by one."""

JUDGES = ("matching", "contrastive")


@dataclass(frozen=True)
class Row:
    """Hold an evaluation's place, what it reads and how many replications it has."""

    folder: RunFolder
    runs: dict[str, Path]
    replications: int

    @property
    def lines(self) -> list[dict[str, Any]]:
        """The results by replication, each at most once."""
        found = {line["replication"]: line for line in read_lines(self.folder.path / "replications.jsonl")}
        return [found[r] for r in range(self.replications) if r in found]


def describe(cfg: DictConfig) -> Row:
    """Find the folder of an evaluation without running anything."""
    validate(cfg)
    store = open_corpus(cfg)
    corpus = manifest(store)["hash"]
    runs = {name: stage_folder(cfg, STAGES[name], corpus).path for name in JUDGES}
    given = plain(cfg.get("evaluators") or {})
    runs |= {stage: Path(given[key]) for stage, key in (("matching", "t2m"), ("contrastive", "clip")) if given.get(key)}
    for name in NEEDS[cfg.source] if cfg.source in NEEDS else _generation_needs(cfg):
        runs[name] = _given_run(cfg, name) or stage_folder(cfg, STAGES[name], corpus).path
    protocol = plain(cfg.scale.protocol)
    replications = protocol.pop("replications")
    identity = {
        "source": cfg.source,
        "corpus": corpus,
        "protocol": protocol,
        "runs": {name: fingerprint(run_identity(path)) for name, path in runs.items()},
        "sampling": plain(cfg.generator.sampling) if cfg.source == "generation" else None,
        "text": plain(cfg.text) if cfg.source in ("generation", "nearest") else None,
    }
    if cfg.source == "generation" and cfg.task == "editing":
        identity["edit"] = plain(cfg.edit)
    elif cfg.source == "generation" and cfg.lengths != "real":
        identity["lengths"] = cfg.lengths
    if any(given.values()):
        # Imported judges have no fingerprint that would hold what they read captions with.
        identity["vocabulary"] = {k: cfg.evaluator[k] for k in ("words", "words_path", "tokens", "tokens_path")}
    own_run = cfg.source == "generation" or (cfg.source in NEEDS and NEEDS[cfg.source])
    who = f"-{Path(cfg.run).name if cfg.get('run') else cfg.method.name}" if own_run else ""
    what = f"edit_{cfg.edit.task}" if "edit" in identity else cfg.source
    own = f"{who}-{cfg.representation.kind}" if who else ""
    name = f"{what}{own}-s{cfg.seed}-{fingerprint(identity)}"
    root = Path(f"{cfg.paths.runs}-debug" if cfg.debug.enabled else cfg.paths.runs)
    return Row(RunFolder(root / "evaluation" / name), runs, replications)


def _generation_needs(cfg: DictConfig) -> list[str]:
    needs = ["generator"]
    linked = upstream(Path(cfg.run)) if cfg.get("run") else None
    has_residual = STAGES["residual"].present(cfg) if linked is None else "residual" in linked
    predicted = cfg.task == "generation" and cfg.lengths == "predicted"
    estimated = predicted and not cfg.generator.get("predicts_length")
    if has_residual:
        needs.append("residual")
    if estimated and (linked is None or "length" in linked):
        needs.append("length")
    return needs


def _given_run(cfg: DictConfig, stage: str) -> Path | None:
    """Return the run that `run=` names, or the part of the generator that it names; `tokenizer_run=` likewise."""
    if not cfg.get("run"):
        return Path(cfg.tokenizer_run) if stage == "tokenizer" and cfg.tokenizer_run else None
    links = upstream(Path(cfg.run))
    return links[stage] if stage in links else Path(cfg.run)


def run_evaluation(cfg: DictConfig) -> Row:
    """Compute the replications that a row lacks; finished ones are never computed again."""
    row = describe(cfg)
    if len(row.lines) == row.replications:
        console.print(f"cached    {row.folder.path}")
        return row
    for name in _own_stages(cfg, row):
        run_stage(cfg, name, quiet=True)
    with row.folder.lock():
        done = {line["replication"] for line in row.lines}
        missing = [r for r in range(row.replications) if r not in done]
        if missing:
            _score(cfg, row, missing)
    return row


def _own_stages(cfg: DictConfig, row: Row) -> list[str]:
    """Return the stages that the configuration describes; what is wrong is told before any of them trains."""
    store, own = open_corpus(cfg), []
    require_captions(store, cfg.scale.protocol.split)
    if not cfg.get("run") and "generator" in row.runs:
        for name in ("generator", "residual"):
            check_parts(cfg, STAGES[name])
    corpus = manifest(store)["hash"]
    for name, path in row.runs.items():
        run = RunFolder(path)
        if stage_folder(cfg, STAGES[name], corpus).path != path:
            if not run.weights.exists():
                raise FileNotFoundError(
                    f"{path} holds no {run.weights.name}; give the folder of a finished or imported run"
                )
            continue
        if not run.done and not cfg.ensure:
            raise FileNotFoundError(
                f"source {cfg.source} needs the {name} run {path}, which isn't finished; train it with "
                f"`{command(cfg, STAGES[name])}` or set ensure=true"
            )
        own.append(name)
    return own


def _score(cfg: DictConfig, row: Row, missing: list[int]) -> None:
    from kinema.experiments.scoring import Scorer

    console.print(f"evaluate  {row.folder.path}: replications {', '.join(map(str, missing))} of {row.replications}")
    resolved = plain(cfg)
    resolved.pop("hydra", None)
    OmegaConf.save(OmegaConf.create(resolved), row.folder.path / "config.yaml")
    scorer = Scorer(cfg, row.runs, open_corpus(cfg))
    software = versions()
    for replication in missing:
        started = time.monotonic()
        result = scorer.replicate(replication)
        if replication == 0:
            scorer.save_samples(row.folder.path / "samples.npz", result)
        line = {
            "replication": replication,
            "metrics": result.metrics,
            "breakdowns": result.breakdowns,
            "seconds": round(time.monotonic() - started, 2),
            "provenance": {**scorer.provenance, "versions": software},
        }
        append_line(row.folder.path / "replications.jsonl", line)
        shown = " ".join(f"{k} {result.metrics[k]:.3f}" for k in ("r1", "r3", "fid", "matching") if k in result.metrics)
        console.print(f"  replication {replication}: {shown} ({line['seconds']:.0f} s)")
    row.folder.mark("done", versions=software)
