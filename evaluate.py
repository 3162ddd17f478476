"""Score one row of a table: `python evaluate.py source=generation method=mardm_sit data=open_mocap`."""

from __future__ import annotations

import sys

import hydra
from omegaconf import DictConfig

from kinema.experiments.config import refuse_processes, register_resolvers

register_resolvers()


@hydra.main(config_path="conf", config_name="evaluate", version_base="1.3")
def main(cfg: DictConfig) -> None:
    """Append the replications that are missing; one replication is one JSON line."""
    # Imported here: --help must not pay for torch.
    from kinema.experiments.evaluation import run_evaluation

    try:
        refuse_processes(cfg, multirun=hydra.core.hydra_config.HydraConfig.get().mode.name == "MULTIRUN")
        run_evaluation(cfg)
    except (ValueError, OSError, ImportError) as error:
        if cfg.debug.enabled:
            raise
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
