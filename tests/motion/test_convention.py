"""Foreign conventions: each leaves its mark on raw joints and is named with the option that mends it, which does so."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from kinema import cli
from kinema.data.synthetic import synthetic_clips
from kinema.motion.checks import check_clip
from kinema.motion.convention import AS_IS, ORDERS, Convention, named_order
from kinema.motion.geometry import likely_rate, pace
from kinema.motion.resampling import resampled
from kinema.motion.skeleton import HUMANML3D, KIT, SKELETONS, Skeleton

Foreign = Callable[[np.ndarray, Skeleton], np.ndarray]


def axes(*order: int, signs: tuple[int, int, int]) -> Foreign:
    """Write x, y, z of ours in other places."""
    return lambda joints, _: joints[..., list(order)] * signs


def ordered(order: str) -> Foreign:
    """Write joints in another order."""
    return lambda joints, skeleton: joints[:, [skeleton.joint_names.index(n) for n in named_order(order, skeleton)]]


def scaled(factor: float) -> Foreign:
    """Write joints in another unit."""
    return lambda joints, _: joints * factor


TURNS = {
    "z": axes(0, 2, 1, signs=(1, -1, 1)),
    "-z": axes(0, 2, 1, signs=(1, 1, -1)),
    "x": axes(1, 0, 2, signs=(1, -1, 1)),
    "-x": axes(1, 0, 2, signs=(-1, 1, 1)),
    "-y": axes(0, 1, 2, signs=(1, -1, -1)),
}
FOREIGN = [
    *(pytest.param(turn, "axis", f"--up {up} ", Convention(up=up), id=f"up {up}") for up, turn in TURNS.items()),
    *(
        pytest.param(ordered(order), "order", f"--order {order}", Convention(order=order), id=order)
        for order in ("limbs", "limbs-right", "trunk", "trunk-right")
    ),
    pytest.param(ordered("swapped"), "sides", "--order swapped", Convention(order="swapped"), id="swapped"),
    pytest.param(
        axes(0, 1, 2, signs=(-1, 1, 1)), "sides", "--handed left", Convention(handed="left"), id="left-handed"
    ),
    *(
        pytest.param(scaled(1 / unit), "unit", f"--scale {unit:g} ", Convention(scale=unit), id=f"unit {unit:g}")
        for unit in (0.001, 0.01, 0.0254, 0.1, 0.3048, 10, 100)
    ),
]


@pytest.fixture(scope="module")
def clips() -> dict[str, np.ndarray]:
    """Give a clip of either skeleton."""
    return {name: next(iter(synthetic_clips(size=1, seed=3, skeleton=name))).joints() for name in SKELETONS}


@pytest.mark.parametrize("up", TURNS)
def test_the_axis_that_is_named_can_be_typed_as_it_is_named(clips, up, tmp_path, capsys):
    file = tmp_path / "clip.npy"
    np.save(file, TURNS[up](clips["humanml3d"], HUMANML3D))
    assert cli.main(["doctor", str(file)]) == 1
    assert f"--up {up} " in capsys.readouterr().out
    assert cli.main(["doctor", str(file), "--up", up]) == 0


@pytest.mark.parametrize("skeleton", SKELETONS.values(), ids=SKELETONS)
@pytest.mark.parametrize(("write", "kind", "fix", "mend"), FOREIGN)
def test_what_is_foreign_is_named_and_mended_by_the_option_that_is_named(clips, skeleton, write, kind, fix, mend):
    ours = clips[skeleton.name]
    theirs = write(ours, skeleton)
    if skeleton is KIT and mend.order in ("trunk", "trunk-right"):  # KIT's own order, and that with sides exchanged
        assert [p.kind for p in check_clip(theirs, skeleton, skeleton.fps)] == ["sides"] * (mend.order == "trunk")
        return
    (problem,) = check_clip(theirs, skeleton, skeleton.fps)
    assert problem.kind == kind
    assert problem.fatal
    assert fix.strip() in problem.fix
    mended = mend.apply(theirs, skeleton)
    assert check_clip(mended, skeleton, skeleton.fps) == []
    np.testing.assert_allclose(mended, ours, rtol=1e-5, atol=1e-5 / skeleton.meters)


def test_an_order_is_told_by_names_and_others_are_passed_over(clips):
    ours = clips["humanml3d"]
    names = [*HUMANML3D.joint_names[::-1], "-"]
    theirs = np.concatenate([ours[:, ::-1], ours[:, :1]], axis=1)
    np.testing.assert_array_equal(Convention(order=",".join(names)).apply(theirs, HUMANML3D), ours)
    (problem,) = check_clip(theirs[:, :22], HUMANML3D, 20.0)
    assert "names of your joints" in problem.fix


def test_several_things_at_once_are_all_named(clips):
    theirs = TURNS["z"](clips["humanml3d"], HUMANML3D) * [-100, 100, 100]
    assert {p.kind for p in check_clip(theirs, HUMANML3D, 20.0)} == {"axis", "sides", "unit"}
    mended = Convention(up="z", handed="left", scale=0.01).apply(theirs, HUMANML3D)
    np.testing.assert_allclose(mended, clips["humanml3d"], atol=1e-5)


@pytest.mark.parametrize(
    ("kind", "told"),
    [
        ("axis", Convention(up="y")),
        ("sides", Convention(handed="right")),
        ("sides", Convention(order="own")),
        ("unit", Convention(scale=1.0)),
        ("order", Convention(order="own")),
    ],
)
def test_what_is_told_is_believed(clips, kind, told):
    ours = clips["humanml3d"]
    damages = {
        "axis": TURNS["z"](ours, HUMANML3D),
        "sides": ours * [-1, 1, 1],
        "unit": ours * 100,
        "order": ordered("limbs")(ours, HUMANML3D),
    }
    theirs = told.apply(damages[kind], HUMANML3D)
    np.testing.assert_array_equal(theirs, damages[kind])
    assert [p.kind for p in check_clip(theirs, HUMANML3D, 20.0)] == [kind]
    assert kind not in {p.kind for p in check_clip(theirs, HUMANML3D, 20.0, told)}


def test_nothing_told_changes_nothing(clips):
    ours = clips["kit"]
    assert AS_IS.apply(ours, KIT).base is ours or AS_IS.apply(ours, KIT) is ours
    assert not AS_IS.vouched


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("skeleton", SKELETONS.values(), ids=SKELETONS)
def test_a_named_order_has_every_joint_once(order, skeleton):
    assert sorted(named_order(order, skeleton)) == sorted(skeleton.joint_names)


@pytest.mark.parametrize(
    ("told", "words"),
    [
        ({"up": "w"}, "up='w'; choose one of x, y, z"),
        ({"handed": "both"}, "handed='both'; choose one of left, right"),
        ({"scale": 0}, "scale=0; it must be a positive number"),
        ({"scale": -1.0}, "positive"),
        ({"scale": float("nan")}, "positive"),
        ({"scale": float("inf")}, "positive"),
        ({"scale": "cm"}, "scale='cm'"),
        ({"scale": True}, "scale=True"),
        ({"fps": 0}, "fps=0"),
        ({"fps": 1e-9}, "fps=1e-09; motion has from 0.1 to 10000 frames a second"),
        ({"fps": "60"}, "fps='60'"),
        ({"fps": [60]}, r"fps=\[60\]"),
        ({"order": "limb"}, "it lacks pelvis"),
        ({"order": "pelvis,hip"}, "it lacks left_hip"),
        ({"order": ",".join([*HUMANML3D.joint_names, "tail"])}, "tail is none of its joints"),
        ({"order": ",".join([*HUMANML3D.joint_names, "head"])}, "it lacks head"),
    ],
)
def test_a_convention_that_cannot_be_is_one_error(told, words, clips):
    with pytest.raises(ValueError, match=words):
        Convention(**told).apply(clips["humanml3d"], HUMANML3D)


@pytest.mark.parametrize("fps", [10, 12.5, 24, 25, 30, 50, 60, 100, 119.88, 120])
def test_resampling_reads_a_straight_way_exactly(fps):
    time = np.arange(round(4 * fps) + 1) / fps
    way = time[:, None, None] * np.ones((1, 22, 3))
    found = resampled(way, fps, 20.0)
    assert abs(len(found) - 81) <= (fps % 1 != 0)
    np.testing.assert_allclose(found[:, 0, 0], np.arange(len(found)) / 20, atol=1e-9)


@pytest.mark.parametrize("ratio", [2, 3, 5, 6])
def test_a_whole_ratio_picks_frames(clips, ratio):
    joints = clips["humanml3d"].astype(np.float32)
    found = resampled(joints, 20.0 * ratio, 20.0)
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, joints[::ratio])


def test_resampling_keeps_what_has_the_rate_and_refuses_none():
    joints = np.zeros((5, 22, 3))
    assert resampled(joints, 20.0, 20.0) is joints
    with pytest.raises(ValueError, match="rates are positive"):
        resampled(joints, 0.0, 20.0)


@pytest.mark.parametrize("fps", [60, 100, 120])
def test_a_rate_is_guessed_from_how_people_move(fps):
    clips = [clip.joints() for clip in synthetic_clips(size=8, seed=1)]
    usual = float(np.median([pace(c) for c in clips]))
    assert likely_rate(usual, 20.0) is None
    fast = float(np.median([pace(resampled(c, 20.0, fps)[::1]) for c in clips]))
    assert fast < usual
    assert likely_rate(usual * 20 / fps, 20.0) in (50, 60, 100, 120)
    assert likely_rate(float("nan"), 20.0) is None


@pytest.mark.parametrize("skeleton", SKELETONS.values(), ids=SKELETONS)
def test_no_clip_of_ours_is_taken_for_foreign(skeleton):
    """Some stoop from first to last (seed 2, clip 18)."""
    for clip in synthetic_clips(size=60, seed=2, skeleton=skeleton.name):
        assert check_clip(clip.joints(), skeleton, skeleton.fps) == []


@pytest.mark.shared
@pytest.mark.slow
def test_no_clip_of_open_mocap_is_taken_for_foreign(open_mocap):
    files = sorted((open_mocap / "joints").glob("*.npy"))
    found = {f.stem: [p.kind for p in check_clip(np.load(f), HUMANML3D, 20.0)] for f in files}
    assert len(found) == 2817
    assert not {name: kinds for name, kinds in found.items() if kinds}


@pytest.mark.shared
@pytest.mark.parametrize(("write", "kind", "fix", "mend"), FOREIGN)
def test_real_clips_in_another_convention_are_found(open_mocap, write, kind, fix, mend):
    """People lie down: of 28 clips one may be missed."""
    clips = [np.load(f).astype(np.float64) for f in sorted((open_mocap / "joints").glob("*.npy"))[::103]]
    found = [{p.kind: p for p in check_clip(write(c, HUMANML3D), HUMANML3D, 20.0)} for c in clips]
    assert sum(kind in one and fix.strip() in one[kind].fix for one in found) >= len(clips) - 1
