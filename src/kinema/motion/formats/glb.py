"""Write a rig as GLB (glTF 2.0, binary) or VRMA: a skeleton and one animation; metres, Y up, facing +Z at rest.

A GLB has a simple figure on its skeleton, a VRMA (VRMC_vrm_animation 1.0) says which bone is which of a human's, so
that it drives any VRM model.
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from kinema.motion.captures.capture import Capture
from kinema.motion.captures.mapping import known_mappings
from kinema.motion.rig.figure import build_figure
from kinema.motion.skeleton import Skeleton

TYPES = {"float32": 5126, "uint8": 5121, "uint16": 5123}
KINDS = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
ARRAY, ELEMENTS = 34962, 34963
"""What a buffer holds: vertices, or the indices of triangles."""
COLOUR = (0.45, 0.55, 0.7, 1.0)
HUMAN_BONES = {
    "pelvis": "hips",
    "spine1": "spine",
    "spine2": "chest",
    "spine3": "upperChest",
    "neck": "neck",
    "head": "head",
    "left_hip": "leftUpperLeg",
    "left_knee": "leftLowerLeg",
    "left_ankle": "leftFoot",
    "left_foot": "leftToes",
    "left_collar": "leftShoulder",
    "left_shoulder": "leftUpperArm",
    "left_elbow": "leftLowerArm",
    "left_wrist": "leftHand",
}
"""VRM's names; those of the right are alike."""


def vrma_bytes(capture: Capture, *, title: str) -> bytes:
    """Write a rig in metres and its animation, with the names of a human's bones."""
    file = _Gltf()
    bones = {_human(name): {"node": node} for node, name in enumerate(capture.names)}
    extension = {"specVersion": "1.0", "humanoid": {"humanBones": bones}}
    content = {
        **_scene(_nodes(capture), [0]),
        "animations": [_animation(capture, file, title)],
        "extensionsUsed": ["VRMC_vrm_animation"],
        "extensions": {"VRMC_vrm_animation": extension},
    }
    return file.binary(content)


def _human(name: str) -> str:
    return HUMAN_BONES[name.replace("right_", "left_")].replace(
        "left", "right" if name.startswith("right_") else "left"
    )


def _scene(nodes: list[dict[str, Any]], shown: list[int]) -> dict[str, Any]:
    asset = {"version": "2.0", "generator": "Kinema"}
    return {"asset": asset, "scene": 0, "scenes": [{"nodes": shown}], "nodes": nodes}


def glb_bytes(capture: Capture, skeleton: Skeleton, *, title: str) -> bytes:
    """Write a rig in metres, its figure and its animation."""
    file, nodes = _Gltf(), _nodes(capture)
    figure = build_figure(capture.rest_positions, skeleton)
    inverse = np.tile(np.eye(4), (len(nodes), 1, 1))
    inverse[:, :3, 3] = -capture.rest_positions
    attributes = {
        "POSITION": file.add(figure.vertices.astype("<f4"), ARRAY, bounds=True),
        "NORMAL": file.add(figure.normals.astype("<f4"), ARRAY),
        "JOINTS_0": file.add(np.pad(figure.joints[:, None], ((0, 0), (0, 3))).astype("u1"), ARRAY),
        "WEIGHTS_0": file.add(np.tile(np.array([1, 0, 0, 0], "<f4"), (len(figure.joints), 1)), ARRAY),
    }
    indices = file.add(figure.triangles.reshape(-1).astype("<u2"), ELEMENTS)
    joints = list(range(len(nodes)))
    body = len(nodes)
    nodes.append({"name": "Figure", "mesh": 0, "skin": 0})
    content = {
        **_scene(nodes, [0, body]),
        "meshes": [{"primitives": [{"attributes": attributes, "indices": indices, "material": 0}]}],
        "materials": [
            {"pbrMetallicRoughness": {"baseColorFactor": COLOUR, "metallicFactor": 0, "roughnessFactor": 0.8}}
        ],
        # Column-major, as glTF has matrices.
        "skins": [
            {
                "joints": joints,
                "skeleton": 0,
                "inverseBindMatrices": file.add(np.swapaxes(inverse, 1, 2).reshape(-1, 16).astype("<f4")),
            }
        ],
        "animations": [_animation(capture, file, title)],
    }
    return file.binary(content)


def _nodes(capture: Capture) -> list[dict[str, Any]]:
    """Describe the joints at rest."""
    nodes = []
    for joint, name in enumerate(capture.names):
        children = [c for c, parent in enumerate(capture.parents) if parent == joint]
        node = {
            "name": next(iter(known_mappings()["mixamo"].joints[name])),
            "translation": capture.rest[joint].tolist(),
        }
        nodes.append(node | ({"children": children} if children else {}))
    return nodes


def _animation(capture: Capture, file: _Gltf, title: str) -> dict[str, Any]:
    """Describe where the root is and how every joint turns, frame by frame."""
    times = file.add((np.arange(capture.frames) / capture.fps).astype("<f4"), bounds=True)
    quaternions = Rotation.from_matrix(capture.rotations.reshape(-1, 3, 3)).as_quat().reshape(capture.frames, -1, 4)
    # The nearer of q and -q, so that players that blend numbers go the short way.
    flips = np.einsum("tji,tji->tj", quaternions[1:], quaternions[:-1]) < 0
    signs = np.where(np.cumsum(flips, axis=0) % 2, -1, 1)
    quaternions[1:] *= signs[..., None]
    samplers = [{"input": times, "output": file.add(capture.translations[:, 0].astype("<f4"))}]
    channels = [{"sampler": 0, "target": {"node": 0, "path": "translation"}}]
    for joint in range(len(capture.names)):
        samplers.append({"input": times, "output": file.add(quaternions[:, joint].astype("<f4"))})
        channels.append({"sampler": len(samplers) - 1, "target": {"node": joint, "path": "rotation"}})
    return {"name": title, "samplers": samplers, "channels": channels}


class _Gltf:
    """Collect arrays into one buffer."""

    def __init__(self) -> None:
        self.buffer, self.views, self.accessors = bytearray(), list[dict[str, Any]](), list[dict[str, Any]]()

    def add(self, values: np.ndarray, target: int | None = None, *, bounds: bool = False) -> int:
        """Append an array, one row an element; `bounds` are required of positions and times."""
        rows = values.reshape(len(values), -1)
        self.views.append({"buffer": 0, "byteOffset": len(self.buffer), "byteLength": values.nbytes})
        if target is not None:
            self.views[-1]["target"] = target
        accessor = {
            "bufferView": len(self.views) - 1,
            "componentType": TYPES[values.dtype.name],
            "count": len(rows),
            "type": KINDS[rows.shape[1]],
        }
        if bounds:
            accessor |= {"min": rows.min(0).tolist(), "max": rows.max(0).tolist()}
        self.accessors.append(accessor)
        self.buffer += values.tobytes() + b"\0" * (-values.nbytes % 4)
        return len(self.accessors) - 1

    def binary(self, content: dict[str, Any]) -> bytes:
        """Write header, JSON and buffer as the two chunks of a GLB file."""
        content |= {
            "accessors": self.accessors,
            "bufferViews": self.views,
            "buffers": [{"byteLength": len(self.buffer)}],
        }
        text = json.dumps(content, separators=(",", ":"), allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text
        chunks += struct.pack("<I4s", len(self.buffer), b"BIN\0") + bytes(self.buffer)
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
