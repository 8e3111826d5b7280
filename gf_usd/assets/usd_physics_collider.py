"""The obstacles of a stage and their motion."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from pxr import Sdf, Usd, UsdGeom

from gf_usd.assets.notes import Notes
from gf_usd.assets.usd_implicit import IMPLICIT
from gf_usd.assets.usd_mesh import posed_points
from gf_usd.assets.usd_physics_material import PhysicsMaterials
from gf_usd.assets.usd_physics_motion import (
    bare_reading,
    matrix,
    relative_motion,
    shape_varies,
    transform_varies,
)
from gf_usd.assets.usd_physics_roles import body_of, is_collider, role
from gf_usd.assets.usd_physics_shapes import Shape, read_shape
from gf_usd.assets.usd_place import LeftAlone
from gf_usd.model import Floats, StageFacts
from gf_usd.stage_physics import Collider


def obstacles(
    prims: Iterable[Usd.Prim], bodies: Sequence[Usd.Prim], time: Usd.TimeCode, notes: Notes
) -> tuple[list[Usd.Prim], list[Usd.Prim]]:
    """Enabled colliders that stand in the way, and those that stand for a baked body itself.

    A collider stands for a body if it is baked, lies under a prim that is, or belongs to the same
    rigid or deformable body.
    """
    baked = [prim.GetPath() for prim in bodies]
    owners = {owner.GetPath() for prim in bodies if (owner := body_of(prim, time))}
    others, own = [], []
    for prim in prims:
        if not is_collider(prim, time):
            continue
        owner = body_of(prim, time)
        if prim.GetPath() in baked:
            own.append(prim)
        elif any(prim.GetPath().HasPrefix(path) for path in baked) or (
            owner and owner.GetPath() in owners
        ):
            own.append(prim)
            notes.add("is the collider of a baked body, whose own surface collides", _name(prim))
        else:
            others.append(prim)
    return others, own


def read_colliders(
    prims: Sequence[Usd.Prim],
    facts: StageFacts,
    materials: PhysicsMaterials,
    time: Usd.TimeCode,
    times: Sequence[float],
    notes: Notes,
) -> tuple[Collider, ...]:
    """The colliders that `prims` are, at the frames' time codes `times`.

    Raises InputError for broken meshes, values and transforms.
    """
    shapes = _shapes(prims, facts, time, notes)
    reading = bare_reading(facts, time)
    motions = _follow(shapes, facts, time, times, notes)
    made = []
    for shape, (frames, deformed) in zip(shapes, motions, strict=True):
        rest = matrix(shape.prim, reading)
        linear, offset = relative_motion(rest, frames or [rest], facts.units.length)
        what = role(shape.prim, time)
        if what == "dynamic":
            notes.add(
                "is a rigid body, which is not simulated: only its animation moves it",
                _name(shape.prim),
            )
        made.append(
            Collider(
                path=_name(shape.prim),
                shape=shape.kind,
                points=shape.points,
                triangles=shape.triangles,
                linear=linear,
                offset=offset,
                deformed=deformed,
                words=materials.bound(shape.prim),
                approximation=shape.approximation,
                role=what,
            )
        )
    return tuple(made)


def _shapes(
    prims: Sequence[Usd.Prim], facts: StageFacts, time: Usd.TimeCode, notes: Notes
) -> list[Shape]:
    reading = bare_reading(facts, time)
    found = []
    for prim in prims:
        if prim.GetTypeName() not in (*IMPLICIT, "Mesh", "Plane"):
            kind = prim.GetTypeName() or "untyped prim"
            notes.add(f"is a {kind}: only meshes and implicit shapes collide", _name(prim))
            continue
        try:
            found.append(read_shape(prim, reading, notes))
        except LeftAlone as reason:
            notes.add(f"does not collide: {reason}", _name(prim))
    return found


def _follow(
    shapes: Sequence[Shape],
    facts: StageFacts,
    time: Usd.TimeCode,
    times: Sequence[float],
    notes: Notes,
) -> list[tuple[list[Floats], Floats | None]]:
    """For each shape the (4, 4) matrices of the frames, none where it stays, or (F, V, 3) [m] where
    its points move by themselves: a skinned mesh does not follow its own transform."""
    reading = bare_reading(facts, time)
    changing = {
        k for k, s in enumerate(shapes) if s.kind == "mesh" and shape_varies(s.prim, reading)
    }
    deforming = {k for k in changing if shapes[k].carriers is not None}
    for k in changing - deforming:
        notes.add("deforms: its approximation only follows its transform", _name(shapes[k].prim))
    moving = {k for k, s in enumerate(shapes) if transform_varies(s.prim)}
    frames: list[list[Floats]] = [[] for _ in shapes]
    posed: list[list[Floats]] = [[] for _ in shapes]
    for code in times if moving | deforming else ():
        reading = bare_reading(facts, Usd.TimeCode(code))
        for k in sorted(moving):
            frames[k].append(matrix(shapes[k].prim, reading))
        for k in sorted(deforming):
            points = posed_points(shapes[k].prim, reading)
            if len(points) == shapes[k].n_points:
                posed[k].append(points[shapes[k].carriers].astype(np.float32))
            else:
                deforming.discard(k)
                notes.add(
                    f"has {len(points)} points at time code {code:g} and {shapes[k].n_points} at"
                    " rest: it only follows its transform",
                    _name(shapes[k].prim),
                )
    return [
        ([], _condensed(posed[k], shapes[k].points)) if k in deforming else (frames[k], None)
        for k in range(len(shapes))
    ]


def _condensed(frames: Sequence[Floats], at_rest: Floats) -> Floats | None:
    """(F, V, 3) of points that do move; one frame where all are alike, None where as at rest."""
    if any(not np.array_equal(frame, frames[0]) for frame in frames):
        return np.stack(frames)
    same = np.array_equal(frames[0], at_rest.astype(np.float32))
    return None if same else np.stack(frames[:1])


def without_instancers(stage: Usd.Stage, notes: Notes) -> list[Usd.Prim]:
    """Every prim of a stage, instances seen as prims; what a PointInstancer repeats is left out."""
    found: list[Usd.Prim] = []
    walk = iter(Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()))
    for prim in walk:
        found.append(prim)
        if prim.IsA(UsdGeom.PointInstancer):
            walk.PruneChildren()
            _note_instancer(prim, notes)
    return found


def _note_instancer(prim: Usd.Prim, notes: Notes) -> None:
    """Say so where an instancer repeats colliders."""
    time = Usd.TimeCode.Default()
    targets = UsdGeom.PointInstancer(prim).GetPrototypesRel().GetForwardedTargets()
    roots = [prim, *(prim.GetStage().GetPrimAtPath(Sdf.Path(target)) for target in targets)]
    below = (
        p for root in roots if root for p in Usd.PrimRange(root, Usd.TraverseInstanceProxies())
    )
    if any(is_collider(p, time) for p in below):
        notes.add("PointInstancer: the colliders it repeats are left out", _name(prim))


def _name(prim: Usd.Prim) -> str:
    return str(prim.GetPath())
