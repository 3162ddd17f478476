"""Score one row: build its source and the judges, append the replications that are missing."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf

from kinema.atomic import write_text
from kinema.data.store import PackedStore
from kinema.experiments.config import plain, validate
from kinema.experiments.corpus import open_corpus, require_captions, require_pool
from kinema.experiments.dashboards import show_results
from kinema.experiments.identity import corpora, fingerprint, run_identity
from kinema.experiments.replications import EACH, REPLICATIONS, whole_lines
from kinema.experiments.run import check, command, run_folder, run_stage, stage_folder
from kinema.experiments.sources import source_of
from kinema.experiments.stages import companions_of, completions_of, get_stage, judges
from kinema.experiments.stages.base import Stage, asked_for, dims, given_run
from kinema.experiments.stages.judge import JudgeStage
from kinema.locks import attempt
from kinema.report.intervals import means
from kinema.runs.console import console
from kinema.runs.folder import RunFolder
from kinema.runs.lines import append_line
from kinema.runs.versions import versions

if TYPE_CHECKING:
    from kinema.experiments.scoring import Scorer

TOLD = ("r1", "r2", "r3", "fid", "matching", "diversity", "multimodality", "clip_score", "mpjpe_mm")
"""Metrics that are printed; the folder has all."""


@dataclass(frozen=True)
class Row:
    """Hold an evaluation's place, the runs it reads by stage, and how many replications it has.

    `subject` is the run whose motion is judged (none: real motion), `beside` its companions (None: without it).
    `asked` are the replications that this call is to score.
    """

    folder: RunFolder
    judges: dict[str, Path]
    subject: dict[str, Path]
    beside: dict[str, Path | None]
    replications: int
    asked: tuple[int, ...]

    @property
    def digest(self) -> str:
        """What its folder's name ends in: two places of the same one are of the same row."""
        return self.folder.path.name.rpartition("-")[2]

    @property
    def runs(self) -> dict[str, Path]:
        """All runs it reads."""
        return self.judges | self.subject | {name: run for name, run in self.beside.items() if run is not None}

    @property
    def asks(self) -> list[JudgeStage]:
        """The stages of its judges."""
        return [stage for stage in judges().values() if stage.name in self.judges]

    @property
    def lines(self) -> list[dict[str, Any]]:
        """The results by replication, each at most once; those that lack a judge's scores don't count."""
        found = {line["replication"]: line for line in whole_lines(self.folder.path, self.judges)}
        return [found[r] for r in range(self.replications) if r in found]

    def mean(self, metric: str) -> float:
        """Return the mean of a metric over the replications; raises ValueError naming those there are."""
        found = [line["metrics"] for line in self.lines]
        if not all(metric in metrics for metrics in found):
            raise ValueError(f"objective={metric} is no metric of this row; it has {', '.join(sorted(found[0]))}")
        return math.fsum(metrics[metric] for metrics in found) / len(found)

    @property
    def missing(self) -> tuple[int, ...]:
        """The replications that are asked for and have no line."""
        there = {line["replication"] for line in self.lines}
        return tuple(r for r in self.asked if r not in there)


def describe(cfg: DictConfig) -> Row:
    """Find the folder of an evaluation without running anything."""
    validate(cfg)
    source = source_of(cfg)
    source.check_run(cfg)
    store, corpus_of = PackedStore.open(open_corpus(cfg)), corpora(cfg)

    def found(stage: Stage) -> Path:
        return stage.given(cfg) or stage_folder(cfg, stage, corpus_of).path

    scored = [get_stage(source.scores)] if source.scores else []
    companions = [other for stage in scored for other in (*companions_of(stage), *completions_of(stage))]
    row = Row(
        RunFolder(Path()),
        judges={stage.name: found(stage) for stage in judges().values()},
        subject={stage.name: found(stage) for stage in scored},
        beside={stage.name: found(stage) if stage.beside(cfg) else None for stage in companions},
        replications=cfg.scale.protocol.replications,
        asked=tuple(range(cfg.scale.protocol.replications) if cfg.replications is None else cfg.replications),
    )
    identity = _identity(cfg, row, store)
    what = source.label(cfg)
    what += ("_feet" if cfg.lock_feet else "") + ("_lifted" if cfg.lift else "")
    what += f"_{cfg.precision}" if "precision" in identity else ""
    run = asked_for(cfg)
    who = [cfg.method.name, cfg.generator.get("variant"), dims(cfg)] if run is None else [run.name]
    read = {name: run for name, run in row.judges.items() if name not in unread(cfg)}
    label = "-".join(word for word in (what, *(who if row.subject else [])) if word)
    split = cfg.data.options.get("split")
    return replace(
        row, judges=read, folder=run_folder(cfg, "evaluation", label, split, cfg.seed, fingerprint(identity))
    )


