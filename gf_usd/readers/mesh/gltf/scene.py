"""The nodes of a glTF file with their meshes; its primitives are joined, so that bodies stay whole.

Each material of a glTF mesh is a primitive of its own: apart they would be open surfaces.

Skinned meshes of a glTF file in the pose of its nodes.

glTF 2.0, 3.7.3.3: a vertex stands at sum_j w_j J_j x, where J_j takes the bind pose to joint j (its
inverse bind matrix) and from there to the world; the node that holds the mesh does not matter.

The transforms of glTF nodes, for row vectors.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.errors import InputError
from gf_usd.readers.mesh.data import REPAIR, FileMesh, FileNode, MeshFile, require_sound
from gf_usd.readers.mesh.gltf.container import Gltf, open_gltf
from gf_usd.readers.mesh.gltf.materials import GltfMaterials
from gf_usd.readers.mesh.gltf.primitives import Primitive, decoded, read_primitives
from gf_usd.readers.notes import Notes


def read_gltf(path: Path) -> MeshFile:
    """The default scene of a glTF file: meters, Y up, as its standard says.

    Raises InputError for a file that is damaged, incomplete or needs what is not read.
    """
    notes = Notes()
    gltf = open_gltf(path)
    if gltf.tree.get("animations"):
        notes.add("its animations are not read: it stands as its nodes do")
    scene = _Scene(gltf, notes)
    nodes = scene.roots()
    return require_sound(
        MeshFile(
            path=path,
            format="glTF",
            nodes=nodes,
            materials=scene.materials.used,
            meters_per_unit=1.0,
            up_axis="Y",
            up_axis_known=True,
            inputs=(*gltf.inputs, *scene.materials.inputs),
            notes=notes.lines(),
        )
    )


class _Scene:
    def __init__(self, gltf: Gltf, notes: Notes) -> None:
        self._gltf = gltf
        self._notes = notes
        self._primitives = read_primitives(gltf, notes)
        self.materials = GltfMaterials(gltf, notes)
        self._skins = Skins(gltf)
        self._posed: list[FileNode] = []  # skinned meshes stand in the world, whatever their node

    def roots(self) -> tuple[FileNode, ...]:
        """Nodes of the default scene that hold a mesh, posed ones last."""
        scenes = self._gltf.rows("scenes")
        if scenes:
            scene = self._gltf.row("scenes", self._gltf.tree.get("scene", 0))
            first = scene.get("nodes", [])
        else:
            inner = {c for node in self._gltf.rows("nodes") for c in node.get("children", [])}
            first = [i for i in range(len(self._gltf.rows("nodes"))) if i not in inner]
        walked = [self._node(index, ()) for index in first]
        found = (*(node for node in walked if node is not None), *self._posed)
        if not found:
            raise InputError(
                f"{self._gltf.path}: no node of its scene holds a mesh",
                "export the scene with its meshes in it",
            )
        return found

    def _node(self, index: int, above: tuple[int, ...]) -> FileNode | None:
        """A node and what is below; None where no mesh is."""
        row = self._gltf.row("nodes", index)
        if index in above or len(above) > 200:
            raise InputError(f"{self._gltf.path}: node {index} stands below itself", REPAIR)
        below = [self._node(child, (*above, index)) for child in row.get("children", [])]
        children = tuple(node for node in below if node is not None)
        name = str(row.get("name") or f"node{index}")
        mesh = self._mesh(row["mesh"], name) if "mesh" in row else None
        if mesh is not None and "skin" in row:
            primitives = self._of_mesh(row["mesh"])
            self._posed.append(self._skins.posed(row["skin"], name, mesh, primitives, self._notes))
            mesh = None
        if mesh is None and not children:
            return None
        return FileNode(name=name, matrix=local_matrix(row), mesh=mesh, children=children)

    def _of_mesh(self, number: Any) -> list[Primitive]:
        self._gltf.row("meshes", number)
        return [found for (m, _), found in self._primitives.items() if m == number]

    def _mesh(self, number: Any, node: str) -> FileMesh | None:
        """The primitives of a mesh as one; None where none has a surface."""
        primitives = self._of_mesh(number)
        if not primitives:
            return None
        name = str(self._gltf.row("meshes", number).get("name") or node)
        starts = np.cumsum([0] + [len(p.points) for p in primitives])
        indices = np.concatenate([p.triangles + at for p, at in zip(primitives, starts)])
        materials = [
            np.full(len(p.triangles), self.materials.index(p.material, "COLOR_0" in p.attributes))
            for p in primitives
        ]
        return FileMesh(
            name=name,
            points=np.concatenate([p.points for p in primitives]),
            counts=np.full(len(indices), 3),
            indices=indices.reshape(-1),
            uvs=_joined([self.materials.uvs(p) for p in primitives], primitives, 0.0),
            normals=self._normals(primitives, name),
            colors=_joined([self.materials.colors(p) for p in primitives], primitives, 1.0),
            materials=np.concatenate(materials),
        )

    def _normals(self, primitives: list[Primitive], name: str) -> Floats | None:
        found = [p.attributes.get("NORMAL") for p in primitives]
        if any(values is None or not np.isfinite(values).all() for values in found):
            if any(values is not None for values in found):
                self._notes.add(
                    "some of its primitives have no usable normals: all of them are left out", name
                )
            return None
        return np.concatenate([values[:, :3] for values in found if values is not None])


def _joined(
    values: list[Floats | None], primitives: list[Primitive], missing: float
) -> Floats | None:
    """(V, k) of all primitives; `missing` where one has none; None where none has."""
    width = next((v.shape[1] for v in values if v is not None), None)
    if width is None:
        return None
    rows = [
        np.full((len(p.points), width), missing) if v is None else v
        for v, p in zip(values, primitives)
    ]
    return np.concatenate(rows)


FLOAT = 5126


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
        kind = row.get("componentType"), row.get("type")
        if kind != (FLOAT, "MAT4") or row.get("count", 0) < count:
            raise InputError(
                f"{self._gltf.path}: accessor {index} holds no {count} inverse bind matrices",
                REPAIR,
            )
        return decoded(self._gltf, index)[:count].reshape(-1, 4, 4)

    def _world(self, index: Any) -> Floats:
        matrix, above = np.eye(4), 0
        at: int | None = index
        while at is not None and above < 1000:
            local = local_matrix(self._gltf.row("nodes", at))
            matrix = matrix if local is None else matrix @ local
            at, above = self._parents.get(at), above + 1
        return matrix


def local_matrix(row: dict[str, Any]) -> Floats | None:
    """(4, 4) of a node for row vectors, x_parent = x S R T; None where it says nothing."""
    if "matrix" in row:
        # Column by column for column vectors is row by row for row vectors.
        return np.array(row["matrix"], np.float64).reshape(4, 4)
    if not any(key in row for key in ("translation", "rotation", "scale")):
        return None
    matrix = np.eye(4)
    scale = np.array(row.get("scale", (1.0, 1.0, 1.0)), np.float64)
    turn = _rotation(np.array(row.get("rotation", (0.0, 0.0, 0.0, 1.0)), np.float64))
    matrix[:3, :3] = scale[:, None] * turn.T
    matrix[3, :3] = row.get("translation", (0.0, 0.0, 0.0))
    return matrix


def _rotation(q: Floats) -> Floats:
    """(3, 3) of a quaternion (x, y, z, w) for column vectors; one of length 0 turns nothing."""
    length = float(np.linalg.norm(q))
    x, y, z, w = q / length if length > 0.0 else (0.0, 0.0, 0.0, 1.0)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
