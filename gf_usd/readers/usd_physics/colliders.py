"""Colliders of a stage: their collision shapes (physics:approximation) and their motion."""

from __future__ import annotations

from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf, Usd, UsdGeom

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import StageFacts
from gf_usd.core.errors import InputError
from gf_usd.core.stage import Collider
from gf_usd.core.units import code_text
from gf_usd.readers.notes import Notes
from gf_usd.readers.usd.implicit import IMPLICIT
from gf_usd.readers.usd.mesh import Reading, posed_points, read_surface
from gf_usd.readers.usd.select import inherited
from gf_usd.readers.usd.stage import Placement, SkippedPrim, upwards
from gf_usd.readers.usd_physics.attributes import body_of, is_collider, number, role, word
from gf_usd.readers.usd_physics.bodies import PhysicsMaterials
from gf_usd.readers.usd_physics.motion import (
    bare_reading,
    matrix,
    relative_motion,
    shape_varies,
    transform_varies,
)

COPY = "is a collider of a copy, by inherits, that follows a baked body: it does not collide"


def obstacles(
    prims: Iterable[Usd.Prim], bodies: Sequence[Usd.Prim], time: Usd.TimeCode, notes: Notes
) -> tuple[list[Usd.Prim], list[Usd.Prim]]:
    """Enabled colliders, separated into obstacles and those of baked bodies.

    A collider belongs to a baked body if it is baked, is a descendant of a baked prim, or is part
    of the same rigid or deformable body.  One that inherits from such a collider is neither where
    its body is a copy that follows the baked one.
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
    copied = {*baked, *owners}
    return [prim for prim in others if not _is_copy(prim, own, copied, time, notes)], own


def _is_copy(
    prim: Usd.Prim,
    own: Sequence[Usd.Prim],
    copied: Container[Sdf.Path],
    time: Usd.TimeCode,
    notes: Notes,
) -> bool:
    """Whether a collider is that of a copy of a baked body.

    The clones of a robot inherit from the first one: what is seen of them moves with what is baked
    of that one (`select`), and their colliders would stay behind as invisible obstacles.  An
    obstacle that takes only its shape from such a collider follows nothing.

    own : colliders of baked bodies; copied : paths of these bodies and of their baked prims.
    """
    if not own or not inherited(prim, {one.GetPath() for one in own}):
        return False
    owner = body_of(prim, time)
    carriers = [owner] if owner else upwards(prim)  # without a body, a baked prim carries it
    if not any(inherited(one, copied) for one in (prim, *carriers)):
        return False
    notes.add(COPY, _name(prim))
    return True


def read_colliders(
    prims: Sequence[Usd.Prim],
    facts: StageFacts,
    materials: PhysicsMaterials,
    time: Usd.TimeCode,
    times: Sequence[float],
    notes: Notes,
) -> tuple[Collider, ...]:
    """The colliders of `prims`, with their motion at the time codes `times` of the frames.

    Raises InputError for invalid meshes, values and transforms, and for a motion that mirrors one.
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
            kind = prim.GetTypeName() or "prims without a type"
            notes.add(f"only meshes and implicit shapes collide, not {kind}", _name(prim))
            continue
        try:
            found.append(read_shape(prim, reading, notes))
        except SkippedPrim as reason:
            notes.add(f"does not collide: {reason}", _name(prim))
    return found


def _follow(
    shapes: Sequence[Shape],
    facts: StageFacts,
    time: Usd.TimeCode,
    times: Sequence[float],
    notes: Notes,
) -> list[tuple[list[Floats], Floats | None]]:
    """The motion of each shape: (4, 4) matrices of the frames, empty where it is static; or
    (F, V, 3) [m] points where they are animated (a skinned mesh ignores its own transform)."""
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
    at_rest = {k: matrix(shapes[k].prim, reading) for k in moving}
    frames: list[list[Floats]] = [[] for _ in shapes]
    posed: list[list[Floats]] = [[] for _ in shapes]
    for code in times if moving | deforming else ():
        reading = bare_reading(facts, Usd.TimeCode(code))
        for k in sorted(moving):
            frames[k].append(matrix(shapes[k].prim, reading))
            _require_unmirrored(shapes[k].prim, frames[k][-1], at_rest[k], reading)
        for k in sorted(deforming):
            points = posed_points(shapes[k].prim, reading)
            if len(points) == shapes[k].n_points:
                posed[k].append(points[shapes[k].carriers].astype(np.float32))
            else:
                deforming.discard(k)
                notes.add(
                    f"has {len(points)} points at time code {code_text(code)} but"
                    f" {shapes[k].n_points} at rest: it only follows its transform",
                    _name(shapes[k].prim),
                )
    return [
        ([], _condensed(posed[k], shapes[k].points)) if k in deforming else (frames[k], None)
        for k in range(len(shapes))
    ]


