"""The synthetic corpus: its motion is possible, and its captions say what the motion shows."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
import torch

from kinema.data.captions import swap_sides
from kinema.data.catalog import read_joints_folder, read_official
from kinema.data.synthetic import ACTIONS, synthetic_clips, synthetic_joints, write_joints_folder, write_official_folder
from kinema.data.synthetic.bodies import Body, pose
from kinema.data.synthetic.corpus import play
from kinema.data.synthetic.plan import Plan
from kinema.data.synthetic.styles import STYLES
from kinema.data.synthetic.wording import tell
from kinema.motion.checks import check_clip
from kinema.motion.features import canonicalise, extract
from kinema.motion.kinematics import bone_lengths
from kinema.motion.mirror import mirror_joints
from kinema.motion.physics import foot_skating
from kinema.motion.skeleton import get_skeleton

SKELETONS = ("humanml3d", "kit")
UNIVERSAL = {"ADJ", "ADP", "ADV", "AUX", "CCONJ", "DET", "NOUN", "NUM", "PART", "PRON", "SCONJ", "VERB"}
STANDING = ("bow", "wave", "punch", "drink", "clap", "point", "squat", "raise arms", "swing bat", "look", "salute")
NUMBERS = {"once": 1, "one": 1, "single": 1, "twice": 2, "two": 2, "three": 3, "four": 4, "five": 5}


@pytest.fixture(scope="module")
def clips():
    """Give 400 clips."""
    return list(synthetic_clips(size=400, seed=11))


def performed(name: str, seed: int, *, mirrored: bool = False, style: str = "neutral", closed: bool = False):
    """Give tracks and plan of one performance of an action."""
    longest = {"longest": 4.8} if closed else {}
    plan = Plan(np.random.default_rng(seed), 20.0, STYLES[style].tempo, STYLES[style].size, closed, **longest)
    return play(ACTIONS[name], plan, style, mirrored), plan


def single(clips, *names: str):
    """Give the clips that show one of these actions and nothing else."""
    return [c for c in clips if c.fields["action"] in names]


def side_of(clip) -> str | None:
    """Give the side that a clip's captions name first, if they all agree."""
    found = {(re.findall(r"\b(left|right)\b", c.caption.text) or [None])[0] for c in clip.captions}
    return found.pop() if len(found) == 1 else None


def test_a_clip_depends_on_seed_and_number_only():
    few, many = (list(synthetic_clips(size=n, seed=3)) for n in (5, 20))
    by_name = {c.name: c for c in many}
    for clip in few:
        other = by_name[clip.name]
        assert (clip.captions, clip.fields, clip.split) == (other.captions, other.fields, other.split)
        np.testing.assert_array_equal(clip.joints(), other.joints())
    other_seed = next(synthetic_clips(size=5, seed=4))
    assert not np.array_equal(few[0].joints()[:40], other_seed.joints()[:40])


def test_splits_have_their_shares_and_come_in_order(clips):
    splits = [c.split for c in clips]
    assert splits == sorted(splits, key=("train", "val", "test").index)
    assert [splits.count(s) for s in ("train", "val", "test")] == pytest.approx([320, 40, 40], abs=2)
    assert len({c.name for c in clips}) == 400
    assert {c.split for c in synthetic_clips(size=9, splits=(1.0, 0.0, 0.0))} == {"train"}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"size": 0}, "size 0"),
        ({"splits": (0.8, 0.1, 0.2)}, "add up to 1"),
        ({"splits": (1.2, -0.1, -0.1)}, "add up to 1"),
        ({"skeleton": "smplx"}, "smplx"),
    ],
)
def test_bad_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        list(synthetic_clips(**arguments))


