"""Reading of the scene of a glTF file: nodes with their meshes.

A glTF mesh has one primitive per material, which would be open surfaces on their own: they are
merged.  Skinned meshes are in the pose of the nodes, or bound to skeletons (`read_rigged_gltf`).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.errors import InputError
from gf_usd.readers.mesh.data import (
    REPAIR,
    FileMesh,
    FileNode,
    FileShape,
    MeshFile,
    require_sound,
)
from gf_usd.readers.mesh.gltf.container import Gltf, open_gltf
from gf_usd.readers.mesh.gltf.materials import GltfMaterials
from gf_usd.readers.mesh.gltf.morphs import changing_shapes, morphed
from gf_usd.readers.mesh.gltf.nodes import Nodes, local_matrix
from gf_usd.readers.mesh.gltf.primitives import Primitive, read_primitives
from gf_usd.readers.mesh.gltf.rigs import Rigs
from gf_usd.readers.mesh.gltf.skins import Skins
from gf_usd.readers.notes import FLESH_KEEPS, Notes


def read_gltf(path: Path) -> MeshFile:
    """The default scene of a glTF file, in meters and Y up, as in the standard.

    Raises InputError for a file that is damaged, incomplete or requires unsupported extensions.
    """
    gltf, notes = open_gltf(path), Notes()
    if gltf.tree.get("animations"):
        flesh = f"; {FLESH_KEEPS}" if gltf.tree.get("skins") else ""
        notes.add(f"its animations are ignored: the pose of its nodes is used{flesh}")
    return _file(gltf, _Scene(gltf, notes), notes)


def read_rigged_gltf(path: Path, fps: float | None = None) -> MeshFile:
    """As `read_gltf`, with skeletons, meshes in the bind pose, and the first animation.

    fps : frames per second of the animation; None: the rate of its keyframes, else 24.

    Raises InputError as `read_gltf`, and for skins and animations that are damaged.
    """
    gltf, notes = open_gltf(path), Notes()
    return _file(gltf, _Scene(gltf, notes, rigged=True, fps=fps), notes)


def _file(gltf: Gltf, scene: _Scene, notes: Notes) -> MeshFile:
    nodes, rigs = scene.roots(), scene.rigs
    return require_sound(
        MeshFile(
            path=gltf.path,
            format="glTF",
            nodes=nodes,
            materials=scene.materials.used,
            meters_per_unit=1.0,
            up_axis="Y",
            up_axis_known=True,
            inputs=(*gltf.inputs, *scene.materials.inputs),
            notes=notes.lines(),
            skeletons=rigs.skeletons if rigs else (),
            fps=rigs.fps if rigs else None,
        )
    )


class _Scene:
    def __init__(
        self, gltf: Gltf, notes: Notes, *, rigged: bool = False, fps: float | None = None
    ) -> None:
        self._gltf = gltf
        self._notes = notes
        self._primitives = read_primitives(gltf, notes)
        self.materials = GltfMaterials(gltf, notes)
        nodes = Nodes(gltf)
        self._skins = Skins(gltf, nodes)
        self.rigs: Rigs | None = None
        if rigged:
            rows = gltf.rows("nodes")
            used = sorted({row["skin"] for row in rows if "mesh" in row and "skin" in row})
            self.rigs = Rigs(gltf, nodes, self._skins, used, fps, notes)
        self._posed: list[FileNode] = []  # skinned meshes, which ignore the transform of their node

    def roots(self) -> tuple[FileNode, ...]:
        """The nodes of the default scene with meshes, skinned ones last."""
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
                f"{self._gltf.path}: no node in its scene has a mesh",
                "export the scene with its meshes",
            )
        return found

    def _node(self, index: int, above: tuple[int, ...]) -> FileNode | None:
        """A node with its descendants; None where there is no mesh."""
        row = self._gltf.row("nodes", index)
        if index in above or len(above) > 200:
            raise InputError(f"{self._gltf.path}: node {index} is its own descendant", REPAIR)
        below = [self._node(child, (*above, index)) for child in row.get("children", [])]
        children = tuple(node for node in below if node is not None)
        name = str(row.get("name") or f"node{index}")
        mesh = self._mesh(row, index, name) if "mesh" in row else None
        if mesh is not None and (posed := self._skinned(row, index, name, mesh)) is not None:
            self._posed.append(posed)
            mesh = None
        if mesh is None and not children:
            return None
        return FileNode(name=name, matrix=local_matrix(row), mesh=mesh, children=children)

    def _skinned(
        self, row: dict[str, Any], index: int, name: str, mesh: FileMesh
    ) -> FileNode | None:
        """A root node with the skinned mesh of a node; None where it is not skinned."""
        primitives = list(self._of_mesh(row["mesh"]).values())
        if self.rigs is None:
            if "skin" not in row:
                return None
            return self._skins.posed(row["skin"], name, mesh, primitives, self._notes)
        if "skin" in row:
            return FileNode(name=name, mesh=self.rigs.skinned(row["skin"], name, mesh, primitives))
        bound = self.rigs.bound_rigidly(index, mesh)
        return None if bound is None else FileNode(name=name, mesh=bound)

    def _of_mesh(self, number: Any) -> dict[int, Primitive]:
        """The primitives of a mesh with a surface, by their index in it."""
        self._gltf.row("meshes", number)
        return {p: found for (m, p), found in self._primitives.items() if m == number}

    def _mesh(self, row: dict[str, Any], index: int, node: str) -> FileMesh | None:
        """The merged primitives of the mesh of a node; None where none has a surface."""
        with_surface = self._of_mesh(row["mesh"])
        if not with_surface:
            return None
        name = str(self._gltf.row("meshes", row["mesh"]).get("name") or node)
        weights = self.rigs.weights(index) if self.rigs else None
        primitives = morphed(self._gltf, row, with_surface, self._notes, name, node, weights)
        shapes: tuple[FileShape, ...] = ()
        if weights is not None:
            shapes = changing_shapes(self._gltf, row["mesh"], with_surface, weights, name)
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
            shapes=shapes,
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
    """(V, k) attribute of all primitives, `missing` where one lacks it; None where all do."""
    width = next((v.shape[1] for v in values if v is not None), None)
    if width is None:
        return None
    rows = [
        np.full((len(p.points), width), missing) if v is None else v
        for v, p in zip(values, primitives)
    ]
    return np.concatenate(rows)
