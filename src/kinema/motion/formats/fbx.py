"""Write a rig as FBX: Blender does, in a process of its own; bpy is GPL and never imported here."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

from kinema.motion.captures.capture import Capture
from kinema.motion.formats import fbx_in_blender
from kinema.motion.formats.glb import glb_bytes
from kinema.motion.skeleton import Skeleton

PYTHON = "KINEMA_BLENDER_PYTHON"
"""Environment variable that names the interpreter with bpy, where it isn't this one."""


def blender_python() -> str:
    """Name the interpreter that is to have bpy: that of the environment variable, or this one."""
    return os.environ.get(PYTHON) or sys.executable


def require_blender() -> None:
    """Raise ValueError, with the ways to have it, where no Blender writes FBX."""
    _run_blender()


def fbx_bytes(capture: Capture, skeleton: Skeleton, *, title: str) -> bytes:
    """Write a rig in metres, its figure and its animation; raises ValueError where there is no Blender, or it fails."""
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "motion.glb", Path(folder) / "motion.fbx"
        clocked = replace(capture, fps=fbx_in_blender.CLOCK)
        source.write_bytes(glb_bytes(clocked, skeleton, title=title))
        _run_blender(str(source), str(target), repr(float(capture.fps)))
        if not target.is_file():
            raise ValueError("Blender wrote no FBX; write .glb, which every tool with FBX reads through Blender, too")
        return target.read_bytes()


def _run_blender(*arguments: str) -> None:
    # -P: the script's neighbours are no modules of Blender's add-ons.
    python = blender_python()
    command = [python, "-P", fbx_in_blender.__file__, *arguments]
    try:
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
    except OSError as error:
        raise ValueError(f"{PYTHON}={python} does not run ({error.strerror}); name a Python that has bpy") from None
    if done.returncode == fbx_in_blender.NO_BLENDER:
        raise ValueError(
            f"FBX is written by Blender's bpy, which {python} can't import: pip install 'kinema[fbx]' (Python 3.13), "
            f"or name another Python that has it with {PYTHON} (docs/export.md), or write .glb"
        )
    if done.returncode:
        last = (done.stderr.strip() or done.stdout.strip() or "it said nothing").splitlines()[-1]
        raise ValueError(f"Blender ({python}) failed to write FBX: {last}; write .glb, or try another version of bpy")
