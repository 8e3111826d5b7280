"""Evaluation of primvars at the corners of a triangulated mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pxr import Usd, UsdGeom

from gf_usd.core.arrays import Floats, Ints
from gf_usd.readers.notes import Notes


@dataclass(frozen=True, kw_only=True)
class Corners:
    """Indices of the points, face vertices and faces of each triangle corner."""

    n_points: int
    n_corners: int
    n_faces: int
    triangles: Ints  # (T, 3) into points
    corners: Ints  # (T, 3) into face indices
    faces: Ints  # (T,) into faces

    def spread(self, values: Floats, interpolation: str) -> Floats | None:
        """(T, 3, k) values at corners, from (n, k); None where n does not match `interpolation`."""
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
    """(T, 3, width) values of a primvar, authored or inherited; None where missing or invalid."""
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
    if values.size:  # the authored type may differ from the declared one
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
