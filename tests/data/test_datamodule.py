from __future__ import annotations

import json

import lightning as L
import numpy as np
import pytest
import torch
from torch import nn

from kinema.data.datamodule import MotionDataModule
from kinema.data.prepare import prepare_store


def module(store, **changes):
    return MotionDataModule(store.path, **{"kind": "clips", "batch_size": 8, "steps": 6, **changes})


def same(one, two):
    return torch.equal(one.features, two.features) and one.captions == two.captions and one.clip_ids == two.clip_ids


class Recorder(L.LightningModule):
    """Note what every step saw."""

    def __init__(self):
        super().__init__()
        self.weight, self.seen = nn.Parameter(torch.zeros(())), []

    def training_step(self, batch, index):
        self.seen.append((batch.entries.tolist(), batch.starts.tolist()))
        return self.weight * batch.features.mean()

    def configure_optimizers(self):
        return torch.optim.SGD(self.parameters(), lr=0.1)


def fit(model, data, steps, folder, resume=None):
    trainer = L.Trainer(
        max_steps=steps, logger=False, enable_checkpointing=False, enable_progress_bar=False, accelerator="cpu",
        enable_model_summary=False,
    )  # fmt: skip
    trainer.fit(model, data, ckpt_path=resume)
    trainer.save_checkpoint(folder / f"{steps}.ckpt")
    return folder / f"{steps}.ckpt"


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", ["windows", "clips"])
def test_a_resumed_run_sees_what_an_unbroken_one_sees(store, tmp_path, kind):
    whole, first, second = Recorder(), Recorder(), Recorder()
    fit(whole, module(store, kind=kind), 6, tmp_path)
    resume = fit(first, module(store, kind=kind), 4, tmp_path)
    fit(second, module(store, kind=kind), 6, tmp_path, resume)
    assert len(whole.seen) == 6
    assert first.seen + second.seen == whole.seen


def test_windows_have_exactly_the_window(store):
    batch = next(iter(module(store, kind="windows", window=48).train_dataloader()))
    assert batch.features.shape == (8, 48, 263)
    assert batch.lengths.tolist() == [48] * 8
    assert batch.captions == []


def test_validation_is_the_same_every_time_and_for_every_seed(store):
    runs = [list(module(store, seed=seed, val_batch_size=4).val_dataloader()) for seed in (0, 0, 1)]
    assert sum(len(b.captions) for b in runs[0]) == 10
    for run in runs[1:]:
        assert all(same(a, b) for a, b in zip(runs[0], run, strict=True))


@pytest.mark.parametrize("count", [5, 9, 10])
def test_a_validation_item_left_alone_joins_the_batch_before_it(store, count):
    whole, batched = (
        [
            name
            for batch in module(store, val_batch_size=size, val_limit=count).val_dataloader()
            for name in batch.clip_ids
        ]
        for size in (count, 4)
    )
    assert batched == whole
    sizes = [len(b.lengths) for b in module(store, val_batch_size=4, val_limit=count).val_dataloader()]
    assert sizes == {5: [5], 9: [4, 5], 10: [4, 4, 2]}[count]


def test_validation_can_be_bounded(store):
    batches = list(module(store, kind="windows", val_limit=7, val_batch_size=5).val_dataloader())
    assert [len(b.lengths) for b in batches] == [5, 2]
    assert len({(e, s) for b in batches for e, s in zip(b.entries.tolist(), b.starts.tolist(), strict=True)}) == 7


@pytest.mark.parametrize("start_method", ["fork", pytest.param("spawn", marks=pytest.mark.slow)])
def test_workers_give_the_same_batches(store, start_method):
    alone = list(module(store, steps=3).train_dataloader())
    shared = list(module(store, steps=3, num_workers=2, start_method=start_method).train_dataloader())
    assert all(same(a, b) for a, b in zip(alone, shared, strict=True))


def test_a_replication_is_a_function_of_its_seed(store):
    data = module(store)
    runs = [list(data.test_batches("test", r, seed=s, batch_size=4)) for r, s in ((0, 7), (0, 7), (1, 7), (0, 8))]
    assert all(same(a, b) for a, b in zip(runs[0], runs[1], strict=True))
    names = [[name for b in run for name in b.clip_ids] for run in runs]
    assert names[0] != names[2]
    assert names[0] != names[3]


@pytest.mark.parametrize(("leftover", "sizes"), [("drop", [4, 4, 4]), ("keep", [4, 4, 4, 2]), ("mld", [4, 4, 4, 2])])
def test_leftover_policies(store, leftover, sizes):
    batches = list(module(store).test_batches("test", 0, 0, batch_size=4, leftover=leftover))
    assert [len(b.captions) for b in batches] == sizes
    assert len({name for b in batches for name in b.clip_ids}) == sum(sizes)
    assert all(b.features.shape[1] == b.lengths.max() for b in batches)


