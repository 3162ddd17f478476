"""GLB and VRMA: what a reader makes of the file is the fitted motion."""

from __future__ import annotations

import json
import struct

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinema.data.synthetic import synthetic_catalog
from kinema.motion.formats.glb import glb_bytes, vrma_bytes
from kinema.motion.rig.figure import build_figure
from kinema.motion.rig.fit import fit_rig
from kinema.motion.rig.pose import HUMANML3D_REST
from kinema.motion.skeleton import HUMANML3D

DTYPES = {5126: "<f4", 5121: "u1", 5123: "<u2"}
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class Read:
    """Read a GLB by the specification: header, two chunks, accessors."""

    def __init__(self, content: bytes) -> None:
        magic, version, length = struct.unpack_from("<4sII", content)
        assert (magic, version, length) == (b"glTF", 2, len(content))
        size, kind = struct.unpack_from("<I4s", content, 12)
        assert kind == b"JSON"
        self.json = json.loads(content[20 : 20 + size])
        binary, kind = struct.unpack_from("<I4s", content, 20 + size)
        assert kind == b"BIN\0"
        self.buffer = content[28 + size :]
        assert binary == len(self.buffer) == self.json["buffers"][0]["byteLength"]

    def array(self, accessor: int) -> np.ndarray:
        """Read an accessor's rows; offsets are multiples of its components' size."""
        found = self.json["accessors"][accessor]
        view, dtype = self.json["bufferViews"][found["bufferView"]], DTYPES[found["componentType"]]
        assert view["byteOffset"] % 4 == 0
        width = WIDTHS[found["type"]]
        values = np.frombuffer(self.buffer, dtype, found["count"] * width, view["byteOffset"]).reshape(-1, width)
        if "min" in found:
            np.testing.assert_allclose(values.min(0), found["min"])
            np.testing.assert_allclose(values.max(0), found["max"])
        return values

    def global_turns(self) -> tuple[np.ndarray, np.ndarray]:
        """Play the animation: every node's turn and place in every frame."""
        (animation,), nodes = self.json["animations"], self.json["nodes"]
        moved = {
            (c["target"]["node"], c["target"]["path"]): animation["samplers"][c["sampler"]]
            for c in animation["channels"]
        }
        frames = len(self.array(moved[0, "translation"]["input"]))
        turns, places = np.empty((frames, 22, 3, 3)), np.empty((frames, 22, 3))
        parents = {child: node for node, content in enumerate(nodes) for child in content.get("children", [])}
        for node in range(22):
            own = Rotation.from_quat(self.array(moved[node, "rotation"]["output"])).as_matrix()
            if node == 0:
                turns[:, 0], places[:, 0] = own, self.array(moved[0, "translation"]["output"])
                continue
            parent = parents[node]
            turns[:, node] = turns[:, parent] @ own
            places[:, node] = places[:, parent] + turns[:, parent] @ np.array(nodes[node]["translation"])
        return turns, places


@pytest.fixture(scope="module")
def fitted():
    clip = next(iter(synthetic_catalog(size=4, seed=0)))
    return fit_rig(clip.joints(), HUMANML3D_REST, 20)


def test_a_reader_sees_the_fitted_positions_at_their_times(fitted):
    read = Read(glb_bytes(fitted, HUMANML3D, title="a walk"))
    _, places = read.global_turns()
    np.testing.assert_allclose(places, fitted.positions, atol=1e-5)
    times = read.array(read.json["animations"][0]["samplers"][0]["input"])
    np.testing.assert_allclose(np.diff(times[:, 0]), 0.05, atol=1e-5)


def test_quaternions_go_the_short_way(fitted):
    read = Read(glb_bytes(fitted, HUMANML3D, title="a walk"))
    for sampler in read.json["animations"][0]["samplers"][1:]:
        quaternions = read.array(sampler["output"])
        assert (np.einsum("ti,ti->t", quaternions[1:], quaternions[:-1]) >= 0).all()


def test_the_skin_rests_where_the_skeleton_does(fitted):
    read = Read(glb_bytes(fitted, HUMANML3D, title="a walk"))
    inverse = read.array(read.json["skins"][0]["inverseBindMatrices"]).reshape(-1, 4, 4).swapaxes(1, 2)
    at_rest = np.concatenate([fitted.rest_positions, np.ones((22, 1))], 1)
    np.testing.assert_allclose(np.einsum("jab,jb->ja", inverse, at_rest), [[0, 0, 0, 1]] * 22, atol=1e-6)
    primitive = read.json["meshes"][0]["primitives"][0]
    assert read.array(primitive["attributes"]["JOINTS_0"])[:, 0].max() < 22
    np.testing.assert_array_equal(read.array(primitive["attributes"]["WEIGHTS_0"]).sum(1), 1)


def test_the_figure_is_closed_and_seen_from_outside(fitted):
    figure = build_figure(fitted.rest_positions, HUMANML3D)
    corners = figure.vertices[figure.triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outward = np.einsum("fi,fi->f", across, figure.normals[figure.triangles].mean(1))
    assert (outward > -1e-9).all()
    assert (outward > 0).mean() > 0.8
    left = figure.vertices[figure.vertices[:, 0] > 0.2]
    mirrored = figure.vertices[figure.vertices[:, 0] < -0.2] * [-1, 1, 1]
    assert abs(left.mean(0) - mirrored.mean(0)).max() < 0.02


def test_a_vrma_names_every_bone_of_a_human(fitted):
    read = Read(vrma_bytes(fitted, title="a walk"))
    bones = read.json["extensions"]["VRMC_vrm_animation"]["humanoid"]["humanBones"]
    assert len(bones) == 22
    assert bones["hips"]["node"] == 0
    assert read.json["nodes"][bones["rightLowerArm"]["node"]]["name"] == "RightForeArm"
    np.testing.assert_allclose(read.global_turns()[1], fitted.positions, atol=1e-5)
    assert "meshes" not in read.json
