"""BVH: any channel order, units, axes and rates; what is wrong with a file is said in one line."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.motion.captures.conftest import REST, SPELLED, bvh_text

from kinema import cli
from kinema.motion.captures import capture
from kinema.motion.captures.bvh import read_bvh
from kinema.motion.captures.reading import captured_joints, read_capture
from kinema.motion.convention import Convention
from kinema.motion.formats.arrays import load_npz
from kinema.motion.kinematics import bone_lengths
from kinema.motion.recording import read_recording
from kinema.motion.skeleton import HUMANML3D

ANGLES = np.random.default_rng(0).uniform(-40, 40, (12, 22, 3))
TO_Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


def expected(angles: np.ndarray, order: str = "ZXY") -> np.ndarray:
    """Walk the tree with scipy's intrinsic Euler angles."""
    turned, found = [], []
    for joint, parent in enumerate(HUMANML3D.parents):
        own = Rotation.from_euler(order, angles[:, joint], degrees=True)
        turned.append(own if parent < 0 else turned[parent] * own)
        start = np.tile([0, 1.0, 0], (len(angles), 1)) if parent < 0 else found[parent]
        found.append(start + (0 if parent < 0 else turned[parent].apply(REST[joint])))
    return np.stack(found, 1)


@pytest.mark.parametrize("order", ["ZXY", "XYZ", "YXZ", "ZYX", "YZX", "XZY"])
def test_channels_turn_in_the_order_they_stand_in(order, write):
    path = write("a.bvh", bvh_text(ANGLES, order=order, interval=0.05))
    joints, understood = captured_joints(read_capture(path), path, up="y", scale=1)
    np.testing.assert_allclose(joints, expected(ANGLES, order), atol=1e-5)
    assert (understood.mapping, understood.fps) == ("SMPL", 20)


def test_position_channels_replace_an_offset_but_for_the_root_which_adds_them(write):
    text = """HIERARCHY
ROOT a
{
  OFFSET 1 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT b c
  {
    OFFSET 0 5 0
    CHANNELS 6 Zposition Yposition Xposition Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0 0 2
    }
  }
}
MOTION
Frames: 1
Frame Time: .0333
10 20 30 90 0 0 3 2 1 0 0 0
"""
    capture = read_bvh(write("a.bvh", text))
    assert capture.names == ("a", "b c", "b c_end")
    assert capture.fps == pytest.approx(1 / 0.0333)
    np.testing.assert_allclose(capture.positions[0], [[11, 20, 30], [9, 21, 33], [9, 21, 35]], atol=1e-12)


@pytest.mark.parametrize("unit", [1.0, 0.01, 0.001, 0.0254])
def test_a_unit_is_found_from_the_body_in_any_pose(unit, write):
    path = write("a.bvh", bvh_text(ANGLES, scale=1 / unit))
    joints, understood = captured_joints(read_capture(path), path)
    assert understood.scale == pytest.approx(unit)
    assert understood.guessed_scale
    np.testing.assert_allclose(bone_lengths(joints, HUMANML3D)[0], HUMANML3D.bone_lengths, atol=2e-4)
    assert "30 fps, y up, guessed scale" in str(understood)


@pytest.mark.parametrize(("up", "turn"), [("z", TO_Z_UP), ("-y", np.diag([1.0, -1, -1])), ("-z", TO_Z_UP.T)])
def test_another_axis_up_is_found_and_turned_not_mirrored(up, turn, write):
    still = np.zeros((12, 22, 3))
    root = np.tile(turn @ [0, 1, 0], (12, 1))
    path = write("a.bvh", bvh_text(still, turn=turn, root=root))
    joints, understood = captured_joints(read_capture(path), path)
    assert understood.up == up
    np.testing.assert_allclose(joints[0], expected(still)[0], atol=2e-5)


def test_a_rest_pose_in_front_is_left_out_and_said(write):
    moving = ANGLES[:1] + np.arange(12)[:, None, None]
    path = write("a.bvh", bvh_text(np.concatenate([np.zeros((2, 22, 3)), moving]), interval=0.05))
    joints, understood = captured_joints(read_capture(path), path, up="y")
    np.testing.assert_allclose(joints, expected(moving), atol=1e-5)
    assert "2 frames of a rest pose left out" in str(understood)


