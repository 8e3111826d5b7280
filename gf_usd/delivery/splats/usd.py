"""Captured Gaussians in a delivered USD file: samples, in half precision where it is sufficient.

UsdSkel skins meshes, points and curves only: no viewer would move a particle field by a binding.
The arrays of the bake are sampled instead.  Half precision has a relative error of 2^-11, which is
small for orientations and scales, and for positions only near the origin of their space.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pxr import Usd, UsdGeom, Vt

from gf_usd.core.arrays import Floats
from gf_usd.delivery.splats.clouds import Cloud, Errors, SplatErrors
from gf_usd.layers.tracks.captured import HARMONICS
from gf_usd.layers.tracks.gaussians import QUATERNIONS, VECTORS
from gf_usd.readers.pictures.splats import SplatMotion

SAMPLED = {"positions": VECTORS, "orientations": QUATERNIONS, "scales": VECTORS}
SHARE = 0.5  # of the allowed error that rounding of positions may take
FINE = 0.005  # of a standard deviation: below 6e-5 a half is coarser than 2^-11 of a number


def author_samples(
    prim: Usd.Prim, source: Usd.Prim, time_codes: Sequence[float], allowed: float
) -> None:
    """Author the arrays of `source`, a prim of the bake, at the stage's edit target.

    allowed : [stage units] distance of a position to the bake.
    """
    values = {
        name: [np.asarray(_value(source, name, code)) for code in time_codes] for name in SAMPLED
    }
    world = UsdGeom.Imageable(source).ComputeLocalToWorldTransform(time_codes[0])
    grown = float(np.linalg.norm(np.array(world)[:3, :3], 2))
    half = {
        "positions": grown * max(map(_rounding, values["positions"])) <= SHARE * allowed,
        "orientations": True,
        "scales": max(map(_relative_rounding, values["scales"])) <= FINE,
    }
    for name, form in SAMPLED.items():
        for twin, mine in ((name, not half[name]), (f"{name}h", half[name])):
            attribute = prim.GetAttribute(twin)
            if not mine:
                if attribute.HasAuthoredValue():
                    attribute.Block()
                continue
            attribute.Clear()
            make = (form.half if half[name] else form.single)[1]
            kind = np.float16 if half[name] else np.float32
            for code, rows in zip(time_codes, values[name]):
                attribute.Set(make(np.ascontiguousarray(rows, kind)), code)
    extent = UsdGeom.Boundable(prim).GetExtentAttr()
    extent.Clear()
    for code in time_codes:
        extent.Set(UsdGeom.Boundable(source).GetExtentAttr().Get(code), code)
    _first_only(prim, (HARMONICS, f"{HARMONICS}h"))


def keep_at_rest(prim: Usd.Prim) -> None:
    """Leave of each array its first sample."""
    _first_only(prim, [f"{name}{h}" for name in (*SAMPLED, HARMONICS) for h in ("", "h")])
    _first_only(prim, ("extent",))


def _first_only(prim: Usd.Prim, names: Sequence[str]) -> None:
    for name in names:
        attribute = prim.GetAttribute(name)
        times = attribute.GetTimeSamples() if attribute else []
        if times:
            first = attribute.Get(times[0])
            attribute.Clear()
            attribute.Set(first)


def _value(prim: Usd.Prim, name: str, code: float) -> Vt.Vec3fArray | Vt.QuatfArray:
    """An attribute, or the one that holds it in half precision."""
    attribute = prim.GetAttribute(name)
    found = attribute.Get(code) if attribute else None
    return prim.GetAttribute(f"{name}h").Get(code) if found is None else found


def _rounding(rows: Floats) -> float:
    """The largest distance between a vector and itself in half precision."""
    off = rows.astype(np.float16).astype(np.float64) - rows
    return float(np.sqrt((off**2).sum(axis=1).max(initial=0.0)))


def _relative_rounding(rows: Floats) -> float:
    """The largest error of a positive number in half precision, of itself."""
    off = np.abs(rows.astype(np.float16).astype(np.float64) - rows)
    return float((off / rows).max(initial=0.0))


def read_errors(
    motion: SplatMotion, clouds: Sequence[Cloud], radii: Sequence[float], codes: Sequence[float]
) -> tuple[SplatErrors, ...]:
    """Of each cloud, as a delivered file shows it.

    radii : [m] of the body that each belongs to.
    """
    found = [Errors() for _ in clouds]
    for frame, sets in enumerate(motion.frames(codes)):
        named = {one.name: one for one in sets}
        for errors, cloud, radius in zip(found, clouds, radii):
            one = named[cloud.name]
            A = np.asarray(one.axes)
            off = one.positions - cloud.positions[frame]
            errors.add(off, radius, A @ A.transpose(0, 2, 1), cloud.covariances(frame))
    return tuple(errors.found for errors in found)
