"""The bodies of a bake: surfaces that fall as one, and the contacts they can have."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import Asset, StageFacts
from gf_usd.core.errors import InputError
from gf_usd.core.frames import Particles, SurfaceSamples
from gf_usd.core.mesh import shells, signed_volume, weld
from gf_usd.core.neighbors import kd_tree
from gf_usd.core.stage import BodyPhysics, Collider, ContactSetup, Skin, StagePhysics, Triple
from gf_usd.readers.isolated import Reading

if TYPE_CHECKING:
    from gf_usd.geometry.solid import Solid
    from gf_usd.system.sandbox import Limits


LEAST = 16  # particles: a body of fewer does not hold a grid


@dataclass(frozen=True, kw_only=True)
class BodyPlan:
    """The bodies of a bake."""

    of_surface: Ints  # (S,) body of each filled surface, in the order of `Solid.surfaces`
    radius: Floats  # (B,) [m] r = (3 V / 4 pi)^(1/3)
    surfaces: tuple[tuple[str, ...], ...]  # prim paths of each body
    embedded: dict[str, int]  # body that each mesh moves with, by prim path
    notes: tuple[str, ...] = ()

    @property
    def count(self) -> int:
        return len(self.radius)


def plan_bodies(
    asset: Asset,
    solid: Solid,
    spacing: float,
    sample: Callable[[Ints], Particles],
    owners: dict[str, str],
    *,
    combine: bool,
) -> tuple[BodyPlan, Particles]:
    """The bodies of a solid, and the particles that fill them.

    spacing : [m] about that of the particles; sample : particles for the body (S,) of each surface;
    owners : the physics body prim that a surface belongs to, by path; combine : one body in all.
    """
    from gf_usd.geometry.connected.bodies import find_bodies

    owned = [owners.get(s.path, "") for s in solid.surfaces]
    of = find_bodies(solid, spacing, owners=owned, combine=combine)
    particles = sample(of)
    of, fused = _fuse_small(of, solid, particles)
    if fused:
        particles = sample(of)
    body = of[particles.surface]
    volume = np.bincount(body, particles.V0, minlength=int(of.max()) + 1)
    paths = [s.path for s in solid.surfaces]
    names = tuple(tuple(p for p, k in zip(paths, of) if k == b) for b in range(int(of.max()) + 1))
    notes = [
        f"<{paths[s]}> holds {n} particles of its own and is one body with <{paths[host]}>"
        for s, n, host in fused
    ]
    if len(names) > 1:
        notes.append(
            f"{len(names)} bodies, which meet by contact: {_listed(names)}; --combine makes one of"
            " them"
        )
    several = len(names) > 1
    radius = np.cbrt(3.0 * volume / (4.0 * np.pi)) if several else np.array([particles.radius])
    plan = BodyPlan(
        of_surface=of,
        radius=radius,
        surfaces=names,
        embedded=_embedded(asset, dict(zip(paths, of.tolist())), particles, body),
        notes=tuple(notes),
    )
    return plan, replace(particles, body=body if several else None)


def _listed(names: Sequence[Sequence[str]]) -> str:
    first = ", ".join(f"<{one[0]}>" for one in names[:4])
    return first + (f" and {len(names) - 4} more" if len(names) > 4 else "")


def _fuse_small(of: Ints, solid: Solid, particles: Particles) -> tuple[Ints, list[Any]]:
    """Bodies of too few particles become one with the nearest; (surface, particles, host) of each.

    A surface without any particle is a shell about nothing: it can only be embedded.
    """
    of, fused = of.copy(), []
    for body in range(int(of.max()) + 1):
        members = np.flatnonzero(of == body)
        mine = np.isin(particles.surface, members)
        if mine.sum() >= LEAST or len(members) == len(of):
            continue
        rest = np.flatnonzero(~mine)
        points = np.concatenate([solid.surfaces[s].points for s in members])
        gap, at = kd_tree(particles.X[rest]).query(points)
        host = int(particles.surface[rest[at[np.argmin(gap)]]])
        of[members] = of[host]
        fused += [(int(s), int((particles.surface == s).sum()), host) for s in members]
    _, first = np.unique(of, return_index=True)
    renumbered = np.argsort(np.argsort(first))[np.unique(of, return_inverse=True)[1]]
    return renumbered, fused


def _embedded(
    asset: Asset, filled: dict[str, int], particles: Particles, body: Ints
) -> dict[str, int]:
    """Body that each surface moves with: its own, or that which most of its points are nearest."""
    tree, out = None, {}
    for surface in asset.surfaces:
        if surface.path in filled:
            out[surface.path] = filled[surface.path]
            continue
        if tree is None:
            tree = kd_tree(particles.X)
        out[surface.path] = int(np.bincount(body[tree.query(surface.points)[1]]).argmax())
    return out


@dataclass(frozen=True, kw_only=True)
class LimbPlan:
    """A filled solid whose near limbs share no nodes (docs/physics.md)."""

    particles: Particles
    samples: SurfaceSamples
    contact_setup: ContactSetup
    embedded_copies: dict[str, Ints] = field(default_factory=dict)  # of cells, of points, by path
    notes: tuple[str, ...] = ()


def keep_limbs_apart(
    solid: Solid, bodies: BodyPlan, filled: LimbPlan, points: Mapping[str, Floats]
) -> LimbPlan:
    """The particles with the copies of cells that limbs share; the copy of each embedded point.

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
        f"parts that are close at rest can move apart: {limbs.nodes} grid nodes are duplicated"
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