def _require_unmirrored(prim: Usd.Prim, frame: Floats, at_rest: Floats, reading: Reading) -> None:
    """Raise InputError where a transform (4, 4) is a mirror image of that at rest.

    The faces of the shape would point inward, and bodies in contact would be pushed into it.
    """
    if np.linalg.det(frame[:3, :3]) * np.linalg.det(at_rest[:3, :3]) >= 0.0:
        return
    if reading.skins.placement(prim) is not None:  # its skeleton poses it, not its transform
        return
    raise InputError(
        f"{reading.path}: the collider <{prim.GetPath()}> is a mirror image of its rest pose at"
        f" time code {code_text(reading.time.GetValue())}: its scale, or that of a prim above it,"
        f" changes sign",
        "animate the scale without a change of sign, or bake frames with one sign (--start,"
        " --frames)",
    )


def _condensed(frames: Sequence[Floats], at_rest: Floats) -> Floats | None:
    """(F, V, 3) animated points; F = 1 where all frames are equal.

    None where they equal the rest pose, and where there are no frames.
    """
    if not frames:
        return None
    if any(not np.array_equal(frame, frames[0]) for frame in frames):
        return np.stack(frames)
    same = np.array_equal(frames[0], at_rest.astype(np.float32))
    return None if same else np.stack(frames[:1])


def without_instancers(stage: Usd.Stage, notes: Notes) -> list[Usd.Prim]:
    """All prims of a stage, with instance proxies, without the prototypes of PointInstancers."""
    found: list[Usd.Prim] = []
    walk = iter(Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()))
    for prim in walk:
        found.append(prim)
        if prim.IsA(UsdGeom.PointInstancer):
            walk.PruneChildren()
            _note_instancer(prim, notes)
    return found


def _note_instancer(prim: Usd.Prim, notes: Notes) -> None:
    """Add a note where a PointInstancer has colliders, which are skipped."""
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
# Omniverse's own, for which PhysX has schemas; a mesh with "sdf" collides with its own surface.
PHYSX = ("sdf", "sphereFill")
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
    """A collision shape in the rest pose, world space."""

    prim: Usd.Prim
    kind: str  # mesh | plane
    points: Floats  # (V, 3) [m]
    triangles: Ints  # (T, 3), outward-facing
    approximation: str
    n_points: int  # of the prim's surface
    carriers: Ints | None  # (V,) index in the prim's points; None: moved by its transform only


def read_shape(prim: Usd.Prim, reading: Reading, notes: Notes) -> Shape:
    """The collision shape of a mesh or an implicit shape, by its physics:approximation.

    Raises InputError for invalid meshes and approximations, and SkippedPrim for a prim without a
    surface.
    """
    if prim.IsA(UsdGeom.Plane):
        points = _plane(prim, reading)
        return Shape(
            prim=prim, kind="plane", points=points, triangles=np.array([(0, 1, 2), (0, 2, 3)]),
            approximation="none", n_points=4, carriers=None,
        )  # fmt: skip
    Placement.of(reading.xforms.GetLocalToWorldTransform(prim))  # validation, also of skinned ones
    surface = read_surface(prim, reading)
    points, triangles = np.asarray(surface.points, np.float64), surface.triangles
    carriers = np.arange(len(points))
    approximation = _approximation(prim, reading)
    where = str(prim.GetPath())
    if approximation == "convexHull":
        hull = _hull(points)
        if hull is None:
            notes.add("is flat: its own triangles are used instead of a convex hull", where)
        else:
            carriers, triangles = hull
            points = points[carriers]
    elif approximation in ("boundingCube", "boundingSphere"):
        make = _box if approximation == "boundingCube" else _ball
        points, triangles = make(points, prim, reading)
        carriers = None
    elif approximation not in ("none", "sdf"):
        notes.add(
            f"approximation {approximation}: its own triangles, which are finer, are used", where
        )
    return Shape(
        prim=prim, kind="mesh", points=points, triangles=triangles, approximation=approximation,
        n_points=len(surface.points), carriers=carriers,
    )  # fmt: skip