@pytest.mark.parametrize("skeleton", SKELETONS)
def test_bodies_are_rigid_symmetric_and_varied(skeleton):
    kind, sizes = get_skeleton(skeleton), []
    for index in range(12):
        lengths = bone_lengths(synthetic_joints(5, index, skeleton).astype(np.float64), kind)[:, 1:]
        scale = lengths.mean()
        assert np.ptp(lengths, axis=0).max() < 1e-4 * scale
        for left, right in kind.mirror_pairs:
            assert lengths[0, left - 1] == pytest.approx(lengths[0, right - 1], rel=1e-4)
        sizes.append(scale)
    assert np.std(sizes) > 0.02 * np.mean(sizes)


@pytest.mark.parametrize("skeleton", SKELETONS)
def test_every_clip_passes_checks_and_extraction(skeleton):
    kind = get_skeleton(skeleton)
    lengths, skating = [], []
    for clip in islice(synthetic_clips(size=150, seed=2, skeleton=skeleton), 120):
        joints = clip.joints()
        assert joints.dtype == np.float32
        assert check_clip(joints, kind, kind.fps) == []
        rows = extract(joints, kind, target_bone_lengths="skeleton" if skeleton == "humanml3d" else None)
        assert np.isfinite(rows).all()
        assert rows[:, kind.groups["contacts"]].mean() > 0.15
        lengths.append(len(rows))
        floor = torch.from_numpy(canonicalise(joints.astype(np.float64), kind))[None].float()
        skating.append(float(foot_skating(floor, torch.tensor([len(joints)]), kind)))
    assert kind.min_frames <= min(lengths)
    assert max(lengths) <= 196
    assert np.std(lengths) > 15
    assert np.mean(skating) < 0.1


@pytest.mark.parametrize("skeleton", SKELETONS)
def test_a_foot_stands_still_while_the_other_one_steps(skeleton):
    body = Body.average(skeleton)
    toes = [body.skeleton.feet_left[skeleton == "humanml3d"], body.skeleton.feet_right[skeleton == "humanml3d"]]
    for name in ("walk", "march", "sneak", "limp", "sidestep", "turn around"):
        tracks, _ = performed(name, seed=1)
        joints = pose(body, tracks) / body.leg
        step = np.linalg.norm(np.diff(joints[:, toes], axis=0), axis=-1)
        assert step.min(1).max() < 1e-6, name
        assert step.max() > 0.02, name


@pytest.mark.parametrize("name", STANDING)
def test_feet_stay_where_they_are_in_what_is_done_standing(name):
    body = Body.average("humanml3d")
    feet = [*body.skeleton.feet_left, *body.skeleton.feet_right]
    for style in ("neutral", "drunk", "old"):
        joints = pose(body, performed(name, seed=4, style=style)[0])
        assert np.ptp(joints[:, feet], axis=0).max() < 2e-3


@pytest.mark.parametrize("skeleton", SKELETONS)
def test_knees_bend_forward_and_nothing_goes_through_the_floor(skeleton):
    body = Body.average(skeleton)
    hip, knee, ankle = body.layout.legs[0][:3]
    for name in ACTIONS:
        tracks, _ = performed(name, seed=2)
        joints = pose(body, tracks) / body.leg
        assert joints[..., 1].min() > -0.03, name
        facing = np.stack([np.sin(tracks.heading), np.zeros(tracks.frames), np.cos(tracks.heading)], axis=-1)
        bow = joints[:, knee] - (joints[:, hip] + joints[:, ankle]) / 2
        upright = np.abs((joints[:, hip] - joints[:, ankle])[:, 1]) > 0.7
        bent = np.linalg.norm(bow, axis=-1) > 0.15
        assert ((bow * facing).sum(-1)[upright & bent] > 0).all(), name


@pytest.mark.parametrize("name", sorted(ACTIONS))
def test_the_mirrored_performance_is_the_mirror_image_with_the_sides_swapped(name):
    body = Body.average("humanml3d")
    (plain, plan), (flipped, other) = (performed(name, 7, mirrored=m, style="drunk") for m in (False, True))
    np.testing.assert_allclose(pose(body, flipped), mirror_joints(pose(body, plain), body.skeleton), atol=1e-9)
    captions = []
    for p in (plan, other):
        captions.append(tell([(ACTIONS[name].phrases, p.words)], ("",), np.random.default_rng(0)))
    assert captions[1].text == swap_sides(captions[0].text)
    assert " ".join(captions[1].tokens) == swap_sides(" ".join(captions[0].tokens))


