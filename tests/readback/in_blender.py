"""Read exports in Blender, in a process of its own: python in_blender.py OUT.json FPS STRIDE FILE..."""

import json
import shutil
import sys
import tempfile
from pathlib import Path

import bpy
from mathutils import Vector


def open_vrma(path: str) -> None:
    """Open a VRMA as the glTF that it is."""
    with tempfile.NamedTemporaryFile(suffix=".glb") as copy:
        shutil.copyfile(path, copy.name)
        OPENERS[".glb"](copy.name)


OPENERS = {
    # What is in centimetres is read in metres.
    ".bvh": lambda path: bpy.ops.import_anim.bvh(filepath=path, global_scale=0.01),
    ".glb": lambda path: bpy.ops.import_scene.gltf(filepath=path, disable_bone_shape=True),
    ".vrma": open_vrma,
    ".fbx": lambda path: bpy.ops.wm.fbx_import(filepath=path),
}


def open_file(path: Path, fps: float) -> range:
    """Open a file in an empty scene of a rate; give its frames."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    render = bpy.context.scene.render
    render.fps, render.fps_base = round(fps), round(fps) / fps
    OPENERS[path.suffix](str(path))
    ranges = [action.frame_range for action in bpy.data.actions]
    return range(round(min(first for first, _ in ranges)), round(max(last for _, last in ranges)) + 1)


def joints() -> dict[str, tuple[Vector, str | None]]:
    """Say where every joint is in this frame, and which is its parent: bones, or empties where nothing has a skin."""
    things = bpy.context.scene.objects
    bodies = [thing for thing in things if thing.type == "ARMATURE"]
    found = {bone.name: (body.matrix_world @ bone.head, bone.parent) for body in bodies for bone in body.pose.bones}
    if not bodies:
        found = {
            thing.name: (thing.matrix_world.translation, thing.parent) for thing in things if thing.type == "EMPTY"
        }
    return {name: (place.copy(), parent and parent.name) for name, (place, parent) in found.items()}


def read(path: Path, fps: float, stride: int) -> list[dict[str, list[float]]]:
    """Give every joint's place, metres, Y up, in every so many frames."""
    found = []
    for frame in open_file(path, fps)[::stride]:
        bpy.context.scene.frame_set(frame)
        found.append({name: [x, z, -y] for name, ((x, y, z), _) in joints().items()})
    return found


if __name__ == "__main__":
    target, fps, stride, *paths = sys.argv[1:]
    content = {Path(path).name: read(Path(path), float(fps), int(stride)) for path in paths}
    Path(target).write_text(json.dumps(content))
