"""Bind poses of deformable bodies: PhysicsDeformablePoseAPI of the AOUSD proposal.

    physics:deformablePose:NAME:purposes   ["bindPose"]     AOUSD (OpenUSD-proposals 111)
    physics:deformablePose:NAME:points     in the mesh's own space, one for each of its points
    deformablePose:NAME:omniphysics:...    the same, of Omniverse

The graphics and collision meshes of a body are bound to its simulation mesh in the bind pose; a
mesh without one is bound with its points.  A bake binds all meshes in its rest pose.  A graphics
mesh therefore starts in its bind pose if its simulation mesh does.
"""

from __future__ import annotations

import numpy as np
from pxr import Usd, UsdGeom

from gf_usd.core.arrays import Floats
from gf_usd.readers.usd.stage import upwards
from gf_usd.readers.usd_physics.attributes import apis

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
    """A pose that is invalid for its mesh; the text is the reason."""


def bound_points(prim: Usd.Prim, points: Floats, time: Usd.TimeCode) -> tuple[Floats, str]:
    """The rest points (V, 3) of a mesh in a bake, and a note; "": none.

    points : of the mesh at the time, in local space, as the result.
    Raises BrokenPose for a bind pose with another number of points, or points that are not finite.
    """
    bind = _bind_pose(prim, time)
    if bind is None:
        return points, ""
    if bind.shape != points.shape:
        raise BrokenPose(f"its bind pose has {len(bind)} points, but the mesh has {len(points)}")
    if not np.isfinite(bind).all():
        raise BrokenPose("its bind pose has points that are not finite (NaN or infinity)")
    away = _relative_distance(bind, points)
    if away <= SAME:
        return points, ""
    if apis(prim) & SIMULATED:
        return points, "starts from its points, not from its bind pose"
    if (simulated := _simulation_mesh(prim)) is None or _in_bind_pose(simulated, time):
        return bind, "starts from its bind pose"
    return points, (
        f"starts from its points: the simulation mesh <{simulated.GetPath()}> is not in the"
        " bind pose"
    )


def _relative_distance(a: Floats, b: Floats) -> float:
    """The greatest distance of corresponding points, relative to the size of the mesh."""
    return float(np.abs(a - b).max()) / max(float(np.ptp(a, axis=0).max()), 1e-30)


def _bind_pose(prim: Usd.Prim, time: Usd.TimeCode) -> Floats | None:
    """(V, 3) points of the bind pose; None where there is none."""
    for name in (*prim.GetAppliedSchemas(), *prim.GetPrimTypeInfo().GetAppliedAPISchemas()):
        for schema, template in POSES:
            if not name.startswith(schema):
                continue
            instance = name.removeprefix(schema)
            attributes = [
                prim.GetAttribute(template.format(instance, x)) for x in ("purposes", "points")
            ]
            purposes, points = (one.Get(time) if one else None for one in attributes)
            if BIND in (purposes or ()) and points is not None:
                return np.asarray(points, np.float64).reshape(-1, 3)
    return None


def _simulation_mesh(prim: Usd.Prim) -> Usd.Prim | None:
    """The simulation mesh of the body that a mesh is part of: a child of the body's prim."""
    body = next((one for one in upwards(prim) if apis(one) & BODIES), None)
    children = body.GetChildren() if body else ()
    return next((child for child in children if apis(child) & SIMULATED), None)


def _in_bind_pose(mesh: Usd.Prim, time: Usd.TimeCode) -> bool:
    """Whether a simulation mesh is in its bind pose at a time."""
    bind, attribute = _bind_pose(mesh, time), UsdGeom.PointBased(mesh).GetPointsAttr()
    points = np.asarray(attribute.Get(time) if attribute else (), np.float64).reshape(-1, 3)
    return bind is None or (bind.shape == points.shape and _relative_distance(bind, points) <= SAME)
