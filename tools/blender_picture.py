"""Render frames of a baked stage side by side with Blender's Cycles, on the CPU.

    .clients/blender/bin/python tools/blender_picture.py OUT.png STAGE:FRAME ...

Each stage is imported as Blender's menu does it; all share one camera and one floor, fitted to the
first.  Run with the Python that tools/clients.py installed Blender for.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

WIDTH, HEIGHT = 300, 280
AZIMUTH, ELEVATION = math.radians(35.0), math.radians(14.0)
SAMPLES = 48


def bounds() -> tuple[Vector, Vector]:
    """Corners of all that moves, in this frame."""
    graph = bpy.context.evaluated_depsgraph_get()
    corners = [
        shape.matrix_world @ Vector(corner)
        for item in bpy.context.scene.objects
        if item.type in {"MESH", "POINTCLOUD"}
        for shape in [item.evaluated_get(graph)]
        for corner in shape.bound_box
    ]
    return Vector(map(min, *corners)), Vector(map(max, *corners))


def paint(name: str, color: tuple[float, float, float]) -> bpy.types.Material:
    """A plain material."""
    made = bpy.data.materials.new(name)
    surface = made.node_tree.nodes["Principled BSDF"]
    surface.inputs["Base Color"].default_value = (*color, 1.0)
    surface.inputs["Roughness"].default_value = 0.6
    return made


def paint_points() -> None:
    """Show the points in their own colors, which the importer brings as an attribute."""
    for item in bpy.context.scene.objects:
        if item.type != "POINTCLOUD":
            continue
        made = paint("points", (1.0, 1.0, 1.0))
        nodes = made.node_tree.nodes
        color = nodes.new("ShaderNodeAttribute")
        color.attribute_name = "displayColor"
        made.node_tree.links.new(
            color.outputs["Color"], nodes["Principled BSDF"].inputs["Base Color"]
        )
        item.data.materials.append(made)


def light(center: Vector, radius: float) -> None:
    """A bright sky, a key and a rim."""
    scene = bpy.context.scene
    scene.world = bpy.data.worlds.new("sky")
    sky = scene.world.node_tree.nodes["Background"]
    sky.inputs[0].default_value = (0.85, 0.9, 1.0, 1.0)
    sky.inputs[1].default_value = 0.4
    for turn, height, power, size in ((-0.8, 1.1, 150.0, 2.0), (1.3, 0.5, 45.0, 3.5)):
        lamp = bpy.data.lights.new("lamp", "AREA")
        lamp.energy, lamp.size = power * radius**2, size * radius
        item = bpy.data.objects.new("lamp", lamp)
        scene.collection.objects.link(item)
        way = Vector((math.sin(AZIMUTH + turn), -math.cos(AZIMUTH + turn), height)).normalized()
        item.location = center + 5.0 * radius * way
        item.rotation_euler = (-way).to_track_quat("-Z", "Y").to_euler()


def stand(center: Vector, radius: float) -> None:
    """Camera and floor."""
    scene = bpy.context.scene
    lens = bpy.data.cameras.new("camera")
    lens.lens, lens.clip_start, lens.clip_end = 70.0, 0.001 * radius, 1000.0 * radius
    camera = bpy.data.objects.new("camera", lens)
    scene.collection.objects.link(camera)
    scene.camera = camera
    way = Vector(
        (
            math.sin(AZIMUTH) * math.cos(ELEVATION),
            -math.cos(AZIMUTH) * math.cos(ELEVATION),
            math.sin(ELEVATION),
        )
    )
    camera.location = center + 4.4 * radius * way
    camera.rotation_euler = (-way).to_track_quat("-Z", "Y").to_euler()
    bpy.ops.mesh.primitive_plane_add(size=200.0 * radius, location=(center.x, center.y, 0.0))
    bpy.context.object.data.materials.append(paint("floor", (0.62, 0.65, 0.70)))


def render(stage: str, frame: int, view: tuple[Vector, float] | None, out: Path) -> tuple:
    """One picture; returns the center and radius that it was fitted to."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.usd_import(filepath=stage)
    scene = bpy.context.scene
    if view is None:
        scene.frame_set(scene.frame_start)
        low, high = bounds()
        low.z = 0.0
        view = ((low + high) / 2.0, (high - low).length / 2.0)
    scene.frame_set(frame)
    paint_points()
    light(*view)
    stand(*view)
    scene.render.resolution_x, scene.render.resolution_y = WIDTH, HEIGHT
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.max_bounces = SAMPLES, 4
    scene.cycles.use_denoising = True
    scene.view_settings.view_transform = "Standard"
    scene.render.filepath = str(out)
    bpy.ops.render.render(write_still=True)
    return view


def pixels(path: Path) -> np.ndarray:
    """(H, W, 4), as stored."""
    image = bpy.data.images.load(str(path))
    values = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(values)
    return values.reshape(image.size[1], image.size[0], 4)


def main() -> None:
    """Render the requested pictures and put them side by side."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("out", type=Path, help="picture to write (.png)")
    parser.add_argument("wanted", nargs="+", metavar="STAGE:FRAME")
    args = parser.parse_args()
    view, row = None, []
    with tempfile.TemporaryDirectory() as folder:
        for number, word in enumerate(args.wanted):
            stage, _, frame = word.rpartition(":")
            picture = Path(folder) / f"{number}.png"
            view = render(stage, int(frame), view, picture)
            row.append(pixels(picture))
    strip = np.concatenate(row, axis=1)
    image = bpy.data.images.new("strip", strip.shape[1], strip.shape[0])
    image.pixels.foreach_set(strip.ravel())
    image.filepath_raw, image.file_format = str(args.out.resolve()), "PNG"
    image.save()


if __name__ == "__main__":
    main()
