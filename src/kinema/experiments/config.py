"""Compose and check configurations; nothing here imports torch, so that --help and a cached table are quick."""

from __future__ import annotations

import copy
import functools
import os
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Any, cast

import yaml
from hydra.errors import HydraException, MissingConfigException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import InterpolationKeyError, OmegaConfBaseException

from kinema.files.json import Kind, fault
from kinema.files.kinds import refuse
from kinema.files.yaml import read_yaml


def find_conf(package: Path) -> Path:
    """Return the folder of the configurations: inside an installed package, beside src/ in a checkout."""
    return package / "conf" if (package / "conf").is_dir() else package.parents[1] / "conf"


CONF = find_conf(Path(__file__).resolve().parents[1])
# Names that others own, written here so that a configuration is read without loading torch: test_compose.py compares.
TASKS, LENGTHS = ("generation", "editing", "control"), ("real", "predicted")
PERTURBATIONS, SPACES = ("add", "replace"), ("evaluator", "corpus")
DENSITIES = ("one", "two", "five", "quarter", "all", "mixed")
EDITS = ("inbetween", "outpaint", "prefix", "suffix")
ORACLES = ("action", "style")


def register_resolvers() -> None:
    """Make ${corpus:HUMANML3D,KIT} known to OmegaConf."""
    OmegaConf.register_new_resolver("corpus", _corpus, replace=True)
    OmegaConf.register_new_resolver("product", lambda a, b: a * b, replace=True)


def _corpus(humanml3d: Any, kit: Any, *, _root_: DictConfig) -> Any:
    return kit if _root_.data.skeleton == "kit" else humanml3d


def read_config(run: Path, kind: Kind = dict) -> DictConfig:
    """Read the configuration that a run was made with; raises FileNotFoundError, or ValueError if it is no such."""
    path, fix = run / "config.yaml", "train the run again"
    text = read_yaml(path, fix=fix)
    if "${" in text:
        raise refuse(path, "refers to other values (${...}), and a run's holds plain ones", fix)
    try:
        cfg = OmegaConf.create(text)
    except (OmegaConfBaseException, yaml.YAMLError, ValueError, TypeError) as error:
        raise refuse(path, f"is damaged ({error})", fix) from None
    if wrong := fault(plain(cfg), kind):
        raise refuse(path, wrong, fix)
    return cast(DictConfig, cfg)


def compose(overrides: list[str], config_name: str = "train") -> DictConfig:
    """Compose a configuration outside of hydra.main; raises ValueError naming a wrong override and what is allowed.

    The same overrides are composed once in a process: a table asks for a row's before and after it is run.
    """
    if any("searchpath" in override for override in overrides):  # files of somebody else's, which may change
        return _compose(tuple(overrides), config_name)
    return copy.deepcopy(_composed(tuple(overrides), config_name))


def _compose(overrides: tuple[str, ...], config_name: str) -> DictConfig:
    from hydra import compose as hydra_compose
    from hydra import initialize_config_dir

    register_resolvers()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        try:
            cfg = hydra_compose(config_name, overrides=list(overrides))
        except HydraException as error:
            raise ValueError(explain(error)) from None
    return cfg


_composed = functools.lru_cache(maxsize=512)(_compose)


def explain(error: Exception) -> str:
    """Say what is wrong with an override or a value: of an option that isn't there, name those that are."""
    if isinstance(error, OmegaConfBaseException):
        key, hint = error.full_key, ""
        if isinstance(error, InterpolationKeyError):
            reader = f"{key} reads it: " if key else ""
            hint = f" ({reader}parts of different methods? choose the method=... that these parts belong to)"
        elif key == "generator.sampling.solver":  # sampling/fast.yaml leaves it to a file of the method
            methods = ", ".join(sorted(path.stem for path in (CONF / "sampling/fast").glob("*.yaml")))
            return f"sampling=fast has no sampler for this method, only for {methods}; leave it out"
        elif key:
            hint = f" (set {key})"
        return f"config: {str(error).splitlines()[0]}{hint}"
    if isinstance(error, MissingConfigException) and error.options:
        group, _, option = str(error.missing_cfg_file).rpartition("/")
        return f"{group}={option} is no option; {group} has {', '.join(error.options)}"
    cause = error.__cause__
    if not isinstance(cause, OmegaConfBaseException) or not isinstance(cause.parent_node, DictConfig):
        return str(error)
    key, _, _ = str(cause.full_key).rpartition(".")
    options = ", ".join(sorted(str(k) for k in cause.parent_node if k != "hydra")) or "no options"
    return f"{cause.full_key} is no option; {key or 'the configuration'} has {options}"


