"""Fit one stage of one method or evaluator: `python train.py stage=generator method=mardm_sit data=open_mocap`."""

from __future__ import annotations

import sys

import hydra
from omegaconf import DictConfig

from kinema.experiments.config import refuse_processes, register_resolvers

register_resolvers()


@hydra.main(config_path="conf", config_name="train", version_base="1.3")
def main(cfg: DictConfig) -> None:
    """Train, resume or return the run that the configuration names."""
    # Imported here: --help must not pay for torch.
    from kinema.experiments.run import run_stage

    try:
        refuse_processes(cfg, multirun=hydra.core.hydra_config.HydraConfig.get().mode.name == "MULTIRUN")
        run_stage(cfg, cfg.stage)
    except (ValueError, OSError, ImportError) as error:
        if cfg.debug.enabled:
            raise
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
