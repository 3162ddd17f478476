from __future__ import annotations

import subprocess
import sys
from itertools import pairwise

import numpy as np
import pytest

from kinema.motion.skeleton import SKELETONS, get_skeleton

BOTH = [pytest.param(s, id=s.name) for s in SKELETONS.values()]


@pytest.mark.parametrize("skeleton", BOTH)
def test_tables_describe_one_tree(skeleton):
    n = skeleton.num_joints
    assert len(skeleton.parents) == len(skeleton.rest_directions) == n
    assert skeleton.parents[0] == -1
    for joint, parent in enumerate(skeleton.parents[1:], start=1):
        assert skeleton.ancestry[joint].sum() == 1 + skeleton.ancestry[parent].sum()
    np.testing.assert_array_equal(np.linalg.norm(skeleton.rest_directions, axis=-1), [0] + [1] * (n - 1))


@pytest.mark.parametrize("skeleton", BOTH)
def test_sides_agree_by_name_and_tree(skeleton):
    names, mirrored = skeleton.joint_names, dict(skeleton.mirror_pairs)
    mirrored |= {right: left for left, right in skeleton.mirror_pairs}
    for left, right in skeleton.mirror_pairs:
        assert names[left].replace("left", "right") == names[right]
        parent = skeleton.parents[left]
        assert skeleton.parents[right] == mirrored.get(parent, parent)
    assert [names[j].split("_")[0] for j in skeleton.face_joints] == ["right", "left"] * 2
    assert [names[j].split("_")[0] for j in skeleton.feet_left + skeleton.feet_right] == ["left"] * 2 + ["right"] * 2


@pytest.mark.parametrize(("name", "full", "essential"), [("humanml3d", 263, 67), ("kit", 251, 64)])
def test_groups_tile_the_row(name, full, essential):
    skeleton = get_skeleton(name)
    assert (skeleton.feature_width, skeleton.essential_width) == (full, essential)
    starts_stops = [(c.start, c.stop) for c in skeleton.groups.values()]
    assert starts_stops[0][0] == 0
    assert starts_stops[-1][1] == full
    assert all(a[1] == b[0] for a, b in pairwise(starts_stops))


def test_an_unknown_name_lists_the_known():
    with pytest.raises(ValueError, match=r"'smplx'.*humanml3d, kit"):
        get_skeleton("smplx")


def test_importing_the_skeleton_does_not_import_torch():
    code = "import sys, kinema.motion.skeleton; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
