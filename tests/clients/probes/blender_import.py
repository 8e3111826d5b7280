"""In Blender: import a stage as its menu does, and write down what is there at each frame.

    python blender_import.py STAGE OUT.npz FIRST LAST

OUT holds ``points:PATH`` (frames, vertices, 3), world positions of every mesh and point cloud, and
of meshes also ``normals:PATH`` (corners, 3), ``uv:PATH`` and ``subset:PATH`` (faces) at LAST.
OUT.json holds the objects, the attributes of those that move, and the range of frames.
"""

import json
import sys
from pathlib import Path

import bpy
import numpy as np


def path_of(item):
    for modifier in item.modifiers:
        if modifier.type == "MESH_SEQUENCE_CACHE":
            return modifier.object_path
    return None


def world(item, graph):
    shape = item.evaluated_get(graph)
    data = shape.data
    where = data.attributes["position"].data
    flat = np.empty(3 * len(where), np.float32)
    where.foreach_get("vector", flat)
    matrix = np.array(shape.matrix_world, np.float64)
    return flat.reshape(-1, 3).astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]


def surface(item, graph, path, out):
    shape = item.evaluated_get(graph)
    mesh = shape.data
    flat = np.empty(3 * len(mesh.loops), np.float32)
    mesh.corner_normals.foreach_get("vector", flat)
    # as normals turn: with the inverse transpose
    turn = np.linalg.inv(np.array(shape.matrix_world, np.float64)[:3, :3])
    turned = flat.reshape(-1, 3) @ turn
    out[f"normals:{path}"] = turned / np.linalg.norm(turned, axis=1, keepdims=True)
    if mesh.uv_layers:
        uv = np.empty(2 * len(mesh.loops), np.float32)
        mesh.uv_layers[0].uv.foreach_get("vector", uv)
        out[f"uv:{path}"] = uv.reshape(-1, 2)
    index = np.empty(len(mesh.polygons), np.int32)
    mesh.polygons.foreach_get("material_index", index)
    names = np.array([slot.material.name if slot.material else "" for slot in item.material_slots])
    if len(names):
        out[f"subset:{path}"] = names[index]
    corners = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", corners)
    out[f"corners:{path}"] = corners


stage, target, first, last = sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.wm.usd_import(filepath=stage)
scene = bpy.context.scene
shown = [o for o in scene.objects if o.type in {"MESH", "POINTCLOUD"} and path_of(o)]
frames = {path_of(item): [] for item in shown}
out = {}
for frame in range(first, last + 1):
    scene.frame_set(frame)
    graph = bpy.context.evaluated_depsgraph_get()
    for item in shown:
        frames[path_of(item)].append(world(item, graph))
        if frame == last and item.type == "MESH":
            surface(item, graph, path_of(item), out)
for path, found in frames.items():
    out[f"points:{path}"] = np.array(found)
np.savez(target, **out)
report = {
    "objects": {item.name: item.type for item in scene.objects},
    "attributes": {path_of(item): item.data.attributes.keys() for item in shown},
    "range": [scene.frame_start, scene.frame_end],
    "version": bpy.app.version_string,
}
Path(target).with_suffix(".json").write_text(json.dumps(report))
