"""The nodes of a glTF file with their meshes; its primitives are joined, so that bodies stay whole.

Each material of a glTF mesh is a primitive of its own: apart they would be open surfaces.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from gf_usd.assets.gltf import Gltf, open_gltf
from gf_usd.assets.gltf_material import GltfMaterials
from gf_usd.assets.gltf_mesh import Primitive, read_primitives
from gf_usd.assets.gltf_skin import Skins
from gf_usd.assets.gltf_transform import local_matrix
from gf_usd.assets.mesh_data import REPAIR, FileMesh, FileNode, MeshFile, require_sound
from gf_usd.assets.notes import Notes
from gf_usd.errors import InputError
from gf_usd.model import Floats


def read_gltf(path: Path) -> MeshFile:
    """The default scene of a glTF file: metres, Y up, as its standard says.

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
            colours=_joined([self.materials.colours(p) for p in primitives], primitives, 1.0),
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