def skins(solid: Solid, of: Ints) -> tuple[Skin, ...]:
    """The surface of each body, seen from outside."""
    out = []
    for body in range(int(of.max()) + 1):
        points, triangles, first = [], [], 0
        for s in np.flatnonzero(of == body):
            p, t = solid.outward(int(s))
            points.append(p)
            triangles.append(t + first)
            first += len(p)
        out.append(Skin(points=np.concatenate(points), triangles=np.concatenate(triangles)))
    return tuple(out)


def contact_setup(
    solid: Solid, bodies: BodyPlan, physics: StagePhysics, *, self_contact: bool | None
) -> ContactSetup:
    """Who meets whom, as the stage wants it.

    self_contact : bodies meet themselves; None: those that can, see `rounded`.
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
    for said in physics.bodies:
        if not said.collides and said.path in body:
            mine = body[said.path]
            through |= {(mine, k) for k in range(bodies.count)}
            through_colliders |= {(mine, k) for k in range(len(colliders))}
    made = skins(solid, bodies.of_surface)
    meets: set[int] = set()
    if self_contact is not False:
        passes = {a for a, b in through if a == b}
        meets = {k for k, skin in enumerate(made) if self_contact or not rounded(skin)} - passes
    return ContactSetup(
        skins=made,
        colliders=colliders,
        through=frozenset(through),
        through_colliders=frozenset(through_colliders),
        self_contact=frozenset(meets),
    )


BURIED = 0.02  # of the particles: less is a touch, which contact resolves


def require_clear_start(
    path: Path, particles: Particles, lift: Sequence[float], setup: ContactSetup, unit: float
) -> None:
    """Raise InputError where lifting the bodies puts them into an obstacle.

    particles : of all bodies, where the asset has them; lift : (3,) [m]; unit : [m] of the stage.
    What is in an obstacle in the asset itself stays there.
    """
    way = np.asarray(lift, float)
    if not way.any():
        return
    body = np.zeros(len(particles), np.int64) if particles.body is None else particles.body
    for k, one in enumerate(setup.colliders):
        free = [a for a in range(len(setup.skins)) if (a, k) in setup.through_colliders]
        X = particles.X[~np.isin(body, free)]
        buried = _inside(one, X + way) & ~_inside(one, X)
        if buried.sum() > BURIED * len(X):
            raise InputError(
                f"{path}: moved by {np.linalg.norm(way) / unit:.3g} units to its height over the"
                f" floor, {buried.mean():.0%} of the particles start inside the obstacle"
                f" <{one.path}>",
                "give a --drop that clears it, or --floor none, which leaves everything in place",
            )


def _inside(obstacle: Collider, X: Floats) -> Ints:
    """(n,) which of the points X (n, 3) [m] are in an obstacle at the start."""
    from gf_usd.geometry.winding import winding_inside

    points = obstacle.positions(0)
    if obstacle.shape == "plane":
        a, b, c = points[obstacle.triangles[0]]
        return (X - a) @ np.cross(b - a, c - a) < 0.0
    near = ((points.min(0) <= X) & (points.max(0) >= X)).all(1)
    found = np.zeros(len(X), bool)
    if near.any():
        found[near] = winding_inside(points, obstacle.triangles, X[near])
    return found


CONVEX = 0.9  # of the volume of its convex hull: a body that fills as much of it ...
STOUT = 3.0  # ... and is at most so many times as long as thick cannot be folded onto itself


def rounded(skin: Skin) -> bool:
    """Whether a body is one shell, so nearly convex and so stout that it cannot meet itself."""
    from scipy.spatial import ConvexHull, QhullError

    representative, _ = weld(skin.points)
    used, triangles = np.unique(representative[skin.triangles], return_inverse=True)
    if shells(triangles.reshape(-1, 3)).max(initial=0) > 0:
        return False
    points = skin.points[used]
    center = points - points.mean(0)
    length = np.ptp(center @ np.linalg.svd(center, full_matrices=False)[2].T, axis=0)
    if length.max() > STOUT * length.min():
        return False
    try:
        hull = ConvexHull(points).volume
    except QhullError:  # flat to rounding
        return False
    return signed_volume(skin.points, skin.triangles) >= CONVEX * hull


def file_obstacles(
    files: Sequence[str], facts: StageFacts, limits: Limits | None
) -> tuple[tuple[Collider, ...], tuple[str, ...]]:
    """The surfaces of other files as obstacles that stay, and notes on them.

    facts : of the asset, whose up axis they are turned to.  Raises InputError as `read_asset`, and
    for a file of captured Gaussians alone.
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


