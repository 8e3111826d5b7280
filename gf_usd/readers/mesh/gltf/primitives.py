"""Decoding of the primitives of a glTF file into arrays.

Accessors are decoded by glTF 2.0, 3.6.2: all component types, strides, normalized integers and
sparse accessors; Draco compression by DracoPy, where it is installed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.errors import InputError
from gf_usd.readers.mesh.data import REPAIR
from gf_usd.readers.mesh.gltf.container import DRACO, Gltf
from gf_usd.readers.notes import Notes

GAUSSIANS = "KHR_gaussian_splatting"
TRIANGLES, STRIP = 4, 5
COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
INDICES = (5121, 5123, 5125)
# rows and columns of an element
SHAPES = {"SCALAR": (1, 1), "VEC2": (2, 1), "VEC3": (3, 1), "VEC4": (4, 1)} | {
    "MAT2": (2, 2), "MAT3": (3, 3), "MAT4": (4, 4)
}  # fmt: skip
ALIGNED = 4  # bytes, between the columns of a matrix
# least and greatest number of components of an attribute
WIDTHS = {"NORMAL": (3, 3), "TEXCOORD": (2, 2), "COLOR": (3, 4), "JOINTS": (4, 4)} | {
    "WEIGHTS": (4, 4)
}


@dataclass(frozen=True, kw_only=True)
class Primitive:
    """One primitive in mesh space."""

    points: Floats  # (V, 3)
    triangles: Ints  # (T, 3)
    attributes: dict[str, Floats]  # by glTF name, each (V, k)
    material: int | None


def read_primitives(gltf: Gltf, notes: Notes) -> dict[tuple[int, int], Primitive]:
    """All triangle primitives, by (mesh index, primitive index).

    Raises InputError for accessors that exceed their buffers or have inconsistent lengths, and for
    compressed data that cannot be decoded.
    """
    rows = [
        (m, p, primitive)
        for m, mesh in enumerate(gltf.rows("meshes"))
        for p, primitive in enumerate(mesh.get("primitives", []))
        if _is_surface(primitive, m, notes)
    ]
    if not rows and GAUSSIANS in gltf.tree.get("extensionsUsed", []):
        raise InputError(
            f"{gltf.path}: it holds Gaussians ({GAUSSIANS}), which are not supported in glTF",
            "export them as PLY, SPZ or USD",
        )
    if not rows:
        raise InputError(
            f"{gltf.path}: the file contains no mesh", "give a file that contains a mesh"
        )
    return {(m, p): _primitive(gltf, f"mesh {m}, primitive {p}", row) for m, p, row in rows}


def _is_surface(primitive: dict[str, Any], mesh: int, notes: Notes) -> bool:
    mode = primitive.get("mode", TRIANGLES)
    if mode not in (TRIANGLES, STRIP):
        notes.add(f"points, lines and triangle fans (mode {mode}) are left out", f"mesh {mesh}")
    return mode in (TRIANGLES, STRIP)


def _primitive(gltf: Gltf, where: str, row: dict[str, Any]) -> Primitive:
    named = row.get("attributes", {})
    if "POSITION" not in named:
        raise InputError(f"{gltf.path}: {where} has no POSITION", REPAIR)
    if _is_compressed(gltf, row):
        raw, corners = _decompressed(gltf, where, row)
    else:
        raw = {key: decoded(gltf, index) for key, index in named.items()}
        corners = _corners(gltf, where, row, len(raw["POSITION"]))
    points = raw.pop("POSITION")
    if points.shape[1] != 3:
        raise InputError(
            f"{gltf.path}: {where}: POSITION does not hold three numbers per point", REPAIR
        )
    if len(points) and not np.ptp(points, axis=0).any():
        raise InputError(
            f"{gltf.path}: {where} has no size: its {len(points)} points are all in one place",
            REPAIR,
        )
    for key, values in raw.items():
        low, high = WIDTHS.get(key.split("_")[0], (1, 16))
        if len(values) != len(points) or not low <= values.shape[1] <= high:
            raise InputError(
                f"{gltf.path}: {where}: {key} has {len(values)} rows of {values.shape[1]} "
                f"values for {len(points)} points",
                REPAIR,
            )
    return Primitive(
        points=points,
        triangles=_triangles(gltf, where, row, corners),
        attributes=raw,
        material=row.get("material"),
    )


def _corners(gltf: Gltf, where: str, row: dict[str, Any], points: int) -> Ints:
    """(C,) the points of the corners; without indices, 0, 1, ..."""
    if "indices" not in row:
        return np.arange(points)
    accessor = gltf.row("accessors", row["indices"])
    if accessor.get("componentType") not in INDICES or accessor.get("type") != "SCALAR":
        raise InputError(
            f"{gltf.path}: {where}: its indices are {accessor.get('type')} of component type "
            f"{accessor.get('componentType')}, not unsigned integers",
            REPAIR,
        )
    if "bufferView" not in accessor and "sparse" not in accessor:
        raise InputError(f"{gltf.path}: {where}: its indices have no data", REPAIR)
    return _elements(gltf, row["indices"]).reshape(-1).astype(np.int64)


def _triangles(gltf: Gltf, where: str, row: dict[str, Any], corners: Ints) -> Ints:
    """(T, 3) triangles of a triangle list or strip: glTF 2.0, 3.7.2.1."""
    if row.get("mode", TRIANGLES) == STRIP:
        k = np.arange(max(len(corners) - 2, 0))
        return np.stack([corners[k], corners[k + 1 + k % 2], corners[k + 2 - k % 2]], axis=1)
    if len(corners) % 3:
        raise InputError(
            f"{gltf.path}: {where}: its {len(corners)} corners do not make complete triangles",
            REPAIR,
        )
    return corners.reshape(-1, 3)


def decoded(gltf: Gltf, index: int | None) -> Floats:
    """(n, k) values of an accessor; normalized integers are converted to floats."""
    accessor = gltf.row("accessors", index)
    return _numbers(accessor, _elements(gltf, index))


def _numbers(accessor: dict[str, Any], values: np.ndarray) -> Floats:
    width = int(np.prod(values.shape[1:]))
    numbers = values.astype(np.float64).reshape(len(values), width)
    if not accessor.get("normalized") or values.dtype.kind == "f":
        return numbers
    return np.maximum(numbers / np.iinfo(values.dtype).max, -1.0)


def _elements(gltf: Gltf, index: int | None) -> np.ndarray:
    """(n, k) stored values of an accessor; zeros without a buffer view; sparse values applied."""
    accessor = gltf.row("accessors", index)
    where = f"{gltf.path}: accessor {index}"
    count, (rows, columns) = accessor.get("count", 0), SHAPES.get(accessor.get("type", ""), (0, 0))
    component = COMPONENTS.get(accessor.get("componentType", 0))
    if component is None or not rows:
        raise InputError(
            f"{where} holds {accessor.get('type')} of component type "
            f"{accessor.get('componentType')}, which glTF does not define",
            REPAIR,
        )
    dtype = np.dtype(component)
    if "bufferView" in accessor:
        found = _rows(gltf, where, accessor, dtype, count, rows, columns)
    elif count * rows * columns > sum(map(len, gltf.buffers)):
        raise InputError(f"{where} declares {count} rows but has no data for them", REPAIR)
    else:
        found = np.zeros((count, rows * columns), dtype)
    if "sparse" not in accessor:
        return found
    return _replaced(gltf, where, found, accessor["sparse"], rows, columns)


def _rows(
    gltf: Gltf, where: str, at: dict[str, Any], dtype: np.dtype, count: int, rows: int, columns: int
) -> np.ndarray:
    """(count, rows * columns) values of a buffer view; matrices are column-major."""
    view, start = at.get("bufferView"), at.get("byteOffset", 0)
    data = gltf.view(view)
    packed = rows * dtype.itemsize
    column = packed if columns == 1 else -(-packed // ALIGNED) * ALIGNED
    size = (columns - 1) * column + packed
    stride = gltf.row("bufferViews", view).get("byteStride") or columns * column
    end = start + (count - 1) * stride + size if count else start
    if stride < size or end > len(data):
        raise InputError(
            f"{where} refers to {count} rows of {size} bytes with a stride of {stride}, from "
            f"byte {start} of a buffer view of {len(data)} bytes",
            REPAIR,
        )
    if not count:
        return np.zeros((0, rows * columns), dtype)
    steps = (stride, column, dtype.itemsize)
    found = np.ndarray((count, columns, rows), dtype, data, start, steps)
    return found.reshape(count, rows * columns)


def _replaced(
    gltf: Gltf, where: str, base: np.ndarray, sparse: dict[str, Any], rows: int, columns: int
) -> np.ndarray:
    """Rows with the substitutions of a sparse accessor: glTF 2.0, 3.6.2.3."""
    count, at, values = (sparse.get(key) for key in ("count", "indices", "values"))
    kind = at.get("componentType") if at else None
    if count is None or not at or not values or kind not in INDICES:
        raise InputError(
            f"{where} is sparse but does not state its number of rows, their indices and their "
            f"values",
            REPAIR,
        )
    where, dtype = f"{where}, sparse,", np.dtype(COMPONENTS[kind])
    index = _rows(gltf, where, at, dtype, count, 1, 1)[:, 0]
    new = _rows(gltf, where, values, base.dtype, count, rows, columns)
    if count and int(index.max()) >= len(base):
        raise InputError(
            f"{where} replaces row {int(index.max())}, but there are only {len(base)} rows", REPAIR
        )
    out = base.copy()
    out[index] = new
    return out


def _is_compressed(gltf: Gltf, row: dict[str, Any]) -> bool:
    """Whether a primitive has Draco-compressed data only."""
    if DRACO not in row.get("extensions", {}):
        return False
    plain = (gltf.row("accessors", index) for index in row["attributes"].values())
    return not all("bufferView" in accessor for accessor in plain)


def _decompressed(gltf: Gltf, where: str, row: dict[str, Any]) -> tuple[dict[str, Floats], Ints]:
    """Attributes by glTF name, and corners (C,), of a Draco-compressed primitive."""
    try:
        import DracoPy
    except ImportError as error:
        raise InputError(
            f"{gltf.path}: {where} is compressed with {DRACO}, which requires DracoPy",
            "export it without Draco compression, or: pip install DracoPy",
        ) from error
    blob = row["extensions"][DRACO]
    try:
        mesh = DracoPy.decode(gltf.view(blob.get("bufferView")))
    except (ValueError, RuntimeError, TypeError, DracoPy.FileTypeException) as error:
        raise InputError(
            f"{gltf.path}: {where} is compressed with {DRACO}, and its data cannot be decoded: "
            f"{error}",
            REPAIR,
        ) from error
    faces = getattr(mesh, "faces", None)
    by_id = {one["unique_id"]: one["data"] for one in mesh.attributes}
    found = {
        key: _numbers(gltf.row("accessors", row["attributes"][key]), np.asarray(by_id[number]))
        for key, number in blob.get("attributes", {}).items()
        if number in by_id and key in row["attributes"]
    }
    if "POSITION" not in found or faces is None:
        raise InputError(f"{gltf.path}: {where}: its compressed data contains no mesh", REPAIR)
    return found, np.asarray(faces, np.int64).reshape(-1)
