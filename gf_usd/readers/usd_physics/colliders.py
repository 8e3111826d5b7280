"""The obstacles of a stage and their motion.

The surface that stands for a collider: its own, its hull, a box, a ball or a plane.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf, Usd, UsdGeom

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import StageFacts
from gf_usd.core.errors import InputError
from gf_usd.core.stage import Collider
from gf_usd.readers.notes import Notes
from gf_usd.readers.usd.implicit import IMPLICIT
from gf_usd.readers.usd.mesh import Reading, posed_points, read_surface
from gf_usd.readers.usd.stage import LeftAlone, Placement
from gf_usd.readers.usd_physics.attributes import body_of, is_collider, number, role, word
from gf_usd.readers.usd_physics.bodies import PhysicsMaterials
from gf_usd.readers.usd_physics.motion import (
    bare_reading,
    matrix,
    relative_motion,
    shape_varies,
    transform_varies,
)


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
            notes.add(
                "is the collider of a baked body: the surface of the body collides instead",
                _name(prim),
            )
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
                "is a rigid body, and rigid bodies are not simulated: it moves only if it is "
                "animated",
                _name(shape.prim),
            )
        spec = materials.bound(shape.prim)
        materials.note_keys(spec, shape.prim.GetStage())
        made.append(
            Collider(
                path=_name(shape.prim),
                shape=shape.kind,
                points=shape.points,
                triangles=shape.triangles,
                linear=linear,
                offset=offset,
                deformed=deformed,
                spec=spec,
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
        notes.add(
            "deforms, but its approximation only follows its transform", _name(shapes[k].prim)
        )
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
                    f"has {len(points)} points at time code {code:g} but {shapes[k].n_points} "
                    f"at rest: it only follows its transform",
                    _name(shapes[k].prim),
                )
    return [
        ([], _condensed(posed[k], shapes[k].points)) if k in deforming else (frames[k], None)
        for k in range(len(shapes))
    ]


def _condensed(frames: Sequence[Floats], at_rest: Floats) -> Floats | None:
    """(F, V, 3) of points that do move; one frame where all are alike, None where as at rest.

    None too where no frame was asked for.
    """
    if not frames:
        return None
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


APPROXIMATION = "physics:approximation"
KNOWN = (
    "none", "convexDecomposition", "convexHull", "boundingSphere", "boundingCube",
    "meshSimplification",
)  # fmt: skip
BALL_LEVEL = 3  # icosphere of 642 points: within 0.4 % of the radius
# Corners are numbered 4 x + 2 y + z; outward winding.
BOX = np.array(
    [
        (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
        (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
    ]
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Shape:
    """A collider posed at rest, world, and how it follows its prim."""

    prim: Usd.Prim
    kind: str  # mesh | plane
    points: Floats  # (V, 3) [m]
    triangles: Ints  # (T, 3), outward
    approximation: str
    n_points: int  # of the prim's own surface
    carriers: Ints | None  # (V,) the own points these are; None: they only follow the transform


def read_shape(prim: Usd.Prim, reading: Reading, notes: Notes) -> Shape:
    """The collider that UsdPhysics makes of a mesh or an implicit shape.

    Raises InputError for broken meshes and approximations that are none, LeftAlone for a prim
    without a surface.
    """
    if prim.IsA(UsdGeom.Plane):
        points = _plane(prim, reading)
        return Shape(
            prim=prim, kind="plane", points=points, triangles=np.array([(0, 1, 2), (0, 2, 3)]),
            approximation="none", n_points=4, carriers=None,
        )  # fmt: skip
    Placement.of(reading.xforms.GetLocalToWorldTransform(prim))  # also where a skeleton poses it
    surface = read_surface(prim, reading)
    points, triangles = np.asarray(surface.points, np.float64), surface.triangles
    carriers = np.arange(len(points))
    asked = _approximation(prim, reading)
    where = str(prim.GetPath())
    if asked == "convexHull":
        hull = _hull(points)
        if hull is None:
            notes.add("is flat: its own triangles are used instead of a convex hull", where)
        else:
            carriers, triangles = hull
            points = points[carriers]
    elif asked in ("boundingCube", "boundingSphere"):
        make = _box if asked == "boundingCube" else _ball
        points, triangles = make(points, prim, reading)
        carriers = None
    elif asked != "none":
        notes.add(f"approximation {asked}: its own triangles, which are finer, are used", where)
    return Shape(
        prim=prim, kind="mesh", points=points, triangles=triangles, approximation=asked,
        n_points=len(surface.points), carriers=carriers,
    )  # fmt: skip


def _approximation(prim: Usd.Prim, reading: Reading) -> str:
    attribute = prim.GetAttribute(APPROXIMATION)
    value = attribute.Get() if attribute and prim.IsA(UsdGeom.Mesh) else None
    if value is not None and value not in KNOWN:
        raise InputError(
            f"{reading.path}: <{prim.GetPath()}>: {APPROXIMATION} is {value!r}",
            f"author one of {', '.join(KNOWN)}",
        )
    return str(value or "none")


def _hull(points: Floats) -> tuple[Ints, Ints] | None:
    """Corners (V,) of the convex hull, as indices, and its triangles (T, 3); None where flat."""
    from scipy.spatial import ConvexHull, QhullError  # see `nearby`

    try:
        hull = ConvexHull(points)
    except QhullError:
        return None
    a, b, c = (points[hull.simplices[:, k]] for k in range(3))
    outward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) > 0.0
    triangles = np.where(outward[:, None], hull.simplices, hull.simplices[:, ::-1])
    corners, renumbered = np.unique(triangles, return_inverse=True)
    return corners, renumbered.reshape(-1, 3)


def _own_box(points: Floats, rows: Floats, unit: float) -> tuple[Floats, Floats]:
    """Low and high corner (3,) of world points [m] along the prim's own axes, in its space."""
    local = (points / unit - rows[3, :3]) @ np.linalg.inv(rows[:3, :3])
    return local.min(0), local.max(0)


