"""Caps over the holes of the meshes that a solid is filled with: there contact acts on the filling.

A mesh with holes is filled up to where its winding number falls below one half (`solid`), which in
a planar hole is the plane of its rim: a point of that plane sees the hole over half of all
directions.  Without a cap nothing but the rim would rest on the floor, and the filling would flow
out below it.  Other holes have a cap where it is near the boundary of the filling.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints, cross
from gf_usd.core.mesh.triangulation import triangulate
from gf_usd.geometry.solid import Solid
from gf_usd.geometry.winding import fan_area

SMALLEST = 1.0  # [spacings^2] area of a cap: contact samples on the rim cover smaller holes
NEAR = 0.5  # [spacings] between a cap and the boundary of the filling
MOST_OF_IT = 0.5  # of the area of a cap, which is as near
# Barycentric coordinates of the places on a triangle where this is tested.
TESTED = np.array([[1, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4]]) / np.array([[3], [6], [6], [6]])


def capped(solid: Solid, index: int, members: Ints, spacing: float) -> tuple[Floats, Ints]:
    """Points (V, 3) [m] and triangles of a surface as `Solid.outward`, with caps over its holes.

    members : the surfaces of its body; spacing : [m] of the particles.  The caps have no points of
    their own.
    """
    points, triangles = solid.outward(index)
    rings = solid.rings(index)
    rings = [ring for ring in rings if fan_area(points[ring]) >= SMALLEST * spacing**2]
    if not rings:
        return points, triangles
    if solid.orientation(index) < 0.0:
        rings = [ring[::-1] for ring in rings]
    caps = _caps(solid, points, rings, members, spacing)
    return points, np.concatenate([triangles, caps])


def _caps(
    solid: Solid, points: Floats, rings: Sequence[Ints], members: Ints, spacing: float
) -> NDArray[np.int64]:
    """(C, 3) the triangles of the caps, which face outward."""
    counts = np.array([len(ring) for ring in rings])
    faces, _, hole = triangulate(points, counts, np.concatenate(rings))
    a, b, c = np.moveaxis(points[faces], 1, 0)
    normal = cross(b - a, c - a)
    size = np.linalg.norm(normal, axis=1)
    kept = size > 0.0
    faces, hole, normal, size = faces[kept], hole[kept], normal[kept], size[kept]
    places = np.einsum("pk,tka->tpa", TESTED, points[faces]).reshape(-1, 3)
    aside = np.repeat(NEAR * spacing * normal / size[:, None], len(TESTED), axis=0)
    body = solid.part(members)
    bounds = body.inside(places - aside) & ~body.inside(places + aside)
    near = bounds.reshape(len(faces), -1).mean(1)
    area, good = (np.bincount(hole, w, len(rings)) for w in (size, size * near))
    return faces[(good > MOST_OF_IT * area)[hole]]
