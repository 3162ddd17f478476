"""Render a motion as an mp4 film or as a still strip of poses (needs `kinema[viz]`)."""

from __future__ import annotations

import subprocess
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, cast

import numpy as np

from kinema.atomic import replacing
from kinema.motion.view.body import Body, body_of, finite_metres
from kinema.motion.view.draw import (
    ACCENT,
    INK,
    MUTED,
    REACH,
    STAGE,
    Camera,
    draw_grid,
    draw_path,
    draw_pose,
    facing,
    new_canvas,
    new_figure,
    write,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from kinema.types import Motion

_PIXELS = 480
_TURN, _PITCH = 0.6, 0.2
_TRAVEL = 0.2  # statures from the start that count as travel
_VIEW = 1.46  # the film's field of view in statures


def save_mp4(motion: Motion, path: str | Path) -> Path:
    """Write an H.264 film of 480 x 480 pixels at the motion's frame rate; the camera follows the root."""
    ffmpeg = require_encoder()
    joints, body = finite_metres(motion), body_of(motion)
    way = _smooth(joints[:, 0, [0, 2]], reach=round(motion.fps * 0.4))
    canvas = new_canvas(_PIXELS / 100, _PIXELS / 100, dpi=100)
    axes = canvas.figure.add_axes((0, 0, 1, 1))
    angle = facing(joints[0], body) + _TURN
    with replacing(path) as temporary, _encoder(ffmpeg, motion.fps, temporary, path) as pipe:
        for frame in range(len(joints)):
            axes.clear()
            camera = Camera((way[frame, 0], 0.57 * body.stature, way[frame, 1]), angle, _PITCH, 2.7 * body.stature)
            _draw_frame(axes, joints, frame, body, camera)
            _caption(axes, motion, frame)
            canvas.draw()
            pipe.write(np.asarray(canvas.buffer_rgba())[..., :3].tobytes())
    return Path(path)


def require_encoder() -> str:
    """Return ffmpeg's path; raises ImportError, with the fix, where there is none."""
    try:
        import imageio_ffmpeg
    except ImportError as error:
        raise ImportError("writing mp4 needs imageio-ffmpeg: pip install 'kinema[viz]'") from error
    return imageio_ffmpeg.get_ffmpeg_exe()


@contextmanager
def _encoder(ffmpeg: str, fps: float, temporary: Path, path: str | Path) -> Iterator[IO[bytes]]:
    """Yield a pipe to an encoder of RGB frames, which writes an H.264 film.

    Raises OSError with what the encoder says if it fails (a full disk): its exit code alone tells, at the end.
    """
    taken = [
        "-f",
        "rawvideo",
        "-pix_fmt",
        "rgb24",
        "-s",
        f"{_PIXELS}x{_PIXELS}",
        "-r",
        str(Fraction(fps).limit_denominator()),
        "-i",
        "-",
        "-an",
    ]
    made = ["-vcodec", "libx264", "-pix_fmt", "yuv420p", "-crf", "10", "-v", "error", str(temporary)]
    process = subprocess.Popen([ffmpeg, "-y", *taken, *made], stdin=subprocess.PIPE, stderr=subprocess.PIPE)
    try:
        with suppress(BrokenPipeError):  # its exit code says more
            yield cast("IO[bytes]", process.stdin)
        _, said = process.communicate()
    except BaseException:
        process.kill()
        process.communicate()
        raise
    if process.returncode:
        reason = (said.decode(errors="replace").strip().splitlines() or [f"exit code {process.returncode}"])[0]
        raise OSError(f"could not write {path}: {reason} (is the disk full?); nothing of it is kept")


def save_strip(motion: Motion, path: str | Path, poses: int = 8) -> Path:
    """Write a still picture: evenly spaced poses side by side with their times, the caption above.

    Of a motion that travels also how far it is from its start, and its way from above.
    """
    joints, body = finite_metres(motion), body_of(motion)
    frames = np.unique(np.linspace(0, len(joints) - 1, poses).round().astype(int))
    angle = facing(joints[0], body) + _TURN
    cell, low, high = 0.62 * body.stature, -0.2 * body.stature, 1.32 * body.stature
    drawn = [_centred(joints[f], body, angle) for f in frames]
    most, skin = REACH * body.stature, 0.03 * body.stature
    reach = [tuple(np.clip((p.min() - skin, p.max() + skin), -most, most)) for p, _, _ in drawn]
    places = _places(reach, cell)
    left, right = places[0] + min(reach[0][0], -cell / 2), places[-1] + max(reach[-1][1], cell / 2)
    travelled = np.linalg.norm(joints[frames, 0][:, [0, 2]] - joints[0, 0, [0, 2]], axis=1)
    travels, middle = travelled.max() > _TRAVEL * body.stature, right + 0.6 * cell
    right += 1.2 * cell if travels else 0.0
    height = 2.5
    figure = new_figure(height * (right - left) / (high - low), height, dpi=200)
    axes = figure.add_axes((0, 0, 1, 1))
    _bare(axes, (left, right), (low, high))
    axes.axhspan(low, 0.05 * body.stature, color="#ebeff3", zorder=0, lw=0)
    style: dict[str, Any] = {"ha": "center", "va": "center", "color": MUTED, "fontsize": 8}
    for frame, place, (_, pose, camera), metres in zip(frames, places, drawn, travelled, strict=True):
        draw_pose(axes, pose, body, camera, at=place)
        far = f"\n{metres:.1f} m" if travels else ""
        axes.text(place, low * (0.6 if travels else 0.72), f"{frame / motion.fps:.1f} s{far}", **style)
    if travels:
        _draw_way(axes, _from_above(joints, facing(joints[0], body)), frames, (middle, 0.6 * body.stature), 0.9 * cell)
        axes.text(middle, low * 0.6, "from above,\nfacing up", **style)
    columns = max(20, int(13 * figure.get_size_inches()[0]))
    write(axes, 0.012, 0.965, _lines(motion.text, columns, 2 * columns), va="top", color=INK, fontsize=10)
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png", metadata={"Software": None})
    return Path(path)


def _from_above(joints: np.ndarray, yaw: float) -> np.ndarray:
    """Return the root's way seen from above, where the first pose faces up."""
    way = joints[:, 0, [0, 2]] - joints[0, 0, [0, 2]]
    return way @ np.array([[-np.cos(yaw), np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])


def _draw_way(axes: Axes, way: np.ndarray, frames: np.ndarray, centre: tuple[float, float], size: float) -> None:
    """Draw a way into a square, the poses as dots and the first of them hollow."""
    middle, extent = (way.min(0) + way.max(0)) / 2, float(np.ptp(way, axis=0).max())
    points = (way - middle) * size / extent + centre
    axes.plot(*points.T, color=ACCENT, lw=1.4, zorder=3)
    axes.plot(*points[frames].T, "o", color=ACCENT, ms=3, zorder=4)
    axes.plot(*points[0], "o", mfc=STAGE, mec=ACCENT, ms=5, zorder=5)


def _draw_frame(axes: Axes, joints: np.ndarray, frame: int, body: Body, camera: Camera) -> None:
    half = _VIEW * body.stature / 2
    _bare(axes, (-half, half), (-half, half))
    draw_grid(axes, camera)
    draw_path(axes, joints[:, 0, [0, 2]], frame, camera)
    draw_pose(axes, joints[frame], body, camera)


def _caption(axes: Axes, motion: Motion, frame: int) -> None:
    write(axes, 0.03, 0.97, _lines(motion.text, 56, 160), va="top", color=INK, fontsize=9.5)
    clock = f"{frame / motion.fps:.1f} / {(len(motion.joints) - 1) / motion.fps:.1f} s"
    write(axes, 0.97, 0.03, clock, ha="right", color=MUTED, fontsize=8.5)


def _lines(text: str, columns: int, most: int) -> str:
    return textwrap.fill(textwrap.shorten(text, most, placeholder=" ..."), columns)


def _bare(axes: Axes, x: tuple[float, float], y: tuple[float, float]) -> None:
    axes.set_axis_off()
    axes.set_xlim(*x)
    axes.set_ylim(*y)


def _centred(pose: np.ndarray, body: Body, angle: float) -> tuple[np.ndarray, np.ndarray, Camera]:
    """Return a pose's screen abscissae and the camera that has its root in the middle."""
    camera = Camera((float(pose[0, 0]), 0.0, float(pose[0, 2])), angle, 0.06, 6 * body.stature)
    return camera.project(pose)[:, 0], pose, camera


def _places(reach: list[tuple[float, float]], cell: float) -> list[float]:
    """Put poses side by side, at least `cell` apart and never into one another."""
    places = [0.0]
    for before, after in pairwise(reach):
        places.append(places[-1] + max(cell, before[1] - after[0]))
    return places


def _smooth(path: np.ndarray, reach: int) -> np.ndarray:
    """Average a path over +-reach frames, so that the camera does not bounce with the root."""
    padded = np.pad(path, ((reach, reach), (0, 0)), mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1, axis=0)
    return windows.mean(axis=-1)
