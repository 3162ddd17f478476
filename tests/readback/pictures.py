"""Draw exports as Blender opens them: python pictures.py FOLDER FILE..., for an interpreter that has bpy.

Four moments of the motion stand side by side: the figure where the file has one, else its skeleton.
"""

import sys
from pathlib import Path

import bpy
from in_blender import joints, open_file
from mathutils import Vector

MOMENTS, APART = 4, 1.0
"""How many moments are shown, and how many metres apart."""
SIZE, SAMPLES = (360, 206), 32
THICK = 0.022


def material(name: str, colour: tuple[float, float, float]) -> bpy.types.Material:
    """Make a matt surface."""
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    surface = made.node_tree.nodes["Principled BSDF"]
    surface.inputs["Base Color"].default_value = (*colour, 1)
    surface.inputs["Roughness"].default_value = 0.8
    return made


def draw_figure(thing: bpy.types.Object, shift: Vector) -> None:
    """Keep the figure as it stands in this frame."""
    mesh = bpy.data.meshes.new_from_object(thing.evaluated_get(bpy.context.evaluated_depsgraph_get()))
    still = bpy.data.objects.new("still", mesh)
    still.matrix_world = thing.matrix_world.copy()
    still.location += shift
    bpy.context.collection.objects.link(still)


def draw_skeleton(shift: Vector, surface: bpy.types.Material) -> None:
    """Draw a ball for every joint of this frame, and a stick to its parent."""
    found = joints()
    for place, parent in found.values():
        here = place + shift
        bpy.ops.mesh.primitive_uv_sphere_add(radius=1.4 * THICK, location=here, segments=16, ring_count=10)
        bpy.context.object.data.materials.append(surface)
        if parent is None:
            continue
        way = here - (found[parent][0] + shift)
        bpy.ops.mesh.primitive_cylinder_add(radius=THICK, depth=way.length, location=here - way / 2, vertices=16)
        bpy.context.object.rotation_euler = way.to_track_quat("Z", "Y").to_euler()
        bpy.context.object.data.materials.append(surface)


def stage(width: float) -> None:
    """Set shadows, light and camera."""
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_plane_add(size=200)
    bpy.context.object.is_shadow_catcher = True
    bpy.ops.object.light_add(type="SUN", rotation=(0.7, 0.2, 0.5))
    bpy.context.object.data.energy = 1.6
    scene.world = bpy.data.worlds.new("sky")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.6, 0.63, 0.68, 1)
    bpy.ops.object.camera_add(location=(0.9, -1.3 * width, 1.9))
    camera = bpy.context.object
    camera.rotation_euler = (Vector((0, 0, 0.85)) - camera.location).to_track_quat("-Z", "Y").to_euler()
    camera.data.lens = 40
    scene.camera = camera


def render(path: Path) -> None:
    """Trace the picture on the CPU."""
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.device = "CYCLES", "CPU"
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.seed = SAMPLES, True, 0
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    scene.render.film_transparent = True
    scene.view_settings.view_transform = "Standard"
    scene.render.image_settings.file_format = "PNG"
    scene.render.image_settings.color_mode, scene.render.image_settings.compression = "RGBA", 100
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)


def draw(source: Path, target: Path) -> None:
    """Open a file and draw moments of it."""
    frames = open_file(source, fps=20)
    opened = list(bpy.context.scene.objects)
    figures = [thing for thing in opened if thing.type == "MESH"]
    blue = material("skeleton", (0.1, 0.25, 0.6))
    for moment in range(MOMENTS):
        bpy.context.scene.frame_set(frames[int(len(frames) * (moment + 0.5) / MOMENTS)])
        root = joints()["Hips"][0]
        shift = Vector(((moment - (MOMENTS - 1) / 2) * APART - root.x, -root.y, 0))
        for figure in figures:
            draw_figure(figure, shift)
        if not figures:
            draw_skeleton(shift, blue)
    for thing in opened:
        thing.hide_render = True
    stage(MOMENTS * APART)
    render(target)


if __name__ == "__main__":
    folder, *files = map(Path, sys.argv[1:])
    for file in files:
        draw(file, folder.absolute() / f"export_{file.suffix[1:]}.png")
