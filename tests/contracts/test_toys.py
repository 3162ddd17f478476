"""The contract holds what no method here needs yet: frames as latents, latents without time, latents that are drawn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import torch
from torch import nn

from kinema.data.datasets import ClipDataset
from kinema.generators import Generator
from kinema.generators.lengths import requested_lengths
from kinema.motion.body_parts import columns_of, legs
from kinema.motion.recovery import recover_joints
from kinema.motion.skeleton import get_skeleton
from kinema.motion.trajectory import Trajectory
from kinema.motion.waypoints import Waypoints
from kinema.pipeline import TextToMotion
from kinema.pipeline.following import follow
from kinema.pipeline.holding import hold
from kinema.tokenizers import MotionTokenizer
from kinema.tokenizers.frames import Frames
from kinema.training.latents import EncodeEachTime, LatentCache, latent_source
from kinema.types import Known, Latents, LatentSpace, Motion, MotionBatch, frame_mask

TEXTS = ["a person walks", "a man jumps"]


@dataclass(frozen=True)
class NoOptions:
    """There is nothing to choose."""


class Toy(Generator):
    """Make every latent of the text's first number and the seed; keep what is known."""

    sampling = NoOptions()

    def __init__(self, space: LatentSpace) -> None:
        super().__init__()
        self.space = space
        self.scale = nn.Parameter(torch.ones(()))

    def loss(self, latents, text, *, generator=None, shard=(0, 1)):
        return {"loss": (self.scale - latents.values[latents.mask].mean()).square()}

    def sample(self, text, frames, *, seeds, known=None, sampling=None):
        lengths = requested_lengths(self.space, text, frames, seeds, known, device=self.scale.device)
        shape = (len(lengths), int(lengths.max()), self.space.width)
        values = (text.pooled[:, :1, None] + 1e-3 * seeds[:, None, None]) * self.scale * torch.ones(shape)
        if known is not None:
            mask = known.mask if known.mask.ndim == 3 else known.mask[..., None]
            values = torch.where(mask, known.latents.values, values)
        values = values * frame_mask(lengths, shape[1])[..., None]
        counted = known.latents.frames if frames is None else frames
        return Latents(lengths, self.space.covered(counted), values=values.detach())


class Summary(MotionTokenizer):
    """Say all of a motion in two latents: the first normalised frame and the mean, whatever its length."""

    def __init__(self, representation, *, noise: float = 0.0) -> None:
        super().__init__()
        self.representation, self.noise, self.deterministic = representation, noise, noise == 0
        self.space = LatentSpace("continuous", representation.width, most=2, unit=None)

    def loss(self, motion, *, generator=None, shard=(0, 1)):
        return {"loss": self.encode(motion, generator=generator).values.square().mean()}

    def encode(self, motion, *, generator=None):
        rows = self.representation.normalize(motion.features, motion.lengths)
        mean = rows.sum(1) / motion.lengths[:, None]
        values = torch.stack((rows[:, 0], mean), dim=1)
        if generator is not None:
            values = values + self.noise * torch.randn(values.shape, generator=generator)
        return Latents(self.space.latents_of(motion.lengths), motion.lengths, values=values)

    def decode(self, latents):
        size = int(latents.frames.max())
        values = latents.values[:, 1:].expand(-1, size, -1)
        return MotionBatch(self.representation.denormalize(values, latents.frames), latents.frames)


@pytest.fixture
def representation(workshop):
    return workshop.tokenizer("method=mardm_sit").representation


def held(workshop, tokenizer) -> TextToMotion:
    return TextToMotion(tokenizer.eval(), Toy(tokenizer.space).eval(), workshop.text)


def test_a_method_on_frames_generates_and_edits_to_the_frame(workshop, representation):
    model = held(workshop, Frames(representation))
    motions = model.generate(TEXTS, [37, 50], seed=3)
    assert [len(m.features) for m in motions] == [37, 50]
    assert model.max_frames == model.skeleton.max_frames - 1
    edited = model.edit(motions, "someone waves", [(5, 18)], seed=4)
    for motion, result in zip(motions, edited, strict=True):
        kept = np.r_[0:5, 18 : len(motion.features)]
        assert np.array_equal(result.features[kept], motion.features[kept])
        assert (result.features[5:18] != motion.features[5:18]).any(axis=1).all()
    assert len(model.chain(TEXTS, [37, 50], seed=1, transition=8).features) == 37 + 8 + 50


