"""Fit a model of latents that reads text: the base of a method's generators."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig

from kinema.data.store import PackedStore
from kinema.experiments.instantiate import check_text, read_model
from kinema.experiments.stages.fitted import FittedStage
from kinema.experiments.stages.tokenizer import TokenizerStage
from kinema.pipeline.compatibility import check_pair
from kinema.runs.folder import RunFolder
from kinema.runs.parts import write_text_encoder

if TYPE_CHECKING:
    from kinema.training.modules import GeneratorModule
    from kinema.training.recipe import Recipe


class ConditionedStage(FittedStage):
    """Fit a model that reads captions by the method's text encoder, and latents by the tokenizer if it needs one."""

    reads = ("text",)

    def tokenizer(self, cfg: DictConfig) -> TokenizerStage | None:
        """Return the stage whose latents it reads: none where it needs none, or the method has none."""
        stage = TokenizerStage()
        return stage if stage.name in self.needs and stage.present(cfg) else None

    def check(self, cfg: DictConfig, store: PackedStore) -> None:
        """Check the captions, what encodes them, and that the model fits the tokenizer's latents."""
        super().check(cfg, store)
        check_text(cfg)
        tokenizer = self.tokenizer(cfg)
        if tokenizer is not None:
            check_pair(tokenizer.sketch(cfg), self.sketch(cfg))

    def module(
        self, cfg: DictConfig, model: Any, recipe: Recipe, store: PackedStore, needs: dict[str, RunFolder]
    ) -> GeneratorModule:
        """Encode the captions and the latents that its loss reads."""
        from kinema.experiments.training import generator_module

        stage = self.tokenizer(cfg)
        return generator_module(cfg, model, recipe, store, needs[stage.name] if stage is not None else None)

    def metadata(self, cfg: DictConfig, module: Any, needs: dict[str, RunFolder], folder: RunFolder) -> dict[str, Any]:
        """Name the text encoder, and the representation that the latents are of."""
        write_text_encoder(folder.path, cfg.text.name, cfg.text.path)
        found = {"text": module.text.value.identity}
        stage = self.tokenizer(cfg)
        if stage is not None:
            found["representation"] = read_model(needs[stage.name].path, stage.name).identity()
        return found
