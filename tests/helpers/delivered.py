"""Where points of delivered files are, by readers that share no code with the writers."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom, UsdSkel


def world_points(path: Path, variant: str = "") -> dict[str, np.ndarray]:
    """(T, V, 3) world points of every mesh by UsdSkel's own baking; stage units."""
    stage = Usd.Stage.Open(str(path))
    for prim in stage.GetPseudoRoot().GetChildren():
        if variant and prim.GetVariantSets().HasVariantSet("gaussianFlesh"):
            prim.GetVariantSet("gaussianFlesh").SetVariantSelection(variant)
    stage = Usd.Stage.Open(stage.Flatten())
    UsdSkel.BakeSkinning(stage.Traverse())
    codes = np.arange(stage.GetStartTimeCode(), stage.GetEndTimeCode() + 1.0)
    found = {}
    for prim in stage.Traverse():
        if prim.IsA(UsdGeom.Mesh) and UsdGeom.Imageable(prim).ComputeVisibility() != "invisible":
            rows = []
            for code in codes:
                matrix = np.array(UsdGeom.Imageable(prim).ComputeLocalToWorldTransform(code))
                points = np.array(UsdGeom.Mesh(prim).GetPointsAttr().Get(code), np.float64)
                rows.append(points @ matrix[:3, :3] + matrix[3, :3])
            found[str(prim.GetPath())] = np.array(rows)
    return found


def gltf_vertices(path: Path) -> np.ndarray:
    """Positions of the vertices of the only mesh at each key, as glTF 2.0 says."""
    data = path.read_bytes()
    magic, version, total = struct.unpack_from("<4sII", data)
    assert (magic, version, total) == (b"glTF", 2, len(data))
    size = struct.unpack_from("<I", data, 12)[0]
    tree, blob = json.loads(data[20 : 20 + size]), data[28 + size :]

    def read(number: int) -> np.ndarray:
        row = tree["accessors"][number]
        view = tree["bufferViews"][row["bufferView"]]
        width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}[row["type"]]
        kind = {5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
        flat = np.frombuffer(
            blob, kind[row["componentType"]], row["count"] * width, view["byteOffset"]
        )
        scale = {5121: 255.0, 5122: 32767.0}[row["componentType"]] if "normalized" in row else 1.0
        return flat.reshape(-1, width) / scale

    nodes = [dict(node) for node in tree["nodes"]]
    (animation,) = tree["animations"]
    tracks = [
        (
            channel["target"],
            read(animation["samplers"][channel["sampler"]]["output"]),
            read(animation["samplers"][channel["sampler"]]["input"]),
        )
        for channel in animation["channels"]
    ]

    def matrix(node: dict) -> np.ndarray:
        made = np.eye(4)
        x, y, z, w = np.array(node.get("rotation", (0, 0, 0, 1.0)), float)
        n = x * x + y * y + z * z + w * w
        made[:3, :3] = (
            np.array(
                [
                    [n - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                    [2 * (x * y + z * w), n - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                    [2 * (x * z - y * w), 2 * (y * z + x * w), n - 2 * (x * x + y * y)],
                ]
            )
            / n
        )
        made[:3, :3] *= node.get("scale", (1, 1, 1))
        made[:3, 3] = node.get("translation", (0, 0, 0))
        return made

    def walk(number: int, above: np.ndarray, out: dict[int, np.ndarray]) -> None:
        out[number] = above @ matrix(nodes[number])
        for child in nodes[number].get("children", []):
            walk(child, out[number], out)

    (holder,) = [i for i, node in enumerate(nodes) if "mesh" in node]
    (mesh,) = tree["meshes"]
    frames = []
    for frame in range(len(tracks[0][2])):
        for target, values, times in tracks:
            rows = values.reshape(len(times), -1)
            nodes[target["node"]][target["path"]] = rows[frame].tolist()
        where: dict[int, np.ndarray] = {}
        for root in tree["scenes"][tree["scene"]]["nodes"]:
            walk(root, np.eye(4), where)
        for primitive in mesh["primitives"]:
            points = read(primitive["attributes"]["POSITION"]).astype(float)
            for k, target in enumerate(primitive.get("targets", [])):
                points = points + nodes[holder]["weights"][k] * read(target["POSITION"])
            whole = np.column_stack([points, np.ones(len(points))])
            if "skin" in nodes[holder]:
                skin = tree["skins"][nodes[holder]["skin"]]
                inverse = read(skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
                joints = np.array([where[j] @ b for j, b in zip(skin["joints"], inverse)])
                used = read(primitive["attributes"]["JOINTS_0"]).astype(int)
                weights = read(primitive["attributes"]["WEIGHTS_0"])
                blend = np.einsum("vk,vkij->vij", weights, joints[used])
                frames.append(np.einsum("vij,vj->vi", blend, whole)[:, :3])
            else:
                frames.append((whole @ where[holder].T)[:, :3])
    return np.array(frames)