def test_a_rest_pose_that_no_leap_ends_is_kept_and_said(write):
    moving = np.arange(12)[:, None, None] * np.ones((1, 22, 3))  # two frames of nothing, and as much a frame after them
    path = write("a.bvh", bvh_text(np.concatenate([np.zeros((1, 22, 3)), moving]), interval=0.05))
    joints, understood = captured_joints(read_capture(path), path, up="y")
    assert len(joints) == 13
    assert "the first 2 frames are without rotations, a rest pose perhaps, and were kept" in str(understood)


@pytest.mark.parametrize("unit", [1.0, 100.0])
def test_a_body_whose_root_stands_in_its_offset_and_its_channels_stays_on_the_floor(unit, write):
    """Blender writes the hips' rest place as OFFSET and where they are into the channels."""
    text, height = bvh_text(ANGLES, scale=unit, interval=0.05), -(HUMANML3D.ancestry[10] @ REST)[1]
    lifted = text.replace(*spelled(height * unit), 1)
    assert lifted != text
    path = write("a.bvh", lifted)
    joints, understood = captured_joints(read_capture(path), path, up="y", scale=1 / unit)
    np.testing.assert_allclose(joints, expected(ANGLES), atol=1e-5)
    assert "the root's OFFSET, which would lift the body off the floor" in str(understood)
    # One whose channels start at the rest pose has its height from the OFFSET.
    below = np.tile([0, (1 - height) * unit, 0], (12, 1))
    path = write("b.bvh", bvh_text(ANGLES, scale=unit, interval=0.05, root=below).replace(*spelled(height * unit), 1))
    joints, understood = captured_joints(read_capture(path), path, up="y", scale=1 / unit)
    np.testing.assert_allclose(joints, expected(ANGLES), atol=1e-5)
    assert not understood.notes


def spelled(height: float) -> tuple[str, str]:
    return "OFFSET 0.000000 0.000000 0.000000", f"OFFSET 0 {height:.6f} 0"


@pytest.mark.parametrize(
    ("theirs", "ours"),
    [("End Site", "End site"), ("End Site", "END SITE"), ("Frames: 12", "Frames:12"), ("Frame Time: ", "Frame Time:")],
)
def test_what_programs_spell_otherwise_is_read(theirs, ours, write):
    usual, other = bvh_text(ANGLES), bvh_text(ANGLES).replace(theirs, ours)
    assert usual != other
    found = [read_bvh(write(f"{i}.bvh", text)).positions for i, text in enumerate((usual, other))]
    np.testing.assert_array_equal(*found)


def test_a_turn_is_resampled_along_its_arc(write):
    angles = np.zeros((31, 22, 3))
    angles[:, 0, 0] = np.arange(31) * 40.0  # degrees about Z a frame at 30 fps
    path = write("a.bvh", bvh_text(angles))
    joints, _ = captured_joints(read_capture(path), path, up="y", scale=1)
    assert len(joints) == 21
    np.testing.assert_allclose(bone_lengths(joints, HUMANML3D), np.tile(HUMANML3D.bone_lengths, (21, 1)), atol=1e-5)
    exact = angles[:1].repeat(21, 0)
    exact[:, 0, 0] = np.arange(21) * 60.0
    np.testing.assert_allclose(joints, expected(exact), atol=1e-4)


def test_the_rate_of_a_file_that_lies_can_be_given(write):
    path = write("a.bvh", bvh_text(ANGLES, interval=0.05))
    joints, understood = captured_joints(read_capture(path), path, up="y", scale=1, fps=40)
    assert (len(joints), understood.fps) == (6, 40)
    np.testing.assert_allclose(joints, expected(ANGLES[::2]), atol=1e-5)