def test_a_part_of_the_body_is_regenerated_and_the_rest_is_kept(workshop, representation):
    model = held(workshop, Frames(representation))
    motions = model.generate(TEXTS, [37, 50], seed=3)
    for part, frames, spans in (("upper", None, [(0, 37), (0, 50)]), ("lower", [(5, 18)], [(5, 18), (5, 18)])):
        columns = columns_of(part, model.skeleton)[: representation.width]
        edited = model.edit(motions, "someone waves", frames, parts=part, seed=4)
        for motion, result, (start, end) in zip(motions, edited, spans, strict=True):
            new = np.zeros(motion.features.shape, dtype=bool)
            new[start:end] = columns
            assert np.array_equal(result.features[~new], motion.features[~new])
            assert (result.features[new] != motion.features[new]).mean() > 0.99
    with pytest.raises(ValueError, match=r"nothing to regenerate: give frames, or parts= one of upper, lower"):
        model.edit(motions, "someone waves")
    with pytest.raises(ValueError, match=r"unknown part of the body 'arms'; allowed: upper, lower"):
        model.edit(motions, "someone waves", parts="arms")


def test_a_method_on_frames_is_given_the_way_and_goes_it_to_the_millimetre(workshop, representation):
    model = held(workshop, Frames(representation))
    way = Waypoints(np.array([0.0, 1.0, 2.0]), np.array([[1.0, 1.0], [1.0, 2.0], [2.0, 2.0]]), None)
    made = follow(model, TEXTS, way, seed=1)
    assert made.strides is None
    assert made.away < 1e-3
    for motion in made.motions:
        assert len(motion.joints) == 41
        np.testing.assert_allclose(motion.joints[[0, 20, 40], 0][:, [0, 2]], way.places, atol=1e-3)
        rows = Trajectory.of(motion.features)
        np.testing.assert_allclose(rows.yaw[-1] - rows.yaw[0], -np.pi / 2, atol=0.1)  # it turned to +X
    assert not np.array_equal(made.motions[0].features[:, 3:], made.motions[1].features[:, 3:])


def test_features_of_a_frame_can_be_known_one_by_one(workshop, representation):
    """Keep the columns of the root alone, as an edit of the upper body keeps those of the legs."""
    model, batch = held(workshop, Frames(representation)), workshop.clips()
    latents = model.tokenizer.encode(batch)
    mask = torch.zeros_like(latents.values, dtype=torch.bool)
    mask[..., :4] = latents.mask[..., None]
    made = model.sample(workshop.text(batch.texts), seeds=torch.arange(4), known=Known(latents, mask))
    real = model.tokenizer.decode(latents).features
    assert torch.equal(made.lengths, batch.lengths)
    assert torch.equal(made.features[..., :4], real[..., :4])
    assert (made.features[..., 4:][made.mask] != real[..., 4:][made.mask]).any()


def test_latents_without_time_stand_for_any_length_and_cannot_be_edited(workshop, representation):
    model = held(workshop, Summary(representation))
    motions = model.generate(TEXTS, [37, 50], seed=3)
    assert [len(m.features) for m in motions] == [37, 50]
    for call in (
        lambda: model.edit(motions, "someone waves", [(5, 18)]),
        lambda: model.chain(TEXTS, [37, 50]),
    ):
        with pytest.raises(ValueError, match="needs latents in time, but here 2 latents stand for the whole"):
            call()


def test_spaces_that_differ_are_refused(workshop, representation):
    with pytest.raises(ValueError, match="the generator is for frames as they are, the tokenizer makes continuous"):
        TextToMotion(Summary(representation), Toy(Frames(representation).space), workshop.text)
    other = LatentSpace("continuous", representation.width, most=5, unit=None)
    with pytest.raises(ValueError, match="counts 5 latents a motion, the tokenizer makes 2 latents a motion"):
        TextToMotion(Summary(representation), Toy(other), workshop.text)


def test_a_posterior_is_sampled_anew_in_training_and_by_the_steps_draws_alone(workshop, representation, tmp_path):
    clips, batch = [ClipDataset(workshop.store, "val")], workshop.clips()
    source = latent_source(tmp_path / "latents", Summary(representation, noise=1.0), clips, "cpu")
    assert isinstance(source, EncodeEachTime)
    first, again, other = (source(batch, torch.Generator().manual_seed(s)).values for s in (1, 1, 2))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)
    shares = [source(batch, torch.Generator().manual_seed(1), (rank, 2)).values for rank in (0, 1, 0)]
    assert torch.equal(shares[0], shares[2])
    assert not torch.equal(shares[0], shares[1])
    low, high = source.range()
    assert low.shape == high.shape == (representation.width,)
    assert (low < high).all()
    assert torch.equal(source.range()[0], low)
    assert isinstance(latent_source(tmp_path / "frames", Frames(representation), clips, "cpu"), EncodeEachTime)


