"""ASF/AMC: bones turn in their own axes; what is wrong with a file is said in one line."""

from __future__ import annotations

import re

import numpy as np
import pytest
from tests.motion.captures.conftest import AMC, ASF

from kinema.motion.captures.asf import find_asf, read_amc


def test_a_bone_turns_in_its_own_axes_and_carries_its_children(write):
    write("a.asf", ASF)
    capture = read_amc(write("a_01.amc", AMC))
    assert capture.names == ("root", "thigh", "shin", "shin_end")
    np.testing.assert_allclose(capture.positions[0], [[1, 2, 3], [1, 2, 3], [1, 0, 3], [1, -3, 3]], atol=1e-12)
    # Turned about the bone's own x, which lies 20 degrees off: R = C M C^T, then the root's quarter about y.
    cos, sin = np.cos(np.radians(20)), np.sin(np.radians(20))
    axes = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    quarter = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    root = np.array([[0, 0, 1.0], [0, 1, 0], [-1, 0, 0]])
    thigh = root @ axes @ quarter @ axes.T
    knee = [1, 2, 3] + thigh @ [0, -2, 0]
    ankle = knee + thigh @ quarter @ [0, -3, 0]
    np.testing.assert_allclose(capture.positions[1, 2:], [knee, ankle], atol=1e-12)


def test_radians_are_read_where_the_motion_says_so(write):
    write("a.asf", ASF)
    turned = AMC.replace(":DEGREES", ":RADIANS").replace("90", f"{np.pi / 2}")
    np.testing.assert_allclose(
        read_amc(write("a_02.amc", turned)).positions, read_amc(write("a_01.amc", AMC)).positions, atol=1e-12
    )


def test_the_skeleton_is_found_by_its_name(write):
    write("1.asf", ASF)
    own = write("12.asf", ASF)
    assert find_asf(write("12_01.amc", AMC)) == own
    with pytest.raises(FileNotFoundError, match=r"found 1\.asf, 12\.asf"):
        find_asf(write("other.amc", AMC))


BROKEN = {
    "cut off in a frame": ((ASF, AMC[:-9]), "frame 2 lacks shin"),
    "no frames": ((ASF, ":DEGREES\n"), "has no frames"),
    "a bone too many": ((ASF, AMC.replace("shin 0", "shin 0\narm 3")), "'arm' is no moving bone"),
    "a value too many": ((ASF, AMC.replace("shin 0", "shin 0 1")), "line 6: 'shin' has 2 values"),
    "a bone twice": ((ASF, AMC.replace("shin 0", "shin 0\nshin 0")), "stands twice"),
    "NaN": ((ASF, AMC.replace("shin 0", "shin nan")), "nan in bone 'shin'"),
    "a word": ((ASF, AMC.replace("shin 0", "shin x")), "something else than numbers"),
    "no bones": ((ASF.replace(":bonedata", ":bones"), AMC), "no :bonedata section"),
    "an unknown bone in the hierarchy": ((ASF.replace("thigh shin", "thigh foot"), AMC), "names 'foot'"),
    "a bone on nothing": ((ASF.replace("root thigh", "shin thigh"), AMC), "hang on the root"),
    "a bone without length": ((ASF.replace("length 2", ""), AMC), "bone 'thigh' has no length"),
    "a bone that grows": ((ASF.replace("dof rx ry rz", "dof rx l"), AMC), "degree of freedom 'l'"),
    "a root that stays": ((ASF.replace("TX TY TZ ", ""), AMC), "needs TX TY TZ"),
}


@pytest.mark.parametrize("kind", BROKEN)
def test_what_is_wrong_with_a_file_is_one_clear_error(kind, write):
    (asf, amc), message = BROKEN[kind]
    write("a.asf", asf)
    with pytest.raises(ValueError, match=re.escape(message)) as caught:
        read_amc(write("a.amc", amc))
    assert "\n" not in str(caught.value)
