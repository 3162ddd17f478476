"""Read exports in Blender, in a process of its own: python in_blender.py OUT.json FPS STRIDE FILE..."""

import json
import sys
from pathlib import Path

import bpy

READERS = {
    # What is in centimetres is read in metres.
    ".bvh": lambda path: bpy.ops.import_anim.bvh(filepath=path, global_scale=0.01),
    ".glb": lambda path: bpy.ops.import_scene.gltf(filepath=path),
    ".fbx": lambda path: bpy.ops.wm.fbx_import(filepath=path),
}


def read(path: str, fps: float, stride: int) -> list[dict[str, list[float]]]:
    """Give every bone's place, metres, Y up, in every so many frames."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps, scene.render.fps_base = round(fps), round(fps) / fps
    READERS[Path(path).suffix](path)
    (body,) = (thing for thing in scene.objects if thing.type == "ARMATURE")
    found = []
    first, last = map(round, body.animation_data.action.frame_range)
    for frame in range(first, last + 1, stride):
        scene.frame_set(frame)
        places = {bone.name: body.matrix_world @ bone.head for bone in body.pose.bones}
        found.append({name: [x, z, -y] for name, (x, y, z) in places.items()})
    return found


if __name__ == "__main__":
    target, fps, stride, *paths = sys.argv[1:]
    Path(target).write_text(json.dumps({Path(path).name: read(path, float(fps), int(stride)) for path in paths}))
