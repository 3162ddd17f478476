"""Run one stage: find it finished, resume it, or make it; upstream runs first."""

from __future__ import annotations

import shlex
import time
import traceback
from dataclasses import asdict
from itertools import count
from pathlib import Path

from omegaconf import DictConfig, OmegaConf

from kinema.atomic import write_text
from kinema.data.store import PackedStore
from kinema.devices import global_rank
from kinema.experiments.config import plain, validate
from kinema.experiments.dashboards import show_run
from kinema.experiments.identity import Corpora, corpora, fingerprint, stage_identity
from kinema.experiments.stages import companions_of, get_stage, needs_of
from kinema.experiments.stages.base import Stage, given_run
from kinema.runs.console import console
from kinema.runs.folder import RunFolder
from kinema.runs.parts import link
from kinema.runs.versions import versions

WRITE_SECONDS = 600
"""How long other ranks wait for rank 0 to write a stage's weights before the next stage reads them."""


def stage_folder(cfg: DictConfig, stage: Stage, corpus_of: Corpora | None = None) -> RunFolder:
    """Name the run folder that a configuration's stage has; raises ValueError if it has no such stage."""
    if not stage.present(cfg):
        raise ValueError(f"method {cfg.method.name} has no stage {stage.name}; choose a method= that has one")
    digest = fingerprint(stage_identity(cfg, stage, corpus_of or corpora(cfg)))
    return run_folder(cfg, stage.name, stage.label(cfg), stage.split(cfg), stage.seed(cfg), digest)


def run_folder(cfg: DictConfig, kind: str, label: str, split: str | None, seed: int, digest: str) -> RunFolder:
    """Name a run's folder by what it is for; one that ends in the same fingerprint is the same run, however named."""
    folder = Path(f"{cfg.paths.runs}-debug" if cfg.debug.enabled else cfg.paths.runs) / kind
    there = sorted(folder.glob(f"*-{digest}"))
    words = [label, cfg.data.name, *([split] if split else []), cfg.scale.name]
    words += [*(["debug"] if cfg.debug.enabled else []), f"s{seed}", digest]
    return RunFolder(there[0] if there else folder / "-".join(words))


def command(cfg: DictConfig, stage: Stage) -> str:
    """Return the command that makes a stage of this configuration: what was asked for, with another stage."""
    from hydra.core.hydra_config import HydraConfig

    given = [f"method={cfg.method.name}", f"data={cfg.data.name}", f"scale={cfg.scale.name}", f"seed={cfg.seed}"]
    if HydraConfig.initialized():
        given = [o for o in HydraConfig.get().overrides.task if o.split("=")[0] not in ("stage", "source", "ensure")]
    return shlex.join(["kinema", "train", f"stage={stage.name}", *given])


def run_stage(cfg: DictConfig, name: str, *, quiet: bool = False) -> RunFolder:
    """Return the finished run of a stage, making what is missing.

    Raises FileNotFoundError naming the command where an upstream run is missing and `ensure` is false.
    """
    validate(cfg)
    stage = get_stage(name)
    folder = stage_folder(cfg, stage)
    if folder.done:
        if not quiet:
            console.print(f"cached    {folder.path}")
            show_run(cfg, folder, name)
        return folder
    check(cfg, stage)
    companions = [other for other in companions_of(stage) if other.present(cfg)]
    needs = {other.name: _made(cfg, other, stage) for other in needs_of(stage) if other.present(cfg)}
    beside = {other.name: _made(cfg, other, stage) for other in companions}
    for other in stage.watched_by(cfg):
        _own(cfg, other, stage)
    store = stage.corpus(cfg)
    if global_rank() > 0:
        return _follow(cfg, stage, store, folder, needs)
    with folder.lock():
        if RunFolder(folder.path).done:  # another process made it meanwhile
            console.print(f"cached    {folder.path}")
            return folder
        _make(cfg, stage, store, folder, needs, beside)
    return folder


def check(cfg: DictConfig, stage: Stage) -> None:
    """Raise ValueError if a stage, or one that will be made for it, doesn't fit, before any of them is made."""
    for other in (*needs_of(stage), *companions_of(stage), *stage.watched_by(cfg)):
        if other.present(cfg) and given_run(cfg, other) is None and not stage_folder(cfg, other).done:
            check(cfg, other)
    stage.check(cfg, stage.corpus(cfg))


def _made(cfg: DictConfig, needed: Stage, user: Stage) -> RunFolder:
    """Return the run that a stage needs; make it, unless `ensure` forbids it."""
    given = given_run(cfg, needed)
    return _own(cfg, needed, user) if given is None else given


def _own(cfg: DictConfig, needed: Stage, user: Stage) -> RunFolder:
    """Return the run that the configuration itself describes."""
    found = stage_folder(cfg, needed)
    if not found.done and not cfg.ensure:
        raise FileNotFoundError(
            f"stage {user.name} needs the {needed.name} run {found.path}, which isn't finished; train it with "
            f"`{command(cfg, needed)}` or set ensure=true"
        )
    return run_stage(cfg, needed.name, quiet=True)


def _follow(
    cfg: DictConfig, stage: Stage, store: PackedStore, folder: RunFolder, needs: dict[str, RunFolder]
) -> RunFolder:
    """Make the run along on another rank, or wait for it: rank 0 holds the lock and writes everything."""
    if stage.on_all_ranks and not folder.done:
        stage.make(cfg, store, needs, folder)
    for _ in range(WRITE_SECONDS * 10) if stage.on_all_ranks else count():
        if folder.done:
            return folder
        time.sleep(0.1)
    raise TimeoutError(f"rank 0 has not written {folder.weights} within {WRITE_SECONDS} s; see its own output")


def _make(
    cfg: DictConfig,
    stage: Stage,
    store: PackedStore,
    folder: RunFolder,
    needs: dict[str, RunFolder],
    beside: dict[str, RunFolder],
) -> None:
    resumed = (folder.path / "checkpoints" / "last.ckpt").exists()
    console.print(f"{'resume' if resumed else 'train ':<9} {folder.path}")
    if store.dropped:
        left_out = f"{len(store.dropped)} clips were left out of the corpus: {store.path / 'dropped.json'}"
        console.print(f"[yellow]note[/]      {left_out}")
    resolved = plain(cfg)
    resolved.pop("hydra", None)
    write_text(folder.path / "config.yaml", OmegaConf.to_yaml(OmegaConf.create(resolved)))
    link(folder.path, {name: run.path for name, run in (needs | beside).items()})
    folder.mark("running", versions=versions())
    try:
        result = stage.make(cfg, store, needs, folder)
    except BaseException as error:
        folder.mark("failed", error="".join(traceback.format_exception_only(error)).strip())
        raise
    folder.mark("done", **asdict(result))
    (folder.path / "checkpoints" / "last.ckpt").unlink(missing_ok=True)
    console.print(f"done      {folder.path} in {result.seconds:.0f} s")
