"""Reader of OFF files: a line of counts, a line for each vertex and a line for each polygon.

trimesh triangulates the polygons and does not support comments; this reader preserves polygons.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gf_usd.core.errors import InputError
from gf_usd.readers.mesh.data import (
    REPAIR,
    FileMesh,
    FileNode,
    MeshFile,
    refuse_pointer,
    require_sound,
)
from gf_usd.readers.notes import Notes

HEADS = ("OFF", "COFF")
Rows = list[tuple[int, list[str]]]  # (line number, tokens)


def read_off(path: Path) -> MeshFile:
    """The polygons of an OFF or COFF file; colors are not read.

    Raises InputError for counts that do not match the lines, and for invalid numbers.
    """
    data = path.read_bytes()
    refuse_pointer(path, data)
    notes = Notes()
    vertices, faces = _rows(path, data)
    points = [_numbers(path, line, tokens[:3]) for line, tokens in vertices]
    corners: list[int] = []
    counts: list[int] = []
    for line, tokens in faces:
        count = int(tokens[0]) if tokens[0].isdigit() else -1
        if not 0 <= count < len(tokens) or not all(_is_whole(w) for w in tokens[1 : 1 + count]):
            raise InputError(
                f"{path}, line {line}: '{' '.join(tokens)[:60]}' is not a face (a count "
                f"followed by that many indices)",
                REPAIR,
            )
        counts.append(count)
        corners.extend(int(token) for token in tokens[1 : 1 + count])
    if any(len(tokens) > 3 for _, tokens in vertices) or any(
        len(tokens) > 1 + count for (_, tokens), count in zip(faces, counts)
    ):
        notes.add("its colors are ignored")
    mesh = FileMesh(
        name="mesh",
        points=np.array(points).reshape(-1, 3),
        counts=np.array(counts, np.int64),
        indices=np.array(corners, np.int64),
    )
    return require_sound(
        MeshFile(
            path=path,
            format="OFF",
            nodes=(FileNode(name=mesh.name, mesh=mesh),),
            inputs=(path,),
            notes=notes.lines(),
        )
    )


def _rows(path: Path, data: bytes) -> tuple[Rows, Rows]:
    """The lines of the vertices and those of the faces."""
    lines = data.decode("utf-8", errors="replace").splitlines()
    split = ((n, line.split("#")[0].split()) for n, line in enumerate(lines, 1))
    rows = [(n, tokens) for n, tokens in split if tokens]
    if not rows or rows[0][1][0] not in HEADS:
        raise InputError(
            f"{path} does not begin with {' or '.join(HEADS)}",
            "check the type of the file; other kinds of OFF are not supported",
        )
    # The counts may be on the first line, too.
    rows[0] = (rows[0][0], rows[0][1][1:])
    rows = rows if rows[0][1] else rows[1:]
    if not rows or len(rows[0][1]) < 2 or not all(token.isdigit() for token in rows[0][1][:2]):
        raise InputError(
            f"{path}: the line with the numbers of vertices and faces is missing", REPAIR
        )
    n_vertices, n_faces = (int(token) for token in rows[0][1][:2])
    if len(rows) < 1 + n_vertices + n_faces:
        raise InputError(
            f"{path} declares {n_vertices} vertices and {n_faces} faces, but {len(rows) - 1} "
            f"lines follow",
            "the file was truncated or altered: " + REPAIR,
        )
    return rows[1 : 1 + n_vertices], rows[1 + n_vertices : 1 + n_vertices + n_faces]


def _numbers(path: Path, line: int, tokens: list[str]) -> list[float]:
    try:
        numbers = [float(token) for token in tokens]
    except ValueError:
        numbers = []
    if len(numbers) != 3:
        raise InputError(f"{path}, line {line}: '{' '.join(tokens)[:60]}' is not a vertex", REPAIR)
    return numbers


def _is_whole(token: str) -> bool:
    return token.removeprefix("-").isdigit()