def test_latents_without_time_are_cached_like_others(workshop, representation, tmp_path):
    clips = [ClipDataset(workshop.store, "val")]
    cached = latent_source(tmp_path / "latents", Summary(representation), clips, "cpu")
    assert isinstance(cached, LatentCache)
    entry = int(clips[0].entries[0])
    start, frames = clips[0].crops(entry)[0]
    features = torch.from_numpy(np.array(workshop.store.frames_of(entry)[start : start + frames]))[None]
    batch = MotionBatch(features, torch.tensor([frames]), torch.tensor([entry]), torch.tensor([start]))
    found = cached(batch)
    torch.testing.assert_close(found.values, Summary(representation).encode(batch).values)
    assert found.lengths.tolist() == [2]
    assert found.frames.tolist() == [frames]


@pytest.mark.parametrize("name", ["values.npy", "keys.npy", "offsets.npy", "meta.json"])
def test_latents_that_are_damaged_are_made_again(workshop, representation, tmp_path, name, capsys):
    clips, folder = [ClipDataset(workshop.store, "val")], tmp_path / "latents"
    latent_source(folder, Summary(representation), clips, "cpu")
    good = (folder / name).read_bytes()
    for damaged in (good[:-3], b"", None):
        if damaged is None:
            (folder / name).unlink()
        else:
            (folder / name).write_bytes(damaged)
        latent_source(folder, Summary(representation), clips, "cpu")
        assert (folder / name).read_bytes() == good
        assert f"{name} " in capsys.readouterr().out
    assert [p.name for p in tmp_path.iterdir()] == ["latents"]


def test_a_posterior_s_moments_are_cached_and_drawn_from(workshop, tmp_path):
    """MLD's latents: every step draws anew, as encoding anew would, and no step runs the encoder."""
    tokenizer, clips, batch = workshop.tokenizer("method=mld"), [ClipDataset(workshop.store, "train")], workshop.clips()
    cached, anew = latent_source(tmp_path / "latents", tokenizer, clips, "cpu"), EncodeEachTime(tokenizer)
    assert isinstance(cached, LatentCache)
    for generator in (None, 1, 2):
        drawn = [s(batch, generator and torch.Generator().manual_seed(generator)) for s in (cached, anew)]
        torch.testing.assert_close(drawn[0].values, drawn[1].values, rtol=1e-4, atol=1e-4)
        assert torch.equal(drawn[0].frames, batch.lengths)
    first, other = (cached(batch, torch.Generator().manual_seed(s)).values for s in (1, 2))
    assert not torch.equal(first, other)
    halves = [cached(batch, torch.Generator().manual_seed(1), (rank, 2)).values for rank in (0, 1)]
    assert not torch.equal(*halves)
    low, high = cached.range()
    assert low.shape == high.shape == (tokenizer.space.width,)
    assert (low < high).all()


class Replay(Toy):
    """Make what it is told to, beside what is known."""

    def __init__(self, space: LatentSpace, values: torch.Tensor) -> None:
        super().__init__(space)
        self.values = values

    def sample(self, text, frames, *, seeds, known=None, sampling=None):
        made = super().sample(text, frames, seeds=seeds, known=known, sampling=sampling)
        free = torch.ones_like(made.values, dtype=torch.bool) if known is None else ~known.mask
        made.values = torch.where(free if free.ndim == 3 else free[..., None], self.values, made.values)
        return made


@pytest.fixture
def placed(workshop):
    """Give a tokenizer of joints, the motion of a crop from within a clip, and its latents."""
    tokenizer = workshop.tokenizer("tokenizer=joints", "representation=essential")
    clips = [workshop.store.clip_frames(int(clip)) for clip in workshop.store.split_clips("train")]
    rows = next(rows for rows in clips if len(rows) > 100)[9:89, :67].copy()
    joints = recover_joints(torch.from_numpy(rows), tokenizer.representation.skeleton).numpy()
    batch = MotionBatch(torch.from_numpy(rows)[None], torch.tensor([len(rows)]))
    return tokenizer, Motion(joints, rows, "", "humanml3d", 20.0), tokenizer.encode(batch).values


