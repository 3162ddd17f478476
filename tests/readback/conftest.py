"""Write four motions in every format, and collect how far from them software that isn't ours reads their joints.

`python -m pytest tests/readback -n 0` prints the table of docs/export.md; `make readers` fetches three.js and Khronos'
validator for it, and `KINEMA_BLENDER_PYTHON` names a Python with bpy.
"""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.browser.conftest import chromium  # noqa: F401
from tests.conftest import SHARED

from kinema.data.synthetic import synthetic_catalog
from kinema.motion import export
from kinema.motion.captures.mapping import known_mappings
from kinema.motion.formats.fbx import blender_python
from kinema.motion.skeleton import HUMANML3D
from kinema.types import Motion

MOTIONS = {
    "walking": "bandai_dataset-1_walk_normal_001",
    "turning": "cmugs_pirouette",
    "lying": "hdm05_HDM_bd_lieDownFloor_001_120",
    "jumping": "cmu_13_11",
}
"""Clips of open-mocap: the second turns twice around; synthetic ones stand for them where it isn't."""
NAMES = [next(iter(known_mappings()["mixamo"].joints[name])) for name in HUMANML3D.joint_names]
STRIDE = 10
MOST = 1.0
"""Frames between those that are compared, and millimetres that joints may lie apart."""
TABLE: dict[tuple[str, str], dict[str, float]] = {}
"""Format and reader, motion: the largest distance in millimetres."""


def made_up() -> dict[str, np.ndarray]:
    """Make a walk, one that turns twice around, one that lies and one that jumps."""
    walk = next(iter(synthetic_catalog(size=8, seed=2))).joints().astype(np.float64)
    share = np.linspace(0, 1, len(walk))
    about_y = Rotation.from_euler("y", 720 * share[:, None], degrees=True).as_matrix()
    about_x = Rotation.from_euler("x", -90, degrees=True).as_matrix()
    lift = 0.4 * np.sin(3 * np.pi * share)[:, None, None] ** 2 * [0, 1, 0]
    return {
        "walking": walk,
        "turning": np.einsum("tij,tkj->tki", about_y, walk),
        "lying": walk @ about_x.T,
        "jumping": walk + lift,
    }


@pytest.fixture(scope="session")
def motions() -> dict[str, Motion]:
    folder = SHARED / "data" / "open-mocap" / "joints"
    clips = {name: np.load(folder / f"{clip}.npy") for name, clip in MOTIONS.items()} if folder.is_dir() else made_up()
    return {
        name: Motion(joints.astype(np.float32), np.zeros((0, 0)), name, HUMANML3D.name, HUMANML3D.fps)
        for name, joints in clips.items()
    }


@pytest.fixture(scope="session")
def written(motions, tmp_path_factory) -> Callable[[str, str], Path]:
    folder = tmp_path_factory.mktemp("exports")

    def write(motion: str, ending: str) -> Path:
        path = folder / f"{motion}{ending}"
        return path if path.exists() else export.save(motions[motion], path)

    return write


@pytest.fixture(scope="session")
def agree(motions) -> Callable[[str, str, str, np.ndarray], None]:
    """Compare joints (frames, 22, 3), metres, Y up, with the rig that was written, and note how far they are apart."""

    def compare(ending: str, reader: str, motion: str, found: np.ndarray) -> None:
        expected = export.RIGGED[ending].fit(motions[motion]).positions[::STRIDE]
        assert found.shape == expected.shape
        apart = 1000 * float(np.linalg.norm(found - expected, axis=-1).max())
        TABLE.setdefault((ending, reader), {})[motion] = apart
        assert apart < MOST, f"{reader} reads {motion}{ending} {apart:.3f} mm away"

    return compare


@pytest.fixture(scope="session")
def blender() -> str:
    """Name a Python with bpy, or skip."""
    python = blender_python()
    if subprocess.run([python, "-c", "import bpy"], capture_output=True).returncode:
        pytest.skip(f"{python} has no bpy (Blender); name one that has with KINEMA_BLENDER_PYTHON")
    return python


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    if not TABLE:
        return
    terminalreporter.section("largest distance of a joint at every tenth frame, mm")
    terminalreporter.write_line(f"| format | reader | {' | '.join(MOTIONS)} |\n|---|---|{'---|' * len(MOTIONS)}")
    for (ending, reader), apart in sorted(TABLE.items()):
        cells = " | ".join(f"{apart[name]:.3f}" if name in apart else "" for name in MOTIONS)
        terminalreporter.write_line(f"| `{ending}` | {reader} | {cells} |")
