"""Run one stage: find it finished, resume it, or train it; upstream runs first."""

from __future__ import annotations

import json
import shlex
import time
import traceback
from pathlib import Path

from omegaconf import DictConfig, OmegaConf

from kinema.devices import global_rank
from kinema.experiments.config import plain, validate
from kinema.experiments.corpus import manifest, open_corpus, require_captions
from kinema.experiments.identity import fingerprint, stage_identity
from kinema.experiments.stages import STAGES, Stage, label
from kinema.runs.console import console
from kinema.runs.folder import RunFolder
from kinema.runs.parts import link
from kinema.runs.versions import versions

WRITE_SECONDS = 600
"""How long other ranks wait for rank 0 to write a stage's weights before the next stage reads them."""


def stage_folder(cfg: DictConfig, stage: Stage, corpus_hash: str) -> RunFolder:
    """Name the run folder that a configuration's stage has."""
    root = Path(f"{cfg.paths.runs}-debug" if cfg.debug.enabled else cfg.paths.runs)
    name = f"{label(cfg, stage)}-{fingerprint(stage_identity(cfg, stage, corpus_hash))}"
    return RunFolder(root / stage.name / name)


def command(cfg: DictConfig, stage: Stage) -> str:
    """Return the command that trains a stage of this configuration: what was asked for, with another stage."""
    from hydra.core.hydra_config import HydraConfig

    given = [f"method={cfg.method.name}", f"data={cfg.data.name}", f"scale={cfg.scale.name}", f"seed={cfg.seed}"]
    if HydraConfig.initialized():
        given = [o for o in HydraConfig.get().overrides.task if o.split("=")[0] not in ("stage", "source", "ensure")]
    return shlex.join(["kinema", "train", f"stage={stage.name}", *given])


def run_stage(cfg: DictConfig, name: str, *, quiet: bool = False) -> RunFolder:
    """Return the finished run of a stage, training what is missing.

    Raises FileNotFoundError naming the command where an upstream run is missing and `ensure` is false.
    """
    validate(cfg)
    stage = STAGES[name]
    if not stage.present(cfg):
        raise ValueError(f"method {cfg.method.name} has no stage {name}; choose a method with one, e.g. method=momask")
    store = open_corpus(cfg)
    folder = stage_folder(cfg, stage, manifest(store)["hash"])
    if folder.done:
        if not quiet:
            console.print(f"cached    {folder.path}")
        return folder
    if stage.config(cfg).train.data == "clips":
        require_captions(store, "train", "val")
    upstream = {}
    for one in (stage, *(STAGES[other] for other in stage.companions)):
        check_parts(cfg, one)
    for needed in (*stage.upstream, *stage.companions):
        if not STAGES[needed].present(cfg):
            continue
        if needed == "tokenizer" and cfg.tokenizer_run:
            upstream[needed] = given_tokenizer(cfg)
            continue
        found = stage_folder(cfg, STAGES[needed], manifest(store)["hash"])
        if not found.done and not cfg.ensure:
            raise FileNotFoundError(
                f"stage {name} needs the {needed} run {found.path}, which isn't finished; train it with "
                f"`{command(cfg, STAGES[needed])}` or set ensure=true"
            )
        upstream[needed] = run_stage(cfg, needed, quiet=True)
    if global_rank() > 0:
        return _follow(cfg, stage, store, folder, upstream)
    with folder.lock():
        if folder.done:
            console.print(f"cached    {folder.path}")
            return folder
        _train(cfg, stage, store, folder, upstream)
    return folder


def given_tokenizer(cfg: DictConfig) -> RunFolder:
    """Return the run that `tokenizer_run=` names (trained elsewhere, or imported)."""
    run = RunFolder(Path(cfg.tokenizer_run).resolve())
    if not run.weights.exists():
        raise FileNotFoundError(
            f"tokenizer_run={cfg.tokenizer_run} holds no {run.weights.name}; give the folder of a finished or imported "
            "tokenizer"
        )
    return run


def check_parts(cfg: DictConfig, stage: Stage) -> None:
    """Check that a stage's model fits the tokenizer it will read, before either is trained."""
    if "tokenizer" not in stage.upstream or not stage.present(cfg):
        return
    import torch
    from torch import nn

    from kinema.experiments.instantiate import model_spec, read_model
    from kinema.pipeline.compatibility import check_pair
    from kinema.runs.build import build

    def build_meta(cfg: DictConfig, name: str) -> nn.Module:
        with torch.device("meta"):
            return build(model_spec(cfg, STAGES[name]))

    model = build_meta(cfg, stage.name)
    if not cfg.tokenizer_run:
        tokenizer = build_meta(cfg, "tokenizer")
    else:
        tokenizer, _ = read_model(given_tokenizer(cfg).path)
        own = tokenizer.representation
        if own.kind != cfg.representation.kind or own.skeleton_name != cfg.data.skeleton:
            raise ValueError(
                f"tokenizer_run={cfg.tokenizer_run} was trained on {own.kind} dims of {own.skeleton_name}, this "
                f"configuration asks for representation={cfg.representation.kind} of {cfg.data.skeleton}; choose one"
            )
    check_pair(tokenizer, model)
    if stage.name == "residual":
        build_meta(cfg, "generator").attach(stage.name, model)


def _follow(cfg: DictConfig, stage: Stage, store: Path, folder: RunFolder, upstream: dict[str, RunFolder]) -> RunFolder:
    """Train along on another rank: rank 0 holds the lock and writes everything."""
    from kinema.experiments.training import train_stage

    if not folder.done:
        train_stage(cfg, stage, store, folder, upstream)
    for _ in range(WRITE_SECONDS * 10):
        if folder.done:
            return folder
        time.sleep(0.1)
    raise TimeoutError(f"rank 0 has not written {folder.weights} within {WRITE_SECONDS} s; see its own output")


def _train(cfg: DictConfig, stage: Stage, store: Path, folder: RunFolder, upstream: dict[str, RunFolder]) -> None:
    from kinema.experiments.training import train_stage

    resumed = (folder.path / "checkpoints" / "last.ckpt").exists()
    console.print(f"{'resume' if resumed else 'train ':<9} {folder.path}")
    left_out = len(json.loads((store / "dropped.json").read_text()))
    if left_out:
        console.print(f"[yellow]note[/]      {left_out} clips were left out of the corpus: {store / 'dropped.json'}")
    resolved = plain(cfg)
    resolved.pop("hydra", None)
    OmegaConf.save(OmegaConf.create(resolved), folder.path / "config.yaml")
    link(folder.path, {name: run.path for name, run in upstream.items()})
    folder.mark("running", versions=versions())
    try:
        result = train_stage(cfg, stage, store, folder, upstream)
    except BaseException as error:
        folder.mark("failed", error="".join(traceback.format_exception_only(error)).strip())
        raise
    folder.mark("done", **result)
    (folder.path / "checkpoints" / "last.ckpt").unlink(missing_ok=True)
    console.print(f"done      {folder.path} in {result['seconds']:.0f} s")