def plain(node: Any) -> Any:
    """Resolve a config node to plain containers (what checkpoints may hold); a wrong value is named."""
    if not isinstance(node, DictConfig) and not OmegaConf.is_config(node):
        return node
    try:
        return OmegaConf.to_container(node, resolve=True, throw_on_missing=True)
    except OmegaConfBaseException as error:
        raise ValueError(explain(error)) from None


def validate(cfg: DictConfig) -> None:
    """Check the choices that Hydra cannot; raises ValueError naming value, choices and fix."""
    from kinema.experiments.groups import check_groups  # here: composing alone needs no torch
    from kinema.experiments.sources import source_of

    check_groups(cfg)
    if "source" in cfg:
        source_of(cfg).check_options(cfg)
        _check_scoring(cfg)


def _check_scoring(cfg: DictConfig) -> None:
    count, asked = cfg.scale.protocol.replications, plain(cfg.replications)
    if asked is not None and max(asked) >= count:
        raise ValueError(
            f"replications={asked!r}; it must be null or a list of some of 0 ... {count - 1} "
            "(scale.protocol.replications says how many there are)"
        )
    if cfg.objective is not None and cfg.scale.protocol.split != "val":
        raise ValueError(
            f"objective={cfg.objective} with scale.protocol.split={cfg.scale.protocol.split}; only val selects: set "
            "scale.protocol.split=val"
        )


def refuse_absent_slurm(words: Iterable[str]) -> None:
    """Raise FileNotFoundError where overrides choose Slurm on a machine that hasn't got it."""
    if {"launcher=slurm", "hydra/launcher=submitit_slurm"} & set(words) and shutil.which("srun") is None:
        raise FileNotFoundError(
            "launcher=slurm: there is no srun here; start it on a machine of the cluster, or choose "
            "launcher=submitit_local, joblib or local"
        )


def refuse_processes(cfg: DictConfig, multirun: bool) -> None:
    """Refuse what would train wrongly without an error, or lose what it trained.

    In a sweep, the processes that several devices need take the sweep's arguments and train each on a share of the
    data; processes that are spawned keep the selected weights to themselves.
    """
    if "spawn" in str(cfg.trainer.strategy) or "fork" in str(cfg.trainer.strategy):
        raise ValueError(
            f"trainer.strategy={cfg.trainer.strategy} leaves the selected weights in its processes; "
            "use trainer.strategy=ddp"
        )
    devices = cfg.trainer.devices
    alone = devices in (1, "1") or (OmegaConf.is_list(devices) and len(devices) == 1)
    if multirun and (not alone or cfg.trainer.num_nodes > 1 or str(cfg.trainer.strategy).startswith("ddp")):
        raise ValueError(
            f"trainer.devices={devices} with trainer.strategy={cfg.trainer.strategy} inside a multirun would train "
            "each process on a share of the data alone; use trainer.devices=1 trainer.strategy=auto (and "
            "launcher=slurm or joblib for many runs at once), or one run at a time"
        )
    if cfg.trainer.num_nodes > 1 and not {"RANK", "SLURM_PROCID"} & set(os.environ):
        raise ValueError(
            f"trainer.num_nodes={cfg.trainer.num_nodes}: nothing tells this process which of them it is (RANK or "
            "SLURM_PROCID); start it by torchrun on every node, or by srun"
        )
