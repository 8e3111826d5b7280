"""Obstacles whose winding is reversed with respect to the bodies.

Contact takes the front of an obstacle's faces for its outside.  A closed mesh whose faces point
inward is a room where a body is in it, and an error of modeling where none is: bodies would be
drawn in and crushed between its two walls.  Bodies pass an open surface from behind.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gf_usd.core.arrays import Floats, Ints, cross, row_dots
from gf_usd.core.frames.particles import Particles
from gf_usd.core.mesh.measures import areas, signed_volume
from gf_usd.core.mesh.topology import boundary_edges, weld
from gf_usd.core.stage import Collider, ContactSetup

FLAT = 1e-4  # share of (area)^(3/2) below which a volume counts as 0: no inside
IN_IT = 0.5  # of the particles of a body, from where it is in an obstacle and not in its wall


def turned_to_bodies(
    setup: ContactSetup, particles: Particles, lift: Sequence[float]
) -> tuple[ContactSetup, tuple[str, ...]]:
    """The contacts with such obstacles turned, and notes on them.

    particles : of all bodies, at their position in the asset; lift : (3,) [m].
    """
    X, body = particles.X + np.asarray(lift, float), particles.body_of
    colliders, notes = list(setup.colliders), []
    for k, one in enumerate(colliders):
        met = [
            X[body == a] for a in range(len(setup.skins)) if (a, k) not in setup.through_colliders
        ]
        if one.shape == "plane" or not met:
            continue
        points = one.positions(0)
        welded = weld(points)[0][one.triangles]
        if len(boundary_edges(welded)):
            if _behind(points, one.triangles, np.array([mine.mean(0) for mine in met])):
                notes.append(
                    f"the obstacle <{one.path}> is an open surface whose faces point away from all"
                    " bodies: they are reversed, because bodies pass through such a surface from"
                    " behind"
                )
                colliders[k] = _reversed(one)
        elif _inward(points, one.triangles) and not any(
            _share_in(points, one.triangles, mine) > IN_IT for mine in met
        ):
            notes.append(
                f"the faces of the obstacle <{one.path}> point inward, and no body is in it: they"
                " are reversed"
            )
            colliders[k] = _reversed(one)
    return replace(setup, colliders=tuple(colliders)), tuple(notes)


def _reversed(one: Collider) -> Collider:
    return replace(one, triangles=np.ascontiguousarray(one.triangles[:, ::-1]))


def _inward(points: Floats, triangles: Ints) -> bool:
    """Whether the faces of a closed mesh point inward."""
    return signed_volume(points, triangles) < -FLAT * areas(points, triangles).sum() ** 1.5


def _share_in(points: Floats, triangles: Ints, X: Floats) -> float:
    """Fraction of points X (n, 3) [m] that a closed mesh encloses, whatever its winding."""
    from gf_usd.geometry.winding import winding_inside

    near = ((points.min(0) <= X) & (points.max(0) >= X)).all(1)
    if not near.any():
        return 0.0
    return float(winding_inside(points, triangles, X[near]).sum() / len(X))


def _behind(points: Floats, triangles: Ints, X: Floats) -> bool:
    """Whether all points X (n, 3) [m] are behind an open surface: by its nearest triangle, and by
    the solid angle under which they see its back rather than its front."""
    import igl  # takes long to import: see `core.neighbors`

    from gf_usd.geometry.winding import winding_numbers

    if (winding_numbers(points, triangles, X) <= 0.0).any():
        return False
    center = points.mean(0)
    _, at, nearest = igl.point_mesh_squared_distance(X - center, points - center, triangles)
    a, b, c = np.moveaxis(points[triangles[np.atleast_1d(at)]], 1, 0)
    away = X - center - nearest.reshape(-1, 3)
    return bool((row_dots(cross(b - a, c - a), away) < 0.0).all())
