"""Say what the stages are: where each one's model and recipe stand in the config, and what it needs trained before."""

from __future__ import annotations

from dataclasses import dataclass

from omegaconf import DictConfig, OmegaConf


@dataclass(frozen=True)
class Stage:
    """Describe one stage: `node` is its config (model, train), `upstream` the stages whose runs it reads.

    `companions` are stages that a user of the run wants beside it, without influence on its weights; a stage whose
    model is null is none of the method's.
    """

    name: str
    node: str
    upstream: tuple[str, ...] = ()
    reads: tuple[str, ...] = ()
    owner: str = "method"
    companions: tuple[str, ...] = ()

    def config(self, cfg: DictConfig) -> DictConfig:
        """Return the stage's own part of the configuration."""
        return OmegaConf.select(cfg, self.node)

    def present(self, cfg: DictConfig) -> bool:
        """Say whether the configuration has this stage."""
        return self.config(cfg).model is not None


WORDS = ("evaluator.words", "evaluator.words_path")
TOKENS = ("evaluator.tokens", "evaluator.tokens_path")

STAGES: dict[str, Stage] = {
    s.name: s
    for s in (
        Stage("tokenizer", "tokenizer"),
        Stage("generator", "generator", ("tokenizer",), ("text",), companions=("length", "residual")),
        Stage("residual", "residual", ("tokenizer",), ("text",), "residual"),
        Stage("length", "length", (), ("text",), "data"),
        Stage("decomposition", "evaluator.decomposition", (), (), "evaluator"),
        Stage(
            "matching",
            "evaluator.matching",
            ("decomposition",),
            ("evaluator.words", "evaluator.words_path"),
            "evaluator",
        ),
        Stage("contrastive", "evaluator.contrastive", (), ("evaluator.tokens", "evaluator.tokens_path"), "evaluator"),
    )
}


def label(cfg: DictConfig, stage: Stage) -> str:
    """Name the run's folder before its fingerprint: <method>-<representation>-s<seed>."""
    who = {
        "method": cfg.tokenizer.name if stage.name == "tokenizer" else cfg.method.get("family", cfg.method.name),
        "residual": f"{cfg.residual.name}_residual",
        "evaluator": f"evaluator_{cfg.evaluator.name}",
        "data": "length",
    }[stage.owner]
    representation = cfg.evaluator.representation if stage.owner == "evaluator" else cfg.representation.kind
    return f"{who}-{representation}-s{cfg.seed}"
