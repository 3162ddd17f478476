"""Fit (or take from elsewhere) what turns motion into latents and back."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from omegaconf import DictConfig

from kinema.data.store import PackedStore
from kinema.experiments.instantiate import read_model
from kinema.experiments.stages.base import asked_for, dims, given_run
from kinema.experiments.stages.fitted import FittedStage
from kinema.runs.folder import RunFolder

if TYPE_CHECKING:
    from kinema.training.observers import Observer
    from kinema.training.record import Record


class TokenizerStage(FittedStage):
    """Fit a tokenizer; one that needs no training has a model and no recipe."""

    name = "tokenizer"
    node = "tokenizer"

    def label(self, cfg: DictConfig) -> str:
        """Name the tokenizer and its dims."""
        return f"{cfg.tokenizer.name}-{dims(cfg)}"

    def given(self, cfg: DictConfig) -> Path | None:
        """Return the run that `tokenizer_run=` names, or the one of the run that `run=` names (it may be that one)."""
        run = asked_for(cfg)
        return asked_for(cfg, "tokenizer_run") if run is None else super().given(cfg) or run

    def sketch(self, cfg: DictConfig) -> Any:
        """Build it without memory, or read the given one and hold it to the configuration's representation."""
        run = given_run(cfg, self)
        if run is None:
            return super().sketch(cfg)
        tokenizer = read_model(run.path, self.name)
        own = tokenizer.representation
        if own.kind != cfg.representation.kind or own.skeleton_name != cfg.data.skeleton:
            raise ValueError(
                f"tokenizer_run={cfg.tokenizer_run} was trained on {own.kind} dims of {own.skeleton_name}, this "
                f"configuration asks for representation={cfg.representation.kind} of {cfg.data.skeleton}; choose one"
            )
        return tokenizer

    def prepare(self, model: Any, store: PackedStore) -> None:
        """Give it the statistics, and the training clips to take more from."""
        super().prepare(model, store)
        model.prepare(_training_clips(store))

    def finish(self, model: Any, store: PackedStore) -> None:
        """Give it the training clips again."""
        model.finish(_training_clips(store))

    def callbacks(
        self, cfg: DictConfig, module: Any, store: PackedStore, needs: dict[str, RunFolder], record: Record
    ) -> list[Observer]:
        """Draw reconstructions beside the real motion, and count the codes in use, every few steps."""
        if not cfg.callbacks.samples_every:
            return []
        from kinema.experiments.previews import Reconstructions
        from kinema.training.observers import Samples

        return [Samples(cfg.callbacks.samples_every, record, Reconstructions(cfg, store, record))]


def _training_clips(store: PackedStore) -> Iterator[np.ndarray]:
    return (store.clip_frames(int(clip)) for clip in store.split_clips("train"))
