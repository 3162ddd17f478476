"""Draw a figure with matplotlib: the same camera and colours as the players in the browser, limbs as lines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from kinema.motion.view.body import LEFT, RIGHT, Body

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

COLOURS = {LEFT: "#2a6fe0", RIGHT: "#e2662a", 0: "#4a5365"}
STAGE, GRID, INK, MUTED, SHADOW, ACCENT = "#f6f8fa", "#c9d1dc", "#1b2130", "#636d80", "#dce1e8", "#2767d8"


@dataclass(frozen=True)
class Camera:
    """Look at `target` from `distance`, turned by `angle` about Y and raised by `pitch` (radians, metres)."""

    target: tuple[float, float, float]
    angle: float
    pitch: float
    distance: float

    def project(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Return screen x, y in metres at the target's depth, and the depth."""
        sin, cos = np.sin(self.angle), np.cos(self.angle)
        back = np.array([sin * np.cos(self.pitch), np.sin(self.pitch), cos * np.cos(self.pitch)])
        right = np.array([cos, 0.0, -sin])
        offset = points - np.asarray(self.target)
        depth = np.maximum(self.distance - offset @ back, 0.1 * self.distance)
        scale = self.distance / depth
        return np.stack([offset @ right * scale, offset @ np.cross(back, right) * scale, depth], axis=-1)


def facing(pose: Float[np.ndarray, "j 3"], body: Body) -> float:
    """Return the yaw of a pose: 0 where it faces +Z."""
    r_hip, l_hip, r_shoulder, l_shoulder = pose[list(body.face_joints)]
    across = l_hip - r_hip + l_shoulder - r_shoulder
    return float(np.arctan2(-across[2], across[0]))


def require_matplotlib() -> None:
    """Raise ImportError, with the fix, where there is no matplotlib."""
    try:
        import matplotlib.figure  # noqa: F401
    except ImportError as error:
        raise ImportError("drawing needs matplotlib: pip install 'kinema[viz]'") from error


def new_figure(width: float, height: float, dpi: int) -> Figure:
    """Make an Agg figure, whatever backend the caller's session uses."""
    return new_canvas(width, height, dpi).figure


def new_canvas(width: float, height: float, dpi: int) -> FigureCanvasAgg:
    """Make an Agg canvas with a figure of so many inches; its pixels can be read."""
    require_matplotlib()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    return FigureCanvasAgg(Figure(figsize=(width, height), dpi=dpi, facecolor=STAGE))


def draw_pose(axes: Axes, pose: Float[np.ndarray, "j 3"], body: Body, camera: Camera, at: float = 0.0) -> None:
    """Draw shadow, limbs (the far ones first) and head, shifted sideways by `at` metres."""
    shadow = camera.project(pose * (1, 0, 1))
    points = camera.project(pose)
    unit = _points_per_metre(axes) * body.stature
    bones = [(joint, parent) for joint, parent in enumerate(body.parents) if parent >= 0]
    _lines(axes, [shadow[[parent, joint]] for joint, parent in bones], at, SHADOW, 0.045 * unit, zorder=2)
    depths = {bone: float(points[list(bone), 2].mean()) for bone in bones}
    for order, (joint, parent) in enumerate(sorted(bones, key=depths.__getitem__, reverse=True)):
        side = body.sides[joint]
        width = (0.031 if side else 0.036) * unit * camera.distance / depths[joint, parent]
        segment = [points[[parent, joint]]]
        _lines(axes, segment, at, STAGE, width + 1.6, zorder=10 + order, capstyle="butt")
        _lines(axes, segment, at, COLOURS[side], width, zorder=10 + order)
    _draw_head(axes, pose, body, camera, at, limbs=list(depths.values()))


def draw_grid(axes: Axes, camera: Camera, cell: float = 0.5, reach: int = 12) -> None:
    """Draw half-metre cells on the ground, fixed to the world and fading away from the camera's target."""
    centre = np.round(np.array([camera.target[0], camera.target[2]]) / cell)
    ticks = np.arange(-reach, reach + 1)
    starts = np.stack(np.meshgrid(ticks, ticks, indexing="ij"), -1).reshape(-1, 2)
    for step in ((0, 1), (1, 0)):
        ends = np.stack([starts, starts + step], axis=1) + centre
        far = np.linalg.norm((starts + np.array(step) / 2), axis=1) / reach
        ground = np.insert(ends * cell, 1, 0.0, axis=-1)
        keep = far < 1
        colours = [(*_rgb(GRID), 1 - f) for f in far[keep]]
        _lines(axes, list(camera.project(ground[keep])), 0.0, colours, 0.8, zorder=1)


def draw_path(axes: Axes, path: Float[np.ndarray, "t 2"], now: int, camera: Camera) -> None:
    """Draw the root's way over the ground: solid up to now, dotted from now on."""
    points = camera.project(np.insert(path, 1, 0.0, axis=-1))
    axes.plot(*points[: now + 1, :2].T, color=ACCENT, lw=1.6, zorder=3, alpha=0.85)
    axes.plot(*points[now:, :2].T, color=ACCENT, lw=1.4, zorder=3, alpha=0.5, ls=(0, (1, 2.5)))


def write(axes: Axes, x: float, y: float, text: str, **style: Any) -> None:
    """Write a text as it is at a place in the axes, 0 to 1: no mathematics between dollar signs, `?` for no text."""
    whole = text.encode("utf-8", errors="replace").decode()  # half a surrogate pair has no glyph and no encoding
    axes.text(x, y, whole, transform=axes.transAxes, parse_math=False, **style)


def _draw_head(axes: Axes, pose: np.ndarray, body: Body, camera: Camera, at: float, limbs: list[float]) -> None:
    from matplotlib.patches import Circle

    bone = pose[body.head] - pose[body.parents[body.head]]
    radius = 0.06 * body.stature  # the head joint sits at the skull's base, so the ball goes above it
    x, y, depth = camera.project(pose[body.head] + 0.6 * radius * bone / max(float(np.linalg.norm(bone)), 1e-6))
    ball = Circle((x + at, y), radius * camera.distance / depth, fc=COLOURS[0], ec=STAGE, lw=1.0)
    ball.set_zorder(9.5 + sum(limb > depth for limb in limbs))  # over what is farther, under what is nearer
    axes.add_patch(ball)


def _lines(axes: Axes, segments: list[np.ndarray], at: float, colours: Any, width: float, **style: Any) -> None:
    from matplotlib.collections import LineCollection

    style.setdefault("capstyle", "round")
    shifted = [s[:, :2] + (at, 0.0) for s in segments]
    axes.add_collection(LineCollection(shifted, colors=colours, linewidths=width, **style), autolim=False)


def _points_per_metre(axes: Axes) -> float:
    low, high = axes.get_ylim()
    return axes.get_window_extent().height * 72 / axes.figure.dpi / (high - low)


def _rgb(colour: str) -> tuple[float, float, float]:
    red, green, blue = (int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5))
    return red, green, blue
