"""Build every method and tokenizer from its config on a few synthetic clips, once per session."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest
import torch

from kinema.data.datamodule import MotionDataModule
from kinema.data.store import PackedStore
from kinema.experiments.config import compose
from kinema.experiments.corpus import open_corpus
from kinema.experiments.stages import get_stage
from kinema.runs.build import build
from kinema.text.encoders import build_text_encoder
from kinema.types import MotionBatch

SMALL = ("data=synthetic", "data.options.size=160", "scale=smoke", "text=hashed", "trainer=cpu")


class Workshop:
    """Make parts from configs; codebooks are filled by one batch, so that codes mean something."""

    def __init__(self, shelf: Path) -> None:
        self.paths = [f"paths.stores={shelf}/stores", f"paths.cache={shelf}/cache"]
        self.path = open_corpus(self.cfg())
        self.store = PackedStore.open(self.path)
        self.text = build_text_encoder("hashed")
        self.tokenizer = cache(self._tokenizer)

    def cfg(self, *overrides: str):
        return compose([*SMALL, *self.paths, *overrides])

    def windows(self, count: int = 8) -> MotionBatch:
        data = MotionDataModule(self.path, kind="windows", batch_size=count, steps=1)
        return next(iter(data.train_dataloader()))

    def clips(self, count: int = 4) -> MotionBatch:
        data = MotionDataModule(self.path, kind="clips", batch_size=count, steps=1)
        return next(data.test_batches("train", 0, seed=0, batch_size=count))

    def _tokenizer(self, *overrides: str) -> torch.nn.Module:
        model = self.make("tokenizer", *overrides)
        if self.cfg(*overrides).tokenizer.train is not None:
            model.train()
            model.loss(self.windows(), generator=torch.Generator().manual_seed(0))
        return model.eval()

    def make(self, stage: str, *overrides: str) -> torch.nn.Module:
        torch.manual_seed(0)
        spec = get_stage(stage).spec(self.cfg(*overrides))
        model = build(spec)
        model.spec = spec
        get_stage(stage).prepare(model, self.store)
        return model


@pytest.fixture(scope="session")
def workshop(shelf: Path) -> Workshop:
    """Give the maker of parts."""
    return Workshop(shelf)
