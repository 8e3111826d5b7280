"""Conversion of mesh files to USD layers, which are then read like any USD file.

obj, ply, off   Y up is assumed; own readers, which preserve polygons and UV seams
stl             Z up is assumed, as usual in 3D printing; by trimesh
                these four have no unit: meters are assumed, or centimeters or millimeters where
                they make the body a plausible size
glb, gltf       meters and Y up, by the standard; own reader
fbx             unit and axis of the file; by the program usd-convert-asset
spz, splat, ply with Gaussians: `readers.splats`
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gf_usd.core.errors import InputError
from gf_usd.core.units import PRINTED_UNITS, USUAL_UNITS, plausible_unit
from gf_usd.readers.formats import MESH, PROGRAM, format_of
from gf_usd.readers.mesh.data import MeshFile
from gf_usd.readers.notes import renamed, source_of, unit_and_axis

if TYPE_CHECKING:
    from gf_usd.readers.mesh.to_usd import MeshSource


def convert_mesh(
    path: Path,
    *,
    meters_per_unit: float | None = None,
    up_axis: str | None = None,
    rigged: bool = False,
    fps: float | None = None,
) -> MeshSource:
    """A mesh file converted to a USD layer in memory.

    Parameters
    ----------
    meters_per_unit : [m] size of the file's unit; None: as in the file, or one that makes the body
        a plausible size.
    up_axis : "Y" or "Z"; None: as in the file, or as usual for its format.
    rigged : include skeletons and their animation, with the meshes in the bind pose.
    fps : frames per second of the animation; None: the rate of its keyframes.

    Raises
    ------
    InputError : the file is damaged or empty, the unit or the axis is invalid, or skeletons of such
        files are not supported.
    """
    from gf_usd.readers.mesh.to_usd import MeshSource
    from gf_usd.readers.splats.convert import convert_splats, is_splat_file

    if meters_per_unit is not None and not 0.0 < meters_per_unit < math.inf:
        raise InputError(
            f"--meters-per-unit {meters_per_unit:g} is not a valid unit size",
            "give the size of the file's unit in meters, e.g. 0.01 for centimeters",
        )
    row = format_of(path, MESH, PROGRAM)
    if rigged and (is_splat_file(path) or row is None or not row.rigged):
        raise InputError(
            f"{path}: --flesh: skeletons of {path.suffix} files are not supported",
            "export the character as USD or glTF, with its skeleton and its animation",
        )
    if is_splat_file(path):
        return convert_splats(path, meters_per_unit=meters_per_unit, up_axis=up_axis)
    if up_axis is not None and up_axis.upper() not in ("Y", "Z"):
        raise InputError(
            f"up axis {up_axis!r}: USD allows only Y and Z", "give --up-axis Y or --up-axis Z"
        )
    axis = None if up_axis is None else up_axis.upper()
    assert row is not None
    if row.kind == PROGRAM:
        return row.function(path, meters_per_unit=meters_per_unit, up_axis=axis)
    try:
        file: MeshFile = row.rigged_function(path, fps) if rigged else row.function(path)
    except OSError as error:
        raise InputError(
            f"{path} cannot be read: {error}",
            "check the permissions of the file and of the files it refers to",
        ) from error
    unit, width = meters_per_unit or file.meters_per_unit, 0.0
    if unit is None:
        width = _width(file)
        unit = plausible_unit(width, PRINTED_UNITS if row.name == "STL" else USUAL_UNITS)
    unit_from = source_of(meters_per_unit, file.meters_per_unit is not None)
    axis_from = source_of(axis, file.up_axis_known)
    up = axis or file.up_axis
    return MeshSource.of(
        file,
        meters_per_unit=unit,
        up_axis=up,
        notes=(
            *unit_and_axis(file.format, unit, up, unit_from, axis_from, width=width),
            *renamed([path.stem, *(name for node in file.nodes for name in node.names())]),
            *file.notes,
        ),
        sources={"unit_from": unit_from, "axis_from": axis_from},
    )


def _width(file: MeshFile) -> float:
    """The longest edge of the bounding box of all meshes, in units of the file."""
    points = [m.points for node in file.nodes for m in node.meshes() if len(m.points)]
    low = np.min([p.min(0) for p in points], axis=0)
    high = np.max([p.max(0) for p in points], axis=0)
    return float((high - low).max())
