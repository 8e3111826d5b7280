"""Primvars of a mesh brought to the corners of its triangles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pxr import Usd, UsdGeom

from gf_usd.core.arrays import Floats, Ints
from gf_usd.readers.notes import Notes


@dataclass(frozen=True, kw_only=True)
class Corners:
    """A triangulated mesh: where each triangle corner finds its values."""

    n_points: int
    n_corners: int
    n_faces: int
    triangles: Ints  # (T, 3) into points
    corners: Ints  # (T, 3) into face indices
    faces: Ints  # (T,) into faces

    def spread(self, values: Floats, interpolation: str) -> Floats | None:
        """(T, 3, k) of values (n, k); None where n does not fit the interpolation."""
        where = {
            "constant": (1, np.zeros_like(self.triangles)),
            "uniform": (self.n_faces, np.repeat(self.faces[:, None], 3, axis=1)),
            "varying": (self.n_points, self.triangles),
            "vertex": (self.n_points, self.triangles),
            "faceVarying": (self.n_corners, self.corners),
        }
        count, index = where.get(interpolation, (-1, self.faces))
        return values[index] if len(values) == count else None


def primvar_at_corners(
    prim: Usd.Prim,
    name: str,
    width: int,
    corners: Corners,
    time: Usd.TimeCode,
    notes: Notes,
) -> Floats | None:
    """(T, 3, width) of a primvar, its own or inherited; None where it is missing or unusable."""
    primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance(name)
    if not (primvar and primvar.HasValue()):
        return None
    where, what = str(prim.GetPath()), primvar.GetPrimvarName()
    flat = primvar.ComputeFlattened(time)
    if flat is None:
        notes.add(f"primvar {what} has indices outside its values: ignored", where)
        return None
    if not np.issubdtype(np.asarray(flat).dtype, np.number):
        notes.add(f"primvar {what} holds no numbers: ignored", where)
        return None
    values = np.asarray(flat, dtype=np.float64)
    if values.size:  # the type that is authored may be no array, whatever the one that is declared
        many = values.ndim > 0 and primvar.GetTypeName().isArray
        values = values.reshape((len(values) if many else 1, -1))
    if values.size == 0 or values.shape[-1] < width:
        notes.add(f"primvar {what} has no values {width} wide: ignored", where)
        return None
    if not np.isfinite(values).all():
        notes.add(f"primvar {what} has values that are not finite: ignored", where)
        return None
    interpolation = str(primvar.GetInterpolation())
    spread = corners.spread(values[:, :width], interpolation)
    if spread is None:
        notes.add(
            f"primvar {what} has {len(values)} values, which does not match the number of "
            f"elements of its '{interpolation}' interpolation: ignored",
            where,
        )
    return spread
