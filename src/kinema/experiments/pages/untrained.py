"""Build methods as training would begin with them: what depends on their size alone is measured of those."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from omegaconf import DictConfig

from kinema.data.store import PackedStore
from kinema.experiments.instantiate import machine_of, read_model
from kinema.experiments.run import run_stage
from kinema.experiments.stages import get_stage
from kinema.experiments.stages.fitted import FittedStage
from kinema.experiments.stages.generator import GeneratorStage
from kinema.experiments.stages.tokenizer import TokenizerStage
from kinema.experiments.training import initial_model
from kinema.pipeline import TextToMotion
from kinema.text.encoders import build_text_encoder
from kinema.tokenizers import MotionTokenizer
from kinema.types import Latents, MotionBatch


def untrained(cfg: DictConfig, store: PackedStore, motions: MotionBatch) -> TextToMotion:
    """Build a method as training would begin with it: what it takes does not depend on its weights, but on lengths.

    What it keeps of its training latents (their range) it keeps of those of `motions`.
    """
    tokenizer, generator = (_part(stage.name, cfg, store) for stage in (TokenizerStage, GeneratorStage))
    tokenizer.eval()
    generator.prepare(tokenizer, EncodedMotions(tokenizer, motions))
    parts = {name: _part(name, cfg, store) for name in generator.parts if get_stage(name).present(cfg)}
    device = machine_of(cfg).device()
    encoder = build_text_encoder(cfg.text.name, path=cfg.text.path, device=device)  # a cache would hide what it takes
    return TextToMotion(tokenizer, generator, encoder, parts).to(device)


@dataclass(frozen=True)
class EncodedMotions:
    """Be the latents of some motions where a model asks for those of its training."""

    tokenizer: MotionTokenizer
    motions: MotionBatch

    def __call__(
        self, batch: MotionBatch, generator: torch.Generator | None = None, shard: tuple[int, int] = (0, 1)
    ) -> Latents:
        """Encode a batch."""
        return self.tokenizer.encode(batch)

    @torch.no_grad()
    def range(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Return minimum and maximum of each channel."""
        latents = self(self.motions)
        return latents.content[latents.mask].aminmax(dim=0)


def _part(name: str, cfg: DictConfig, store: PackedStore) -> Any:
    stage = get_stage(name)
    if isinstance(stage, FittedStage):
        return initial_model(stage, cfg, store)[0]
    return read_model(run_stage(cfg, name, quiet=True).path, name)  # a database, which is built and not trained
