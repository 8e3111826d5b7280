"""Skinning of the meshes of a glTF file in the pose of its nodes.

glTF 2.0, 3.7.3.3: a vertex is at sum_j w_j J_j x, where J_j is the inverse bind matrix of joint j
followed by its transform to the world; the transform of the mesh's node is ignored.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.errors import InputError
from gf_usd.readers.mesh.data import REPAIR, FileMesh, FileNode
from gf_usd.readers.mesh.gltf.container import Gltf
from gf_usd.readers.mesh.gltf.nodes import Nodes
from gf_usd.readers.mesh.gltf.primitives import Primitive, decoded
from gf_usd.readers.notes import Notes

FLOAT = 5126


class Skins:
    """The skins of a file."""

    def __init__(self, gltf: Gltf, nodes: Nodes) -> None:
        self._gltf, self._nodes = gltf, nodes

    def posed(
        self, number: int, name: str, mesh: FileMesh, primitives: list[Primitive], notes: Notes
    ) -> FileNode:
        """A root node with the skinned mesh in world space."""
        joints = self._joint_matrices(number)
        found = self.influences(number, primitives)
        if found is None:
            notes.add("its skin has no weights: it is read without a pose", name)
            return FileNode(name=name, mesh=mesh)
        index, weight = found
        blend = np.einsum("vk,vkij->vij", weight, joints[index])
        points = np.einsum("vi,vij->vj", mesh.points, blend[:, :3, :3]) + blend[:, 3, :3]
        normals = mesh.normals
        if normals is not None:
            # The cofactor matrix is the inverse transpose up to a factor, also of singular ones.
            a, b, c = np.moveaxis(blend[:, :3, :3], 1, 0)
            cofactors = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
            normals = np.einsum("vi,vij->vj", normals, cofactors)
        notes.add("is skinned: it is posed by the nodes of its skeleton", name)
        return FileNode(name=name, mesh=replace(mesh, points=points, normals=normals))

    def joints(self, number: int) -> list[int]:
        """The joint nodes of a skin."""
        return self._gltf.row("skins", number).get("joints", [])

    def influences(self, number: int, primitives: list[Primitive]) -> tuple[Ints, Floats] | None:
        """Joints (V, k) of a skin and weights (V, k) of the points of a mesh; None without weights.

        The weights of a point sum to 1, or are all 0.  Raises InputError for joints out of range,
        and for weights that are not finite.
        """
        rows = [self._influences(p, len(self.joints(number))) for p in primitives]
        found = [row for row in rows if row is not None]
        if len(found) < len(rows):
            return None
        width = max(index.shape[1] for index, _ in found)

        def joined(values: list[Floats]) -> Floats:
            return np.concatenate([np.pad(v, ((0, 0), (0, width - v.shape[1]))) for v in values])

        index = joined([np.asarray(i, float) for i, _ in found]).astype(np.int64)
        return index, joined([w for _, w in found])

    def _influences(self, primitive: Primitive, joints: int) -> tuple[Ints, Floats] | None:
        sets = [i for i in range(8) if f"JOINTS_{i}" in primitive.attributes]
        sets = [i for i in sets if f"WEIGHTS_{i}" in primitive.attributes]
        if not sets:
            return None
        index = np.concatenate([primitive.attributes[f"JOINTS_{i}"] for i in sets], axis=1)
        weight = np.concatenate([primitive.attributes[f"WEIGHTS_{i}"] for i in sets], axis=1)
        index = index.astype(np.int64)
        if not np.isfinite(weight).all() or index.min() < 0 or index.max() >= joints:
            raise InputError(
                f"{self._gltf.path}: a skinned mesh refers to joint {index.max()} of {joints} "
                f"or has weights that are not finite",
                REPAIR,
            )
        total = weight.sum(axis=1, keepdims=True)
        return index, weight / np.where(total > 0.0, total, 1.0)

    def inverse_bind(self, number: int) -> NDArray[np.float64] | None:
        """(J, 4, 4) inverse bind matrices; None where the file has none."""
        skin, joints = self._gltf.row("skins", number), self.joints(number)
        if "inverseBindMatrices" not in skin:
            return None
        at = skin["inverseBindMatrices"]
        row = self._gltf.row("accessors", at)
        kind = row.get("componentType"), row.get("type")
        if kind != (FLOAT, "MAT4") or row.get("count", 0) < len(joints):
            raise InputError(
                f"{self._gltf.path}: accessor {at} does not hold {len(joints)} inverse bind "
                f"matrices",
                REPAIR,
            )
        return np.asarray(decoded(self._gltf, at)[: len(joints)].reshape(-1, 4, 4))

    def _joint_matrices(self, number: int) -> Floats:
        """(J, 4, 4) skinning matrices from the bind pose to the world, for row vectors."""
        joints = self.joints(number)
        bind = self.inverse_bind(number)
        if bind is None:
            bind = np.broadcast_to(np.eye(4), (len(joints), 4, 4))
        world = np.array([self._nodes.world(joint) for joint in joints]).reshape(-1, 4, 4)
        return bind @ world
