"""Stiffness and density painted on meshes: primvars in the namespace gaussianFlesh."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom

from gf_usd.assets.usd_select import named_prim
from gf_usd.assets.usd_stage import open_stage, reading
from gf_usd.errors import InputError
from gf_usd.model import Floats, StageFacts, Surface
from gf_usd.playback import first_time_code

YOUNG, NU, DENSITY = (
    f"gaussianFlesh:{name}" for name in ("youngsModulus", "poissonsRatio", "density")
)
# primvar: (field, least, most); what is stated must lie between
KNOWN = {
    YOUNG: ("youngs_modulus", 0.0, np.inf),
    NU: ("poissons_ratio", -1.0, 0.5),
    DENSITY: ("density", 0.0, np.inf),
}


def read_painted(
    file: Path, facts: StageFacts, surfaces: Sequence[Surface], *, rest: float | None = None
) -> dict[str, dict[str, Floats]]:
    """By prim path and field (youngs_modulus [Pa], poissons_ratio, density [kg/m^3]) the painted
    value (C,) at each corner of each face, in the order of Surface.face_indices.

    A constant one is inherited, as primvars are.  rest : time code of the rest pose.

    Raises InputError for values that are no number, out of range, or not one for each element.
    """
    scales = {YOUNG: facts.units.pressure, NU: 1.0, DENSITY: facts.units.density}
    out: dict[str, dict[str, Floats]] = {}
    with reading(file):
        stage = open_stage(file)
        time = Usd.TimeCode(first_time_code(facts, rest))
        for surface in surfaces:
            api = UsdGeom.PrimvarsAPI(named_prim(stage, facts.path, surface.path))
            for name, (field, least, most) in KNOWN.items():
                primvar = api.FindPrimvarWithInheritance(name)
                if not (primvar and primvar.HasValue()):
                    continue
                where = f"{facts.path}: <{surface.path}>: {primvar.GetAttr().GetName()}"
                values = _numbers(primvar, time, where)
                _require_within(values, least, most, where)
                corners = _at_corners(values, str(primvar.GetInterpolation()), surface, where)
                out.setdefault(surface.path, {})[field] = corners * scales[name]
    return out


def _numbers(primvar: UsdGeom.Primvar, time: Usd.TimeCode, where: str) -> Floats:
    """(n,) the values, indices followed."""
    flat = primvar.ComputeFlattened(time)
    if flat is None:
        raise InputError(
            f"{where} has indices outside its values", "author the primvar again, without indices"
        )
    values = np.atleast_1d(np.asarray(flat))
    if values.ndim != 1 or not np.issubdtype(values.dtype, np.number):
        raise InputError(
            f"{where} is of type {primvar.GetTypeName()}", "author it as float or float[]"
        )
    return values.astype(np.float64)


def _require_within(values: Floats, least: float, most: float, where: str) -> None:
    # NaN compares false: it counts as bad
    bad = ~((values > least) & (values < most))
    if bad.any():
        first = float(values[np.flatnonzero(bad)[0]])
        limits = f"between {least:g} and {most:g}" if np.isfinite(most) else f"above {least:g}"
        raise InputError(
            f"{where} has {int(bad.sum())} of {len(values)} values out of range, the first is"
            f" {first:g}",
            f"paint finite values {limits}, in units of the stage",
        )


def _at_corners(values: Floats, interpolation: str, surface: Surface, where: str) -> Floats:
    """(C,) of values (n,)."""
    corners = np.asarray(surface.face_indices)
    faces = np.repeat(np.arange(len(surface.face_counts)), surface.face_counts)
    rows = {
        "constant": (1, np.zeros_like(corners)),
        "uniform": (len(surface.face_counts), faces),
        "varying": (len(surface.points), corners),
        "vertex": (len(surface.points), corners),
        "faceVarying": (len(corners), np.arange(len(corners))),
    }
    count, index = rows[interpolation]
    if len(values) != count:
        raise InputError(
            f"{where} has {len(values)} values, and '{interpolation}' wants {count}",
            "paint the mesh again, or correct the interpolation",
        )
    return values[index]
