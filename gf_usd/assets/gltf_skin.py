"""Skinned meshes of a glTF file in the pose of its nodes.

glTF 2.0, 3.7.3.3: a vertex stands at sum_j w_j J_j x, where J_j takes the bind pose to joint j (its
inverse bind matrix) and from there to the world; the node that holds the mesh does not matter.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from gf_usd.assets.gltf import Gltf
from gf_usd.assets.gltf_mesh import Primitive
from gf_usd.assets.gltf_transform import local_matrix
from gf_usd.assets.mesh_data import REPAIR, FileMesh, FileNode
from gf_usd.assets.notes import Notes
from gf_usd.errors import InputError
from gf_usd.model import Floats

FLOAT, MAT4 = 5126, "MAT4"


class Skins:
    """The skins of a file."""

    def __init__(self, gltf: Gltf) -> None:
        self._gltf = gltf
        self._parents = {
            child: i
            for i, node in enumerate(gltf.rows("nodes"))
            for child in node.get("children", [])
        }

    def posed(
        self, number: Any, name: str, mesh: FileMesh, primitives: list[Primitive], notes: Notes
    ) -> FileNode:
        """A node in the world with the mesh as its skeleton holds it."""
        joints = self._joint_matrices(number)
        rows = [self._blend(p, joints) for p in primitives]
        if any(row is None for row in rows):
            notes.add("its skin has no weights: read without a pose", name)
            return FileNode(name=name, mesh=mesh)
        blend = np.concatenate([row for row in rows if row is not None])
        points = np.einsum("vi,vij->vj", mesh.points, blend[:, :3, :3]) + blend[:, 3, :3]
        normals = mesh.normals
        if normals is not None:
            # The cofactors are the inverse transpose up to a factor, and exist where no inverse is.
            a, b, c = np.moveaxis(blend[:, :3, :3], 1, 0)
            cofactors = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
            normals = np.einsum("vi,vij->vj", normals, cofactors)
        notes.add("is skinned: it stands as the nodes of its skeleton do", name)
        return FileNode(name=name, mesh=replace(mesh, points=points, normals=normals))

    def _blend(self, primitive: Primitive, joints: Floats) -> Floats | None:
        """(V, 4, 4) for row vectors; None without weights."""
        sets = [i for i in range(8) if f"JOINTS_{i}" in primitive.attributes]
        sets = [i for i in sets if f"WEIGHTS_{i}" in primitive.attributes]
        if not sets:
            return None
        index = np.concatenate([primitive.attributes[f"JOINTS_{i}"] for i in sets], axis=1)
        weight = np.concatenate([primitive.attributes[f"WEIGHTS_{i}"] for i in sets], axis=1)
        index = index.astype(np.int64)
        if not np.isfinite(weight).all() or index.min() < 0 or index.max() >= len(joints):
            raise InputError(
                f"{self._gltf.path}: a skinned mesh names joint {index.max()} of {len(joints)}, or "
                "has weights that are not finite",
                REPAIR,
            )
        total = weight.sum(axis=1, keepdims=True)
        weight = weight / np.where(total > 0.0, total, 1.0)
        return np.einsum("vk,vkij->vij", weight, joints[index])

    def _joint_matrices(self, number: Any) -> Floats:
        """(J, 4, 4) from the bind pose to the world, for row vectors."""
        skin = self._gltf.row("skins", number)
        joints = skin.get("joints", [])
        bind = np.broadcast_to(np.eye(4), (len(joints), 4, 4))
        if "inverseBindMatrices" in skin:
            bind = self._matrices(skin["inverseBindMatrices"], len(joints))
        world = np.array([self._world(joint) for joint in joints]).reshape(-1, 4, 4)
        return bind @ world

    def _matrices(self, index: Any, count: int) -> Floats:
        row = self._gltf.row("accessors", index)
        data = self._gltf.view(row.get("bufferView"))[row.get("byteOffset", 0) :]
        if row.get("componentType") != FLOAT or row.get("type") != MAT4 or len(data) < 64 * count:
            raise InputError(
                f"{self._gltf.path}: accessor {index} holds no {count} inverse bind matrices",
                REPAIR,
            )
        return np.frombuffer(data, "<f4", count=16 * count).astype(np.float64).reshape(-1, 4, 4)

    def _world(self, index: Any) -> Floats:
        matrix, above = np.eye(4), 0
        at: int | None = index
        while at is not None and above < 1000:
            local = local_matrix(self._gltf.row("nodes", at))
            matrix = matrix if local is None else matrix @ local
            at, above = self._parents.get(at), above + 1
        return matrix
