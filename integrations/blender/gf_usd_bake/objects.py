"""Objects out of Blender as USD, and the baked USD back as caches on copies of them."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from .program import ProgramError

COLLECTION = "gf-usd"
SOURCE = "gf_usd_source"  # custom property of a copy: the name of its original
MODIFIER = "gf-usd"
ROOT = "/root"


def selected(context: bpy.types.Context) -> list[Any]:
    """The selected mesh objects that are neither results of an earlier bake nor obstacles."""
    bars = obstacles(context)
    return [
        o for o in context.selected_objects
        if o.type == "MESH" and SOURCE not in o and o not in bars
    ]  # fmt: skip


def obstacles(context: bpy.types.Context) -> list[Any]:
    """The meshes of the collection of obstacles: visible, and no results of earlier bakes."""
    chosen = context.scene.gf_usd.obstacles
    if chosen is None:
        return []
    return [
        o
        for o in chosen.all_objects
        if o.type == "MESH" and SOURCE not in o and not o.hide_viewport
    ]


def make_copies(
    context: bpy.types.Context, originals: list[Any], ending: str = "soft"
) -> list[str]:
    """Names of new objects with the meshes of the originals as they are in this frame.

    Modifiers are applied, and materials, UVs and attributes kept.  They belong to no collection
    yet, and are kept alive until `show` or `discard`.  Their names are fit for prims, and end in
    `_soft` or another `ending`.
    """
    graph = context.evaluated_depsgraph_get()
    names = []
    for original in originals:
        shape = original.evaluated_get(graph)
        mesh = bpy.data.meshes.new_from_object(
            shape, preserve_all_data_layers=True, depsgraph=graph
        )
        copy = bpy.data.objects.new(_free_name(original.name, ending), mesh)
        copy.matrix_world = shape.matrix_world
        copy[SOURCE] = original.name
        copy.use_fake_user = True
        names.append(copy.name)
    return names


def _free_name(name: str, ending: str) -> str:
    """A name that the exporter leaves as it is: fit for a prim, and like no other object's."""
    taken = {_plain(other.name) for other in bpy.data.objects}
    stem = f"{_plain(name)}_{ending}"
    free, number = stem, 1
    while free in taken:
        number += 1
        free = f"{stem}_{number}"
    return free


def prim_path(name: str) -> str:
    """Of a copy in the exported stage."""
    return f"{ROOT}/{name}"


def _plain(name: str) -> str:
    """Letters, digits and _, and no digit in front."""
    plain = re.sub(r"[^A-Za-z0-9_]", "_", name)
    return f"_{plain}" if plain[0].isdigit() else plain


def discard(names: list[str]) -> None:
    """Remove copies that nothing came of."""
    for name in names:
        copy = bpy.data.objects.get(name)
        if copy is not None:
            bpy.data.meshes.remove(copy.data)


def lowest_vertex(names: list[str]) -> float:
    """z [Blender units] of the lowest vertex in the world.

    Raises ProgramError where there is none.
    """
    heights = []
    for name in names:
        copy = bpy.data.objects[name]
        points = np.empty(3 * len(copy.data.vertices), np.float32)
        copy.data.vertices.foreach_get("co", points)
        row = np.array(copy.matrix_basis)[2]
        heights += (points.reshape(-1, 3) @ row[:3] + row[3]).tolist()
    if not heights:
        raise ProgramError("the selected objects have no vertices", "select a closed mesh")
    return min(heights)


def export(context: bpy.types.Context, names: list[str], path: Path) -> None:
    """Write the copies, and nothing else, to a USD file: Z up, one unit for one Blender unit.

    Raises ProgramError where Blender cannot.
    """
    active = context.view_layer.objects.active
    were = list(context.selected_objects)
    scene = context.scene
    for other in were:
        other.select_set(False)
    copies = [bpy.data.objects[name] for name in names]
    try:
        for copy in copies:
            scene.collection.objects.link(copy)
            copy.select_set(True)
        bpy.ops.wm.usd_export(
            filepath=str(path),
            selected_objects_only=True,
            merge_parent_xform=True,
            root_prim_path=ROOT,
            export_animation=False,
            export_subdivision="TESSELLATE",
            evaluation_mode="VIEWPORT",
            # Blender shades and paints the copy as before: it needs the points alone
            export_normals=False,
            export_materials=True,
            convert_world_material=False,
            allow_unicode=False,
        )
    except RuntimeError as error:
        raise ProgramError(f"Blender cannot export to {path}: {error}", "change Folder") from error
    finally:
        for copy in copies:
            scene.collection.objects.unlink(copy)
        for other in were:
            other.select_set(True)
        context.view_layer.objects.active = active


def show(context: bpy.types.Context, names: list[str], root: Path) -> list[Any]:
    """Put the copies into the scene, moved by a baked stage, and hide their originals.

    Copies of an earlier bake of the same originals go.

    Raises ProgramError where a copy is gone, or has no prim in the stage.
    """
    copies = [bpy.data.objects.get(name) for name in names]
    if None in copies:
        raise ProgramError(
            "the objects that were to take the result are gone, perhaps by Undo",
            f"it is in {root}: File > Import > Universal Scene Description",
        )
    cache = _open(root)
    collection = bpy.data.collections.get(COLLECTION) or bpy.data.collections.new(COLLECTION)
    if collection.name not in context.scene.collection.children:
        context.scene.collection.children.link(collection)
    olds = list(collection.objects)
    for copy in copies:
        collection.objects.link(copy)
        copy.use_fake_user = False
        modifier = copy.modifiers.new(MODIFIER, "MESH_SEQUENCE_CACHE")
        modifier.cache_file = cache
        modifier.object_path = prim_path(copy.name)
        modifier.read_data = {"VERT"}
    # only now Blender reads the file
    context.view_layer.update()
    known = {row.path for row in cache.object_paths}
    lost = {prim_path(copy.name) for copy in copies} - known
    if lost:
        raise ProgramError(
            f"{root} has no {', '.join(sorted(lost))}",
            f"it has {', '.join(sorted(known)) or 'no prims'}",
        )
    originals = {copy[SOURCE] for copy in copies}
    for old in [o for o in olds if o.get(SOURCE) in originals]:
        bpy.data.meshes.remove(old.data)
    for other in context.selected_objects:
        other.select_set(False)
    for copy in copies:
        copy.name = f"{copy[SOURCE]}.soft"
        copy.select_set(True)
        original = bpy.data.objects.get(copy[SOURCE])
        if original is not None and original.name in context.view_layer.objects:
            original.hide_set(True)
            original.hide_render = True
    context.view_layer.objects.active = copies[0]
    return copies


def _open(root: Path) -> Any:
    """A new cache file of Blender."""
    before = set(bpy.data.cache_files)
    bpy.ops.cachefile.open(filepath=str(root), relative_path=bool(bpy.data.filepath))
    (cache,) = set(bpy.data.cache_files) - before
    return cache
