"""The tables of an OBJ file as meshes, one for each object or group.

Objects and groups that share points are one body to whoever drew them, and a body cut in pieces has
no inside: they stay one mesh, and their names become sets of faces on it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gf_usd.assets.mesh_data import FileMesh, FileNode, tidy
from gf_usd.assets.notes import Notes
from gf_usd.colour import srgb_to_linear
from gf_usd.model import Floats, Ints
from gf_usd.nearby import components
from gf_usd.sparse import coo_matrix

NO_INDEX = -1
NO_NAME = "mesh"


@dataclass(frozen=True, kw_only=True)
class Tables:
    """An OBJ file as arrays; every index counts from 0 and is inside its table or NO_INDEX."""

    points: Floats  # (V, 3)
    colours: Floats | None  # (V, 3) sRGB
    uvs: Floats  # (U, 2)
    normals: Floats  # (K, 3)
    counts: Ints  # (P,)
    corners: Ints  # (C,) into points
    uv_corners: Ints  # (C,) into uvs
    normal_corners: Ints  # (C,) into normals
    parts: Ints  # (P,) into part_names
    part_names: tuple[tuple[str, str], ...]  # (object, group)
    materials: Ints  # (P,) into material_names
    material_names: tuple[str, ...]


def to_nodes(tables: Tables, defined: list[str], notes: Notes) -> tuple[FileNode, ...]:
    """A node with a mesh for each body; materials become indices into the names `defined`."""
    where = {name: i for i, name in enumerate(defined)}
    slots = np.array([where.get(n, NO_INDEX) for n in tables.material_names] + [NO_INDEX])
    materials = slots[tables.materials]
    face_of = np.repeat(np.arange(len(tables.counts)), tables.counts)
    unused = len(tables.points) - len(np.unique(tables.corners))
    if unused:
        notes.add(f"{unused} of its {len(tables.points)} points belong to no face: left out")
    nodes = []
    for faces, parts in _bodies(tables, face_of):
        mesh = _mesh(tables, faces, parts, materials, face_of, notes)
        nodes.append(FileNode(name=mesh.name, mesh=mesh))
    return tuple(nodes)


def _bodies(tables: Tables, face_of: Ints) -> list[tuple[Ints, list[int]]]:
    """(faces, parts) of each body: parts joined where they share a point, in the file's order."""
    n = len(tables.part_names)
    owner = tables.parts[face_of]
    graph = coo_matrix(
        (np.ones(len(owner)), (owner, n + tables.corners)), shape=(n + len(tables.points),) * 2
    )
    label = components(graph)[1][:n]
    bodies = []
    for body in dict.fromkeys(label.tolist()):
        parts = np.flatnonzero(label == body)
        bodies.append((np.flatnonzero(np.isin(tables.parts, parts)), parts.tolist()))
    return bodies


def _mesh(
    tables: Tables, faces: Ints, parts: list[int], materials: Ints, face_of: Ints, notes: Notes
) -> FileMesh:
    names = [_name(*tables.part_names[part]) for part in parts]
    name = names[0]
    groups: tuple[tuple[str, Ints], ...] = ()
    if len(parts) > 1:
        objects = {tables.part_names[part][0] for part in parts}
        name = objects.pop() or NO_NAME if len(objects) == 1 else name
        groups = tuple(
            (label, np.flatnonzero(tables.parts[faces] == part))
            for label, part in zip(names, parts)
        )
        notes.add(
            f"its {len(parts)} objects or groups ({_some(names)}) share points: they are one mesh",
            name,
        )
    mine = np.isin(face_of, faces)
    points, indices, used = _points(tables, mine)
    uvs, uv_indices = _uvs(tables, mine, name, notes)
    normals, normal_indices = _normals(tables, mine, name, notes)
    colours = None
    if tables.colours is not None:
        colours = srgb_to_linear(np.clip(tables.colours[used], 0.0, 1.0))
    own = materials[faces]
    return FileMesh(
        name=name,
        points=points,
        counts=tables.counts[faces],
        indices=indices,
        uvs=uvs,
        uv_indices=uv_indices,
        normals=normals,
        normal_indices=normal_indices,
        colours=colours,
        materials=own if (own != NO_INDEX).any() else None,
        groups=groups,
    )


def _points(tables: Tables, mine: Ints) -> tuple[Floats, Ints, Ints]:
    """Points (V, 3) of the corners, indices into them, and their rows in the file's table."""
    used, indices = np.unique(tables.corners[mine], return_inverse=True)
    return tables.points[used], indices.reshape(-1), used


def _uvs(tables: Tables, mine: Ints, name: str, notes: Notes) -> tuple[Floats | None, Ints | None]:
    corners = tables.uv_corners[mine]
    missing = corners == NO_INDEX
    if missing.all():
        return None, None
    table = tables.uvs
    if missing.any():
        notes.add(
            f"{int(missing.sum())} of its {len(corners)} corners have no texture coordinates: "
            "(0, 0) there",
            name,
        )
        corners = np.where(missing, len(table), corners)
        table = np.vstack([table, [[0.0, 0.0]]])
    return tidy(table, corners)


def _normals(
    tables: Tables, mine: Ints, name: str, notes: Notes
) -> tuple[Floats | None, Ints | None]:
    corners = tables.normal_corners[mine]
    missing = corners == NO_INDEX
    if missing.any():
        if not missing.all():
            notes.add(
                f"{int(missing.sum())} of its {len(corners)} corners have no normal: all of its "
                "normals are left out",
                name,
            )
        return None, None
    return tidy(tables.normals, corners)


def _name(thing: str, group: str) -> str:
    return "_".join(word for word in (thing, group) if word) or NO_NAME


def _some(names: list[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
