"""Possible contacts of the bodies of a bake: with each other, with obstacles, with themselves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gf_usd.core.arrays import Floats, Ints, cross, row_dots
from gf_usd.core.asset import StageFacts
from gf_usd.core.errors import InputError, counted
from gf_usd.core.frames import Particles, SurfaceSamples
from gf_usd.core.mesh import shells, signed_volume, weld, with_short_edges
from gf_usd.core.stage import Collider, ContactSetup, Skin, StagePhysics
from gf_usd.prepare.bodies.plan import BodyPlan
from gf_usd.readers.isolated import Reading

if TYPE_CHECKING:
    from gf_usd.geometry.solid import Solid
    from gf_usd.system.sandbox import Limits


@dataclass(frozen=True, kw_only=True)
class LimbPlan:
    """A filled solid with separate nodes for near limbs (docs/physics.md)."""

    particles: Particles
    samples: SurfaceSamples
    contact_setup: ContactSetup
    embedded_copies: dict[str, Ints] = field(default_factory=dict)  # of cells, of points, by path
    notes: tuple[str, ...] = ()


def separate_limbs(
    solid: Solid, bodies: BodyPlan, filled: LimbPlan, points: Mapping[str, Floats]
) -> LimbPlan:
    """Particles with copies of the cells that limbs share; the cell copy of each embedded point.

    points : (n, 3) [m] embedded points, by prim path.
    """
    from gf_usd.geometry.connected.copies import find_limbs

    limbs = find_limbs(solid, filled.particles, bodies.of_surface)
    if limbs is None:
        return filled
    samples, setup = filled.samples, filled.contact_setup
    skins = tuple(
        replace(skin, cell_copy=limbs.of_points(skin.points, np.full(len(skin.points), k)))
        for k, skin in enumerate(setup.skins)
    )
    notes = [
        "parts that are close at rest can move apart:"
        f" {counted(limbs.nodes, 'grid node is', 'grid nodes are')} duplicated"
    ]
    if limbs.crowded:
        notes.append(
            f"in {limbs.crowded} grid cells surfaces are too close together to be separated: parts"
            " in them move together"
        )
    return LimbPlan(
        particles=replace(filled.particles, copies=limbs.copies),
        samples=replace(samples, cell_copy=limbs.of_points(samples.X, samples.body)),
        contact_setup=replace(setup, skins=skins),
        embedded_copies={
            path: limbs.of_points(X, np.full(len(X), bodies.embedded[path]))
            for path, X in points.items()
        },
        notes=tuple(notes),
    )


# [spacings] of an edge of the surface that bodies collide with.  Faces are flat between vertices
# however the body bends: boxes of twelve triangles overlapped by 1.7 spacings (measured).
LONGEST = 1.5


def skins(solid: Solid, of: Ints, spacing: float = np.inf) -> tuple[Skin, ...]:
    """The surface of each body, facing outward, with edges of at most LONGEST spacings [m]."""
    out = []
    for body in range(int(of.max()) + 1):
        points, triangles, first = [], [], 0
        for s in np.flatnonzero(of == body):
            p, t = solid.outward(int(s))
            points.append(p)
            triangles.append(t + first)
            first += len(p)
        whole = np.concatenate(points), np.concatenate(triangles)
        if np.isfinite(spacing):
            whole = with_short_edges(*whole, LONGEST * spacing)
        out.append(Skin(points=whole[0], triangles=whole[1]))
    return tuple(out)


def contact_setup(
    solid: Solid,
    bodies: BodyPlan,
    physics: StagePhysics,
    *,
    spacing: float,
    self_contact: bool | None,
    meet_from: int = 0,
) -> ContactSetup:
    """The possible contacts between bodies, from the stage.

    spacing : [m] of the particles.
    self_contact : bodies can touch themselves; None: all but those of `cannot_touch_itself`.
    meet_from : frame from which bodies can touch each other.
    """
    colliders = physics.obstacles
    body = {path: k for k, paths in enumerate(bodies.surfaces) for path in paths}
    wall = {c.path: k for k, c in enumerate(colliders)}
    through, through_colliders = set(), set()
    for one, other in physics.ignored:
        if one in body and other in body:
            through.add((body[one], body[other]))
        elif one in body and other in wall:
            through_colliders.add((body[one], wall[other]))
    for physics_body in physics.bodies:
        if not physics_body.collides and physics_body.path in body:
            mine = body[physics_body.path]
            through |= {(mine, k) for k in range(bodies.count)}
            through_colliders |= {(mine, k) for k in range(len(colliders))}
    made = skins(solid, bodies.of_surface, spacing)
    meets: set[int] = set()
    if self_contact is not False:
        passes = {a for a, b in through if a == b}
        meets = {
            k for k, skin in enumerate(made) if self_contact or not cannot_touch_itself(skin)
        } - passes
    return ContactSetup(
        skins=tuple(
            replace(skin, path=paths[0]) for skin, paths in zip(made, bodies.surfaces, strict=True)
        ),
        colliders=colliders,
        through=frozenset(through),
        through_colliders=frozenset(through_colliders),
        self_contact=frozenset(meets),
        meet_from=meet_from,
    )


BURIED = 0.02  # of the particles: less is a touch, which contact resolves


def require_clear_start(
    path: Path, particles: Particles, lift: Sequence[float], setup: ContactSetup, unit: float
) -> None:
    """Raise InputError where lifting the bodies moves them into an obstacle.

    particles : of all bodies, at their position in the asset; lift : (3,) [m]; unit : [m] of the
        stage.  Particles that are inside an obstacle in the asset itself are allowed.
    """
    way = np.asarray(lift, float)
    if not way.any():
        return
    body = particles.body_of
    for k, one in enumerate(setup.colliders):
        free = [a for a in range(len(setup.skins)) if (a, k) in setup.through_colliders]
        X = particles.X[~np.isin(body, free)]
        buried = _inside(one, X + way) & ~_inside(one, X)
        if buried.sum() > BURIED * len(X):
            raise InputError(
                f"{path}: moved by {np.linalg.norm(way) / unit:.3g} units to its height over the"
                f" floor, {buried.mean():.0%} of the particles start inside the obstacle"
                f" <{one.path}>",
                "use a --drop that clears it, or --floor none, which does not move the body",
            )


def penetration_notes(
    particles: Particles, lift: Sequence[float], setup: ContactSetup, bodies: BodyPlan
) -> tuple[str, ...]:
    """Notes on bodies that have particles in an obstacle at the start."""
    body, X = particles.body_of, particles.X + np.asarray(lift, float)
    notes = []
    for k, one in enumerate(setup.colliders):
        met = [a for a in range(bodies.count) if (a, k) not in setup.through_colliders]
        count = np.bincount(body[_inside(one, X)], minlength=bodies.count)
        for a in (a for a in met if count[a]):
            whole = int((body == a).sum())
            room = ", or reverse the faces of the obstacle if it is a room around the body"
            notes.append(
                f"<{bodies.surfaces[a][0]}> starts with {count[a]} of {whole}"
                f" particles inside the obstacle <{one.path}> and stays as deep as it is until"
                f" it moves away; move them apart in the asset{room if count[a] == whole else ''}"
            )
    return tuple(notes)


def _inside(obstacle: Collider, X: Floats) -> Ints:
    """(n,) whether points X (n, 3) [m] are inside an obstacle at the start.

    What a room encloses is in front of its faces, and thus outside.
    """
    from gf_usd.geometry.winding import winding_numbers

    points = obstacle.positions(0)
    if obstacle.shape == "plane":
        a, b, c = points[obstacle.triangles[0]]
        return (X - a) @ cross(b - a, c - a) < 0.0
    near = ((points.min(0) <= X) & (points.max(0) >= X)).all(1)
    found = np.zeros(len(X), bool)
    if near.any():
        found[near] = winding_numbers(points, obstacle.triangles, X[near]) > 0.5
    return found


CONVEX = 0.9  # of the volume of its convex hull: a body that fills as much of it ...

STOUT = 3.0  # ... and is at most so many times as long as thick cannot be folded onto itself


ROWS = 256  # triangles whose products with all points are worked out at a time
SIDE = 6  # parts of an octahedron's edges: 146 directions, which hold 0.98 of a ball
MANY = 1 << 25  # triangles times points, from where a hull is found sooner than its bound


def cannot_touch_itself(skin: Skin) -> bool:
    """Whether a body is one shell, nearly convex and so compact that it cannot touch itself."""
    representative, _ = weld(skin.points)
    used, triangles = np.unique(representative[skin.triangles], return_inverse=True)
    if shells(triangles.reshape(-1, 3)).max(initial=0) > 0:
        return False
    points = skin.points[used]
    center = points - points.mean(0)
    length = np.ptp(center @ np.linalg.svd(center, full_matrices=False)[2].T, axis=0)
    if length.max() > STOUT * length.min():
        return False
    volume, triangles = signed_volume(skin.points, skin.triangles), triangles.reshape(-1, 3)
    if len(points) * len(triangles) < MANY and volume >= CONVEX * hull_upper_bound(
        points, triangles
    ):
        return True
    if volume < CONVEX * hull_lower_bound(points):
        return False
    from scipy.spatial import ConvexHull, QhullError  # takes longer to import than all of this

    try:
        hull = ConvexHull(points).volume
    except QhullError:  # flat to rounding
        return False
    return volume >= CONVEX * hull


def hull_upper_bound(points: Floats, triangles: Ints) -> float:
    """[m^3] upper bound of the volume of the convex hull of a closed shell; inf where there is
    none.

    Where the center c is at d_i > 0 behind the planes of all triangles, the cones from c over the
    triangles fill the shell.  No point is more than h_i in front of plane i, and therefore no point
    of the hull, so that

        V <= sum_i V_i (1 + h_i / d_i)^3

    with V_i = A_i d_i / 3 the volume of a triangle's cone.

    points : (V, 3) [m]; triangles : (T, 3), facing outward.
    """
    ends = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    sides = np.sort(ends[:, 0] * len(points) + ends[:, 1])
    if len(sides) % 2 or (sides[::2] != sides[1::2]).any() or (sides[2::2] == sides[1:-1:2]).any():
        return np.inf  # it is open, or more than two triangles meet at an edge
    X = points - 0.5 * (points.min(0) + points.max(0))
    a, b, c = np.moveaxis(X[triangles], 1, 0)
    normal = cross(b - a, c - a)  # 2 A_i long
    behind = np.einsum("ta,ta->t", normal, a)  # 6 V_i
    if (behind <= 0.0).any():
        return np.inf
    most = np.concatenate(
        [(normal[k : k + ROWS] @ X.T).max(1) for k in range(0, len(triangles), ROWS)]
    )
    return float((behind * (most / behind) ** 3).sum() / 6.0)


def hull_lower_bound(points: Floats) -> float:
    """[m^3] lower bound of the volume of the convex hull of points (V, 3) [m]; 0 where there is
    none.

    The points that are farthest along directions on a sphere, connected as the directions are, form
    a surface within the hull.  Seen from the center c of the bounding box, this surface covers all
    directions once if its solid angles O_i sum to 4 pi, or k + 1 times where k triangles face
    inward.  With V_i the signed volumes of the cones over its triangles, and R the distance from c
    to the farthest point,

        V >= sum_i V_i - 1/3 R^3 sum_{O_i < 0} |O_i|

    The solid angle is that of van Oosterom and Strackee (1983).
    """
    directions, triangles = _octahedron(SIDE)
    X = points - 0.5 * (points.min(0) + points.max(0))
    corners = X[(directions @ X.T).argmax(1)][triangles]
    a, b, c = np.moveaxis(corners, 1, 0)
    la, lb, lc = np.moveaxis(np.linalg.norm(corners, axis=2), 1, 0)
    cone = row_dots(cross(a, b), c)  # 6 V_i
    below = la * lb * lc + row_dots(a, b) * lc + row_dots(b, c) * la + row_dots(c, a) * lb
    angle = 2.0 * np.arctan2(cone, below)
    if abs(angle.sum() - 4.0 * np.pi) > 1e-6:
        return 0.0
    farthest = max(la.max(), lb.max(), lc.max())
    return max(0.0, float(cone.sum() / 6.0 + np.minimum(angle, 0.0).sum() * farthest**3 / 3.0))


def _octahedron(side: int) -> tuple[Floats, Ints]:
    """Directions (d, 3) to the vertices of an octahedron whose edges are divided into `side` parts,
    and its triangles (8 side^2, 3), facing outward."""
    at = np.indices((side, side, side)).reshape(3, -1).T
    up, down = (at[at.sum(1) == side - k] for k in (1, 2))
    eye = np.eye(3, dtype=int)
    one = np.concatenate([up[:, None] + eye, down[:, None] + (1 - eye)[[2, 0, 1]]])
    octants = []
    for signs in np.stack(np.meshgrid(*[[1, -1]] * 3), -1).reshape(-1, 3):
        octants.append((one * signs)[:, :: int(signs.prod())])
    corners, triangles = np.unique(
        np.concatenate(octants).reshape(-1, 3), axis=0, return_inverse=True
    )
    return corners / np.linalg.norm(corners, axis=1)[:, None], triangles.reshape(-1, 3)


def file_obstacles(
    files: Sequence[str], facts: StageFacts, limits: Limits | None
) -> tuple[tuple[Collider, ...], tuple[str, ...]]:
    """The surfaces of other files as static obstacles, and notes on them.

    facts : of the asset, to whose up axis they are rotated.
    Raises InputError as `read_asset`, and for a file of captured Gaussians only.
    """
    made: list[Collider] = []
    notes: list[str] = []
    for name in files:
        path = Path(name)
        with Reading(path, limits, elastic=False) as reading:
            read = reading.result().asset
        if not read.surfaces:
            raise InputError(f"{path}: no mesh in it can be an obstacle", "give a file with meshes")
        turn = np.eye(3) if read.facts.up_axis == facts.up_axis else TURNED[read.facts.up_axis]
        made += [
            Collider(
                path=f"{path.name}:{s.path}", shape="mesh", points=np.asarray(s.points) @ turn.T,
                triangles=s.triangles, linear=np.eye(3)[None], offset=np.zeros((1, 3)),
            )
            for s in read.surfaces
        ]  # fmt: skip
        still = ", as at its first frame" if read.facts.animated else ""
        turned = f", turned from {read.facts.up_axis} up" if turn[0, 0] != turn[1, 1] else ""
        notes.append(
            f"{path.name}: {len(read.surfaces)} obstacle{'s' * (len(read.surfaces) > 1)}{turned}"
            f"{still}; the result does not contain the file"
        )
    return tuple(made), tuple(notes)


# From Y up to Z up and back, for column vectors.
TURNED = {
    "Y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "Z": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
}