def unread(cfg: DictConfig) -> list[str]:
    """Name the judges that a row neither trains nor asks; one that was imported for it is asked.

    They are part of a row's identity all the same: it is the same row with fewer metrics.
    """
    return [name for name in cfg.evaluator.unread if get_stage(name).given(cfg) is None]


def _identity(cfg: DictConfig, row: Row, store: PackedStore) -> dict[str, Any]:
    """Collect what determines a row's results, whatever the number of replications."""
    source = source_of(cfg)
    identity = {
        "source": cfg.source,
        "corpus": store.hash,
        "protocol": {k: v for k, v in plain(cfg.scale.protocol).items() if k != "replications"},
        "runs": {name: fingerprint(run_identity(path)) for name, path in row.runs.items()},
        "sampling": source.sampling(cfg),
        "text": plain(cfg.text) if source.reads_text(cfg) else None,
        **source.settings(cfg),
    }
    if store.knowledge is not None:  # oracles, breakdowns and what counts as memorised rest on it
        identity["knowledge"] = store.knowledge
    if source.lengths(cfg) != "real":
        identity["lengths"] = source.lengths(cfg)
    if cfg.lift:
        identity["lift"] = True
    if cfg.lock_feet:
        identity["lock_feet"] = True
    if cfg.precision != "float32":
        identity["precision"] = cfg.precision
    if any((cfg.get("evaluators") or {}).values()):
        # Imported judges have no fingerprint that would hold what they read captions with.
        identity["vocabulary"] = {k: cfg.evaluator[k] for k in ("words", "words_path", "tokens", "tokens_path")}
    return identity


def run_evaluation(cfg: DictConfig) -> Row:
    """Compute the replications that a row lacks; finished ones are never computed again.

    Several processes may score one row: each takes what no other is at.
    """
    row = describe(cfg)
    if not row.missing:
        _mark(row)
        console.print(f"cached    {row.folder.path}")
        show_results(cfg, row.folder, anew=False)
        return row
    for stage in _unfinished(cfg, row):
        run_stage(cfg, stage.name, quiet=True)
    scoring = _Scoring(cfg, row)
    with row.folder.marked_by_failure():
        for patient in (False, True):  # what another process is at is waited for when nothing else is left
            for replication in row.missing:
                with attempt(row.folder.path / f".replication-{replication}.lock", wait=patient) as mine:
                    if mine and replication in row.missing:
                        scoring.score(replication)
    _mark(row)
    if len(row.lines) == row.replications:
        tell_means(row)
        with row.folder.lock():
            show_results(cfg, row.folder, anew=True)
    return row


def _mark(row: Row) -> None:
    """Say in the row's folder that it is done, or where more replications belong to it than were asked for, partly."""
    done = len(row.lines) == row.replications
    state = "done" if done else "partial"
    if row.folder.status["state"] != state and (done or not row.folder.held):  # else another scores the others
        row.folder.mark(state, versions=versions())


def tell_means(row: Row) -> None:
    """Print the means over all replications, with their 95 % intervals."""
    found = means([line["metrics"] for line in row.lines])
    shown = ", ".join(f"{name} {found[name].text(3)}" for name in TOLD if name in found)
    console.print(f"mean      of {row.replications}: {shown}")


