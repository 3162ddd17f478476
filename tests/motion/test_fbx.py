"""FBX is written by an interpreter that has Blender; what it can't do is one clear error and no file."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest

import kinema
from kinema.data.synthetic import synthetic_catalog
from kinema.motion import export
from kinema.motion.formats.fbx import PYTHON
from kinema.motion.skeleton import HUMANML3D
from kinema.types import Motion


@pytest.fixture
def walk() -> Motion:
    clip = next(iter(synthetic_catalog(size=4, seed=0)))
    return Motion(clip.joints().astype(np.float32), np.zeros((0, 0)), "walks", "humanml3d", 20.0)


@pytest.mark.parametrize(
    ("script", "message"),
    [
        (None, r"python does not run \(No such file or directory\); name a Python that has bpy"),
        ("exit 3", r"python can't import: pip install 'kinema\[fbx\]'.*KINEMA_BLENDER_PYTHON.*or write \.glb$"),
        ('printf half > "$4"; echo "Error: no room" >&2; exit 1', r"failed to write FBX: Error: no room; write \.glb"),
        ("exit 0", "wrote no FBX"),
    ],
)
def test_what_blender_cannot_do_is_one_error_and_keeps_the_old_file(script, message, walk, tmp_path, monkeypatch):
    python = tmp_path / "python"
    if script is not None:
        python.write_text(f"#!/bin/sh\n{script}\n")
        python.chmod(0o755)
    monkeypatch.setenv(PYTHON, str(python))
    (tmp_path / "out").mkdir()
    target = tmp_path / "out" / "walk.fbx"
    target.write_text("older")
    with pytest.raises(ValueError, match=message) as caught:
        export.save(walk, target)
    assert "\n" not in str(caught.value)
    assert [path.name for path in target.parent.iterdir()] == ["walk.fbx"]
    assert target.read_text() == "older"


@pytest.mark.parametrize(
    ("script", "message"),
    [(None, "does not run"), ("exit 3", "pip install 'kinema"), ("echo Segfault >&2; exit 139", "failed .*: Segfault")],
)
def test_a_missing_blender_is_told_before_there_is_a_motion(script, message, tmp_path, monkeypatch):
    python = tmp_path / "python"
    if script is not None:
        python.write_text(f"#!/bin/sh\n{script}\n")
        python.chmod(0o755)
    monkeypatch.setenv(PYTHON, str(python))
    with pytest.raises(ValueError, match=message):
        export.check("walk.fbx", HUMANML3D)
    export.check("walk.glb", HUMANML3D)


def test_blender_is_imported_by_one_script_that_nothing_runs_in_this_process():
    found = set()
    for file in Path(kinema.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            found |= {file.name for name in names if name.split(".")[0] == "bpy"}
    assert found == {"fbx_in_blender.py"}
