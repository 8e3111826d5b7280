"""Reader of STL files by trimesh, with additional validation."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gf_usd.core.errors import InputError, counted
from gf_usd.core.mesh.topology import weld
from gf_usd.readers.mesh.data import (
    REPAIR,
    FileMesh,
    FileNode,
    MeshFile,
    load,
    refuse_pointer,
    require_sound,
    used_rows,
)
from gf_usd.readers.notes import Notes

STL_HEADER, STL_FACET = 84, 50  # bytes


def read_stl(path: Path) -> MeshFile:
    """The triangles of an STL file, one mesh per solid, with coincident corners merged.

    Raises InputError for a file that is neither text nor of the length that its header declares.
    """
    data = path.read_bytes()
    refuse_pointer(path, data)
    notes = Notes()
    loaded = load(path, _stl_body(path, data, notes), "stl")
    nodes = []
    for name, points, triangles in loaded:
        joined, indices = used_rows(points, weld(points, 0.0)[0][triangles.reshape(-1)])
        mesh = FileMesh(
            name=name, points=joined, counts=np.full(len(triangles), 3), indices=indices
        )
        nodes.append(FileNode(name=name, mesh=mesh))
    return require_sound(
        MeshFile(
            path=path,
            format="STL",
            nodes=tuple(nodes),
            up_axis="Z",
            inputs=(path,),
            notes=notes.lines(),
        )
    )


def _stl_body(path: Path, data: bytes, notes: Notes) -> bytes:
    """The file's bytes, normalized for trimesh's detection of text and binary files."""
    count = int.from_bytes(data[80:STL_HEADER], "little") if len(data) >= STL_HEADER else 0
    whole = STL_HEADER + STL_FACET * count
    text = data.lstrip()[:5].lower() == b"solid" and b"facet" in data.lower()
    if count and len(data) >= whole and not (text and len(data) > whole):
        if len(data) > whole:
            extra = counted(len(data) - whole, "byte")
            notes.add(f"the file ends with {extra} after its {count} triangles: ignored")
        return data[:whole]
    if text:
        if data.lower().count(b"endsolid") == 0:
            raise InputError(f"{path} is truncated: its solid has no end", REPAIR)
        return data.decode("utf-8", errors="replace").encode()
    raise InputError(
        f"{path} is not a complete STL file: a binary file with {count} triangles has {whole} "
        f"bytes, but this file has {len(data)} and is not text that begins with 'solid'",
        "the file was truncated or altered: " + REPAIR,
    )
