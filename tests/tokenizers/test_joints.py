"""Frames of absolute joints: what goes in comes out, and statistics, edits and padding are as they should be."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import torch

from kinema.data.synthetic.corpus import synthetic_joints
from kinema.motion.body_parts import columns_of, legs
from kinema.motion.features import extract
from kinema.motion.recovery import recover_joints
from kinema.motion.representation import Representation
from kinema.motion.skeleton import get_skeleton
from kinema.motion.statistics import Statistics
from kinema.runs import weights
from kinema.tokenizers.joints import Joints
from kinema.types import MotionBatch

SKELETONS = ["humanml3d", "kit"]


@cache
def clips(skeleton: str) -> list[np.ndarray]:
    kind = get_skeleton(skeleton)
    return [extract(synthetic_joints(5, i, skeleton), kind, target_bone_lengths=None)[:196] for i in range(4)]


def tokenizer(skeleton: str, statistics: str = "shared_axis") -> Joints:
    kind = get_skeleton(skeleton)
    model = Joints(
        Representation("essential", skeleton).fit(Statistics.compute(clips(skeleton), kind)), statistics=statistics
    )
    model.prepare(clips(skeleton))
    return model.eval()


def batch(skeleton: str) -> MotionBatch:
    rows = clips(skeleton)
    features = torch.zeros(len(rows), max(map(len, rows)) + 7, rows[0].shape[1])
    for place, clip in zip(features, rows, strict=True):
        place[: len(clip)] = torch.from_numpy(clip)
    return MotionBatch(features, torch.tensor([len(clip) for clip in rows]))


@pytest.mark.parametrize("skeleton", SKELETONS)
def test_joints_come_back_within_a_millimetre_and_rows_almost(skeleton):
    kind, motion = get_skeleton(skeleton), batch(skeleton)
    model = tokenizer(skeleton)
    latents = model.encode(motion)
    assert latents.values.shape[2] == model.space.width == 3 * kind.num_joints
    decoded = model.decode(latents)
    assert torch.equal(decoded.lengths, motion.lengths)
    assert decoded.features.shape[2] == model.representation.width
    ours, real = (recover_joints(m.features, kind)[motion.mask] for m in (decoded, motion))
    assert (ours - real).abs().max() * kind.meters < 1e-3
    real_rows = model.representation.normalize(motion.features, motion.lengths)
    rows = model.representation.normalize(decoded.features, decoded.lengths)
    for i, size in enumerate(motion.lengths.tolist()):  # the last row has no step, and the smoothing ends before it
        assert (rows - real_rows)[i, : size - 1].square().mean().sqrt() < 0.05


def test_nothing_of_the_padding_or_of_the_neighbours_is_read():
    motion, model = batch("humanml3d"), tokenizer("humanml3d")
    latents = model.encode(motion)
    assert not latents.values[~latents.mask].any()
    latents.values[~latents.mask] = torch.nan
    decoded = model.decode(latents)
    assert not decoded.features[~decoded.mask].any()
    for i, size in enumerate(motion.lengths.tolist()):
        own = model.encode(MotionBatch(motion.features[i : i + 1, :size], motion.lengths[i : i + 1]))
        torch.testing.assert_close(own.values[0], latents.values[i, :size])
        torch.testing.assert_close(model.decode(own).features[0], decoded.features[i, :size], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("skeleton", SKELETONS)
def test_statistics_are_shared_by_joints_or_each_coordinate_s_own(skeleton):
    joints = np.concatenate(
        [recover_joints(torch.from_numpy(rows.astype(np.float64)), get_skeleton(skeleton)).numpy()
         for rows in clips(skeleton)]
    )  # fmt: skip
    shared, own = tokenizer(skeleton), tokenizer(skeleton, "per_joint")
    for joint in (0, 7):
        np.testing.assert_allclose(shared.mean[joint], joints.mean((0, 1)), rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(shared.std[joint], joints.std((0, 1)), rtol=1e-4)
    np.testing.assert_allclose(own.mean, joints.mean(0), rtol=1e-4, atol=1e-5 / get_skeleton(skeleton).meters)
    np.testing.assert_allclose(own.std, joints.std(0), rtol=1e-4)


def test_it_says_what_its_numbers_mean_and_keeps_it_in_its_weights(tmp_path):
    shared, own = tokenizer("humanml3d"), tokenizer("humanml3d", "per_joint")
    assert shared.identity() != own.identity()
    assert shared.identity().items() >= shared.representation.identity().items()
    form = {"_target_": "kinema.motion.representation.Representation", "kind": "essential", "skeleton": "humanml3d"}
    spec = {"_target_": "kinema.tokenizers.joints.Joints", "representation": form, "statistics": "per_joint"}
    again, _ = weights.load(weights.save(own, spec, tmp_path / "weights.safetensors", half=True))
    assert again.identity() == own.identity()
    fresh = Joints(Representation("essential", "humanml3d"))
    with pytest.raises(ValueError, match=r"no statistics of joints; call prepare\(clips\)"):
        fresh.encode(batch("humanml3d"))


def test_rows_of_all_dims_and_unknown_statistics_are_refused():
    with pytest.raises(ValueError, match="not by redundant ones; set representation=essential"):
        Joints(Representation("redundant", "humanml3d"))
    with pytest.raises(ValueError, match="shared_axis, per_joint"):
        Joints(Representation("essential", "humanml3d"), statistics="none")


@pytest.mark.parametrize("skeleton", SKELETONS)
def test_it_says_which_joints_a_part_of_the_body_is(skeleton):
    kind, model = get_skeleton(skeleton), tokenizer(skeleton)

    def joints_kept(part: str) -> np.ndarray:
        keep = torch.from_numpy(~columns_of(part, kind)[: kind.essential_width])[None, None]
        return model.known_numbers(keep)[0, 0].reshape(-1, 3).numpy()

    lower = np.isin(np.arange(kind.num_joints), list(legs(kind)))
    np.testing.assert_array_equal(joints_kept("upper"), np.repeat(lower[:, None], 3, 1))
    np.testing.assert_array_equal(joints_kept("lower"), np.repeat(~lower[:, None], 3, 1))
    way = np.zeros((kind.num_joints, 3), bool)
    way[0, [0, 2]] = True
    np.testing.assert_array_equal(joints_kept("body"), way)


def test_pieces_are_encoded_where_they_stand():
    motion, model = batch("humanml3d"), tokenizer("humanml3d")
    whole = model.encode(motion).values
    rows, starts, lengths = torch.tensor([0, 0, 2]), torch.tensor([0, 30, 12]), torch.tensor([9, 11, 4])
    cut = model.encode_pieces(motion, rows, starts, lengths)
    assert torch.equal(cut.lengths, lengths)
    for i, (row, start, size) in enumerate(zip(rows, starts, lengths, strict=True)):
        assert torch.equal(cut.values[i, :size], whole[row, start : start + size])
