"""Bind poses of deformable bodies: PhysicsDeformablePoseAPI of the AOUSD proposal.

    physics:deformablePose:NAME:purposes   ["bindPose"]     AOUSD (OpenUSD-proposals 111)
    physics:deformablePose:NAME:points     in the mesh's own space, one for each of its points
    deformablePose:NAME:omniphysics:...    the same of Omniverse

In the bind pose graphics and collision meshes of a body are bound to its simulation mesh; without
one the points of a mesh are its bind pose.  A bake binds all meshes where it begins, so that a
graphics mesh begins in its bind pose, as long as its simulation mesh does.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from pxr import Usd, UsdGeom

from gf_usd.core.arrays import Floats

POSES = (
    ("PhysicsDeformablePoseAPI:", "physics:deformablePose:{}:{}"),
    ("OmniPhysicsDeformablePoseAPI:", "deformablePose:{}:omniphysics:{}"),
)
BIND = "bindPose"
BODIES = {"PhysicsDeformableBodyAPI", "OmniPhysicsDeformableBodyAPI"}
SIMULATED = {
    f"{prefix}{kind}DeformableSimAPI"
    for prefix in ("Physics", "OmniPhysics")
    for kind in ("Volume", "Surface")
}
SAME = 1e-5  # of the mesh: points are single precision


class BrokenPose(ValueError):
    """A pose that does not fit its mesh; the text says why."""


def bound_points(prim: Usd.Prim, points: Floats, time: Usd.TimeCode) -> tuple[Floats, str]:
    """The points (V, 3) with which a mesh enters a bake, and a note; "": there is nothing to say.

    points : of the mesh at the time, in its own space, as the result.
    Raises BrokenPose for a bind pose with another number of points, or with points that are none.
    """
    bind = _bind_pose(prim, time)
    if bind is None:
        return points, ""
    if bind.shape != points.shape:
        raise BrokenPose(f"its bind pose has {len(bind)} points, but the mesh has {len(points)}")
    if not np.isfinite(bind).all():
        raise BrokenPose("its bind pose has points that are not finite (NaN or infinity)")
    away = _away(bind, points)
    if away <= SAME:
        return points, ""
    if _apis(prim) & SIMULATED:
        return points, "starts from its points, not from its bind pose"
    if (simulated := _simulation_mesh(prim)) is None or _stands_bound(simulated, time):
        return bind, "starts from its bind pose"
    return points, (
        f"starts from its points: the simulation mesh <{simulated.GetPath()}> is not in the"
        " bind pose"
    )


def _away(a: Floats, b: Floats) -> float:
    """The largest distance over the size of what is bound."""
    return float(np.abs(a - b).max()) / max(float(np.ptp(a, axis=0).max()), 1e-30)


def _bind_pose(prim: Usd.Prim, time: Usd.TimeCode) -> Floats | None:
    """(V, 3); None where there is none."""
    for name in (*prim.GetAppliedSchemas(), *prim.GetPrimTypeInfo().GetAppliedAPISchemas()):
        for schema, template in POSES:
            if not name.startswith(schema):
                continue
            instance = name.removeprefix(schema)
            said = [prim.GetAttribute(template.format(instance, x)) for x in ("purposes", "points")]
            purposes, points = (one.Get(time) if one else None for one in said)
            if BIND in (purposes or ()) and points is not None:
                return np.asarray(points, np.float64).reshape(-1, 3)
    return None


def _apis(prim: Usd.Prim) -> set[str]:
    return {*prim.GetAppliedSchemas(), *prim.GetPrimTypeInfo().GetAppliedAPISchemas()}


def _upwards(prim: Usd.Prim) -> Iterator[Usd.Prim]:
    while prim and not prim.IsPseudoRoot():
        yield prim
        prim = prim.GetParent()


def _simulation_mesh(prim: Usd.Prim) -> Usd.Prim | None:
    """That of the body which a mesh is part of: a child of the body's prim."""
    body = next((one for one in _upwards(prim) if _apis(one) & BODIES), None)
    children = body.GetChildren() if body else ()
    return next((child for child in children if _apis(child) & SIMULATED), None)


def _stands_bound(mesh: Usd.Prim, time: Usd.TimeCode) -> bool:
    """Whether a simulation mesh is in its bind pose at a time."""
    bind, attribute = _bind_pose(mesh, time), UsdGeom.PointBased(mesh).GetPointsAttr()
    points = np.asarray(attribute.Get(time) if attribute else (), np.float64).reshape(-1, 3)
    return bind is None or (bind.shape == points.shape and _away(bind, points) <= SAME)