def test_a_split_smaller_than_a_batch_is_named(store):
    with pytest.raises(ValueError, match="14 entries, fewer than one batch of 32; pass leftover='keep'"):
        next(module(store).test_batches("test", 0, 0))
    with pytest.raises(ValueError, match="'pad'; choose one of drop, keep, mld"):
        next(module(store).test_batches("test", 0, 0, leftover="pad"))


@pytest.mark.parametrize(("asked", "filled"), [(1, 1), (8, 8), (24, 24), (25, 24), (64, 24), (256, 24)])
def test_a_batch_is_all_of_a_split_that_has_fewer_items(store, asked, filled):
    """24 training entries with their mirrored ones; a split as large as a batch or larger is served as ever."""
    data = module(store, batch_size=asked, steps=3)
    batches = list(data.train_dataloader())
    assert [len(batch.lengths) for batch in batches] == [filled] * 3 == [data.filled()] * 3
    if asked > filled:
        assert all(len(set(batch.entries.tolist())) == 24 for batch in batches)


@pytest.mark.parametrize(
    ("asked", "world", "filled"), [(64, 2, 24), (64, 5, 20), (64, 7, 21), (20, 5, 20), (64, 24, 24)]
)
def test_a_smaller_batch_can_be_shared_by_ranks(store, asked, world, filled):
    assert module(store, batch_size=asked).filled(world) == filled


def test_clips_of_a_corpus_without_captions_fail_before_training(joints_corpus, tmp_path):
    path = prepare_store("joints", joints_corpus({"a": ("train", 80, None)}), tmp_path / "o", name="mute")
    with pytest.raises(ValueError, match="no captions"):
        MotionDataModule(path, kind="clips", batch_size=1, steps=1).setup("fit")
    MotionDataModule(path, kind="windows", batch_size=1, steps=1).setup("fit")


@pytest.mark.parametrize("kind", ["windows", "clips"])
def test_essential_dims_are_a_view_of_the_first_columns(store, kind):
    whole, narrow = (module(store, kind=kind, dims=dims) for dims in ("redundant", "essential"))
    for loader in ("train_dataloader", "val_dataloader"):
        for all_columns, first in zip(getattr(whole, loader)(), getattr(narrow, loader)(), strict=True):
            assert torch.equal(first.features, all_columns.features[..., :67])
            assert first.clip_ids == all_columns.clip_ids
    batches = (next(data.test_batches("test", 0, 0, batch_size=4)) for data in (whole, narrow))
    assert [batch.features.shape[-1] for batch in batches] == [263, 67]
    served = narrow.dataset("train")
    assert np.shares_memory(served[0, 0].features, served.store.features)


def test_unknown_dims_are_named(store):
    with pytest.raises(ValueError, match="unknown dims 'joints'; choose one of essential, redundant"):
        module(store, dims="joints").setup("fit")


def test_unknown_kind_is_named(store):
    with pytest.raises(ValueError, match="'frames' of data; choose one of windows, clips"):
        module(store, kind="frames")


class Writer(Recorder):
    """Write what every step of a rank saw to a file."""

    def __init__(self, folder):
        super().__init__()
        self.folder = folder

    def on_train_end(self):
        (self.folder / f"{self.global_rank}.json").write_text(json.dumps(self.seen))


def fit_on_two_ranks(model, data, sharded_again):
    L.Trainer(
        max_steps=3, devices=2, accelerator="cpu", strategy="ddp_fork", use_distributed_sampler=sharded_again,
        logger=False, enable_checkpointing=False, enable_progress_bar=False, enable_model_summary=False,
    ).fit(model, data)  # fmt: skip


@pytest.mark.filterwarnings("ignore")
def test_two_ranks_see_together_what_one_process_sees(store, tmp_path):
    alone = Recorder()
    fit(alone, module(store), 3, tmp_path)
    fit_on_two_ranks(Writer(tmp_path), module(store), sharded_again=False)
    ranks = [json.loads((tmp_path / f"{rank}.json").read_text()) for rank in (0, 1)]
    together = [([*e0, *e1], [*s0, *s1]) for (e0, s0), (e1, s1) in zip(*ranks, strict=True)]
    assert together == alone.seen


@pytest.mark.filterwarnings("ignore")
def test_a_trainer_that_would_share_out_again_is_refused(store, tmp_path):
    with pytest.raises(Exception, match="use_distributed_sampler=False"):
        fit_on_two_ranks(Writer(tmp_path), module(store), sharded_again=True)
