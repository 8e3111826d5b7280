"""Possible contacts of the bodies of a bake: with each other, with obstacles, with themselves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gf_usd.core.arrays import Floats, Ints, cross
from gf_usd.core.asset import StageFacts
from gf_usd.core.errors import InputError, counted
from gf_usd.core.frames.particles import Particles, SurfaceSamples
from gf_usd.core.mesh.subdivision import with_short_edges
from gf_usd.core.stage import Collider, ContactSetup, Skin, StagePhysics
from gf_usd.core.units import length_text
from gf_usd.prepare.bodies.convexity import cannot_touch_itself
from gf_usd.prepare.bodies.plan import BodyPlan
from gf_usd.readers.usd_physics.obstacle_files import read_obstacle_file

if TYPE_CHECKING:
    from gf_usd.geometry.solid import Solid
    from gf_usd.system.sandbox import Limits

MOST_NAMED = 3  # bodies in one obstacle that each have a note


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
    notes = []
    if limbs.crowded:
        notes.append(
            f"in {counted(limbs.crowded, 'grid cell')} surfaces are too close together to be"
            " separated: parts in them move together"
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
    """The surface of each body, facing outward, with edges of at most LONGEST spacings [m], and
    with the caps of its holes; of none without a spacing.
    """
    from gf_usd.geometry.sampling.holes import capped

    out = []
    for body in range(int(of.max()) + 1):
        points, triangles, first = [], [], 0
        members = np.flatnonzero(of == body)
        for s in members.tolist():
            p, t = capped(solid, s, members, spacing)
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
            k
            for k, skin in enumerate(made)
            if self_contact or not cannot_touch_itself(skin, _shell(solid, bodies, k, skin))
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


def _shell(solid: Solid, bodies: BodyPlan, body: int, skin: Skin) -> Ints | None:
    """(T,) shell of each triangle of a skin that is one whole surface; None: it is not."""
    mine = np.flatnonzero(bodies.of_surface == body)
    welded = solid.surfaces[mine[0]].welded
    whole = len(mine) == 1 and len(skin.triangles) == len(welded.triangles)
    return welded.shell if whole else None


BURIED = 0.02  # of the particles: less is a touch, which contact resolves


def require_clear_start(
    path: Path, particles: Particles, lift: Sequence[float], setup: ContactSetup, unit: float
) -> None:
    """Raise InputError where lifting the bodies moves them into an obstacle.

    particles : of all bodies, at their position in the asset; lift : (3,) [m]; unit : [m] of the
        stage.  Particles that are inside an obstacle in the asset itself are allowed.
    """
    way = np.asarray(lift, float)
    away = float(np.linalg.norm(way))
    if not away:
        return
    body = particles.body_of
    for k, one in enumerate(setup.colliders):
        free = [a for a in range(len(setup.skins)) if (a, k) in setup.through_colliders]
        X = particles.X[~np.isin(body, free)]
        buried = _inside(one, X + way) & ~_inside(one, X)
        if buried.sum() > BURIED * len(X):
            raise InputError(
                f"{path}: moved by {length_text(away)} ({away / unit:.3g} stage units) to its"
                f" height over the floor, {buried.mean():.0%} of the particles start inside the"
                f" obstacle <{one.path}>",
                "use a --drop that clears it, or --floor none, which does not move the body",
            )


def penetration_notes(
    particles: Particles,
    lift: Sequence[float],
    setup: ContactSetup,
    bodies: BodyPlan,
    free: tuple[Floats, float] | None = None,
) -> tuple[str, ...]:
    """Notes on bodies that have particles in an obstacle at the start.

    Of more than `MOST_NAMED` bodies in one obstacle only the first is named.

    free : direction up (3,) and unit [m] of the stage, where --drop lifts all bodies by its value:
        without a floor and pins.
    """
    body, X = particles.body_of, particles.X + np.asarray(lift, float)
    whole = np.bincount(body, minlength=bodies.count)
    notes = []
    for k, one in enumerate(setup.colliders):
        count = np.bincount(body[_inside(one, X)], minlength=bodies.count)
        met = [a for a in range(bodies.count) if count[a] and (a, k) not in setup.through_colliders]
        if not met:
            continue
        ways = ["move them apart in the asset"]
        if one.shape != "plane" and (count[met] == whole[met]).all():
            ways.append("reverse the faces of the obstacle if it is a room around the body")
        elif free is not None and (drop := _drop_above(one, particles, *free)) is not None:
            ways.append(f"use --drop {drop:.3g} to start above it")
        way = ", or ".join(ways)
        names = [
            f"<{bodies.surfaces[a][0]}> starts with {count[a]} of {whole[a]} particles" for a in met
        ]
        keeps = f"inside the obstacle <{one.path}> and keeps this overlap until it moves away"
        if len(met) > MOST_NAMED:
            more = len(met) - 1
            notes.append(f"{names[0]} {keeps}, and so do {more} more bodies; {way}")
        else:
            notes += [f"{name} {keeps}; {way}" for name in names]
    return tuple(notes)


def _drop_above(obstacle: Collider, particles: Particles, up: Floats, unit: float) -> float | None:
    """The --drop, in stage units, that lifts all particles above an obstacle; None: none does."""
    points = obstacle.positions(0)
    if obstacle.shape == "plane":
        a, b, c = points[obstacle.triangles[0]]
        normal = cross(b - a, c - a)
        steep = float(normal @ up)
        if steep <= 0.0:
            return None
        over = float(((a - particles.X) @ normal).max()) / steep
    else:
        over = float((points @ up).max() - (particles.X @ up).min())
    drop = (over + particles.spacing) / unit
    step = 10.0 ** (np.floor(np.log10(drop)) - 1.0)  # two digits, rounded up
    return float(np.ceil(drop / step) * step)


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


def file_obstacles(
    files: Sequence[str], facts: StageFacts, limits: Limits | None
) -> tuple[tuple[Collider, ...], tuple[str, ...]]:
    """The surfaces of other files as static obstacles, and notes on them.

    facts : of the asset, to whose up axis they are rotated.
    Raises InputError as `read_obstacle_file`.
    """
    made: list[Collider] = []
    notes: list[str] = []
    for path in map(Path, files):
        read = read_obstacle_file(path, facts.up_axis, limits)
        made += [
            Collider(
                path=f"{path.name}:{s.path}", shape="mesh", points=read.points(s),
                triangles=s.triangles, linear=np.eye(3)[None], offset=np.zeros((1, 3)),
            )
            for s in read.surfaces
        ]  # fmt: skip
        still = ", as at its first frame" if read.animated else ""
        assumed = " and ".join(read.assumed)
        if assumed:
            assumed = f", with {assumed} assumed (a USD file states them)"
        turned = f", turned from {read.turned_from} up" if read.turned_from else ""
        notes.append(
            f"{path.name}: {counted(len(read.surfaces), 'obstacle')}{assumed}{turned}{still}; the"
            " result does not contain the file"
        )
    return tuple(made), tuple(notes)
