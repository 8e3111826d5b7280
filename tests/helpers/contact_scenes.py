"""Bodies that meet, made of values: as a plan would hand them to the solver."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import igl
import numpy as np
from solids import preset_material, settings, solid, surface

from gf_usd.core.asset import Surface
from gf_usd.core.frames.frame import Frame
from gf_usd.core.stage import Collider, ContactSetup, PhysicsMaterialSpec, Pin
from gf_usd.geometry.connected.bodies import find_bodies
from gf_usd.geometry.sampling.contact_samples import sample_surface
from gf_usd.geometry.sampling.particles import sample_solid
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.prepare.bodies.contact import skins

FILTER = 10.0 / 0.319  # [1/s] what a bake has for a body of 1 m


def contact_solver(
    *surfaces: Surface,
    particles: int,
    material: str = "rubber",
    velocity: Any = (0.0, 0.0, 0.0),
    colliders: tuple[Collider, ...] = (),
    through: frozenset[tuple[int, int]] = frozenset(),
    through_colliders: frozenset[tuple[int, int]] = frozenset(),
    self_contact: bool = False,
    pins: Sequence[Pin] = (),
    changes: dict[str, Any] | None = None,
    **options: Any,
) -> TotalLagrangian:
    """A solver of surfaces that are bodies of their own where they lie apart.

    changes : fields of the material; options : settings.  Every surface is embedded by its path.
    """
    made = solid(*surfaces)
    of = find_bodies(made, float(np.cbrt(made.volume / particles)))
    filled = sample_solid(made, particles=particles, spacing=None, seed=0, bodies=of)
    return TotalLagrangian(
        filled,
        [preset_material(material, filled, **(changes or {}))],
        settings(**{"filter_rate": FILTER, **options}),
        samples=sample_surface(made, filled.spacing, of),
        embedded={s.path: s.points for s in surfaces},
        embedded_body={s.path: int(k) for s, k in zip(surfaces, of)},
        velocity=velocity,
        pins=pins,
        contact_setup=ContactSetup(
            skins=skins(made, of, filled.spacing),
            colliders=colliders,
            through=through,
            through_colliders=through_colliders,
            self_contact=frozenset(range(len(set(of.tolist())))) if self_contact else frozenset(),
        ),
    )


def obstacle(
    points: Any,
    triangles: Any,
    shape: str = "mesh",
    offset: Any = ((0.0, 0.0, 0.0),),
    friction: float | None = None,
    restitution: float | None = None,
) -> Collider:
    """One that moves by offset (F, 3) [m] at each frame."""
    offset = np.asarray(offset, float)
    return Collider(
        path="/Obstacle",
        shape=shape,
        points=np.asarray(points, float),
        triangles=np.asarray(triangles),
        linear=np.tile(np.eye(3), (len(offset), 1, 1)),
        offset=offset,
        spec=PhysicsMaterialSpec(dynamic_friction=friction, restitution=restitution),
    )


def tilted(points: Any, degrees: float) -> np.ndarray:
    """Points (n, 3) turned about the z axis through the origin."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.asarray(points, float) @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T


def half_space(degrees: float = 0.0, height: float = 0.0, **options: Any) -> Collider:
    """The `plane` collider through the origin, or at a height [m] along its own normal."""
    corners = [[-1, height, -1], [-1, height, 1], [1, height, 1], [1, height, -1]]
    return obstacle(tilted(corners, degrees), [[0, 1, 2], [0, 2, 3]], shape="plane", **options)


def momenta(solver: TotalLagrangian, frame: Frame) -> np.ndarray:
    """(B, 3) [kg m/s] of every body."""
    body = solver.particles.body
    assert body is not None
    return np.stack(
        [np.bincount(body, solver.body.m * frame.particles.v[:, a]) for a in range(3)], 1
    )


def depth(frame: Frame, one: Surface, other: Surface) -> float:
    """[m] of the deepest vertex of a deformed mesh in the other; 0 where none is inside.

    By the winding number and the distance to the triangles, neither of which the solver uses.
    """
    deepest = 0.0
    for a, b in ((one, other), (other, one)):
        X, points = (np.ascontiguousarray(frame.embedded[s.path].x) for s in (a, b))
        triangles = np.ascontiguousarray(b.triangles, dtype=np.int64)
        inside = np.abs(np.asarray(igl.fast_winding_number(points, triangles, X))) > 0.5
        squared = igl.point_mesh_squared_distance(X, points, triangles)[0]
        deepest = max(deepest, float(np.sqrt(np.asarray(squared)[inside]).max(initial=0.0)))
    return deepest


def bricks(filled: np.ndarray, edge: float, **more: Any) -> Surface:
    """The boundary of cubes of an edge [m] where filled (i, j, k) is true; faces look outward."""
    padded = np.pad(filled, 1)
    corners, quads = {}, []
    for cell in np.argwhere(padded):
        for axis in range(3):
            for side in (0, 1):
                step = np.eye(3, dtype=int)[axis]
                if padded[tuple(cell + (2 * side - 1) * step)]:
                    continue
                one, two = np.roll(step, 1), np.roll(step, 2)
                if side == 0:
                    one, two = two, one
                start = cell + side * step
                square = (start, start + one, start + one + two, start + two)
                quads.append([corners.setdefault(tuple(c), len(corners)) for c in square])
    q = np.array(quads)
    points = (np.array(list(corners)) - 1) * edge
    return surface(points, np.concatenate([q[:, [0, 1, 2]], q[:, [0, 2, 3]]]), **more)
