"""Skeletons are recognised by their joints' names; a user's own mapping is one file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinema.motion.captures.mapping import find_mapping, known_mappings, read_mapping
from kinema.motion.skeleton import HUMANML3D

KNOWN = known_mappings()


@pytest.mark.parametrize("name", KNOWN)
def test_a_skeleton_is_recognised_by_its_joints_whatever_stands_before_them(name):
    sources = sorted({source for weights in KNOWN[name].joints.values() for source in weights})
    assert find_mapping(tuple(sources), Path("a.bvh")) is KNOWN[name]
    assert find_mapping(("other", *(f"rig:{s.upper()}" for s in sources)), Path("a.bvh")) is KNOWN[name]


@pytest.mark.parametrize("prefix", ["mixamorig:", "mixamorig1:", "mixamorig_", "mixamorig", "Armature|mixamorig4:"])
def test_mixamos_prefix_is_left_out_however_it_was_carried_over(prefix):
    sources = {source for weights in KNOWN["mixamo"].joints.values() for source in weights}
    assert find_mapping(tuple(f"{prefix}{source}" for source in sorted(sources)), Path("a.bvh")) is KNOWN["mixamo"]


def test_the_nearest_skeleton_lacks_the_smallest_share_of_its_joints():
    sources = sorted({source for weights in KNOWN["mixamo"].joints.values() for source in weights} - {"Spine2"})
    with pytest.raises(ValueError, match="nearest is mixamo, which needs Spine2 too"):
        find_mapping(tuple(sources), Path("a.bvh"))


@pytest.mark.parametrize("name", KNOWN)
def test_left_and_right_are_each_others_mirror_image(name):
    def side(joint: str) -> str:
        return joint.replace("left_", "*").replace("right_", "left_").replace("*", "right_")

    joints = KNOWN[name].joints
    for joint, sources in joints.items():
        assert sorted(sources.values()) == sorted(joints[side(joint)].values())
        assert joint == side(joint) or sources != joints[side(joint)]


def test_weights_make_means_of_source_joints():
    names = tuple(sorted({s for w in KNOWN["daz"].joints.values() for s in w}))
    weights = KNOWN["daz"].weights(names, HUMANML3D)
    np.testing.assert_allclose(weights.sum(1), 1)
    assert weights[0, names.index("hip")] == 0.5


GOOD = (Path(__file__).parents[3] / "src/kinema/motion/captures/mappings/smpl.yaml").read_text()
BROKEN = {
    "no joints": ("title: x", "needs `joints:`"),
    "a joint too few": (GOOD.replace("  head: Head\n", ""), "lacks joint 'head'"),
    "a joint too many": (GOOD + "  tail: Tail\n", "has the unknown joint 'tail'"),
    "shares that don't sum to one": (GOOD.replace("head: Head", "head: {Head: .5, Neck: .4}"), "sum to 1"),
    "a list": (GOOD.replace("head: Head", "head: [Head]"), "sum to 1"),
    "an unknown key": ("units: cm\n" + GOOD, "unknown key 'units'"),
    "a scale of text": ("scale: cm\n" + GOOD, "scale=cm"),
    "frames of text": ("skip_frames: few\n" + GOOD, "skip_frames=few"),
    "no YAML": ("a: [", "is no YAML"),
}


@pytest.mark.parametrize("kind", BROKEN)
def test_what_is_wrong_with_a_mapping_is_one_clear_error(kind, write):
    text, message = BROKEN[kind]
    with pytest.raises(ValueError, match=message) as caught:
        read_mapping(write("own.yaml", text))
    assert "own.yaml" in str(caught.value)
    assert "\n" not in str(caught.value)
