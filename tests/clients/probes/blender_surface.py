"""In Blender: import a stage and write down one mesh whose faces change, frame by frame.

    python blender_surface.py STAGE PATH OUT.npz FIRST LAST

OUT holds ``points:FRAME`` (V, 3), world, ``faces:FRAME`` (C,), the vertices of the corners,
``color:FRAME`` (V, 4) and, where Blender has it, ``velocity:FRAME`` (V, 3).  OUT.json names the
attributes of the mesh, and the meshes that are shown.
"""

import json
import sys
from pathlib import Path

import bpy
import numpy as np

stage, wanted, target, first, last = *sys.argv[1:4], int(sys.argv[4]), int(sys.argv[5])
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.wm.usd_import(filepath=stage)


def path_of(item):
    for modifier in item.modifiers:
        if modifier.type == "MESH_SEQUENCE_CACHE":
            return modifier.object_path
    return None


def taken(data, name, width):
    flat = np.empty(width * len(data), np.float32)
    data.foreach_get(name, flat)
    return flat.reshape(-1, width)


scene = bpy.context.scene
(item,) = [o for o in scene.objects if o.type == "MESH" and path_of(o) == wanted]
out = {}
for frame in range(first, last + 1):
    scene.frame_set(frame)
    shape = item.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh, matrix = shape.data, np.array(shape.matrix_world, np.float64)
    points = taken(mesh.attributes["position"].data, "vector", 3)
    out[f"points:{frame}"] = points @ matrix[:3, :3].T + matrix[:3, 3]
    corners = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", corners)
    out[f"faces:{frame}"] = corners
    if "displayColor" in mesh.attributes:
        out[f"color:{frame}"] = taken(mesh.attributes["displayColor"].data, "color", 4)
    if "velocity" in mesh.attributes:
        out[f"velocity:{frame}"] = taken(mesh.attributes["velocity"].data, "vector", 3)
np.savez(target, **out)
report = {
    "attributes": mesh.attributes.keys(),
    "meshes": {o.name: not o.hide_render for o in scene.objects if o.type == "MESH"},
}
Path(target).with_suffix(".json").write_text(json.dumps(report))
