"""Reading of PLY files as polygon meshes.

trimesh does not support binary PLY files with faces of different corner counts, and triangulates
polygons; this reader preserves them.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.errors import InputError
from gf_usd.core.radiance import srgb_to_linear
from gf_usd.readers.mesh.data import (
    REPAIR,
    FileMaterial,
    FileMesh,
    FileNode,
    MeshFile,
    Picture,
    Slot,
    refuse_pointer,
    require_sound,
    used_rows,
)
from gf_usd.readers.mesh.ply.tables import Ragged, header, read_body
from gf_usd.readers.notes import Notes

UV_NAMES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))


def read_ply(path: Path) -> MeshFile:
    """The polygons of a PLY file with their colors, normals and texture coordinates.

    Raises InputError for a header or body that is invalid, and for a file without faces.
    """
    data = path.read_bytes()
    refuse_pointer(path, data)
    elements, order, texture, start = header(path, data)
    tables = read_body(path, data, start, elements, order)
    notes = Notes()
    _require_mesh(path, tables)
    picture = _picture(path, texture, notes)
    mesh = _mesh(path, tables, picture is not None, notes)
    materials = ()
    if picture is not None and mesh.uvs is not None:
        slot = Slot(input="diffuseColor", picture=picture)
        materials = (FileMaterial(name="texture", texture_slots=(slot,)),)
    return require_sound(
        MeshFile(
            path=path,
            format="PLY",
            nodes=(FileNode(name=mesh.name, mesh=mesh),),
            materials=materials,
            inputs=(path,),
            notes=notes.lines(),
        )
    )


def _require_mesh(path: Path, tables: dict[str, dict[str, Floats | Ragged]]) -> None:
    vertex = tables.get("vertex", {})
    missing = [axis for axis in "xyz" if axis not in vertex]
    if missing:
        raise InputError(f"{path}: its vertices have no {missing[0]}", REPAIR)
    if _faces(tables) is not None:
        return
    if "tristrips" in tables:
        raise InputError(
            f"{path} holds triangle strips, which are not supported", "export it with faces"
        )
    count = len(np.asarray(vertex["x"]))
    raise InputError(
        f"{path} holds {count} points but no faces, so there is no surface to fill",
        "give a file with faces; a surface reconstruction program can turn a point cloud into a "
        "mesh",
    )


def _faces(tables: dict[str, dict[str, Floats | Ragged]]) -> Ragged | None:
    face = tables.get("face", {})
    found = face.get("vertex_indices", face.get("vertex_index"))
    return found if isinstance(found, Ragged) and len(found.counts) else None


def _mesh(
    path: Path, tables: dict[str, dict[str, Floats | Ragged]], textured: bool, notes: Notes
) -> FileMesh:
    vertex, face = tables["vertex"], tables["face"]
    faces = _faces(tables)
    assert faces is not None
    corners = faces.values.astype(np.int64)
    uvs, uv_indices = _uvs(vertex, face, faces, notes)
    colors, per_face = _colors(vertex), False
    if colors is None:
        colors = _colors(face)
        per_face = colors is not None
    normals = _columns(vertex, ("nx", "ny", "nz"))
    if normals is not None and not np.isfinite(normals).all():
        notes.add("some of its normals are not finite: all are left out")
        normals = None
    if textured and uvs is None:
        notes.add("it names a texture but has no texture coordinates: the texture is left out")
    points = _columns(vertex, ("x", "y", "z"))
    assert points is not None
    return FileMesh(
        name="mesh",
        points=points,
        counts=faces.counts,
        indices=corners,
        uvs=uvs,
        uv_indices=uv_indices,
        normals=normals,
        colors=colors,
        colors_per_face=per_face,
        materials=np.zeros(len(faces.counts), np.int64) if textured and uvs is not None else None,
    )


def _columns(table: dict[str, Floats | Ragged], names: tuple[str, ...]) -> Floats | None:
    """(n, k) values of scalar columns; None where one is missing."""
    found = [table.get(name) for name in names]
    if any(column is None or isinstance(column, Ragged) for column in found):
        return None
    return np.stack([np.asarray(column, np.float64) for column in found], axis=1)


def _colors(table: dict[str, Floats | Ragged]) -> Floats | None:
    """(n, 3) linear colors: integers are sRGB in the range of their type, floats are linear."""
    first = table.get("red")
    colors = _columns(table, ("red", "green", "blue"))
    if colors is None or not np.isfinite(colors).all():
        return None
    kind = np.asarray(first).dtype
    if kind.kind in "iu":
        return srgb_to_linear(np.clip(colors / np.iinfo(kind).max, 0.0, 1.0))
    return np.clip(colors, 0.0, 1.0)


def _uvs(
    vertex: dict[str, Floats | Ragged], face: dict[str, Floats | Ragged], faces: Ragged,
    notes: Notes,
) -> tuple[Floats | None, Ints | None]:  # fmt: skip
    """Texture coordinates at corners (as MeshLab writes them), or else at points."""
    texcoord = face.get("texcoord")
    uvs = indices = None
    if isinstance(texcoord, Ragged) and (texcoord.counts == 2 * faces.counts).all():
        values = texcoord.values.astype(np.float64).reshape(-1, 2)
        uvs, inverse = np.unique(values, axis=0, return_inverse=True)
        uvs, indices = used_rows(uvs, inverse.reshape(-1))
    else:
        for names in UV_NAMES:
            uvs = _columns(vertex, names) if uvs is None else uvs
    if uvs is not None and not np.isfinite(uvs).all():
        notes.add("some of its texture coordinates are not finite: all are left out")
        return None, None
    return uvs, indices


def _picture(path: Path, texture: str, notes: Notes) -> Picture | None:
    if not texture:
        return None
    found = path.parent / texture.replace("\\", "/")
    if not found.is_file():
        notes.add(f"its texture {texture} does not exist and is left out")
        return None
    return Picture(name=found.name, path=found)
