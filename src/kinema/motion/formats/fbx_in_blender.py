"""Turn a GLB into FBX inside Blender: a script for an interpreter that has bpy, which the package never imports.

Usage: python fbx_in_blender.py IN.glb OUT.fbx FPS, where a frame of the GLB lasts 1 / `CLOCK`. Exit code `NO_BLENDER`
says that there is no bpy; without words that is all it tells.
"""

import math
import sys

NO_BLENDER = 3
CLOCK = 24
"""Frames per second of the GLB, whatever the motion's: Blender's importer knows whole numbers alone."""


def convert(source: str, target: str, fps: float) -> None:
    """Import the file; export skeleton, figure and every frame of the motion in centimetres, Y up."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps, scene.render.fps_base = CLOCK, 1
    # The importer turns the file's metres into this unit, and the exporter writes it as it is: no node is scaled.
    scene.unit_settings.scale_length = 0.01
    bpy.ops.import_scene.gltf(filepath=source, disable_bone_shape=True)
    scene.frame_start, scene.frame_end = (round(frame) for frame in bpy.data.actions[0].frame_range)
    scene.render.fps, scene.render.fps_base = math.ceil(fps), math.ceil(fps) / fps
    bpy.ops.export_scene.fbx(
        filepath=target,
        object_types={"ARMATURE", "MESH"},
        add_leaf_bones=False,
        bake_anim_use_nla_strips=False,
        bake_anim_use_all_actions=False,
        bake_anim_simplify_factor=0,
    )


if __name__ == "__main__":
    try:
        import bpy  # noqa: F401
    except ImportError as error:
        print(error, file=sys.stderr)
        sys.exit(NO_BLENDER)
    if sys.argv[1:]:
        convert(sys.argv[1], sys.argv[2], float(sys.argv[3]))
