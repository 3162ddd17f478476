"""An edit changes what it is asked to and nothing else; what follows it moves on from where it ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kinema.motion.recovery import recover_joints
from kinema.motion.rotation import rotate_yaw
from kinema.motion.skeleton import HUMANML3D
from kinema.pipeline.editing import TASKS, complement, largest_seam, parse_ranges, resolve_ranges


@pytest.fixture
def motions(model):
    return model.generate(["a person walks", "a man jumps"], [38, 60], seed=1)


@pytest.mark.parametrize(
    "frames", [[(10, 20)], [(0, 5), (30, 38)], [(37, 38)], "prefix", "suffix", "inbetween", "outpaint"]
)
def test_kept_rows_come_back_bit_equal_and_the_rest_is_new(model, motions, frames):
    edited = model.edit(motions, "someone turns around", frames, seed=2)
    for motion, result, ranges in zip(motions, edited, resolve_ranges(frames, [38, 60]), strict=True):
        changed = np.zeros(len(motion.features), bool)
        for start, end in ranges:
            changed[start:end] = True
        assert result.features.shape == motion.features.shape
        assert np.array_equal(result.features[~changed], motion.features[~changed])
        assert np.array_equal(result.kept, ~changed)
        assert (np.abs(result.features[changed] - motion.features[changed]).max(axis=1) > 1e-4).all()
        assert result.text == "someone turns around"


def test_the_kept_part_behind_an_edit_is_moved_rigidly(model, motions):
    (edited,) = model.edit(motions[1], "someone turns around", [(20, 30)], seed=2)
    before, after = motions[1].joints, edited.joints
    np.testing.assert_allclose(after[:20], before[:20], atol=1e-4)
    assert np.abs(after[40:] - before[40:]).max() > 0.01
    distances = [np.linalg.norm(j[30:, :, None] - j[30:, None], axis=-1) for j in (before, after)]
    np.testing.assert_allclose(*distances, atol=1e-3)
    paths = [np.linalg.norm(np.diff(j[30:, 0], axis=0), axis=-1) for j in (before, after)]
    np.testing.assert_allclose(*paths, atol=1e-3)


def test_the_raw_decoding_touches_all_rows(model, motions):
    raw = model.edit(motions, "someone waves", [(8, 16)], seed=2, paste=False)
    pasted = model.edit(motions, "someone waves", [(8, 16)], seed=2, blend=0)
    for source, one, other in zip(motions, raw, pasted, strict=True):
        assert np.abs(one.features[20:] - source.features[20:]).max() > 1e-3
        np.testing.assert_allclose(one.features[8:16], other.features[8:16], atol=1e-5)


@pytest.mark.parametrize("frames", [[(20, 40)], [(0, 20)], [(30, 60)], [(28, 32)], [(12, 28), (32, 60)]])
def test_new_frames_begin_where_kept_ones_end(model, motions, frames):
    raw, side_by_side, blended = (
        model.edit(motions[1], "someone waves", frames, seed=2, **how)[0]
        for how in ({"paste": False}, {"blend": 0.0}, {})
    )
    kept = blended.kept
    assert np.array_equal(blended.features[kept], motions[1].features[kept])
    for seam in np.flatnonzero(kept[1:] != kept[:-1]) + 1:
        step = raw.features[seam] - raw.features[seam - 1]
        by_blending = blended.features[seam] - blended.features[seam - 1] - step
        by_pasting = side_by_side.features[seam] - side_by_side.features[seam - 1] - step
        assert np.abs(by_blending).max() < 0.3 * np.abs(by_pasting).max()
    far = np.array([not kept[max(0, i - 8) : i + 9].any() for i in range(60)])
    assert np.array_equal(blended.features[far], side_by_side.features[far])


def test_no_frames_are_led_where_none_are_kept(model, motions):
    whole, raw = (model.edit(motions, "someone waves", [(0, 38)], seed=2, **how) for how in ({}, {"paste": False}))
    assert np.array_equal(whole[0].features, raw[0].features)
    with pytest.raises(ValueError, match="blend=-1"):
        model.edit(motions, "someone waves", "prefix", blend=-1)


def test_an_edit_depends_on_its_seed_and_not_on_its_batch(model, motions):
    edited = model.edit(motions, "someone waves", "inbetween", seed=4)
    for motion, result in zip(motions, edited, strict=True):
        (alone,) = model.edit(motion, "someone waves", "inbetween", seed=result.seed)
        np.testing.assert_allclose(alone.features, result.features, rtol=1e-4, atol=1e-4)


def test_one_motion_goes_with_many_texts_and_each_motion_can_have_its_own_ranges(model, motions):
    edited = model.edit(motions[0], ["someone waves", "a man bows"], "prefix", seed=4)
    assert [m.text for m in edited] == ["someone waves", "a man bows"]
    edited = model.edit(motions, "someone waves", [[(0, 8)], "suffix"], seed=4)
    assert np.array_equal(edited[0].features[8:], motions[0].features[8:])
    assert np.array_equal(edited[1].features[30:], motions[1].features[30:])


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        ([(10, 39)], r"range \(10, 39\) is outside the clip; it has frames 0 to 38"),
        ([(-1, 5)], r"range \(-1, 5\)"),
        ([(5, 5)], r"range \(5, 5\)"),
        ([], "nothing to regenerate"),
        ("middle", "unknown edit 'middle'; allowed: prefix, suffix, inbetween, outpaint"),
        ([[(0, 4)], [(0, 4)], [(0, 4)]], "ranges for 3 motions, but there are 2"),
    ],
)
def test_bad_ranges_are_named(model, motions, frames, message):
    with pytest.raises(ValueError, match=message):
        model.edit(motions, "someone waves", frames)


def test_motions_that_do_not_fit_the_model_are_named(model, motions):
    with pytest.raises(ValueError, match="motion 0 has the skeleton 'kit', the model 'humanml3d'"):
        model.edit(replace(motions[0], skeleton="kit"), "someone waves", "prefix")
    with pytest.raises(ValueError, match="motion 0 has 60 feature columns"):
        model.edit(replace(motions[0], features=motions[0].features[:, :60]), "someone waves", "prefix")
    with pytest.raises(ValueError, match="motion 0 holds NaN"):
        model.edit(replace(motions[0], features=motions[0].features * np.nan), "someone waves", "prefix")
    with pytest.raises(ValueError, match="length 200 is out of range"):
        model.edit(replace(motions[0], features=np.zeros((200, 67), np.float32)), "someone waves", "prefix")
    with pytest.raises(ValueError, match="2 motions and 3 texts"):
        model.edit(motions, ["a", "b", "c"], "prefix")


@pytest.mark.parametrize(
    ("asked", "kept"),
    [
        ([(1, 38)], [(0, 4)]),
        ([(0, 37)], [(36, 38)]),
        ([(1, 36)], [(0, 4), (36, 38)]),
        ([(0, 9), (11, 38)], [(8, 12)]),
        ([(0, 11), (13, 38)], [(8, 16)]),
        ([(0, 10), (15, 38)], [(8, 16)]),
        ([(0, 10), (16, 38)], [(10, 16)]),
        ([(0, 1), (2, 3), (4, 38)], [(0, 4)]),
    ],
)
def test_a_kept_stretch_under_a_latent_is_widened_so_that_the_generator_knows_it(model, motions, asked, kept):
    (edited,) = model.edit(motions[0], "someone turns around", asked, seed=2)
    expected = np.zeros(38, bool)
    for start, end in kept:
        expected[start:end] = True
    assert np.array_equal(edited.kept, expected)
    assert np.array_equal(edited.features[expected], motions[0].features[expected])
    frame, step = largest_seam(edited)
    assert edited.kept[frame] != edited.kept[frame - 1]
    assert step == pytest.approx(np.linalg.norm(edited.joints[frame] - edited.joints[frame - 1], axis=-1).max())


@pytest.mark.parametrize(("asked", "whole"), [([(1, 3)], "0:4"), ([(1, 4)], "0:4"), ([(36, 37)], "36:38")])
def test_a_range_of_which_nothing_would_be_left_is_refused(model, motions, asked, whole):
    with pytest.raises(ValueError, match=f"nothing of motion 0 is left .* frames {whole} or more"):
        model.edit(motions[0], "someone turns around", asked)


@pytest.mark.parametrize("yaw", [0.0, 0.7, np.pi, -2.5])
@pytest.mark.parametrize("step", [(0, 0, 0), (3, 0, -2), (0.5, 1.2, 100)])
@pytest.mark.parametrize("frames", ["prefix", "suffix", "inbetween"])
def test_an_edit_stands_and_faces_as_its_source_does(model, motions, frames, yaw, step):
    def move(joints):
        return (rotate_yaw(joints.astype(np.float64), yaw) + step).astype(np.float32)

    (plain,) = model.edit(motions[0], "someone waves", frames, seed=2)
    (moved,) = model.edit(replace(motions[0], joints=move(motions[0].joints)), "someone waves", frames, seed=2)
    assert np.array_equal(moved.features, plain.features)
    first = move(motions[0].joints)[0, 0]
    np.testing.assert_allclose(moved.joints[0, 0, [0, 2]], first[[0, 2]], atol=1e-3)
    if frames != "suffix":  # the first frame is the source's
        np.testing.assert_allclose(moved.joints, move(plain.joints), atol=2e-3)


def test_an_edit_of_a_motion_in_its_place_is_the_rows_and_nothing_else(model, motions):
    import torch

    (edited,) = model.edit(motions[0], "someone waves", "prefix", seed=2)
    assert np.array_equal(edited.joints, recover_joints(torch.from_numpy(edited.features)[None], HUMANML3D)[0].numpy())


@pytest.mark.parametrize("length", [7, 38, 40, 196])
def test_the_tasks_keep_what_their_names_say(length):
    kept = {task: complement(ranges(length), length) for task, ranges in TASKS.items()}
    assert kept["prefix"] == [(0, length // 2)]
    assert kept["suffix"] == [(length - length // 2, length)]
    assert kept["inbetween"] == [(0, length // 4), (length - length // 4, length)]
    assert kept["outpaint"] == [(length // 4, length // 4 + length // 2)]


def test_ranges_as_text():
    assert parse_ranges("20:60,80:", 100, 20.0) == [(20, 60), (80, 100)]
    assert parse_ranges("1s:2.5s", 100, 20.0) == [(20, 50)]
    assert parse_ranges(":1s", 100, 12.5) == [(0, 12)]
    assert parse_ranges("20:60,80:", 100, 20.0, kept=True) == [(0, 20), (60, 80)]
    for kept in (False, True):
        assert parse_ranges("prefix", 100, 20.0, kept=kept) == [(50, 100)]
    assert complement([(20, 60), (80, 100)], 100) == [(0, 20), (60, 80)]
    assert complement([(0, 100)], 100) == []
    for text, message in (("20-60", "is no START:END"), ("a:5", "neither a frame"), ("0:200", "is outside")):
        with pytest.raises(ValueError, match=message):
            parse_ranges(text, 100, 20.0)