def _unfinished(cfg: DictConfig, row: Row) -> list[Stage]:
    """Return the stages whose runs are to be made; what is wrong is told before any of them trains."""
    _check_judges(cfg, row)
    store = PackedStore.open(open_corpus(cfg))
    source_of(cfg).check(cfg, store)
    require_captions(store, cfg.scale.protocol.split)
    require_pool(cfg, store)
    check_reads(cfg, row)
    wanted = [get_stage(name) for name in row.runs]
    found = [stage for stage in wanted if given_run(cfg, stage) is None and not RunFolder(row.runs[stage.name]).done]
    for stage in found:
        if not cfg.ensure:
            raise FileNotFoundError(
                f"source {cfg.source} needs the {stage.name} run {row.runs[stage.name]}, which isn't finished; train "
                f"it with `{command(cfg, stage)}` or set ensure=true"
            )
        check(cfg, stage)
    return found


def check_reads(cfg: DictConfig, row: Row) -> None:
    """Find the vocabularies and the text encoder, which are read when every run is made."""
    from kinema.experiments.instantiate import check_text  # here: --help must not pay for torch

    for stage in row.asks:
        stage.vocabulary(cfg)
    if source_of(cfg).reads_text(cfg):
        check_text(cfg)
    else:
        source_of(cfg).check_text(row)


def _check_judges(cfg: DictConfig, row: Row) -> None:
    """Check that the motion has the columns that the judges read."""
    lacking = (
        row.subject
        and not cfg.lift
        and cfg.representation.kind == "essential"
        and cfg.evaluator.representation != "essential"
    )
    if lacking and any(stage.given(cfg) is None for stage in row.asks):
        raise ValueError(
            f"evaluator={cfg.evaluator.name} reads {cfg.evaluator.representation} dims, method={cfg.method.name} makes "
            "essential ones alone; choose representation=redundant or evaluator=essential, or lift=true, which "
            "recomputes the others from the joints"
        )


class _Scoring:
    """Score replications one by one; what they share is loaded for the first."""

    def __init__(self, cfg: DictConfig, row: Row) -> None:
        self.cfg, self.row = cfg, row
        self.software = versions()

    @cached_property
    def scorer(self) -> Scorer:
        """Load the judges, the source and the corpus, and say in the folder what is scored."""
        from kinema.experiments.scoring import Scorer

        resolved = plain(self.cfg)
        resolved.pop("hydra", None)
        # Another process' configuration of this row differs in nothing that counts.
        write_text(self.row.folder.path / "config.yaml", OmegaConf.to_yaml(OmegaConf.create(resolved)))
        self.row.folder.mark("running", versions=self.software)
        missing = ", ".join(map(str, self.row.missing))
        console.print(f"evaluate  {self.row.folder.path}: replications {missing} of {self.row.replications}")
        return Scorer(self.cfg, self.row, open_corpus(self.cfg))

    def score(self, replication: int) -> None:
        """Score one replication and append its line."""
        started, folder = time.monotonic(), self.row.folder
        scorer = self.scorer
        result = scorer.replicate(replication)
        each = scorer.source.seconds()
        if replication == 0:
            scorer.save_samples(folder.path / "samples.npz", result)
        line = {
            "replication": replication,
            "metrics": result.metrics,
            "breakdowns": result.breakdowns,
            "seconds": round(time.monotonic() - started, 2),
            "provenance": {**scorer.provenance, "versions": self.software},
            **({} if each is None else {EACH: each}),
            **({"unread": names} if (names := unread(self.cfg)) else {}),
        }
        with folder.lock():
            append_line(folder.path / REPLICATIONS, line)
        shown = " ".join(f"{k} {result.metrics[k]:.3f}" for k in ("r1", "r3", "fid", "matching") if k in result.metrics)
        console.print(f"  replication {replication}: {shown} ({line['seconds']:.0f} s)")
