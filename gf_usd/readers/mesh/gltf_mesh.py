"""The primitives of a glTF file as arrays, decoded by trimesh.

trimesh gets the file rewritten: every primitive is a mesh of its own whose name says which it is,
and each attribute also stands under a name with an underscore, which it hands on as it is.  So
nothing is lost to its own ideas of colours and texture coordinates.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.errors import InputError
from gf_usd.readers.mesh.data import REPAIR, load_meshes
from gf_usd.readers.mesh.gltf import DRACO, Gltf
from gf_usd.readers.notes import Notes

GAUSSIANS = "KHR_gaussian_splatting"
TRIANGLES, STRIP = 4, 5
# what a whole number stands for where its accessor is normalised: componentType -> largest
WHOLE = {5120: 127.0, 5121: 255.0, 5122: 32767.0, 5123: 65535.0}
# fewest and most numbers in a row of an attribute
WIDTHS = {"NORMAL": (3, 3), "TEXCOORD": (2, 2), "COLOR": (3, 4), "JOINTS": (4, 4)} | {
    "WEIGHTS": (4, 4)
}


@dataclass(frozen=True, kw_only=True)
class Primitive:
    """One primitive in the space of its mesh."""

    points: Floats  # (V, 3)
    triangles: Ints  # (T, 3)
    attributes: dict[str, Floats]  # by glTF name, each (V, k)
    material: int | None


def read_primitives(gltf: Gltf, notes: Notes) -> dict[tuple[int, int], Primitive]:
    """Every primitive made of triangles, by (number of mesh, number in the mesh).

    Raises InputError for sparse accessors, compressed data that could not be decoded, and what
    trimesh cannot read.
    """
    rows = [
        (m, p, primitive)
        for m, mesh in enumerate(gltf.rows("meshes"))
        for p, primitive in enumerate(mesh.get("primitives", []))
        if _is_surface(primitive, m, notes)
    ]
    if not rows and GAUSSIANS in gltf.tree.get("extensionsUsed", []):
        raise InputError(
            f"{gltf.path}: it holds Gaussians ({GAUSSIANS}), which are not read out of glTF",
            "export them as PLY, SPZ or USD",
        )
    if not rows:
        raise InputError(f"{gltf.path}: there is no mesh in it", "give a file with a mesh in it")
    tree = {
        "asset": {"version": "2.0"},
        "buffers": [
            {"uri": f"{i}", "byteLength": len(data)} for i, data in enumerate(gltf.buffers)
        ],
        "bufferViews": gltf.rows("bufferViews"),
        "accessors": gltf.rows("accessors"),
        "meshes": [
            {"name": f"{m}.{p}", "primitives": [_with_aliases(gltf, row)]} for m, p, row in rows
        ],
        "nodes": [{"mesh": i} for i in range(len(rows))],
        "scenes": [{"nodes": list(range(len(rows)))}],
        "scene": 0,
    }
    files = {f"{i}": data for i, data in enumerate(gltf.buffers)}
    loaded = load_meshes(gltf.path, json.dumps(tree).encode(), "gltf", files)
    return {
        (m, p): _primitive(gltf, f"mesh {m}, primitive {p}", row, loaded.get(f"{m}.{p}"))
        for m, p, row in rows
    }


def _is_surface(primitive: dict[str, Any], mesh: int, notes: Notes) -> bool:
    mode = primitive.get("mode", TRIANGLES)
    if mode not in (TRIANGLES, STRIP):
        notes.add(f"points, lines and triangle fans (mode {mode}) are left out", f"mesh {mesh}")
    elif primitive.get("targets"):
        notes.add("morph targets are not read: the shape without them", f"mesh {mesh}")
    return mode in (TRIANGLES, STRIP)


def _with_aliases(gltf: Gltf, primitive: dict[str, Any]) -> dict[str, Any]:
    attributes = primitive.get("attributes", {})
    if "POSITION" not in attributes:
        raise InputError(f"{gltf.path}: a primitive has no POSITION", REPAIR)
    for index in (*attributes.values(), *[primitive[k] for k in ("indices",) if k in primitive]):
        accessor = gltf.row("accessors", index)
        if "sparse" in accessor:
            raise InputError(
                f"{gltf.path}: accessor {index} is sparse, which is not read",
                "export it again without sparse accessors",
            )
        if "bufferView" in accessor:
            gltf.view(accessor["bufferView"])
    kept = {k: v for k, v in primitive.items() if k in ("indices", "mode")}
    if DRACO in primitive.get("extensions", {}):
        kept["extensions"] = {DRACO: primitive["extensions"][DRACO]}
    kept["attributes"] = {**attributes, **{f"_{key}": value for key, value in attributes.items()}}
    return kept


def _primitive(gltf: Gltf, where: str, row: dict[str, Any], mesh: Any) -> Primitive:
    if mesh is None:
        raise InputError(f"{gltf.path}: {where} could not be read", REPAIR)
    raw = mesh.vertex_attributes
    attributes = {
        key: _numbers(gltf, index, np.asarray(raw[f"_{key}"]))
        for key, index in row["attributes"].items()
        if f"_{key}" in raw
    }
    points = attributes.pop("POSITION")
    if points.shape[1] != 3:
        raise InputError(f"{gltf.path}: {where}: POSITION is no triple of numbers", REPAIR)
    if len(points) and not np.ptp(points, axis=0).any():
        compressed = DRACO in row.get("extensions", {})
        raise InputError(
            f"{gltf.path}: {where} has no size: its {len(points)} points are all in one place"
            + (f"; it is compressed with {DRACO}, which was not decoded" if compressed else ""),
            "export it without Draco compression, or: pip install DracoPy"
            if compressed
            else REPAIR,
        )
    for key, values in attributes.items():
        wanted = WIDTHS.get(key.split("_")[0], (1, 4))
        if len(values) != len(points) or not wanted[0] <= values.shape[1] <= wanted[1]:
            raise InputError(
                f"{gltf.path}: {where}: {key} holds {len(values)} rows of {values.shape[1]} for "
                f"{len(points)} points",
                REPAIR,
            )
    return Primitive(
        points=points,
        triangles=np.asarray(mesh.faces, np.int64).reshape(-1, 3),
        attributes=attributes,
        material=row.get("material"),
    )


def _numbers(gltf: Gltf, index: int, values: np.ndarray) -> Floats:
    """(n, k) of an accessor; whole numbers that stand for fractions become those."""
    accessor = gltf.row("accessors", index)
    width = int(np.prod(values.shape[1:]))
    numbers = values.astype(np.float64).reshape(len(values), width)
    if not accessor.get("normalized") or values.dtype.kind == "f":
        return numbers
    return np.maximum(numbers / WHOLE.get(accessor.get("componentType", 0), 1.0), -1.0)
