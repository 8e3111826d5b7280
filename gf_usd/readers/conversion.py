"""Mesh files: each is parsed, becomes a USD layer and is read as USD.

obj, ply, off   meters are assumed, Y up; own readers: polygons and seams stay
stl             meters are assumed, Z up, as printers have it; trimesh
glb, gltf       meters, Y up by their standard; own reader
fbx             what the file says; the program usd-convert-asset
spz, splat, ply with Gaussians: usd_splat_source
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from gf_usd.core.errors import InputError
from gf_usd.readers.formats import MESH, PROGRAM, format_of
from gf_usd.readers.mesh.data import MeshFile
from gf_usd.readers.notes import source_of, unit_and_axis

if TYPE_CHECKING:
    from gf_usd.readers.mesh.to_usd import MeshSource


ASSUMED_UNIT = 1.0  # [m]


def convert_mesh(
    path: Path, *, meters_per_unit: float | None = None, up_axis: str | None = None
) -> MeshSource:
    """A mesh file as USD, not yet written anywhere.

    Parameters
    ----------
    meters_per_unit : [m] size of the file's unit; None: what the file says, or 1.
    up_axis : "Y" or "Z"; None: what the file says, or what is usual for its format.

    Raises
    ------
    InputError : the file is damaged or empty, or the unit or the axis makes no sense.
    """
    from gf_usd.readers.mesh.to_usd import MeshSource
    from gf_usd.readers.splats.convert import convert_splats, is_splat_file

    if meters_per_unit is not None and not 0.0 < meters_per_unit < math.inf:
        raise InputError(
            f"--meters-per-unit {meters_per_unit:g} is not a size",
            "give the size of the file's unit in meters, e.g. 0.01 for centimeters",
        )
    if is_splat_file(path):
        return convert_splats(path, meters_per_unit=meters_per_unit, up_axis=up_axis)
    if up_axis is not None and up_axis.upper() not in ("Y", "Z"):
        raise InputError(
            f"up axis {up_axis!r}: USD knows Y and Z", "give --up-axis Y or --up-axis Z"
        )
    axis = None if up_axis is None else up_axis.upper()
    row = format_of(path, MESH, PROGRAM)
    assert row is not None
    if row.kind == PROGRAM:
        return row.function(path, meters_per_unit=meters_per_unit, up_axis=axis)
    try:
        file: MeshFile = row.function(path)
    except OSError as error:
        raise InputError(
            f"{path} cannot be read: {error}", "check the permissions of it and its files"
        ) from error
    unit = meters_per_unit or file.meters_per_unit or ASSUMED_UNIT
    unit_from = source_of(meters_per_unit, file.meters_per_unit is not None)
    axis_from = source_of(axis, file.up_axis_known)
    up = axis or file.up_axis
    return MeshSource.of(
        file,
        meters_per_unit=unit,
        up_axis=up,
        notes=(*unit_and_axis(file.format, unit, up, unit_from, axis_from), *file.notes),
        sources={"unit_from": unit_from, "axis_from": axis_from},
    )