def start_velocities(
    asset: Asset,
    bodies: BodyPlan,
    said: dict[str, BodyPhysics],
    time_scale: float,
    particles: Particles,
    *,
    velocity: Triple | None = None,
    spin: Triple | None = None,
) -> list[Any]:
    """The motion of each body at the start: X (n, 3) [m] -> (n, 3) [m/s], or three zeros.

    What is asked for goes before what UsdPhysics states for a body, and that before the animation
    that ends at the start, of which an affine velocity field is fitted, v = a + A X.  time_scale :
    simulated seconds a second of playback.  velocity : [m/s]; spin : [rad/s] about each body's
    center of mass; None: not asked for.
    """
    centers = _centers(particles)
    points = {s.path: np.asarray(s.points, float) for s in asset.surfaces}
    out: list[Any] = []
    for k, paths in enumerate(bodies.surfaces):
        center = np.concatenate([points[p] for p in paths]).mean(0)
        known = [said[p] for p in paths if p in said]
        stated = next((b for b in known if b.velocity or b.angular_velocity), None)
        moving = [(points[p], said[p].moving) for p in paths if p in said]
        # of Points the first are their own, which alone have velocities
        moving = [(x if v is None else x[: len(v)], v) for x, v in moving]
        if velocity or spin:
            own = stated or BodyPhysics(path="")
            own = replace(
                own,
                velocity=velocity or own.velocity,
                angular_velocity=spin or own.angular_velocity,
            )
            out.append(partial(own.initial_velocities, center=centers[k]))
        elif stated is not None:
            out.append(partial(stated.initial_velocities, center=center))
        elif any(v is not None for _, v in moving):
            X = np.concatenate([p for p, v in moving if v is not None])
            v = np.concatenate([v for _, v in moving if v is not None]) / time_scale
            out.append(_affine(X, v))
        else:
            out.append((0.0, 0.0, 0.0))
    return out


def _centers(particles: Particles) -> Floats:
    """(B, 3) [m] the center of volume of each body."""
    of = np.zeros(len(particles), np.int64) if particles.body is None else particles.body
    volume = np.bincount(of, particles.V0)
    return np.stack([np.bincount(of, particles.V0 * x) / volume for x in particles.X.T], axis=1)


@dataclass(frozen=True)
class AffineMotion:
    """X (n, 3) [m] -> v + (X - center) A, (n, 3) [m/s]."""

    center: Floats  # (3,) [m]
    v: Floats  # (3,) [m/s]
    A: Floats  # (3, 3) [1/s]

    def __call__(self, X: Floats) -> Floats:
        return self.v + (X - self.center) @ self.A


def _affine(X: Floats, v: Floats) -> AffineMotion:
    """The least-squares fit of velocities v (n, 3) at X (n, 3)."""
    center = X.mean(0)
    basis = np.hstack([np.ones((len(X), 1)), X - center])
    fit = np.linalg.lstsq(basis, v, rcond=1e-9)[0]
    return AffineMotion(center, fit[0], fit[1:])
