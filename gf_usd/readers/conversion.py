"""Mesh files: a suffix and its parser; whatever it is, it becomes a USD layer and is read as USD.

obj, ply, off   metres are assumed, Y up; own readers: polygons and seams stay
stl             metres are assumed, Z up, as printers have it; trimesh
glb, gltf       metres, Y up by their standard; trimesh
fbx             what the file says; the program usd-convert-asset
spz, splat, ply with Gaussians: usd_splat_source
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from gf_usd.core.asset import Asset
from gf_usd.core.errors import InputError
from gf_usd.readers.mesh.data import MeshFile
from gf_usd.readers.notes import source_of, unit_and_axis

if TYPE_CHECKING:
    from gf_usd.readers.mesh.to_usd import MeshSource


PARSERS = {
    ".obj": "gf_usd.readers.mesh.obj:read_obj",
    ".ply": "gf_usd.readers.mesh.ply:read_ply",
    ".stl": "gf_usd.readers.mesh.stl:read_stl",
    ".off": "gf_usd.readers.mesh.off:read_off",
    ".glb": "gf_usd.readers.mesh.gltf_scene:read_gltf",
    ".gltf": "gf_usd.readers.mesh.gltf_scene:read_gltf",
}
FBX = ".fbx"
ASSUMED_UNIT = 1.0  # [m]


def read_mesh(
    path: Path,
    *,
    prims: Sequence[str] = (),
    meters_per_unit: float | None = None,
    up_axis: str | None = None,
    time_code: float | None = None,
) -> Asset:
    """The surfaces of a mesh file; arguments and errors of `gf_usd.readers.read_asset`."""
    source = convert_mesh(path, meters_per_unit=meters_per_unit, up_axis=up_axis)
    return source.asset(prims=prims, time_code=time_code)


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
            "give the size of the file's unit in metres, e.g. 0.01 for centimetres",
        )
    if is_splat_file(path):
        return convert_splats(path, meters_per_unit=meters_per_unit, up_axis=up_axis)
    if up_axis is not None and up_axis.upper() not in ("Y", "Z"):
        raise InputError(
            f"up axis {up_axis!r}: USD knows Y and Z", "give --up-axis Y or --up-axis Z"
        )
    axis = None if up_axis is None else up_axis.upper()
    if path.suffix.lower() == FBX:
        from gf_usd.readers.mesh.fbx import convert_fbx

        return convert_fbx(path, meters_per_unit=meters_per_unit, up_axis=axis)
    module, function = PARSERS[path.suffix.lower()].split(":")
    try:
        file: MeshFile = getattr(import_module(module), function)(path)
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
