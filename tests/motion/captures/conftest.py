"""Make small BVH and ASF/AMC files of a body that is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinema.motion.captures.amass import BodyModels
from kinema.motion.captures.mapping import known_mappings
from kinema.motion.kinematics import place_joints
from kinema.motion.rig.pose import HUMANML3D_REST
from kinema.motion.skeleton import HUMANML3D

REST = HUMANML3D.rest_directions * HUMANML3D.bone_lengths[:, None]
SPELLED = {joint: next(iter(source)) for joint, source in known_mappings()["smpl"].joints.items()}


def bvh_text(
    angles: np.ndarray,
    *,
    scale: float = 1.0,
    order: str = "ZXY",
    interval: float = 1 / 30,
    turn: np.ndarray | None = None,
    root: np.ndarray | None = None,
) -> str:
    """Write SMPL's joints (T, 22, 3 angles in degrees, in the order's order) as BVH; `turn` changes the axes."""
    rest = REST * scale if turn is None else REST @ turn.T * scale
    names = [SPELLED[name] for name in HUMANML3D.joint_names]
    lines, order_of = ["HIERARCHY"], []

    def joint(index: int, depth: int) -> None:
        order_of.append(index)
        pad, children = "\t" * depth, [c for c, p in enumerate(HUMANML3D.parents) if p == index]
        lines.append(f"{pad}{'JOINT' if depth else 'ROOT'} {names[index]}")
        offset = " ".join(f"{v:.6f}" for v in rest[index])
        place = "Xposition Yposition Zposition " if depth == 0 else ""
        turns = " ".join(f"{a}rotation" for a in order)
        lines.extend([f"{pad}{{", f"{pad}\tOFFSET {offset}", f"{pad}\tCHANNELS {6 if place else 3} {place}{turns}"])
        for child in children:
            joint(child, depth + 1)
        if not children:
            lines.extend([f"{pad}\tEnd Site", f"{pad}\t{{", f"{pad}\t\tOFFSET 0 0 0", f"{pad}\t}}"])
        lines.append(f"{pad}}}")

    joint(0, 0)
    root = np.tile([0, scale, 0], (len(angles), 1)) if root is None else root
    lines += ["MOTION", f"Frames: {len(angles)}", f"Frame Time: {interval:.6g}"]
    for frame, place in zip(angles, root, strict=True):
        lines.append(" ".join(f"{v:.6f}" for v in [*place, *frame[order_of].reshape(-1)]))
    return "\n".join(lines) + "\n"


@pytest.fixture
def write(tmp_path):
    """Return a function that writes a file's text and gives its path."""

    def written(name: str, text: str) -> Path:
        path = tmp_path / name
        path.write_text(text)
        return path

    return written


ASF = """:version 1.10
:units
  length 0.45
  angle deg
:root
  order TX TY TZ RX RY RZ
  axis XYZ
  position 0 0 0
  orientation 0 0 0
:bonedata
  begin
    name thigh
    direction 0 -1 0
    length 2
    axis 0 0 20 XYZ
    dof rx ry rz
  end
  begin
    name shin
    direction 0 -1 0
    length 3
    axis 0 0 0 XYZ
    dof rx
  end
:hierarchy
  begin
    root thigh
    thigh shin
  end
"""
AMC = """:FULLY-SPECIFIED
:DEGREES
1
root 1 2 3 0 0 0
thigh 0 0 0
shin 0
2
root 1 2 3 0 90 0
thigh 90 0 0
shin 90
"""


STANDING = place_joints(np.array([0.0, 0.9, 0]), HUMANML3D_REST.directions * HUMANML3D.bone_lengths[:, None], HUMANML3D)


@pytest.fixture
def models(tmp_path):
    """Make up body models in a temporary folder."""
    return made_up_models(tmp_path)


def made_up_models(folder: Path) -> BodyModels:
    """Make up body models: 60 vertices, the first 52 of them the joints."""
    draw = np.random.default_rng(0)
    regressor = np.zeros((52, 60))
    regressor[np.arange(52), np.arange(52)] = 1
    template = np.concatenate([STANDING, draw.normal(size=(38, 3))])
    for gender, size in (("male", 1.1), ("female", 1.0)):
        (folder / "smplh" / gender).mkdir(parents=True)
        (folder / "dmpls" / gender).mkdir(parents=True)
        shapes = draw.normal(size=(60, 3, 16)) * 0.01
        np.savez(
            folder / "smplh" / gender / "model.npz",
            J_regressor=regressor,
            v_template=template * size,
            shapedirs=shapes,
        )
        np.savez(folder / "dmpls" / gender / "model.npz", eigvec=draw.normal(size=(60, 3, 12)) * 0.01)
    return BodyModels(folder / "smplh", folder / "dmpls")


def archive(path, frames=7, **changes):
    """Write an AMASS archive of random poses; give its content and its path."""
    draw = np.random.default_rng(1)
    content = {
        "poses": draw.normal(size=(frames, 156)) * 0.3,
        "trans": draw.normal(size=(frames, 3)),
        "betas": draw.normal(size=16),
        "dmpls": draw.normal(size=(frames, 8)),
        "gender": np.array("male"),
        "mocap_framerate": np.array(120.0),
    } | changes
    np.savez(path, **{key: value for key, value in content.items() if value is not None})
    return content, path
