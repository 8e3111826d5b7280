"""The packed PLY layout of PlayCanvas and SuperSplat (``.compressed.ply``).

Every 256 Gaussians share a row of the element chunk with the limits of their positions, logarithmic
scales and colours (0..1 in older files); each has four 32-bit words of the vertex element:

    packed_position, packed_scale   x, y, z in 11, 10, 11 bits between the limits, x on top
    packed_rotation                 index of the largest of (w, x, y, z) in 2 bits, the others in
                                    their order in 10 bits each, from -1/sqrt(2) to 1/sqrt(2)
    packed_color                    red, green, blue, opacity in 8 bits each

and a byte for each f_rest of the element sh: -4 for 0, 4 for 255, else (b + 1/2) / 32 - 4.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gf_usd.assets.mesh_data import REPAIR
from gf_usd.assets.ply_body import Table
from gf_usd.errors import InputError
from gf_usd.harmonics import Y_0
from gf_usd.splats import Splats

PACKED = "packed_position"
CHUNK = 256
REST = {0: 0, 9: 1, 24: 2, 45: 3}  # bytes of sh, and the degree
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
            f"{path}: {count} packed Gaussians need {rows[-1] + 1} chunks, it has {have}", REPAIR
        )
    positions = _between(path, chunk, rows, ("x", "y", "z"), _bits(words["position"], XYZ))
    logs = _between(
        path, chunk, rows, ("scale_x", "scale_y", "scale_z"), _bits(words["scale"], XYZ)
    )
    colour = _bits(words["color"], BYTES)
    base = colour[:, :3]
    if "min_r" in chunk:
        base = _between(path, chunk, rows, ("r", "g", "b"), base)
    degree, rest = _rest(path, tables.get("sh", {}), count)
    harmonics = np.empty((count, (degree + 1) ** 2, 3), np.float32)
    harmonics[:, 0] = (base - 0.5) / Y_0
    harmonics[:, 1:] = rest.reshape(count, 3, (degree + 1) ** 2 - 1).swapaxes(1, 2)
    return Splats(
        positions=positions.astype(np.float32),
        orientations=_rotations(words["rotation"]),
        scales=np.exp(logs),
        opacities=colour[:, 3],
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


def _rest(path: Path, table: Table, count: int) -> tuple[int, NDArray[np.float64]]:
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
