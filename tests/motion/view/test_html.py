"""Check the pages of players: nothing leaves the page, the joints survive, captions cannot inject anything."""

from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

import kinema.motion.view.html as viewer
from kinema.motion.skeleton import HUMANML3D, KIT
from kinema.motion.view.body import body_of, joint_sides
from kinema.motion.view.html import SCRIPTS, save_html, viewer_fragment
from kinema.motion.view.packed import pack, ranges, standing
from kinema.types import Motion


class Players(HTMLParser):
    """Collect the attributes of every player and the names of all tags."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.players: list[dict[str, str]] = []
        self.tags: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        if tag == "figure":
            self.players.append(dict(attrs))


@pytest.fixture
def motion(wander) -> Motion:
    return Motion(wander(HUMANML3D, 50), np.zeros((50, 263), np.float32), "a person walks", "humanml3d", 20.0, seed=3)


def unpack(player: dict[str, str], joints: int) -> np.ndarray:
    motion = json.loads(player["data-motion"])
    integers = np.frombuffer(base64.b64decode(motion["joints"]), "<i2").reshape(-1, joints, 3)
    return integers * motion["scale"] + np.array(motion["centre"])


@pytest.mark.parametrize("skeleton", [HUMANML3D, KIT], ids=lambda s: s.name)
def test_page_holds_the_joints_in_metres(wander, tmp_path, skeleton):
    joints = wander(skeleton, 40)
    motion = Motion(joints, np.zeros((40, 1)), "walk", skeleton.name, skeleton.fps)
    page = Players(save_html([motion], tmp_path / "page.html").read_text())
    shown = unpack(page.players[0], skeleton.num_joints)
    assert np.abs(shown - joints * skeleton.meters).max() < 1e-4  # a tenth of a millimetre
    assert float(page.players[0]["data-fps"]) == skeleton.fps


def test_quantisation_error_is_half_a_step():
    joints = np.random.default_rng(0).normal(scale=5, size=(30, 22, 3))
    packed = pack(joints)
    integers = np.frombuffer(base64.b64decode(packed.data), "<i2").reshape(joints.shape)
    error = np.abs(integers * packed.scale + packed.centre - joints).max()
    assert error <= packed.scale / 2 * (1 + 1e-9)
    assert np.abs(integers).max() == 32767  # the whole range is used


def test_page_needs_no_network(motion, tmp_path):
    text = save_html([motion], tmp_path / "page.html").read_text()
    assert not re.findall(r"https?://|@import|url\(|<link|<img|\bsrc=|\bfetch\(|XMLHttpRequest", text)


def test_captions_cannot_inject(motion, tmp_path):
    nasty = "</script><script>alert(1)</script><img src=x onerror='a'> \" ' & <b>"
    plain = Players(save_html([motion], tmp_path / "plain.html", title="t").read_text())
    page = Players(save_html([replace(motion, text=nasty)], tmp_path / "nasty.html", title=nasty).read_text())
    assert page.tags == plain.tags


def test_same_motions_give_the_same_bytes(motion, tmp_path):
    pages = [save_html([motion, motion], tmp_path / name).read_bytes() for name in ("a.html", "b.html")]
    assert pages[0] == pages[1]


def test_labels_and_groups(motion):
    other = replace(motion, text="a person jumps")
    motions, groups = [motion, motion, other], [motion.text, motion.text, other.text]
    text = viewer_fragment(motions, labels=["A", "B", "A"], groups=groups)
    assert text.count("<h3") == 2
    assert text.count("<div class='kinema-grid'>") == 2
    assert re.findall(r"kinema-label'>(\w)<", text) == ["A", "B", "A"]
    assert "<span class='kinema-caption'>" not in text  # the heading says it already
    with pytest.raises(ValueError, match="2 labels for 3 motions"):
        viewer_fragment(motions, labels=["A", "B"])


def test_broken_motion_is_named_instead_of_played(motion):
    joints = motion.joints.copy()
    joints[7:, 3] = np.nan
    text = viewer_fragment([motion, replace(motion, joints=joints)])
    assert "Not finite from frame 7" in text
    assert sum("data-motion" in player for player in Players(text).players) == 1


def test_bad_input_is_named(motion, tmp_path):
    with pytest.raises(ValueError, match=r"22, 3\); got \(50, 21, 3\)"):
        viewer_fragment([replace(motion, joints=motion.joints[:, :21])])
    with pytest.raises(ValueError, match="no motions"):
        save_html([], tmp_path / "page.html")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("skeleton", [HUMANML3D, KIT], ids=lambda s: s.name)
def test_sides_and_head(wander, skeleton):
    sides = joint_sides(skeleton)
    assert sides == tuple(name.startswith("right_") - name.startswith("left_") for name in skeleton.joint_names)
    assert [sides[j] for j in skeleton.face_joints] == [1, -1, 1, -1]
    body = body_of(Motion(wander(skeleton, 40), np.zeros((40, 1)), "", skeleton.name, skeleton.fps))
    assert sides[body.head] == 0
    assert body.head not in skeleton.parents
    assert 0.5 < body.stature < 3


@pytest.mark.parametrize("name", SCRIPTS)
def test_script_is_valid_javascript(name):
    node = shutil.which("node")
    if node is None:
        pytest.skip(f"node is not installed; it checks the syntax of {name}")
    script = Path(viewer.__file__).with_name(name)
    done = subprocess.run([node, "--check", str(script)], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("skeleton", [HUMANML3D, KIT], ids=lambda s: s.name)
def test_every_bone_is_a_limb_or_inside_the_trunk(wander, skeleton):
    body = body_of(Motion(wander(skeleton, 40), np.zeros((40, 1)), "", skeleton.name, skeleton.fps))
    names = skeleton.joint_names
    limbs = {"left_knee", "left_ankle", "left_elbow", "left_wrist", "right_elbow", "head"}
    assert limbs <= {names[joint] for joint in body.bones}
    assert {"left_hip", "right_hip", "left_shoulder", "right_shoulder", "pelvis"} <= {
        names[joint] for joint in (*body.trunk[0], *body.trunk[1])
    }
    assert not set(body.bones) & {joint for part in body.trunk for joint in part}
    assert [names[joint] for joint in body.hands] in (["left_wrist", "right_wrist"], ["right_wrist", "left_wrist"])
    assert {skeleton.parents[joint] for joint in body.bones} <= {*body.bones, *body.trunk[0], *body.trunk[1]}


def test_feet_that_stand_are_ranges(motion):
    still = np.repeat(motion.joints[:1], 50, axis=0)
    left, right = standing(replace(motion, joints=still))
    lowest = HUMANML3D.feet_left[-1], HUMANML3D.feet_right[-1]
    heights = [still[0, toe, 1] for toe in lowest]
    assert (left, right)[int(np.argmin(heights))] == [(0, 50)]
    assert standing(replace(motion, joints=still + np.linspace(0, 20, 50, dtype=np.float32)[:, None, None])) == [[], []]


def test_kept_frames_are_ranges(motion):
    mask = np.zeros(50, bool)
    mask[:10] = mask[40:] = mask[20] = True
    assert ranges(mask) == [(0, 10), (20, 21), (40, 50)]
    assert ranges(None) == ranges(np.zeros(5, bool)) == []
    (player,) = Players(viewer_fragment([replace(motion, kept=mask)])).players
    assert json.loads(player["data-motion"])["kept"] == [[0, 10], [20, 21], [40, 50]]
