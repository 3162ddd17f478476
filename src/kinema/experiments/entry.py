"""Run what `kinema train`, `kinema evaluate`, train.py and evaluate.py are asked for on the command line."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from kinema.experiments.config import CONF, explain, refuse_processes, register_resolvers


def train(arguments: Sequence[str] | None = None) -> None:
    """Train, resume or return the run that the configuration names; exit 1 with one line for a user's error.

    `arguments` are Hydra's (sys.argv's if left out): overrides such as stage=generator method=mardm_sit, or flags.
    """

    def stage(cfg: DictConfig) -> None:
        from kinema.experiments.run import run_stage  # here: --help must not pay for torch

        run_stage(cfg, cfg.stage)

    _run("train", stage, arguments)


def evaluate(arguments: Sequence[str] | None = None) -> None:
    """Append the replications of one row that are missing, one JSON line each; arguments and errors as of `train`."""

    def row(cfg: DictConfig) -> None:
        from kinema.experiments.evaluation import run_evaluation

        run_evaluation(cfg)

    _run("evaluate", row, arguments)


def _run(config_name: str, task: Callable[[DictConfig], None], arguments: Sequence[str] | None) -> None:
    given = sys.argv

    def job(cfg: DictConfig) -> None:
        # Lightning starts the processes of further devices with what sys.argv was; Hydra read a part of it.
        sys.argv = given
        try:
            refuse_processes(cfg, multirun=HydraConfig.get().mode == RunMode.MULTIRUN)
            task(cfg)
        except (ValueError, OSError, ImportError) as error:
            if cfg.debug.enabled:
                raise
            sys.exit(f"error: {error}")

    register_resolvers()
    if arguments is not None:
        sys.argv = [given[0], *arguments]
    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra raises what it would print: `explain` names the options there are
    try:
        hydra.main(config_path=str(CONF), config_name=config_name, version_base="1.3")(job)()
    except (HydraException, OmegaConfBaseException) as error:
        sys.exit(f"error: {explain(error)}")
    finally:
        sys.argv = given
