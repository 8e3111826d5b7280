"""Reader of 3D Gaussian splats in PLY files: the layout of 3DGS, and the packed one of PlayCanvas.

Layout of 3DGS (Kerbl et al. 2023), per vertex: x y z; scale_0..2 (natural logarithm of the standard
deviation); rot_0..3 (w, x, y, z, not normalized); opacity (a logit); f_dc_0..2 (spherical harmonics
coefficients of degree 0, one per color); f_rest_* (higher degrees, all of red, then green, then
blue).  Other integer columns are labels.

Packed layout of PlayCanvas and SuperSplat (``.compressed.ply``): every 256 Gaussians share a row of
the element chunk with the bounds of their positions, logarithmic scales and colors (0..1 in older
files); each has four 32-bit words of the vertex element:

    packed_position, packed_scale   x, y, z in 11, 10, 11 bits between the limits, x on top
    packed_rotation                 index of the largest of (w, x, y, z) in 2 bits, the others in
                                    their order in 10 bits each, from -1/sqrt(2) to 1/sqrt(2)
    packed_color                    red, green, blue, opacity in 8 bits each

and a byte for each f_rest of the element sh: -4 for 0, 4 for 255, else (b + 1/2) / 32 - 4.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import Splats
from gf_usd.core.errors import InputError
from gf_usd.core.radiance import Y_0
from gf_usd.readers.mesh.data import REPAIR, refuse_pointer
from gf_usd.readers.mesh.ply.tables import Element, Ragged, Table, header, read_body

HEAD = 65536  # bytes that contain the header of a splat file
# Columns of 3DGS and derived programs that are not labels.
KNOWN = re.compile(r"[xyz]|n[xyz]|f_dc_\d|f_rest_\d+|opacity|scale_\d|rot_\d|packed_\w+")
WHOLE = 2.0**31  # bound of labels, the range of USD's int


REST = {0: 0, 9: 1, 24: 2, 45: 3}  # bytes of sh, and the degree


def holds_splats(path: Path) -> bool:
    """Whether the header of a PLY file has the columns of Gaussian splats, and no faces."""
    with path.open("rb") as file:
        head = file.read(HEAD).split(b"end_header")[0]
    words = [line.split() for line in head.splitlines()]
    names = {line[-1] for line in words if line[:1] == [b"property"]}
    faces = any(line[:2] == [b"element", b"face"] and line[2:] != [b"0"] for line in words)
    return not faces and (b"f_dc_0" in names or PACKED.encode() in names)


def read_splat_ply(path: Path) -> Splats:
    """The Gaussians of a PLY file.

    Raises InputError for a damaged file and for one that lacks a column.
    """
    data = path.read_bytes()
    refuse_pointer(path, data)
    elements, order, _, start = header(path, data)
    tables = read_body(path, data, start, elements, order)
    vertex = tables.get("vertex", {})
    if PACKED in vertex:
        return replace(unpack(path, tables), labels=_labels(vertex))
    _require(path, elements)
    degree, rest = _rest(path, vertex)
    count = len(np.asarray(vertex["x"]))
    harmonics = np.empty((count, (degree + 1) ** 2, 3), np.float32)
    harmonics[:, 0] = _stack(vertex, ["f_dc_0", "f_dc_1", "f_dc_2"])
    if degree:
        harmonics[:, 1:] = _stack(vertex, rest).reshape(count, 3, len(rest) // 3).swapaxes(1, 2)
    with np.errstate(over="ignore"):
        scales = np.exp(_stack(vertex, ["scale_0", "scale_1", "scale_2"]).astype(np.float64))
    return Splats(
        positions=_stack(vertex, ["x", "y", "z"]),
        orientations=_stack(vertex, ["rot_0", "rot_1", "rot_2", "rot_3"]).astype(np.float64),
        scales=scales,
        opacities=sigmoid(_stack(vertex, ["opacity"])[:, 0]),
        harmonics=harmonics,
        labels=_labels(vertex),
    )


def sigmoid(logit: Floats) -> NDArray[np.float64]:
    """1 / (1 + exp(-x)), without overflow."""
    x = np.asarray(logit, np.float64)
    small = np.exp(-np.abs(x))
    return np.where(x >= 0.0, 1.0, small) / (1.0 + small)


def _require(path: Path, elements: list[Element]) -> None:
    """Raise InputError where a column that 3DGS needs is missing."""
    vertex = next((e for e in elements if e.name == "vertex"), None)
    names = [c.name for c in vertex.columns] if vertex else []
    wanted = ["x", "y", "z", "opacity", *(f"f_dc_{i}" for i in range(3))]
    wanted += [f"scale_{i}" for i in range(3)] + [f"rot_{i}" for i in range(4)]
    missing = [name for name in wanted if name not in names]
    if missing:
        raise InputError(
            f"{path}: its Gaussian splats have no column {', '.join(missing)}",
            "3DGS files have the columns x y z, f_dc, opacity, scale and rot: " + REPAIR,
        )


def _rest(path: Path, vertex: Table) -> tuple[int, list[str]]:
    """Degree, and the names of the columns of the higher degrees in order."""
    count = sum(name.startswith("f_rest_") for name in vertex)
    names = [f"f_rest_{i}" for i in range(count)]
    if count not in REST or any(name not in vertex for name in names):
        raise InputError(
            f"{path}: it has {count} columns f_rest; degrees 0 to 3 have 0, 9, 24 and 45, "
            "numbered from 0",
            REPAIR,
        )
    return REST[count], names


def _labels(vertex: Table) -> dict[str, Ints]:
    """Every column of whole numbers but those that 3DGS has; some programs store them as floats."""
    found = {}
    for name, column in vertex.items():
        if isinstance(column, Ragged) or KNOWN.fullmatch(name):
            continue
        values = np.asarray(column, np.float64)
        if (np.isfinite(values) & (np.abs(values) < WHOLE) & (values == np.rint(values))).all():
            found[name] = values.astype(np.int64)
    return found


def _stack(table: Table, names: list[str]) -> NDArray[np.float32]:
    """(n, k) of scalar columns."""
    columns = [table[name] for name in names]
    assert not any(isinstance(column, Ragged) for column in columns)
    return np.stack([np.asarray(column, np.float32) for column in columns], axis=1)


PACKED = "packed_position"
CHUNK = 256


XYZ = ((21, 11), (11, 10), (0, 11))  # shift and bits
BYTES = ((24, 8), (16, 8), (8, 8), (0, 8))
THREE = ((20, 10), (10, 10), (0, 10))


def unpack(path: Path, tables: dict[str, Table]) -> Splats:
    """The Gaussians of the tables of a packed PLY file.

    Raises InputError where an element or a column is missing.
    """
    vertex, chunk = tables["vertex"], tables.get("chunk", {})
    words = {name: _column(path, vertex, f"packed_{name}", "vertex").astype(np.uint32)
             for name in ("position", "rotation", "scale", "color")}  # fmt: skip
    count = len(words["position"])
    rows = np.arange(count) // CHUNK
    have = len(next(iter(chunk.values()))) if chunk else 0  # type: ignore[arg-type]
    if count and have <= rows[-1]:
        raise InputError(
            f"{path}: {count} packed Gaussians need {rows[-1] + 1} chunks but it has {have}", REPAIR
        )
    positions = _between(path, chunk, rows, ("x", "y", "z"), _bits(words["position"], XYZ))
    logs = _between(
        path, chunk, rows, ("scale_x", "scale_y", "scale_z"), _bits(words["scale"], XYZ)
    )
    color = _bits(words["color"], BYTES)
    base = color[:, :3]
    if "min_r" in chunk:
        base = _between(path, chunk, rows, ("r", "g", "b"), base)
    degree, rest = _packed_rest(path, tables.get("sh", {}), count)
    harmonics = np.empty((count, (degree + 1) ** 2, 3), np.float32)
    harmonics[:, 0] = (base - 0.5) / Y_0
    harmonics[:, 1:] = rest.reshape(count, 3, (degree + 1) ** 2 - 1).swapaxes(1, 2)
    return Splats(
        positions=positions.astype(np.float32),
        orientations=_rotations(words["rotation"]),
        scales=np.exp(logs),
        opacities=color[:, 3],
        harmonics=harmonics,
    )


def _bits(words: NDArray[np.uint32], layout: tuple[tuple[int, int], ...]) -> NDArray[np.float64]:
    """(n, k) fields of words, each from 0 to 1."""
    fields = [((words >> shift) & (2**bits - 1)) / (2.0**bits - 1.0) for shift, bits in layout]
    return np.stack(fields, axis=1)


def _rotations(words: NDArray[np.uint32]) -> NDArray[np.float64]:
    """(n, 4) unit quaternions (w, x, y, z)."""
    three = (_bits(words, THREE) - 0.5) * np.sqrt(2.0)
    largest = (words >> 30).astype(int)
    out = np.empty((len(words), 4))
    rows = np.arange(len(words))
    for place in range(3):
        out[rows, place + (place >= largest)] = three[:, place]
    out[rows, largest] = np.sqrt(np.maximum(0.0, 1.0 - (three**2).sum(axis=1)))
    return out


def _between(
    path: Path, chunk: Table, rows: NDArray, names: tuple[str, ...], share: NDArray
) -> NDArray[np.float64]:
    """min + share (max - min) of each column, with the limits of each Gaussian's chunk."""
    low, high = (
        np.stack([_column(path, chunk, f"{end}_{n}", "chunk")[rows] for n in names], axis=1)
        for end in ("min", "max")
    )
    return low + share * (high - low)


def _packed_rest(path: Path, table: Table, count: int) -> tuple[int, NDArray[np.float64]]:
    """Degree and f_rest (n, 9, 24 or 45)."""
    if len(table) not in REST:
        raise InputError(
            f"{path}: its element sh has {len(table)} columns; degrees 1 to 3 have 9, 24 and 45",
            REPAIR,
        )
    columns = [_column(path, table, f"f_rest_{i}", "sh") for i in range(len(table))]
    stored = np.stack(columns, axis=1) if columns else np.empty((count, 0))
    inner = (stored + 0.5) / 32.0 - 4.0
    return REST[len(table)], np.where(stored == 0, -4.0, np.where(stored == 255, 4.0, inner))


def _column(path: Path, table: Table, name: str, element: str) -> NDArray:
    if name not in table:
        raise InputError(f"{path}: its element {element} has no column {name}", REPAIR)
    column = np.asarray(table[name])
    return column.astype(np.float64) if column.dtype.kind == "f" else column
