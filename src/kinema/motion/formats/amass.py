"""Write a rig as an AMASS archive (.amass.npz): poses of the mean SMPL-H body, Z up; SMPL's layout, hands at rest."""

from __future__ import annotations

import io

import numpy as np
from scipy.spatial.transform import Rotation

from kinema.motion.captures.amass import REST, UP
from kinema.motion.captures.capture import Capture

JOINTS, SHAPES, SOFT = 52, 16, 8
"""Joints of SMPL-H (the body's 22, then the hands'), shape and soft-tissue coefficients that AMASS' archives have."""
PELVIS = (-0.002, -0.223, 0.028)
"""Where the unposed mean body has its pelvis, in its own axes (Y up): `trans` moves the body from there."""
UPRIGHT = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""Stands a body of Y up in AMASS' world of Z up: what faced +Z faces -Y."""
ABOUT = (
    "AMASS' layout, written by Kinema: poses are axis-angle (T, 52 * 3), SMPL-H's order, hands at rest; metres, Z up; "
    "facing -Y where +Z was ahead. betas are zero: the mean body, whose bones are not the motion's own. rest_joints "
    "are the motion's own unposed joints (22, 3), Y up: with them in place of the body's, joints come out as fitted"
)


def amass_bytes(capture: Capture, *, title: str) -> bytes:
    """Write a rig in metres, Y up, whose rest pose is SMPL's."""
    turns = capture.rotations.copy()
    turns[:, 0] = UPRIGHT @ turns[:, 0]
    poses = np.zeros((capture.frames, JOINTS, 3))
    poses[:, : len(capture.names)] = Rotation.from_matrix(turns.reshape(-1, 3, 3)).as_rotvec().reshape(*turns.shape[:3])
    content = {
        "poses": poses.reshape(capture.frames, -1),
        "trans": capture.translations[:, 0] @ UPRIGHT.T - PELVIS,
        "betas": np.zeros(SHAPES),
        "dmpls": np.zeros((capture.frames, SOFT)),
        "gender": np.array("neutral"),
        "mocap_framerate": np.array(float(capture.fps)),
        UP: np.array("z"),
        REST: capture.rest_positions - capture.rest_positions[0] + PELVIS,
        "text": np.array(title),
        "about": np.array(ABOUT),
    }
    buffer = io.BytesIO()
    np.savez(buffer, **content)
    return buffer.getvalue()
