"""Conversion of Gaussian splat files to USD layers."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gf_usd.core.asset import Splats, valid_gaussians
from gf_usd.core.errors import InputError
from gf_usd.readers.formats import MESH, SPLATS, Format, format_of
from gf_usd.readers.mesh.to_usd import Folder, MeshSource, record_of
from gf_usd.readers.notes import Notes, renamed, source_of, unit_and_axis
from gf_usd.readers.splats.ply import holds_splats
from gf_usd.readers.usd.splats import write_splat_layer

# Captures often have y or z down, as in camera space: a half turn about x corrects it.
AXES = {"Y": ("Y", 0.0), "Z": ("Z", 0.0), "-Y": ("Y", 180.0), "-Z": ("Z", 180.0)}


def is_splat_file(path: Path) -> bool:
    """Whether a file holds Gaussians rather than a mesh; PLY may hold either."""
    if not format_of(path, SPLATS):
        return False
    return not format_of(path, MESH) or holds_splats(path)


def _format(path: Path) -> Format:
    row = format_of(path, SPLATS)
    assert row is not None
    return row


def read_splat_file(path: Path, notes: Notes) -> Splats:
    """The valid Gaussians of a file.

    Raises InputError for a damaged file and for one without valid Gaussians.
    """
    try:
        # `valid_gaussians` counts what is not finite
        with np.errstate(over="ignore", invalid="ignore"):
            splats: Splats = _format(path).function(path)
    except OSError as error:
        raise InputError(
            f"{path} cannot be read: {error}", "check the permissions of the file"
        ) from error
    return valid_gaussians(splats, str(path), notes.add)


def convert_splats(path: Path, *, meters_per_unit: float | None, up_axis: str | None) -> MeshSource:
    """A splat file converted to a temporary USD layer.

    meters_per_unit : [m] size of the file's unit; None: 1.   up_axis : Y, Z, -Y or -Z; None: Y.

    Raises InputError for a damaged file, and for another axis.
    """
    axis = "Y" if up_axis is None else up_axis.upper()
    if axis not in AXES:
        raise InputError(
            f"up axis {up_axis!r}: it must be Y, Z, -Y or -Z", "give one of them with --up-axis"
        )
    name = _format(path).name
    notes = Notes()
    unit = 1.0 if meters_per_unit is None else meters_per_unit
    unit_from = source_of(meters_per_unit, False)
    axis_from = source_of(up_axis, _format(path).says_axis)
    for line in unit_and_axis(
        name, unit, axis, unit_from, axis_from, ", or -Y where the splats are upside down"
    ):
        notes.add(line)
    for line in renamed([path.stem]):
        notes.add(line)
    splats = read_splat_file(path, notes)
    folder = Folder()
    up, turn = AXES[axis]
    write_splat_layer(splats, folder.layer, path.stem, meters_per_unit=unit, up_axis=up, turn=turn)
    record = record_of(path, (path,), unit, axis)
    sources = {"unit_from": unit_from, "axis_from": axis_from}
    return MeshSource(path, folder, record, notes.lines(), sources)