def _box(points: Floats, prim: Usd.Prim, reading: Reading) -> tuple[Floats, Ints]:
    """The box around the points along the prim's own axes."""
    rows, unit = matrix(prim, reading), reading.meters_per_unit
    low, high = _own_box(points, rows, unit)
    corners = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    local = low + corners * (high - low)
    mirrored = np.linalg.det(rows[:3, :3]) < 0.0
    return _world(local, rows, unit), BOX[:, ::-1] if mirrored else BOX


def _ball(points: Floats, prim: Usd.Prim, reading: Reading) -> tuple[Floats, Ints]:
    """The ball around the points, its center that of the box around them."""
    from trimesh.creation import icosphere

    rows, unit = matrix(prim, reading), reading.meters_per_unit
    center = _world(np.mean(_own_box(points, rows, unit), axis=0), rows, unit)
    radius = np.linalg.norm(points - center, axis=1).max()
    unit_ball = icosphere(subdivisions=BALL_LEVEL)
    return center + radius * np.asarray(unit_ball.vertices), np.asarray(unit_ball.faces, np.int64)


def _plane(prim: Usd.Prim, reading: Reading) -> NDArray[np.float64]:
    """Corners (4, 3) [m] of the drawn part, counter-clockwise seen from the axis."""
    path, time = reading.path, reading.time
    axis = "XYZ".index(word(path, prim, "axis", time, ("X", "Y", "Z")) or "Z")
    # USD's fallback where none is stated; only the picture has an end, the plane has none.
    width, length = (0.5 * (number(path, prim, name, time) or 2.0) for name in ("width", "length"))
    # USD's sizes along the two axes that follow `axis` in a cycle.
    along = {0: (length, width), 1: (length, width), 2: (width, length)}[axis]
    corners = np.zeros((4, 3))
    corners[:, (axis + 1) % 3] = np.array([-1.0, 1.0, 1.0, -1.0]) * along[0]
    corners[:, (axis + 2) % 3] = np.array([-1.0, -1.0, 1.0, 1.0]) * along[1]
    place = Placement.of(reading.xforms.GetLocalToWorldTransform(prim))
    turned = corners[::-1] if place.mirrored else corners
    return place.points(turned) * reading.meters_per_unit


def _world(local: Floats, rows: Floats, unit: float) -> NDArray[np.float64]:
    return (local @ rows[:3, :3] + rows[3, :3]) * unit
