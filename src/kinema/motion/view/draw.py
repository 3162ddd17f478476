"""Draw a figure with matplotlib: the same body, camera and colours as the players in the browser."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from kinema.motion.view.body import LEFT, RIGHT, Body
from kinema.motion.view.volume import FINE, SOFT, Piece, Seen, look, pieces

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

COLOURS = {LEFT: "#2a6fe0", RIGHT: "#e2662a", 0: "#4a5365"}
ROUND = np.array([(np.cos(a), 0.0, np.sin(a)) for a in np.arange(8) * np.pi / 4])
REACH = 1.5
"""Statures from the root beyond which a body is cut off: no sound one goes there."""
FADES = 8
"""Steps in which the ground's grid fades."""
STAGE, GRID, INK, MUTED, SHADOW, ACCENT = "#f6f8fa", "#c9d1dc", "#1b2130", "#636d80", "#d3dae3", "#2767d8"


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
    """Draw a body and its shadow, shifted sideways by `at` metres."""
    made = pieces(pose, body)
    _draw_shadow(axes, made, camera, at)
    window = axes.get_window_extent()
    density = window.height / float(np.ptp(axes.get_ylim()))
    corner = np.array([axes.get_xlim()[0] - at, axes.get_ylim()[0]])
    bones = np.concatenate([_seen(piece.balls, camera)[list(piece.bones)] for piece in made])
    spots, radii = (bones[..., :2] - corner) * density, bones[..., 3:] * density
    root, reach = (camera.project(pose[0])[:2] - corner) * density, REACH * body.stature * density
    frame = np.clip([root - reach, root + reach], 0, [window.width, window.height])
    low = np.floor((spots - radii).min((0, 1)).clip(*frame)).astype(int)
    width, height = np.ceil((spots + radii).max((0, 1)).clip(*frame)).astype(int) - low
    if width < 1 or height < 1:
        return
    bones = FINE * np.concatenate([spots - low, -bones[..., 2:3] * density, radii], axis=-1)
    owners = [i for i, piece in enumerate(made) for _ in piece.bones]
    seen = look(bones, owners, FINE * width, FINE * height)
    seen = seen.softened(len(body.trunk), round(SOFT * body.stature * density * FINE))
    fog = -seen.near / (FINE * density) - camera.project(pose[0])[2]
    picture = _coloured(seen, [piece.side for piece in made], 0.06 + fog / (2 * body.stature))
    left, bottom = corner + (at, 0) + low / density
    extent = (left, left + width / density, bottom, bottom + height / density)
    axes.imshow(picture, extent=extent, aspect="auto", interpolation="nearest", zorder=10)


def draw_grid(axes: Axes, camera: Camera, cell: float = 0.5, reach: int = 12) -> None:
    """Draw half-metre cells on the ground, fixed to the world and fading away from the camera's target."""
    from matplotlib.collections import LineCollection

    centre = np.round(np.array([camera.target[0], camera.target[2]]) / cell)
    ticks = np.arange(-reach, reach + 1)
    starts = np.stack(np.meshgrid(ticks, ticks, indexing="ij"), -1).reshape(-1, 2)
    steps = np.repeat([(0, 1), (1, 0)], len(starts), axis=0)
    starts = np.tile(starts, (2, 1))
    level = (FADES * np.linalg.norm(starts + steps / 2, axis=1) / reach).astype(int)
    ends = cell * (np.stack([starts, starts + steps, starts * np.nan], axis=1) + centre)
    points = camera.project(np.insert(ends, 1, 0.0, axis=-1))[..., :2]
    fading = [points[level == one].reshape(-1, 2) for one in range(FADES)]  # a line each, broken between cells
    colours = [(*_rgb(GRID), 1 - (one + 0.5) / FADES) for one in range(FADES)]
    axes.add_collection(LineCollection(fading, colors=colours, linewidths=0.8, zorder=1), autolim=False)


def draw_path(axes: Axes, path: Float[np.ndarray, "t 2"], now: int, camera: Camera) -> None:
    """Draw the root's way over the ground: solid up to now, dotted from now on."""
    points = camera.project(np.insert(path, 1, 0.0, axis=-1))
    axes.plot(*points[: now + 1, :2].T, color=ACCENT, lw=1.6, zorder=3, alpha=0.85)
    axes.plot(*points[now:, :2].T, color=ACCENT, lw=1.4, zorder=3, alpha=0.5, ls=(0, (1, 2.5)))


def write(axes: Axes, x: float, y: float, text: str, **style: Any) -> None:
    """Write a text as it is at a place in the axes, 0 to 1: no mathematics between dollar signs, `?` for no text."""
    whole = text.encode("utf-8", errors="replace").decode()  # half a surrogate pair has no glyph and no encoding
    axes.text(x, y, whole, transform=axes.transAxes, parse_math=False, **style)


def _seen(balls: Float[np.ndarray, "k 4"], camera: Camera) -> Float[np.ndarray, "k 4"]:
    """Project balls: screen x and y, depth, and their radius there."""
    points = camera.project(balls[:, :3])
    return np.concatenate([points, balls[:, 3:] * camera.distance / points[:, 2:]], axis=1)


def _coloured(seen: Seen, sides: list[int], fog: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "p q 4"]:
    """Colour what is seen (the players' tones) and take the mean of each pixel's samples."""
    there = seen.piece >= 0
    base = np.array([_rgb(COLOURS[side]) for side in sides])[seen.piece[there]]
    strength = (0.55 + 0.66 * seen.light[there].clip(0))[:, None]
    lit = np.where(strength < 1, base * strength, base + (1 - base) * 0.9 * (strength - 1))
    shown = np.zeros((*there.shape, 4))
    shown[there, :3] = lit + fog[there].clip(0, 0.4)[:, None] * (_rgb(STAGE) - lit)
    shown[there, 3] = 1
    mean = np.mean([shown[i::FINE, j::FINE] for i in range(FINE) for j in range(FINE)], axis=0)
    mean[..., :3] /= np.maximum(mean[..., 3:], 1e-6)
    return mean.clip(0, 1)


def _draw_shadow(axes: Axes, made: list[Piece], camera: Camera, at: float) -> None:
    """Darken the ground below a body."""
    from matplotlib.collections import PolyCollection
    from scipy.spatial import ConvexHull

    outlines = []
    for piece in made:
        spots = piece.balls[:, None, :3] * (1, 0, 1) + piece.balls[:, None, 3:] * ROUND
        points = camera.project(spots.reshape(-1, 3))[:, :2]
        outlines.append(points[ConvexHull(points, qhull_options="QJ").vertices] + (at, 0.0))
    axes.add_collection(PolyCollection(outlines, facecolors=SHADOW, edgecolors="none", zorder=2), autolim=False)


def _rgb(colour: str) -> tuple[float, float, float]:
    red, green, blue = (int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5))
    return red, green, blue