def test_of_joints_in_space_an_edit_keeps_what_it_is_told_to_where_it_stood(workshop, placed):
    """A generator that makes the source again gives it back, whatever heading its rows are told by."""
    tokenizer, source, values = placed
    model = TextToMotion(tokenizer, Replay(tokenizer.space, values).eval(), workshop.text)
    whole = np.ones(80, bool)
    for frames, parts in (
        ([(20, 50)], None),
        (None, "upper"),
        ([(20, 50)], "lower"),
        (None, "body"),
        ("inbetween", None),
    ):
        (made,) = model.edit(source, "someone waves", frames, parts=parts, seed=1)
        assert np.abs(made.joints - source.joints).max() < 2e-3, (frames, parts)
        kept = made.kept if parts is None else whole if parts != "lower" else ~np.isin(np.arange(80), range(20, 50))
        columns = np.ones(67, bool) if parts is None else ~columns_of(parts, model.skeleton)[:67]
        assert np.array_equal(made.features[kept][:, columns], source.features[kept][:, columns])


def test_of_joints_in_space_a_part_moves_and_the_rest_stands(workshop, placed):
    tokenizer, source, values = placed
    lower = np.isin(np.arange(22), list(legs(get_skeleton("humanml3d"))))
    lifted = values.unflatten(2, (-1, 3)).clone()
    lifted[..., 1] += 0.2 / tokenizer.std[0, 1]
    model = TextToMotion(tokenizer, Replay(tokenizer.space, lifted.flatten(2)).eval(), workshop.text)
    for part, new in (("upper", ~lower), ("lower", lower)):
        (made,) = model.edit(source, "someone waves", parts=part, seed=1)
        away = made.joints - source.joints
        assert np.abs(away[:, ~new]).max() < 2e-3
        np.testing.assert_allclose(away[:, new, 1], 0.2, atol=1e-3)


def test_of_joints_in_space_held_frames_and_ways_are_known(workshop, placed):
    tokenizer, source, values = placed
    model = TextToMotion(tokenizer, Replay(tokenizer.space, values).eval(), workshop.text)
    held = hold(model, source, "someone waves", [0, 40, 79], seed=1)
    assert held.away < 2e-3
    way = Waypoints(np.array([0.0, 2.0, 3.95]), np.array([[1.0, 1.0], [1.0, 2.0], [2.0, 2.0]]), None)
    made = follow(model, ["a person walks"], way, seed=1)
    assert made.away < 1e-3


def test_of_joints_in_space_parts_are_joined_where_their_rows_lead(workshop, placed):
    """A transition of a generator that walks on leads from the end of the first part to the second's start."""
    tokenizer, source, values = placed
    model = TextToMotion(tokenizer, Onward(tokenizer, values).eval(), workshop.text)
    made = model.chain(TEXTS, [80, 80], seed=1, transition=8)
    assert len(made.features) == 168
    assert made.kept.tolist() == [True] * 80 + [False] * 8 + [True] * 80
    rows = tokenizer.decode(Latents(torch.tensor([80]), torch.tensor([80]), values=values)).features[0].numpy()
    for part in (made.features[:80], made.features[88:]):
        np.testing.assert_array_equal(part, rows)
    steps = np.linalg.norm(np.diff(made.joints, axis=0), axis=-1).max(-1)
    usual = np.linalg.norm(np.diff(source.joints, axis=0), axis=-1).max()
    assert steps[79:88].max() < 2 * usual
    way = np.linalg.norm(np.diff(made.joints[:, 0][:, [0, 2]], axis=0), axis=-1)
    assert way[79:88].max() < 2 * way[:79].max()


class Onward(Toy):
    """Make the parts that it is told to; between kept frames, go straight from one to the next."""

    def __init__(self, tokenizer: MotionTokenizer, values: torch.Tensor) -> None:
        super().__init__(tokenizer.space)
        self.values = values

    def sample(self, text, frames, *, seeds, known=None, sampling=None):
        if known is None:
            size = torch.full((len(seeds),), self.values.shape[1])
            return Latents(size, size, values=self.values.expand(len(seeds), -1, -1))
        values = known.latents.values.clone()
        for row, mask in zip(values, known.mask, strict=True):
            here = mask.nonzero().flatten()
            for free in (~mask).nonzero().flatten().tolist():
                left, right = here[here < free].max(), here[here > free].min()
                row[free] = torch.lerp(row[left], row[right], (free - left) / (right - left))
        return Latents(known.latents.lengths, known.latents.frames, values=values)
