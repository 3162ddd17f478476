"""Compose and check configurations; nothing here imports torch, so that --help and a cached table are quick."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

CONF = Path(__file__).resolve().parents[3] / "conf"
SCALES = ("paper", "tiny", "smoke")
STAGES = ("tokenizer", "generator", "length", "decomposition", "matching", "contrastive")
SOURCES = ("real", "shuffled", "noise", "nearest", "reconstruction", "generation")


def register_resolvers() -> None:
    """Make ${scaled:PAPER,TINY,SMOKE} and ${corpus:HUMANML3D,KIT} known to OmegaConf."""
    OmegaConf.register_new_resolver("scaled", _scaled, replace=True)
    OmegaConf.register_new_resolver("corpus", _corpus, replace=True)


def _scaled(paper: Any, tiny: Any, smoke: Any, *, _root_: DictConfig) -> Any:
    return dict(zip(SCALES, (paper, tiny, smoke), strict=True))[_root_.scale.name]


def _corpus(humanml3d: Any, kit: Any, *, _root_: DictConfig) -> Any:
    return kit if _root_.data.skeleton == "kit" else humanml3d


def compose(overrides: list[str], config_name: str = "train") -> DictConfig:
    """Compose a configuration outside of hydra.main."""
    from hydra import compose as hydra_compose
    from hydra import initialize_config_dir

    register_resolvers()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        return hydra_compose(config_name, overrides=overrides)


def plain(node: Any) -> Any:
    """Resolve a config node to plain containers (what checkpoints may hold); a wrong value is named."""
    if not isinstance(node, DictConfig) and not OmegaConf.is_config(node):
        return node
    try:
        return OmegaConf.to_container(node, resolve=True, throw_on_missing=True)
    except OmegaConfBaseException as error:
        key = getattr(error, "full_key", None)
        raise ValueError(f"config: {str(error).splitlines()[0]}{f' (set {key})' if key else ''}") from None


def validate(cfg: DictConfig) -> None:
    """Check the choices that Hydra cannot; raises ValueError naming value, choices and fix."""
    checks = [("scale.name", cfg.scale.name, SCALES)]
    if "stage" in cfg:
        checks.append(("stage", cfg.stage, STAGES))
    if "source" in cfg:
        checks.append(("source", cfg.source, SOURCES))
    for name, value, allowed in checks:
        if value not in allowed:
            raise ValueError(f"{name}={value!r} is unknown; allowed: {', '.join(allowed)}")
    if not isinstance(cfg.seed, int) or cfg.seed < 0:
        raise ValueError(f"seed={cfg.seed!r}; it must be an integer of at least 0")


def refuse_ddp_in_multirun(cfg: DictConfig, multirun: bool) -> None:
    """Refuse what trains on half of the data without an error: `ddp` relaunches the script inside a sweep."""
    if multirun and str(cfg.trainer.strategy).startswith("ddp") and "spawn" not in str(cfg.trainer.strategy):
        raise ValueError(
            f"trainer.strategy={cfg.trainer.strategy} inside a multirun would train each process on a share of the "
            "data alone; use trainer.strategy=ddp_spawn, launcher=slurm, or one run at a time"
        )