GOOD = bvh_text(ANGLES)
BROKEN = {
    "cut off in the middle of the frames": (GOOD[: int(len(GOOD) * 0.8)], "it is cut off"),
    "cut off in the hierarchy": (GOOD[:700], "no MOTION section"),
    "a brace too few": (GOOD.replace("}\nMOTION", "MOTION"), "is cut off in"),
    "one channel too few": (
        GOOD.replace("CHANNELS 3 Zrotation Xrotation Yrotation", "CHANNELS 2 Zrotation Xrotation", 1),
        "CHANNELS aren't",
    ),
    "no frames": (GOOD.replace("Frames: 12", "Frames: 0"), "has no frames"),
    "frames that aren't there": (GOOD.replace("Frames: 12", "Frames: 1000000000000"), "holds 828"),
    "NaN": (GOOD.rstrip().rpartition(" ")[0] + " nan", "nan in the motion (number 828)"),
    "two roots": (GOOD.replace("MOTION", "ROOT second\n{\nOFFSET 0 0 0\nCHANNELS 0\n}\nMOTION"), "second ROOT"),
    "a joint twice": (GOOD.replace("JOINT L_Knee", "JOINT L_Hip"), "several joints 'L_Hip'"),
    "an unknown channel": (GOOD.replace("Zrotation", "Wrotation", 1), "channel 'wrotation'"),
    "no frame time": (GOOD.replace("Frame Time: 0.0333333", ""), "`Frame Time: seconds`"),
    "a frame time in milliseconds": (GOOD.replace("0.0333333", "33.3"), "Frame Time 33.3"),
    "a word among the numbers": (GOOD.replace("OFFSET 0.103074", "OFFSET wide"), "'wide' in joint"),
    "another file": ("<html>", "is no BVH file"),
    "nothing": ("", "is no BVH file"),
    "binary": ("\0\1\2", "is a binary file"),
    "no end of nesting": ("HIERARCHY ROOT a {" + "JOINT b {" * 3000 + "MOTION", "nests more than 200 joints"),
    "unknown joints": (GOOD.replace("L_Hip", "Tentacle"), "needs L_Hip too"),
    "a giant": (bvh_text(ANGLES, scale=7), "no human"),
}


@pytest.mark.parametrize("kind", BROKEN)
def test_what_is_wrong_with_a_file_is_one_clear_error(kind, write):
    text, message = BROKEN[kind]
    path = write("bad.bvh", text)
    with pytest.raises(ValueError, match=re.escape(message)) as caught:
        captured_joints(read_capture(path), path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["a.c3d", "a.fbx", "a.asf", "a.xyz", "a"])
def test_other_formats_are_refused_with_the_way_out(name, write):
    with pytest.raises(ValueError, match=name):
        read_capture(write(name, "x"))


def test_what_is_told_of_a_capture_is_believed(write):
    """Somebody lies throughout: found from the pose another axis is up."""
    angles = np.zeros((40, 22, 3))
    angles[:, 0, 1] = -90.0  # about X, the second of ZXY
    angles[:, 1, 1] = np.linspace(0, 30, 40)
    path = write("a.bvh", bvh_text(angles))
    assert "z up" in read_recording(path).note
    lying = read_recording(path, Convention(up="y"))
    assert "y up" in lying.note
    assert [problem.kind for problem in lying.problems()] == []


def test_a_rig_of_ones_own_is_read_by_a_mapping(write, tmp_path, capsys):
    theirs = {joint: f"rig_{joint}_jnt" for joint in HUMANML3D.joint_names}
    text, known = bvh_text(ANGLES), bvh_text(ANGLES)
    for joint, name in SPELLED.items():
        text = re.sub(rf"(ROOT|JOINT) {re.escape(name)}\n", rf"\1 {theirs[joint]}\n", text)
    path, other = write("rig.bvh", text), write("known.bvh", known)
    out = str(tmp_path / "out.npz")
    assert cli.main(["export", str(path), "--out", out]) == 2
    assert "--mapping FILE.yaml" in capsys.readouterr().err
    mapping = write("rig.yaml", "title: My rig\njoints:\n" + "".join(f"  {j}: {n}\n" for j, n in theirs.items()))
    assert cli.main(["export", str(path), "--mapping", str(mapping), "--out", out]) == 0
    assert "My rig" in capsys.readouterr().out
    np.testing.assert_allclose(load_npz(out).joints, read_recording(other).joints, atol=1e-5)


def test_joints_that_cost_a_file_nothing_do_not_fill_the_memory(tmp_path, monkeypatch):
    monkeypatch.setattr(capture, "MOST", 1000)
    file = tmp_path / "bomb.bvh"
    joints = (
        "".join(f"JOINT j{i} {{ OFFSET 0 1 0 CHANNELS 0 " for i in range(100))
        + "End Site { OFFSET 0 1 0 } "
        + "} " * 100
    )
    root = f"HIERARCHY ROOT hips {{ OFFSET 0 0 0 CHANNELS 3 Xposition Yposition Zposition {joints} }}"
    file.write_text(f"{root}\nMOTION\nFrames: 20\nFrame Time: 0.05\n" + "0 0 0\n" * 20)
    with pytest.raises(ValueError, match=r"bomb.bvh has 1\d\d joints in 20 frames; at most 1,000 places are read"):
        read_bvh(file)