@pytest.mark.parametrize(
    ("actions", "joints"),
    [
        (("wave", "point", "drink", "salute", "scratch head", "throw"), ("left_wrist", "right_wrist")),
        (("kick", "lunge"), ("left_ankle", "right_ankle")),
    ],
)
def test_the_limb_that_the_caption_names_is_the_one_that_moves(clips, actions, joints):
    body, checked = get_skeleton("humanml3d"), 0
    for clip in single(clips, *actions):
        side = side_of(clip)
        if side is None or "both" in clip.captions[0].caption.text:
            continue
        left, right = (np.ptp(clip.joints()[:, body.joint_names.index(j)], axis=0).sum() for j in joints)
        assert (left > right) == (side == "left"), clip.captions[0].caption.text
        checked += 1
    assert checked > 5


def test_turns_go_where_the_caption_says(clips):
    checked = 0
    for clip in single(clips, "turn around", "spin"):
        texts = " ".join(c.caption.text for c in clip.captions)
        left = "counterclockwise" in texts or "to the left" in texts
        across = clip.joints()[:, 1] - clip.joints()[:, 2]
        yaw = np.unwrap(np.arctan2(-across[:, 2], across[:, 0]))
        angle = yaw[-1] - yaw[0]
        assert abs(angle) > 1
        assert (angle > 0) == left, texts
        checked += 1
    assert checked > 5


@pytest.mark.parametrize("name", ["squat", "bow", "jump"])
def test_things_are_done_as_often_as_the_caption_says(clips, name):
    checked = 0
    for clip in single(clips, name):
        words = re.findall(r"\w+", clip.captions[0].caption.text)
        said = [NUMBERS[w] for w in words if w in NUMBERS] or [1]
        joints = clip.joints()
        height = joints[:, 0, 1] if name == "squat" else joints[:, 15, 1] - joints[:, 0, 1]
        low = height < height.max() - 0.5 * np.ptp(height)
        if name == "jump":
            low = joints[:, [7, 8, 10, 11], 1].min(1) > 0.03
        assert np.count_nonzero(np.diff(low.astype(int)) == 1) == said[0], clip.captions[0].caption.text
        checked += 1
    assert checked > 2


def test_manners_are_visible(clips):
    def speed(style: str) -> float:
        tracks = [performed("walk", seed, style=style)[0] for seed in range(6)]
        return float(np.mean([np.linalg.norm(np.diff(t.root[:, [0, 2]], axis=0), axis=1).mean() for t in tracks]))

    assert speed("slow") < 0.75 * speed("neutral") < 0.75 * 0.8 * speed("fast")
    body = Body.average("humanml3d")
    lean = {s: pose(body, performed("wave", 1, style=s)[0])[:, 12, 2].mean() for s in ("old", "neutral", "proud")}
    assert lean["old"] > lean["neutral"] + 0.1
    assert lean["proud"] < lean["neutral"] - 0.03
    assert {c.fields["style"] for c in clips} == set(STYLES)


def test_two_actions_follow_each_other_without_a_slide():
    body = Body.average("humanml3d")
    toes = [body.skeleton.feet_left[1], body.skeleton.feet_right[1]]
    for seed, (one, other) in enumerate([("walk", "wave"), ("turn around", "squat"), ("sidestep", "bow")]):
        first, second = (performed(name, seed, closed=True)[0] for name in (one, other))
        joints = pose(body, first.then(second, 6))
        step = np.linalg.norm(np.diff(joints[:, toes], axis=0), axis=-1)
        assert step.min(1).max() < 1e-3
        assert step[first.frames - 8 : first.frames + 2].max() < 1e-3


