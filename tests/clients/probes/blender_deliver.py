"""In Blender: import a delivered file, and write down where its meshes are at each frame.

    python blender_deliver.py FILE OUT.npz FIRST LAST FPS

OUT holds ``NAME`` (frames, vertices, 3), world positions of every mesh object, and ``uv:NAME``.
"""

import sys

import bpy
import numpy as np

path, target, first, last, fps = sys.argv[1], sys.argv[2], *map(int, sys.argv[3:6])
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.context.scene.render.fps = fps
if path.endswith(".glb"):
    bpy.ops.import_scene.gltf(filepath=path, merge_vertices=False)
else:
    bpy.ops.wm.usd_import(filepath=path)
out = {}
# custom shapes of bones are meshes too
shown = [o for o in bpy.context.scene.objects if o.type == "MESH" and o.parent is not None]
frames = {item.name: [] for item in shown}
for frame in range(first, last + 1):
    bpy.context.scene.frame_set(frame)
    graph = bpy.context.evaluated_depsgraph_get()
    for item in shown:
        shape = item.evaluated_get(graph)
        flat = np.empty(3 * len(shape.data.vertices), np.float32)
        shape.data.vertices.foreach_get("co", flat)
        matrix = np.array(shape.matrix_world, np.float64)
        frames[item.name].append(flat.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3])
for item in shown:
    out[item.name] = np.array(frames[item.name])
    out[f"material:{item.name}"] = np.array([s.material.name for s in item.material_slots])
np.savez(target, **out)
