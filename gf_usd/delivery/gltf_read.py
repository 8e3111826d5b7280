"""Where the vertices of a written glTF file stand in each frame: its nodes, skins and weights."""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.matrices import matrix_from_quaternion
from gf_usd.core.scene import Recording
from gf_usd.delivery.gltf import up_rotation
from gf_usd.delivery.gltf_surface import primitives_of
from gf_usd.delivery.rig import Rig

DTYPES = {5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
FULL = {5121: 255.0, 5122: 32767.0, 5123: 65535.0}


def read_error(path: Path, recording: Recording, rigs: Sequence[Rig]) -> float:
    """The largest distance to the bake over vertices and frames, in radii."""
    file = GlbFile(path)
    world = matrix_from_quaternion(up_rotation(recording.up)[[3, 0, 1, 2]])
    nodes = iter([i for i, node in enumerate(file.tree["nodes"]) if "mesh" in node])
    largest = 0.0
    for rig in rigs:
        for mesh in rig.body.meshes:
            node = next(nodes)
            at = [p.points for p in primitives_of(recording.meshes[mesh])]
            part = rig.body.frames[:, rig.body.points_of(mesh)]
            for frame in range(len(recording.time_codes)):
                found = file.vertices(node, frame)
                wanted = part[frame, np.concatenate(at)] @ world.T
                off = np.sqrt(((found - wanted) ** 2).sum(axis=1).max())
                largest = max(largest, float(off) / rig.body.radius)
    return largest


class GlbFile:
    """A binary glTF file whose animation has a key for each frame."""

    def __init__(self, path: Path) -> None:
        data = path.read_bytes()
        length = struct.unpack_from("<I", data, 12)[0]
        self.tree: dict[str, Any] = json.loads(data[20 : 20 + length])
        self._bin = data[28 + length :]
        self._parents = {
            child: i for i, n in enumerate(self.tree["nodes"]) for child in n.get("children", [])
        }
        self._keys: dict[tuple[int, str], Floats] = {}
        for animation in self.tree.get("animations", []):
            for channel in animation["channels"]:
                where = channel["target"]
                output = animation["samplers"][channel["sampler"]]["output"]
                self._keys[where["node"], where["path"]] = self.array(output)
        self.array = cache(self.array)

    def array(self, number: int) -> Floats:
        """(n, width) of an accessor."""
        row = self.tree["accessors"][number]
        view = self.tree["bufferViews"][row["bufferView"]]
        width = WIDTHS[row["type"]]
        start = view.get("byteOffset", 0) + row.get("byteOffset", 0)
        kind = np.dtype(DTYPES[row["componentType"]])
        flat = np.frombuffer(self._bin, kind, row["count"] * width, start).astype(np.float64)
        if row.get("normalized"):
            flat = np.maximum(flat / FULL[row["componentType"]], -1.0)
        return flat.reshape(-1, width)

    def vertices(self, node: int, frame: int) -> Floats:
        """(N, 3) of all primitives of a node, in the scene."""
        row = self.tree["nodes"][node]
        mesh = self.tree["meshes"][row["mesh"]]
        weights = self._keys.get((node, "weights"))
        out = []
        for primitive in mesh["primitives"]:
            points = self.array(primitive["attributes"]["POSITION"])
            targets = primitive.get("targets", [])
            if targets and weights is not None:
                for k, target in enumerate(targets):
                    share = weights.reshape(-1, len(targets))[frame, k]
                    points = points + share * self.array(target["POSITION"])
            out.append(self._placed(row, node, primitive, points, frame))
        return np.concatenate(out)

    def _placed(
        self, row: dict[str, Any], node: int, primitive: Any, points: Floats, frame: int
    ) -> Floats:
        whole = np.column_stack([points, np.ones(len(points))])
        if "skin" not in row:
            return (whole @ self._world(node, frame))[:, :3]
        skin = self.tree["skins"][row["skin"]]
        inverse = self.array(skin["inverseBindMatrices"]).reshape(-1, 4, 4)
        joints = inverse @ np.array([self._world(j, frame) for j in skin["joints"]])
        index = self.array(primitive["attributes"]["JOINTS_0"]).astype(int)
        share = self.array(primitive["attributes"]["WEIGHTS_0"])
        found = np.zeros((len(points), 3))
        for slot in range(index.shape[1]):
            moved = np.matmul(whole[:, None], joints[index[:, slot]])[:, 0, :3]
            found += share[:, slot, None] * moved
        return found

    def _world(self, node: int, frame: int) -> Floats:
        """(4, 4) for row vectors."""
        matrix = np.eye(4)
        at: int | None = node
        while at is not None:
            matrix = matrix @ self._local(at, frame)
            at = self._parents.get(at)
        return matrix

    def _local(self, node: int, frame: int) -> Floats:
        row = self.tree["nodes"][node]
        matrix = np.eye(4)
        turn = self._keys.get((node, "rotation"))
        q = row.get("rotation", (0.0, 0.0, 0.0, 1.0)) if turn is None else turn[frame]
        q = np.asarray(q) / np.linalg.norm(q)
        matrix[:3, :3] = matrix_from_quaternion(q[[3, 0, 1, 2]]).T
        move = self._keys.get((node, "translation"))
        matrix[3, :3] = row.get("translation", (0.0, 0.0, 0.0)) if move is None else move[frame]
        return matrix