def _approximation(prim: Usd.Prim, reading: Reading) -> str:
    attribute = prim.GetAttribute(APPROXIMATION)
    value = attribute.Get() if attribute and prim.IsA(UsdGeom.Mesh) else None
    if value is not None and value not in (*KNOWN, *PHYSX):
        raise InputError(
            f"{reading.path}: <{prim.GetPath()}>: {APPROXIMATION} is {value!r}",
            f"author one of {', '.join(KNOWN)}",
        )
    return str(value or "none")


def _hull(points: Floats) -> tuple[Ints, Ints] | None:
    """Corners (V,) of the convex hull, as indices, and its triangles (T, 3); None where flat."""
    from scipy.spatial import ConvexHull, QhullError  # takes long to import: see `core.neighbors`

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
    """Low and high corner (3,) of the bounding box of world points [m], in local space."""
    local = (points / unit - rows[3, :3]) @ np.linalg.inv(rows[:3, :3])
    return local.min(0), local.max(0)


def _box(points: Floats, prim: Usd.Prim, reading: Reading) -> tuple[Floats, Ints]:
    """The bounding box of the points along the prim's local axes."""
    rows, unit = matrix(prim, reading), reading.meters_per_unit
    low, high = _own_box(points, rows, unit)
    corners = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    local = low + corners * (high - low)
    mirrored = np.linalg.det(rows[:3, :3]) < 0.0
    return _world(local, rows, unit), BOX[:, ::-1] if mirrored else BOX


def _ball(points: Floats, prim: Usd.Prim, reading: Reading) -> tuple[Floats, Ints]:
    """The bounding sphere about the center of the points' local bounding box."""
    from trimesh.creation import icosphere

    rows, unit = matrix(prim, reading), reading.meters_per_unit
    center = _world(np.mean(_own_box(points, rows, unit), axis=0), rows, unit)
    radius = np.linalg.norm(points - center, axis=1).max()
    unit_ball = icosphere(subdivisions=BALL_LEVEL)
    return center + radius * np.asarray(unit_ball.vertices), np.asarray(unit_ball.faces, np.int64)


def _plane(prim: Usd.Prim, reading: Reading) -> NDArray[np.float64]:
    """Corners (4, 3) [m] of the rendered part of a plane, counter-clockwise seen from its axis."""
    path, time = reading.path, reading.time
    axis = "XYZ".index(word(path, prim, "axis", time, ("X", "Y", "Z")) or "Z")
    # USD's fallback sizes; they bound the rendered part only, the collision plane is infinite.
    width, length = (0.5 * (number(path, prim, name, time) or 2.0) for name in ("width", "length"))
    # width and length are along the two axes that follow `axis` cyclically
    along = {0: (length, width), 1: (length, width), 2: (width, length)}[axis]
    corners = np.zeros((4, 3))
    corners[:, (axis + 1) % 3] = np.array([-1.0, 1.0, 1.0, -1.0]) * along[0]
    corners[:, (axis + 2) % 3] = np.array([-1.0, -1.0, 1.0, 1.0]) * along[1]
    place = Placement.of(reading.xforms.GetLocalToWorldTransform(prim))
    turned = corners[::-1] if place.mirrored else corners
    return place.points(turned) * reading.meters_per_unit


def _world(local: Floats, rows: Floats, unit: float) -> NDArray[np.float64]:
    return (local @ rows[:3, :3] + rows[3, :3]) * unit
