"""Run what `kinema train`, `kinema evaluate`, train.py and evaluate.py are asked for on the command line."""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Callable, Sequence

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from kinema.experiments.config import CONF, explain, refuse_absent_slurm, refuse_processes, register_resolvers
from kinema.experiments.refusals import refusals
from kinema.signals import Interrupted, interruptible

EXPECTED = (ValueError, OSError, ImportError)
"""What a user can mend: told in one line."""


@refusals()
def train(arguments: Sequence[str] | None = None) -> None:
    """Train, resume or return the run that the configuration names; exit 2 with one line for a user's error.

    A sweeper is given the validation loss of the weights that were kept.
    `arguments` are Hydra's (sys.argv's if left out): overrides such as stage=generator method=mardm_sit, or flags.
    """

    def stage(cfg: DictConfig) -> float | None:
        from kinema.experiments.run import run_stage  # here: --help must not pay for torch

        return run_stage(cfg, cfg.stage).status.get("val_loss")

    _run("train", stage, arguments)


@refusals()
def evaluate(arguments: Sequence[str] | None = None) -> None:
    """Append the replications of one row that are missing, one JSON line each; arguments and errors as of `train`.

    A sweeper is given the mean of the metric that `objective` names.
    """

    def row(cfg: DictConfig) -> float | None:
        from kinema.experiments.evaluation import run_evaluation

        scored = run_evaluation(cfg)
        return None if cfg.objective is None else scored.mean(cfg.objective)

    _run("evaluate", row, arguments)


def _run(config_name: str, task: Callable[[DictConfig], float | None], arguments: Sequence[str] | None) -> None:
    given, failed = sys.argv, []
    asked = given[1:] if arguments is None else list(arguments)

    def job(cfg: DictConfig) -> float | None:
        # Lightning starts the processes of further devices with what sys.argv was; Hydra read a part of it.
        sys.argv = given
        sweep = HydraConfig.get().mode == RunMode.MULTIRUN
        try:
            refuse_processes(cfg, multirun=sweep)
            from kinema.experiments.corpus import files_listed_once  # here: --help must not pay for it

            with files_listed_once():
                return task(cfg)
        except Exception as error:
            if sweep:  # it must not end the others: they are listed when all are done
                own = [o for o in HydraConfig.get().overrides.task if o not in asked]
                failed.append(f"{' '.join(own)}: {_told(error)}")
                raise
            if cfg.debug.enabled or not isinstance(error, EXPECTED):
                raise
            sys.exit(_line(error))

    register_resolvers()
    sys.argv = [given[0], *asked]
    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra raises what it would print: `explain` names the options there are
    try:
        refuse_absent_slurm(asked)
        with interruptible():
            hydra.main(config_path=str(CONF), config_name=config_name, version_base="1.3")(job)()
    except Interrupted as stop:
        if not stop.told:
            print(f"stopped   {stop}", file=sys.stderr)
        raise
    except (HydraException, OmegaConfBaseException) as error:
        sys.exit(_line(explain(error)))
    except Exception as error:  # of a job of a sweep; one that ran elsewhere isn't listed
        if not failed and not isinstance(error, EXPECTED):
            raise
        listed = [f"{len(failed)} of the sweep's jobs failed, the others are done:", *failed]
        sys.exit(_line("\n  ".join(listed) if failed else error))
    finally:
        sys.argv = given


def _line(error: object) -> str:
    """Write an error out, whatever the names in it hold."""
    from kinema.runs.console import printable  # here: --help must not pay for it

    return f"error: {printable(str(error))}"


def _told(error: Exception) -> str:
    """Tell at once why a job of a sweep failed, and return it as one line; of what nobody expects also where."""
    from kinema.runs.console import console  # here: launchers pickle what a job names

    if not isinstance(error, EXPECTED):
        traceback.print_exception(error)
    line = " ".join(str(error).split()) if isinstance(error, EXPECTED) else repr(error)
    console.print(f"[red]failed[/]    {line}")
    return line
