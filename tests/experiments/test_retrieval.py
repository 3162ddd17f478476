"""The retrieval database is a run of its own: of the training split alone, beside the generator wherever that goes."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from kinema.data.datamodule import MotionDataModule
from kinema.data.store import PackedStore
from kinema.evaluation.sources import Generated
from kinema.experiments.config import compose
from kinema.experiments.corpus import open_corpus
from kinema.experiments.run import run_stage
from kinema.experiments.stages import get_stage
from kinema.generators.remodiffuse import RetrievalDatabase
from kinema.pipeline import TextToMotion
from kinema.runs.parts import load_part, upstream

CHOICE = ("method=remodiffuse", "scale=smoke")


@pytest.fixture
def cfg(micro):
    def composed(*more: str):
        kept = [o for o in micro if not o.startswith("tokenizer.")]
        return compose([*kept, *CHOICE, *more])

    return composed


def test_the_generator_s_run_brings_its_database_and_the_test_motion_never_reaches_it(cfg, tmp_path):
    """Train, load and save; then answer captions whose motions are swapped for others of their lengths."""
    small = cfg("generator.train.steps=2")
    run = run_stage(small, "generator")
    assert set(upstream(run.path)) >= {"tokenizer", "retrieval"}
    model = TextToMotion.from_run(run.path, device="cpu")
    made = model.generate(["a person walks", "someone jumps"], [40, 61], seed=1)
    model.save(tmp_path / "saved")
    again = TextToMotion.from_run(tmp_path / "saved", device="cpu")
    for first, second in zip(made, again.generate(["a person walks", "someone jumps"], [40, 61], seed=1), strict=True):
        assert torch.equal(torch.from_numpy(first.features), torch.from_numpy(second.features))
    data = MotionDataModule(open_corpus(small), kind="clips", batch_size=4, steps=1)
    batch, seeds = next(data.test_batches("test", 0, seed=0, batch_size=4)), torch.arange(4)
    other = replace(batch, features=torch.randn_like(batch.features), clip_ids=["Mwalk"] * 4, entries=None, starts=None)
    answers = [Generated(model, lengths="real")(one, seeds).features for one in (batch, other)]
    assert torch.equal(*answers)


def test_it_holds_the_training_split_and_nothing_else(cfg):
    """Compare names, captions, frames and families with the corpus'."""
    small = cfg()
    store, run = PackedStore.open(open_corpus(small)), run_stage(small, "retrieval")
    database, meta = load_part(run.path, part="retrieval")
    assert isinstance(database, RetrievalDatabase)
    assert meta["corpus"] == store.hash
    entries = {store.entry_name(int(e)): int(e) for e in store.split_entries("train")}
    names = list(database.family_of)
    assert set(names) <= set(entries)
    assert len(names) == len(database.lengths) > 10
    captions = [(c.text, i) for i, name in enumerate(names) for c in store.entry_captions(entries[name])]
    assert [entry for _, entry in captions] == database.captions[:, 1].tolist()
    assert len({text for text, _ in captions}) == len(database.keys) < len(captions)
    for name, family in database.family_of.items():
        assert database.family_of.get(f"M{name}", family) == family
    assert len(set(database.family_of.values())) < len(names)
    tokenizer, _ = load_part(upstream(run.path)["tokenizer"])
    for row in (0, 7, len(captions) - 1):
        neighbours = database.gather(torch.tensor([[row]]))
        frames = store.frames_of(entries[names[captions[row][1]]])[: neighbours.lengths.item()]
        expected = tokenizer.representation.normalize(torch.from_numpy(frames.copy()))
        torch.testing.assert_close(neighbours.motions[0, 0], expected)
    assert run_stage(small, "retrieval").path == run.path


def test_a_corpus_of_fewer_captions_than_neighbours_is_refused(cfg):
    few = cfg("generator.model.neighbours=5000")
    with pytest.raises(ValueError, match="captions in its training split, fewer than the 5000 neighbours"):
        get_stage("retrieval").check(few, PackedStore.open(open_corpus(few)))
