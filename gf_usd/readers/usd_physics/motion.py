"""The animation of a prim for physics: transforms, points and velocities, without shading."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf, Usd, UsdGeom

from gf_usd.core.arrays import Floats
from gf_usd.core.asset import StageFacts
from gf_usd.core.errors import InputError
from gf_usd.readers.notes import Notes
from gf_usd.readers.usd.mesh import Reading, posed_points
from gf_usd.readers.usd.shading import BoundShading, ShadingReader
from gf_usd.readers.usd.skeleton.skins import Skins
from gf_usd.readers.usd.splats import is_captured
from gf_usd.readers.usd.stage import upwards

# Attributes that define the shape of a prim in local space.
SHAPE = (
    "points", "faceVertexCounts", "faceVertexIndices", "size", "radius", "radiusTop",
    "radiusBottom", "height", "width", "length", "axis",
)  # fmt: skip


class NoShading(ShadingReader):
    """A shading reader without bindings, to read shapes without colors."""

    def bound(self, prim: Usd.Prim) -> BoundShading | None:
        """None: no material is bound."""
        return None


def bare_reading(facts: StageFacts, time: Usd.TimeCode) -> Reading:
    """The context for reading shapes of a stage at one time, without shading and notes."""
    notes, xforms = Notes(), UsdGeom.XformCache(time)
    return Reading(
        path=facts.path,
        time=time,
        meters_per_unit=facts.units.length,
        xforms=xforms,
        skins=Skins(time, xforms, notes),
        shadings=NoShading(time, notes),
        notes=notes,
    )


class Readings:
    """Cache of `bare_reading` by time, with common skeleton bindings."""

    def __init__(self, facts: StageFacts) -> None:
        self.facts = facts
        self._made: dict[Usd.TimeCode, Reading] = {}

    def at(self, time: Usd.TimeCode) -> Reading:
        """The context of one time."""
        if time not in self._made:
            self._made[time] = bare_reading(self.facts, time)
        return self._made[time]


def matrix(prim: Usd.Prim, reading: Reading) -> NDArray[np.float64]:
    """(4, 4) local-to-world matrix for row vectors, stage units; InputError where not finite."""
    rows = np.array(reading.xforms.GetLocalToWorldTransform(prim), dtype=np.float64)
    if not np.isfinite(rows).all():
        raise InputError(
            f"{reading.path}: <{prim.GetPath()}>: its transform is not finite at {reading.time}",
            "repair the animation of this prim, or of one above it",
        )
    return rows


def transform_varies(prim: Usd.Prim) -> bool:
    """Whether the transform of the prim or an ancestor might vary over time."""
    placed = (UsdGeom.Xformable(one) for one in upwards(prim))
    return any(one.TransformMightBeTimeVarying() for one in placed if one)


def moves_after(prim: Usd.Prim, time: Usd.TimeCode) -> bool:
    """Whether the transform of the prim or an ancestor varies after a time."""
    codes: set[float] = set()
    for one in upwards(prim):
        if placed := UsdGeom.Xformable(one):
            codes.update(placed.GetTimeSamples())
    shown = UsdGeom.Imageable(prim)
    here = shown.ComputeLocalToWorldTransform(time)
    later = (code for code in sorted(codes) if code > time.GetValue())
    return any(shown.ComputeLocalToWorldTransform(code) != here for code in later)


def shape_varies(prim: Usd.Prim, reading: Reading) -> bool:
    """Whether the local points might vary over time, or are skinned to a skeleton."""
    if prim.IsA(UsdGeom.Mesh) and reading.skins.placement(prim) is not None:
        return True
    named = (prim.GetAttribute(name) for name in SHAPE)
    return any(attribute and attribute.ValueMightBeTimeVarying() for attribute in named)


def relative_motion(
    at_rest: Floats, frames: Sequence[Floats], unit: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The affine maps from the rest pose to each frame: linear (F, 3, 3) and offset (F, 3) [m].

    at_rest, frames : (4, 4) local-to-world matrices for row vectors, stage units of `unit` [m].
    F = 1 where all frames are equal.
    """
    if all(np.array_equal(frame, frames[0]) for frame in frames):
        frames = frames[:1]
    back = np.linalg.inv(at_rest)
    still = np.eye(4)
    moved = np.stack([still if np.array_equal(f, at_rest) else back @ f for f in frames])
    return np.swapaxes(moved[:, :3, :3], 1, 2).copy(), moved[:, 3, :3] * unit


def velocity_at_rest(
    prim: Usd.Prim, readings: Readings, rest: float | None, step: float, notes: Notes
) -> Floats | None:
    """(V, 3) [m/s of playback] initial velocities, from the animation before the rest pose.

    The backward difference (x(rest) - x(rest - step)) / step of the posed points; where it is 0,
    the authored point velocities.  None where there is neither.

    rest : time code of the rest pose; None: there is no animation before it.
    step : time codes per frame.
    """
    if rest is None:
        return None
    if is_captured(prim):
        if transform_varies(prim) or prim.GetAttribute("velocities").HasAuthoredValue():
            notes.add("consists of Gaussians: no initial velocity is read", str(prim.GetPath()))
        return None
    now = readings.at(Usd.TimeCode(rest))
    where = str(prim.GetPath())
    if transform_varies(prim) or shape_varies(prim, now):
        before = readings.at(Usd.TimeCode(rest - step))
        x, earlier = posed_points(prim, now), posed_points(prim, before)
        if x.shape != earlier.shape:
            notes.add(
                f"has {len(earlier)} points one frame before the first and {len(x)} at the "
                f"first: its animation gives no initial velocity",
                where,
            )
            return None
        if not np.array_equal(x, earlier):
            notes.add("starts with the velocity of its animation", where)
            return (x - earlier) / (step / (readings.facts.time_codes_per_second or 24.0))
    return _authored_velocities(prim, now, notes)


def _authored_velocities(prim: Usd.Prim, reading: Reading, notes: Notes) -> Floats | None:
    attribute = prim.GetAttribute("velocities")
    value = attribute.Get(reading.time) if attribute and attribute.HasAuthoredValue() else None
    if value is None or attribute.GetTypeName() != Sdf.ValueTypeNames.Vector3fArray:
        return None
    where, local = str(prim.GetPath()), np.asarray(value)
    # the authored type may differ from the schema's
    if local.dtype.kind not in "fiu" or local.shape[1:] != (3,):
        notes.add("its velocities are not of type vector3f[]: ignored", where)
        return None
    local = local.astype(np.float64)
    count = len(UsdGeom.PointBased(prim).GetPointsAttr().Get(reading.time) or [])
    if len(local) != count or not np.isfinite(local).all():
        notes.add(
            f"its {len(local)} velocities are not one finite vector for each point: ignored", where
        )
        return None
    if not local.any():
        return None
    if reading.skins.placement(prim) is not None:
        notes.add("is posed by a skeleton: its authored velocities are ignored", where)
        return None
    notes.add("starts with its authored velocities", where)
    return local @ matrix(prim, reading)[:3, :3] * reading.meters_per_unit
