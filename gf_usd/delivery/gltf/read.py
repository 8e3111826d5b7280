"""Reads a written glTF file back: the positions of its vertices in each frame.

They follow from the nodes, skins and morph weights."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.matrices import gaussian_axes, matrix_from_quaternion
from gf_usd.core.scene import Recording
from gf_usd.delivery.gltf.splats import NAME
from gf_usd.delivery.gltf.surface import primitives_of
from gf_usd.delivery.gltf.write import up_rotation
from gf_usd.delivery.rig import Rig
from gf_usd.delivery.splats.clouds import Cloud, Errors, SplatErrors

DTYPES = {5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
FULL = {5121: 255.0, 5122: 32767.0, 5123: 65535.0}


def read_error(path: Path, recording: Recording, rigs: Sequence[Rig]) -> float:
    """The largest distance to the bake over points and frames, in radii.

    Over vertices, and over Gaussians, except for those that follow a single joint.  Where a body is
    hidden there is nothing to compare.
    """
    file = GlbFile(path)
    world = _upright(recording)
    largest = 0.0
    for rig, node, mesh, splats, rows in _parts(file, rigs):
        if rig.single and mesh < 0:
            continue
        part = rig.body.points_of(mesh) if splats < 0 else rig.body.splats_of(splats)
        wanted = rig.body.frames[:, part] @ world.T
        if mesh >= 0:
            rows = np.concatenate([p.points for p in primitives_of(recording.meshes[mesh])])
        for frame in range(len(recording.time_codes)):
            if rig.body.shown and not rig.body.shown[frame]:
                continue
            off = file.vertices(node, frame) - wanted[frame, rows]
            far = float(np.sqrt((off**2).sum(axis=1).max()))
            largest = max(largest, far / rig.body.radius)
    return largest


def read_splat_errors(
    path: Path, recording: Recording, rigs: Sequence[Rig], clouds: Sequence[Cloud]
) -> tuple[SplatErrors, ...]:
    """Of each set of Gaussians."""
    file = GlbFile(path)
    world = _upright(recording)
    found = [Errors() for _ in clouds]
    for rig, node, mesh, splats, rows in _parts(file, rigs):
        if mesh >= 0:
            continue
        number, every = rig.body.splats[splats]
        cloud, mine = clouds[number], every[rows]
        for frame in range(len(recording.time_codes)):
            off = file.vertices(node, frame) - cloud.positions[frame, mine] @ world.T
            wanted = world @ cloud.covariances(frame)[mine] @ world.T
            found[number].add(off, rig.body.radius, file.covariances(node, frame), wanted)
    return tuple(errors.found for errors in found)


def _upright(recording: Recording) -> Floats:
    return matrix_from_quaternion(up_rotation(recording.up)[None, [3, 0, 1, 2]])[0]


def _parts(file: GlbFile, rigs: Sequence[Rig]) -> Iterator[tuple[Rig, int, int, int, Ints]]:
    """(rig, node, mesh, -1, none) of each mesh, (rig, node, -1, number, rows) of Gaussians.

    In the order in which `write_glb` makes nodes.  rows : which of a set the node has.
    """
    nodes = iter([i for i, node in enumerate(file.tree["nodes"]) if "mesh" in node])
    for rig in rigs:
        for mesh in rig.body.meshes:
            yield rig, next(nodes), mesh, -1, np.zeros(0, np.int64)
        for number, (_, rows) in enumerate(rig.body.splats):
            joint = rig.single[number] if rig.single else np.zeros(len(rows), np.int64)
            for one in np.unique(joint):
                yield rig, next(nodes), -1, number, np.flatnonzero(joint == one)


class GlbFile:
    """A binary glTF file whose animation has one key per frame."""

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
        self._worlds = cache(self._worlds)

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

    def covariances(self, node: int, frame: int) -> Floats:
        """(N, 3, 3) M S M^T of the Gaussians of a node, in the scene."""
        row = self.tree["nodes"][node]
        out = []
        for primitive in self.tree["meshes"][row["mesh"]]["primitives"]:
            named = primitive["attributes"]
            quaternions = self.array(named[f"{NAME}:ROTATION"])
            scales = self.array(named[f"{NAME}:SCALE"])
            M = self._matrices(row, node, primitive, frame)[..., :3, :3].swapaxes(-1, -2)
            A = M @ gaussian_axes(quaternions[:, [3, 0, 1, 2]], scales)
            out.append(A @ A.transpose(0, 2, 1))
        return np.concatenate(out)

    def _placed(
        self, row: dict[str, Any], node: int, primitive: Any, points: Floats, frame: int
    ) -> Floats:
        whole = np.column_stack([points, np.ones(len(points))])
        matrices = self._matrices(row, node, primitive, frame)
        return np.matmul(whole[:, None], matrices)[:, 0, :3]

    def _matrices(self, row: dict[str, Any], node: int, primitive: Any, frame: int) -> Floats:
        """For row vectors: (4, 4) of a node, or (N, 4, 4) of the points of a skin."""
        if "skin" not in row:
            return self._world(node, frame)
        skin = self.tree["skins"][row["skin"]]
        inverse = self.array(skin["inverseBindMatrices"]).reshape(-1, 4, 4)
        joints = inverse @ np.array([self._world(j, frame) for j in skin["joints"]])
        index = self.array(primitive["attributes"]["JOINTS_0"]).astype(int)
        share = self.array(primitive["attributes"]["WEIGHTS_0"])
        blended = np.zeros((len(index), 4, 4))
        for slot in range(index.shape[1]):
            blended += share[:, slot, None, None] * joints[index[:, slot]]
        return blended

    def _world(self, node: int, frame: int) -> Floats:
        """(4, 4) for row vectors."""
        every = self._worlds(node)
        return every[frame if len(every) > 1 else 0]

    def _worlds(self, node: int) -> Floats:
        """(T, 4, 4) in each frame, or (1, 4, 4) where nothing moves it."""
        own, parent = self._locals(node), self._parents.get(node)
        return own if parent is None else own @ self._worlds(parent)

    def _locals(self, node: int) -> Floats:
        row = self.tree["nodes"][node]
        turn = self._keys.get((node, "rotation"))
        q = np.array([row.get("rotation", (0.0, 0.0, 0.0, 1.0))]) if turn is None else turn
        q = q / np.linalg.norm(q, axis=1, keepdims=True)
        move = self._keys.get((node, "translation"))
        d = np.array([row.get("translation", (0.0, 0.0, 0.0))]) if move is None else move
        scale = self._keys.get((node, "scale"), np.ones((1, 3)))
        matrix = np.tile(np.eye(4), (max(len(q), len(d), len(scale)), 1, 1))
        turned = matrix_from_quaternion(q[:, [3, 0, 1, 2]]).swapaxes(1, 2)
        matrix[:, :3, :3] = scale[:, :, None] * turned
        matrix[:, 3, :3] = d
        return matrix
