"""3D Gaussian splats in PLY files, as 3DGS and its heirs write them.

Per vertex: x y z; scale_0..2 (natural logarithm of the standard deviation); rot_0..3 (w, x, y, z,
not normalised); opacity (a logit); f_dc_0..2 (coefficients of degree 0, one a colour); f_rest_*
(the higher degrees, all of red first, then green, then blue).  Any other column of whole numbers is
a label.  The packed layout of PlayCanvas is
read by `splat_packed`.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gf_usd.assets.mesh_data import REPAIR, refuse_pointer
from gf_usd.assets.ply import header
from gf_usd.assets.ply_body import Element, Ragged, Table, read_body
from gf_usd.assets.splat_packed import PACKED, unpack
from gf_usd.errors import InputError
from gf_usd.model import Floats, Ints
from gf_usd.splats import Splats

HEAD = 65536  # bytes in which the header of a splat file ends
# What 3DGS and its heirs write beside labels.
KNOWN = re.compile(r"[xyz]|n[xyz]|f_dc_\d|f_rest_\d+|opacity|scale_\d|rot_\d|packed_\w+")
WHOLE = 2.0**31  # labels are as large as USD's int at most
REST = {0: 0, 9: 1, 24: 2, 45: 3}  # columns of f_rest, and the degree


def holds_splats(path: Path) -> bool:
    """True for a PLY file of Gaussian splats: its header has their columns and no faces."""
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
            "3DGS files have x y z, f_dc, opacity, scale and rot: " + REPAIR,
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
