"""Serve a packed corpus to Lightning: the one data module of every stage."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import cached_property
from pathlib import Path
from typing import Literal

import lightning as L
import numpy as np
from torch.utils.data import DataLoader

from kinema.data.collate import collate
from kinema.data.datasets import ClipDataset, Item, WindowDataset
from kinema.data.sampler import LEFTOVERS, StepSampler
from kinema.data.store import PackedStore
from kinema.seeds import item_seed, stream
from kinema.types import MotionBatch

KINDS = ("windows", "clips")
VALIDATION_SEED = 0
"""Not the run's seed: runs are compared on the same crops and captions."""


class MotionDataModule(L.LightningDataModule):
    """Serve windows (tokenizers) or captioned clips (generators, evaluators) as batches of de-normalised features.

    `dims` are the columns that are read: "essential" is a view of a quarter of the bytes, "redundant" all. Statistics
    are the models'.

    Training is counted in steps: the training loader has `steps` batches of `batch_size` (all ranks together), a pure
    function of `seed`, and goes on where the trainer stands; a split of fewer items is one batch. Train with
    `Trainer(max_steps=steps, ...)`, and under DDP with `use_distributed_sampler=False`, since ranks take their share
    here. `val_limit` bounds the validation items (spread evenly). `legacy_windows` is the published item space of
    windows.
    """

    def __init__(
        self,
        store: str | Path,
        *,
        kind: str,
        batch_size: int,
        steps: int,
        window: int = 64,
        seed: int = 0,
        num_workers: int = 0,
        val_batch_size: int | None = None,
        val_limit: int | None = None,
        legacy_windows: bool = False,
        dims: str = "redundant",
        start_method: Literal["fork", "spawn", "forkserver"] | None = None,
    ) -> None:
        super().__init__()
        if kind not in KINDS:
            raise ValueError(f"unknown kind {kind!r} of data; choose one of {', '.join(KINDS)}")
        self.path, self.kind, self.batch_size, self.steps = Path(store), kind, batch_size, steps
        self.window, self.seed, self.legacy_windows = window, seed, legacy_windows
        self.dims, self.num_workers, self.start_method = dims, num_workers, start_method
        self.val_batch_size, self.val_limit = val_batch_size or batch_size, val_limit

    @cached_property
    def store(self) -> PackedStore:
        """The packed corpus, opened on first use."""
        return PackedStore.open(self.path)

    def dataset(self, split: str) -> WindowDataset | ClipDataset:
        """Return the items of a split, of this module's kind."""
        if self.kind == "windows":
            return WindowDataset(self.store, split, self.window, legacy=self.legacy_windows, dims=self.dims)
        return ClipDataset(self.store, split, dims=self.dims)

    def setup(self, stage: str | None = None) -> None:
        """Check the corpus before the first batch, so that a wrong one fails at once."""
        if stage in (None, "fit"):
            self.dataset("train")

    def train_dataloader(self) -> DataLoader[Item]:
        """Return the training batches from the trainer's current step on."""
        dataset, rank, world, start = self.dataset("train"), 0, 1, 0
        if self.trainer is not None:
            rank, world = self.trainer.global_rank, self.trainer.world_size
            start = self.trainer.global_step * self.trainer.accumulate_grad_batches
            _refuse_second_sharding(self.trainer)
        size = self.filled(world)
        sampler = StepSampler(len(dataset), size, self.seed, self.steps, start, rank, world)
        return self._loader(dataset, sampler)

    def filled(self, world: int = 1) -> int:
        """Return the batch size in use: the one asked for, or of fewer items all (what ranks can share evenly)."""
        items = len(self.dataset("train"))
        return self.batch_size if items >= self.batch_size else max(1, items // world) * world

    def val_dataloader(self) -> DataLoader[Item]:
        """Return the validation batches: the same items, crops and captions every time.

        Every rank validates all of them, so that the loss which selects weights does not depend on the number of ranks
        (contrastive losses depend on what shares a batch).
        """
        dataset = self.dataset("val")
        count = len(dataset) if self.val_limit is None else min(self.val_limit, len(dataset))
        chosen = np.linspace(0, len(dataset) - 1, count).round().astype(int).tolist()
        items = [(index, item_seed(VALIDATION_SEED, 0, index)) for index in chosen]
        batches = [items[i : i + self.val_batch_size] for i in range(0, count, self.val_batch_size)]
        if len(batches) > 1 and len(batches[-1]) == 1:  # a contrastive loss is of two at least
            alone = batches.pop()
            batches[-1].extend(alone)
        return self._loader(dataset, batches)

    def test_batches(
        self,
        split: str,
        replication: int,
        seed: int,
        batch_size: int = 32,
        leftover: str = "drop",
    ) -> Iterator[MotionBatch]:
        """Yield one replication of the test protocol: entries shuffled, one caption and one crop each.

        `leftover` names what becomes of the last, smaller batch: "drop" leaves it out of all metrics (T2M), "keep" and
        "mld" yield it; with "mld" the pools of R-precision are the full batches only (METRICS, loader policy).
        """
        if leftover not in LEFTOVERS:
            raise ValueError(f"unknown leftover {leftover!r}; choose one of {', '.join(LEFTOVERS)}")
        dataset = ClipDataset(self.store, split, dims=self.dims)
        if leftover == "drop" and len(dataset) < batch_size:
            raise ValueError(
                f"split {split!r} of {self.store.name!r} has {len(dataset)} entries, fewer than one batch of "
                f"{batch_size}; pass leftover='keep'"
            )
        order = stream(seed, replication).permutation(len(dataset)).tolist()
        stop = len(order) - len(order) % batch_size if leftover == "drop" else len(order)
        for first in range(0, stop, batch_size):
            chosen = order[first : min(first + batch_size, stop)]
            yield collate([dataset[index, item_seed(seed, replication, index)] for index in chosen])

    def _loader(
        self, dataset: WindowDataset | ClipDataset, batches: Iterable[list[tuple[int, int]]]
    ) -> DataLoader[Item]:
        context = self.start_method if self.num_workers else None
        return DataLoader(
            dataset,
            batch_sampler=batches,
            collate_fn=collate,
            num_workers=self.num_workers,
            multiprocessing_context=context,
        )


def _refuse_second_sharding(trainer: L.Trainer) -> None:
    """Refuse a trainer that would shard the batches again: each rank would then train on a part of its part."""
    if trainer.world_size > 1 and trainer._accelerator_connector.use_distributed_sampler:
        raise ValueError("the data module shares out batches itself; pass use_distributed_sampler=False to the Trainer")
