"""The surface that stands for a collider: its own, its hull, a box, a ball or a plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom

from gf_usd.assets.notes import Notes
from gf_usd.assets.usd_mesh import Reading, read_surface
from gf_usd.assets.usd_physics_motion import matrix
from gf_usd.assets.usd_physics_values import number, word
from gf_usd.assets.usd_place import Placement
from gf_usd.errors import InputError
from gf_usd.model import Floats, Ints

APPROXIMATION = "physics:approximation"
MESH_COLLISION = "PhysicsMeshCollisionAPI"
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
            notes.add("is flat: its own triangles collide instead of a convex hull", where)
        else:
            carriers, triangles = hull
            points = points[carriers]
    elif asked in ("boundingCube", "boundingSphere"):
        make = _box if asked == "boundingCube" else _ball
        points, triangles = make(points, prim, reading)
        carriers = None
    elif asked != "none":
        notes.add(f"approximation {asked}: its own triangles collide, which are finer", where)
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
