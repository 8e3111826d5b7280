"""STL and OFF files, parsed by trimesh; what it would pass over in silence is looked at first."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gf_usd.assets.mesh_data import (
    REPAIR,
    FileMesh,
    FileNode,
    MeshFile,
    refuse_pointer,
    require_sound,
    tidy,
)
from gf_usd.assets.notes import Notes
from gf_usd.assets.trimesh_load import load
from gf_usd.errors import InputError
from gf_usd.model import Floats, Ints
from gf_usd.topology import weld

STL_HEADER, STL_FACET = 84, 50  # bytes


def read_stl(path: Path) -> MeshFile:
    """The triangles of an STL file, one mesh for each solid; corners in one place are one point.

    Raises InputError for a file that is neither text nor as long as its header says.
    """
    data = path.read_bytes()
    refuse_pointer(path, data)
    notes = Notes()
    loaded = load(path, _stl_body(path, data, notes), "stl")
    nodes = []
    for name, points, triangles in loaded:
        joined, indices = tidy(points, weld(points, 0.0)[0][triangles.reshape(-1)])
        nodes.append(_node(name, joined, np.full(len(triangles), 3), indices))
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
    """The file, in the form that trimesh is sure to understand."""
    count = int.from_bytes(data[80:STL_HEADER], "little") if len(data) >= STL_HEADER else 0
    whole = STL_HEADER + STL_FACET * count
    text = data.lstrip()[:5].lower() == b"solid" and b"facet" in data.lower()
    if count and len(data) >= whole and not (text and len(data) > whole):
        if len(data) > whole:
            notes.add(f"{len(data) - whole} bytes follow its {count} triangles: left out")
        return data[:whole]
    if text:
        if data.lower().count(b"endsolid") == 0:
            raise InputError(f"{path} is cut off: its solid does not end", REPAIR)
        return data.decode("utf-8", errors="replace").encode()
    raise InputError(
        f"{path} is no whole STL file: a binary one with {count} triangles has {whole} bytes, "
        f"this has {len(data)}, and it is no text that begins with 'solid'",
        "it was cut off or altered: " + REPAIR,
    )


def read_off(path: Path) -> MeshFile:
    """The polygons of an OFF file, cut into triangles, as trimesh gives them (and it says so).

    Raises InputError for counts that do not fit the lines, and for what is no number.
    """
    data = path.read_bytes()
    refuse_pointer(path, data)
    vertices, faces, corners = _off_counts(path, data)
    notes = Notes()
    (name, points, triangles), *_ = load(path, data, "off")
    if corners > 3 * faces:
        notes.add(f"its {faces} polygons were cut into {len(triangles)} triangles")
    if len(points) != vertices:
        raise InputError(f"{path}: {len(points)} of {vertices} vertices could be read", REPAIR)
    node = _node(name, points, np.full(len(triangles), 3), triangles.reshape(-1))
    return require_sound(
        MeshFile(path=path, format="OFF", nodes=(node,), inputs=(path,), notes=notes.lines())
    )


def _off_counts(path: Path, data: bytes) -> tuple[int, int, int]:
    """Vertices and faces as announced, and corners of all faces; every line of them is there."""
    text = data.decode("utf-8", errors="replace")
    rows = [
        (number, words)
        for number, line in enumerate(text.splitlines(), 1)
        if (words := line.split("#", 1)[0].split())
    ]
    if not rows or rows[0][1][0] not in ("OFF", "COFF"):
        raise InputError(
            f"{path} does not begin with OFF or COFF",
            "check what the file really is; other kinds of OFF are not read",
        )
    rest = [(n, w) for n, w in [(rows[0][0], rows[0][1][1:]), *rows[1:]] if w]
    if not rest or len(rest[0][1]) < 2 or not all(w.isdigit() for w in rest[0][1][:2]):
        raise InputError(f"{path}: no line with its numbers of vertices and faces", REPAIR)
    vertices, faces = (int(word) for word in rest[0][1][:2])
    if len(rest) < 1 + vertices + faces:
        raise InputError(
            f"{path} announces {vertices} vertices and {faces} faces, and {len(rest) - 1} lines "
            "follow",
            "it was cut off or altered: " + REPAIR,
        )
    corners = 0
    for number, words in rest[1 + vertices : 1 + vertices + faces]:
        if not words[0].isdigit() or len(words) < 1 + int(words[0]):
            raise InputError(
                f"{path}, line {number}: '{' '.join(words)[:60]}' is no face: a count and as many "
                "indices",
                REPAIR,
            )
        corners += int(words[0])
    return vertices, faces, corners


def _node(name: str, points: Floats, counts: Ints, indices: Ints) -> FileNode:
    mesh = FileMesh(name=name, points=points, counts=counts, indices=indices)
    return FileNode(name=name, mesh=mesh)
