"""Turn Euler angles of capture files into matrices."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def euler(axes: str, angles: Float[np.ndarray, "t a"], *, degrees: bool) -> Float[np.ndarray, "t 3 3"]:
    """Multiply turns about the own axes `axes` ("zxy") from left to right: R = R_z R_x R_y.

    There may be none or many of them, one axis several times (scipy's and roma's take three different ones).
    """
    found = np.tile(np.eye(3), (len(angles), 1, 1))
    for axis, angle in zip(axes, (np.radians(angles) if degrees else angles).T, strict=True):
        turn = np.tile(np.eye(3), (len(angles), 1, 1))
        first, second = ((1, 2), (2, 0), (0, 1))["xyz".index(axis)]
        turn[:, first, first] = turn[:, second, second] = np.cos(angle)
        turn[:, second, first] = np.sin(angle)
        turn[:, first, second] = -np.sin(angle)
        found = found @ turn
    return found