def test_captions_carry_humanml3d_tokens(clips):
    for clip in clips:
        assert len(clip.captions) == 3
        for annotated in clip.captions:
            caption = annotated.caption
            assert caption.text == caption.text.lower()
            assert len(caption.tokens) == len(caption.text.replace(",", "").split())
            words, tags = zip(*(t.split("/") for t in caption.tokens), strict=True)
            assert set(tags) <= UNIVERSAL
            assert "{" not in caption.text
            assert "*" not in caption.text
            for side in ("left", "right", "clockwise", "counterclockwise"):
                assert words.count(side) == caption.text.replace(",", "").split().count(side)
    kicks = [c.caption for clip in single(clips, "kick") for c in clip.captions]
    assert any("kicks" in c.text and "kick/VERB" in c.tokens for c in kicks)


def test_the_corpus_is_diverse_and_pools_rarely_hold_duplicates(clips):
    assert len(ACTIONS) >= 20
    assert len({c.fields["action"] for c in clips if "+" not in c.fields["action"]}) >= 30
    shown = [
        re.sub(r"^(.*, )?(the|a|some)\s?(person|man|woman|figure|human|one|body)", r"\1", c.captions[0].caption.text)
        for c in clips
    ]
    rng = np.random.default_rng(0)
    repeated = [32 - len(set(rng.choice(shown, 32, replace=False))) for _ in range(50)]
    assert np.mean(repeated) < 0.5


def test_tagged_captions_are_about_a_part_long_enough(clips):
    tagged = [(c, a) for c in clips for a in c.captions if a.tagged]
    assert 0.05 < len(tagged) / len(clips) < 0.25
    for clip, annotated in tagged:
        rows = len(clip.joints()) - 1
        assert 0 <= annotated.start < annotated.end <= rows / 20 + 0.051
        assert min(int(annotated.end * 20), rows) - int(annotated.start * 20) >= 40
        assert any(not a.tagged for a in clip.captions)
    assert not any(a.tagged for c in synthetic_clips(size=60, skeleton="kit") for a in c.captions)


def test_folders_are_read_back_as_written(tmp_path):
    clips = list(synthetic_clips(size=12, seed=1))
    catalog = read_joints_folder(write_joints_folder(clips, tmp_path / "joints-corpus"))
    assert catalog.dropped == []
    for clip, back in zip(clips, catalog.clips, strict=True):
        assert (clip.name, clip.split, clip.captions, clip.fields) == (
            back.name,
            back.split,
            back.captions,
            back.fields,
        )
        np.testing.assert_array_equal(clip.joints(), back.joints())


def test_a_folder_is_written_whole_or_not_at_all(tmp_path):
    clips = list(synthetic_clips(size=3, seed=1))
    broken = replace(clips[-1], joints=None, features=clips[-1].joints)
    with pytest.raises(ValueError, match="only clips of joints"):
        write_joints_folder([*clips[:-1], broken], tmp_path / "corpus")
    assert list(tmp_path.iterdir()) == []
    write_joints_folder(clips, tmp_path / "corpus")
    with pytest.raises(ValueError, match="exists; choose another"):
        write_joints_folder(clips, tmp_path / "corpus")


@pytest.mark.parametrize("skeleton", SKELETONS)
def test_official_folders_hold_mirrored_clips_and_statistics(tmp_path, skeleton):
    clips = list(synthetic_clips(size=10, seed=1, skeleton=skeleton))
    catalog = read_official(write_official_folder(clips, tmp_path / "official", skeleton), skeleton)
    assert len(catalog.clips) == 20
    assert sum(c.mirrored for c in catalog.clips) == 10
    assert catalog.statistics is not None
    named = {c.name: c for c in catalog.clips}
    clip = clips[0]
    assert named[f"M{clip.name}"].captions == [c.mirrored() for c in clip.captions]
    assert named[clip.name].features().shape == (len(clip.joints()) - 1, get_skeleton(skeleton).feature_width)
