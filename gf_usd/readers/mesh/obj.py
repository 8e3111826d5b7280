"""Reader of Wavefront OBJ files.

Supported are v (with w, or with colors r g b), vt, vn, f with any number of corners and negative
indices, o, g, usemtl, mtllib, and line continuation by a backslash.  Polygons and UV seams are
preserved: texture coordinates and normals keep their own indices.

There is one mesh for each object or group, but those that share points are one mesh, since their
parts would be open surfaces; their names become face sets on it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.errors import InputError, counted, listed
from gf_usd.core.neighbors import components
from gf_usd.core.radiance import srgb_to_linear
from gf_usd.readers.mesh.data import (
    REPAIR,
    FileMesh,
    FileNode,
    MeshFile,
    refuse_pointer,
    require_sound,
    used_rows,
)
from gf_usd.readers.mesh.mtl import read_libraries
from gf_usd.readers.notes import Notes

SILENT = {"#", "s", "mg", "lod", "bevel", "c_interp", "d_interp", "shadow_obj", "trace_obj"}
OTHER = {"l": "line", "p": "point"}
THIN = "face with fewer than three corners"
LEFT_OUT = {THIN: "faces with fewer than three corners"}  # plurals that are not the noun with s


def read_obj(path: Path) -> MeshFile:
    """The polygons, groups and materials of an OBJ file.

    Raises InputError for an invalid line (with its number), an index out of range, numbers that are
    not finite, and a file without faces.
    """
    with path.open("rb") as file:
        head = file.read(512)
    refuse_pointer(path, head)
    if b"\0" in head:
        raise InputError(
            f"{path} is not an OBJ file: it holds binary data", "check the type of the file"
        )
    notes = Notes()
    reader = _Reader(path)
    for number, tokens in _statements(path):
        reader.take(number, tokens)
    tables = reader.tables(notes)
    materials, read = read_libraries(path, reader.libraries, tables.material_names, notes)
    return require_sound(
        MeshFile(
            path=path,
            format="OBJ",
            nodes=to_nodes(tables, list(materials), notes),
            materials=tuple(materials.values()),
            inputs=(path, *read),
            notes=notes.lines(),
        )
    )


def _statements(path: Path) -> Iterator[tuple[int, list[str]]]:
    """(line number, tokens) of each non-empty line; a final backslash continues it."""
    begun, first = "", 0
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        for number, line in enumerate(file, start=1):
            first = first or number
            text = line.rstrip("\r\n")
            if text.endswith("\\"):
                begun += text[:-1] + " "
                continue
            tokens = (begun + text).split()
            if tokens:
                yield first, tokens
            begun, first = "", 0
    if begun.split():
        yield first, begun.split()


class _Reader:
    """Parser that collects statements into tables."""

    def __init__(self, path: Path) -> None:
        self.libraries: list[str] = []
        self._path = path
        self._rows: dict[str, list[list[float]]] = {"v": [], "vt": [], "vn": []}
        self._lines: dict[str, list[int]] = {"v": [], "vt": [], "vn": []}
        self._counts: list[int] = []
        self._face_lines: list[int] = []
        self._corners: tuple[list[int], list[int], list[int]] = ([], [], [])
        self._parts: dict[tuple[str, str], int] = {}
        self._names: dict[str, int] = {}
        self._object, self._group, self._material = "", "", NO_INDEX
        self._face_parts: list[int] = []
        self._face_materials: list[int] = []
        self._left_out: Counter[str] = Counter()

    def take(self, number: int, tokens: list[str]) -> None:
        """Add one statement."""
        key = tokens[0]
        if key in self._rows:
            self._row(key, number, tokens)
        elif key in ("f", "fo"):
            self._face(number, tokens)
        elif key == "o":
            self._object, self._group = " ".join(tokens[1:]), ""
        elif key == "g":
            self._group = " ".join(tokens[1:])
        elif key == "usemtl":
            name = " ".join(tokens[1:])
            self._material = self._names.setdefault(name, len(self._names))
        elif key == "mtllib":
            self.libraries.append(" ".join(tokens[1:]))
        elif key in OTHER:
            self._left_out[OTHER[key]] += 1
        elif key not in SILENT and not key.startswith("#"):
            self._left_out[f"'{key[:16]}' statement"] += 1

    def _row(self, key: str, number: int, tokens: list[str]) -> None:
        try:
            values = [float(token) for token in tokens[1:8]]
        except ValueError:
            shown = " ".join(tokens)[:60]
            raise self._error(number, f"'{shown}' contains a value that is not a number") from None
        least = 1 if key == "vt" else 3
        if len(values) < least:
            raise self._error(number, f"{key} has {len(values)} numbers but needs {least}")
        if key == "vt":
            values = [values[0], values[1] if len(values) > 1 else 0.0]
        elif key == "vn":
            values = values[:3]
        self._rows[key].append(values)
        self._lines[key].append(number)

    def _face(self, number: int, tokens: list[str]) -> None:
        if len(tokens) < 4:
            self._left_out[THIN] += 1
            return
        lengths = [len(self._rows[key]) for key in ("v", "vt", "vn")]
        for token in tokens[1:]:
            parts = token.split("/")
            if len(parts) > 3:
                raise self._error(number, f"the corner '{token}' has {len(parts)} indices, not 1-3")
            for slot in range(3):
                text = parts[slot] if slot < len(parts) else ""
                index = NO_INDEX
                if text or slot == 0:
                    index = self._index(number, token, text, lengths[slot])
                self._corners[slot].append(index)
        self._counts.append(len(tokens) - 1)
        self._face_lines.append(number)
        key = (self._object, self._group)
        self._face_parts.append(self._parts.setdefault(key, len(self._parts)))
        self._face_materials.append(self._material)

    def _index(self, number: int, token: str, text: str, length: int) -> int:
        """Zero-based index; a negative one counts from the end of the table so far."""
        try:
            value = int(text)
        except ValueError:
            raise self._error(number, f"the corner '{token}' is not an index") from None
        if value > 0:
            return value - 1
        if value == 0 or -value > length:
            what = "indices begin at 1" if value == 0 else f"only {length} precede it"
            raise self._error(number, f"the corner '{token}' has the index {value}: {what}")
        return length + value

    def tables(self, notes: Notes) -> Tables:
        """The tables as arrays; raises InputError where they are inconsistent."""
        for what, count in self._left_out.items():
            notes.add(f"left out: {counted(count, what, LEFT_OUT.get(what, ''))}")
        if not self._counts:
            raise InputError(
                f"{self._path}: the file contains no faces ({len(self._rows['v'])} points)",
                "give a file that contains a mesh; export free-form surfaces as polygons",
            )
        points = self._table("v", 3)
        tables = Tables(
            points=points,
            colors=self._colors(),
            uvs=self._table("vt", 2),
            normals=self._table("vn", 3),
            counts=np.array(self._counts),
            corners=np.array(self._corners[0]),
            uv_corners=np.array(self._corners[1]),
            normal_corners=np.array(self._corners[2]),
            parts=np.array(self._face_parts),
            part_names=tuple(self._parts),
            materials=np.array(self._face_materials),
            material_names=tuple(self._names),
        )
        for key, table, corners in (
            ("v", tables.points, tables.corners),
            ("vt", tables.uvs, tables.uv_corners),
            ("vn", tables.normals, tables.normal_corners),
        ):
            self._require_inside(key, len(table), corners)
        return tables

    def _table(self, key: str, width: int) -> np.ndarray:
        rows = np.array([row[:width] for row in self._rows[key]]).reshape(-1, width)
        lost = np.flatnonzero(~np.isfinite(rows).all(axis=1))
        if len(lost):
            line = self._lines[key][lost[0]]
            more = f"; {len(lost)} rows in all" if len(lost) > 1 else ""
            raise self._error(line, f"{key} contains a number that is not finite{more}")
        return rows

    def _colors(self) -> np.ndarray | None:
        """(V, 3) sRGB colors: the last three of the six or seven numbers of every v."""
        rows = self._rows["v"]
        if min(len(row) for row in rows) < 6:
            return None
        return np.array([row[-3:] for row in rows])

    def _require_inside(self, key: str, length: int, corners: np.ndarray) -> None:
        outside = np.flatnonzero(corners >= length)
        if len(outside):
            face = int(np.searchsorted(np.cumsum(self._counts), outside[0], side="right"))
            raise self._error(
                self._face_lines[face],
                f"the face names {key} {corners[outside[0]] + 1}, but there are {length}; "
                f"{counted(len(outside), 'corner has', 'corners have')} such an index",
            )

    def _error(self, line: int, what: str) -> InputError:
        return InputError(f"{self._path}, line {line}: {what}", REPAIR)


NO_INDEX = -1
NO_NAME = "mesh"


@dataclass(frozen=True, kw_only=True)
class Tables:
    """An OBJ file as arrays; indices are zero-based and valid, or NO_INDEX."""

    points: Floats  # (V, 3)
    colors: Floats | None  # (V, 3) sRGB
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
    rows = np.array([where.get(n, NO_INDEX) for n in tables.material_names] + [NO_INDEX])
    materials = rows[tables.materials]
    face_of = np.repeat(np.arange(len(tables.counts)), tables.counts)
    unused = len(tables.points) - len(np.unique(tables.corners))
    if unused:
        belong = "belongs to no face and is" if unused == 1 else "belong to no face and are"
        notes.add(f"{unused} of its {len(tables.points)} points {belong} left out")
    nodes = []
    for faces, parts in _bodies(tables, face_of):
        mesh = _mesh(tables, faces, parts, materials, face_of, notes)
        nodes.append(FileNode(name=mesh.name, mesh=mesh))
    return tuple(nodes)


def _bodies(tables: Tables, face_of: Ints) -> list[tuple[Ints, list[int]]]:
    """(faces, parts) of each body: parts that share points are joined; in the file's order."""
    n = len(tables.part_names)
    if n == 1:
        return [(np.arange(len(tables.counts)), [0])]
    from scipy.sparse import coo_matrix

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
            f"its {len(parts)} objects or groups ({listed(names, 3)}) share points and are read as "
            f"one mesh",
            name,
        )
    mine = np.isin(face_of, faces)
    points, indices, used = _points(tables, mine)
    uvs, uv_indices = _uvs(tables, mine, name, notes)
    normals, normal_indices = _normals(tables, mine, name, notes)
    colors = None
    if tables.colors is not None:
        colors = srgb_to_linear(np.clip(tables.colors[used], 0.0, 1.0))
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
        colors=colors,
        materials=own if (own != NO_INDEX).any() else None,
        groups=groups,
    )


def _points(tables: Tables, mine: Ints) -> tuple[Floats, Ints, Ints]:
    """Points (V, 3) of the corners, indices into these, and their rows in the file's table."""
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
            f"(0, 0) is used",
            name,
        )
        corners = np.where(missing, len(table), corners)
        table = np.vstack([table, [[0.0, 0.0]]])
    return used_rows(table, corners)


def _normals(
    tables: Tables, mine: Ints, name: str, notes: Notes
) -> tuple[Floats | None, Ints | None]:
    corners = tables.normal_corners[mine]
    missing = corners == NO_INDEX
    if missing.any():
        if not missing.all():
            notes.add(
                f"{int(missing.sum())} of its {len(corners)} corners have no normal, so all of "
                f"its normals are left out",
                name,
            )
        return None, None
    return used_rows(tables.normals, corners)


def _name(thing: str, group: str) -> str:
    return "_".join(token for token in (thing, group) if token) or NO_NAME
