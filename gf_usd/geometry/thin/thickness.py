"""Thickness of a solid, by ray casting from points on its surface.

The thickness at a surface point is the length of the ray along the inward normal to where it leaves
the solid: the thickness of a plate, the diameter of a rod.  (The shape diameter function of
Shapira, Shamir and Cohen-Or 2008 averages a cone of such rays, which underestimates the thickness
near the edges of a box.)  Where the sides meet at a sharp edge, as those of a tetrahedron do, its
length goes to zero towards the edge: see `THICK_EDGE`.  A ray ends where it leaves the union of the
surfaces of its body; `shell_chords` also end where they leave a single shell.  Points are sampled
uniformly by area, so that shares of points are shares of the surface.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import igl
import numpy as np

from gf_usd.core.arrays import Floats, Ints, cross
from gf_usd.core.mesh.measures import areas
from gf_usd.geometry.solid import Bounds, Solid
from gf_usd.geometry.winding import Flags

RAYS = 1000  # a share of 5 % is 50 of them, with a standard deviation of 0.7 %
THIN_SHARE = 0.05  # of the surface area is thinner than `Thickness.thin`
SMALL_SHARE = 0.01  # of the triangles are smaller than the unit of the ray test
# Rays that leave through a face at a larger angle to their first one, 45 degrees, are longer than
# the distance to the edge of the wedge: they measure that distance, and no resolution fills an
# edge.  They count as the median of those of their shell, about the thickness of a triangular rod.
THICK_EDGE = np.cos(np.pi / 4.0)
CLEAR = 1e-4  # of the box's diagonal: offset from a triangle for an unambiguous inside test


@dataclass(frozen=True, kw_only=True)
class Thickness:
    """Quantiles of the thickness of a solid, by surface area."""

    thin: float  # [m] 5 % quantile
    median: float  # [m]

    def across(self, spacing: float) -> float:
        """Number of particles across the thin parts, at a spacing [m]."""
        return self.thin / spacing


def thickness(solid: Solid, bodies: Ints | None = None, rays: int = RAYS) -> Thickness | None:
    """The thickness of a solid; None where no ray leaves it through a surface.

    bodies : (S,) the body of each surface, in which its rays end; None: a single body.
    """
    of = np.zeros(len(solid.surfaces), np.int64) if bodies is None else bodies
    return solid.measured((rays, of.tobytes()), lambda: _quantiles(*inward_rays(solid, of, rays)))


def _quantiles(length: Floats, oblique: Flags, shell: Ints) -> Thickness | None:
    """Of rays: lengths (n,) [m], whether they end at an oblique face, and their shells (n,)."""
    if not len(length):
        return None
    wide = length.copy()
    for k in np.unique(shell[oblique]):
        mine = oblique & (shell == k)
        wide[mine] = np.maximum(length[mine], np.median(length[mine]))
    return Thickness(thin=float(np.quantile(wide, THIN_SHARE)), median=float(np.median(length)))


def inward_rays(solid: Solid, of: Ints, rays: int) -> tuple[Floats, Flags, Ints]:
    """Inward rays from n <= `rays` points on the surfaces of the bodies: (n,) [m] their lengths,
    (n,) whether they end at an oblique face, and (n,) the shells from which they start.

    Points inside another surface of the body, and rays that leave through a hole, are left out.

    of : (S,) the body of each surface, in which its rays end.
    """
    start, normal, face = _spread(*_mesh(solid), rays)
    clear = np.full(rays, CLEAR * float(np.linalg.norm(solid.high - solid.low)))
    body = np.repeat(of, [len(triangles) for triangles in solid.triangles])[face]
    length, slope = np.empty(rays), np.empty(rays)
    for k in np.unique(body):
        part, mine = solid.part(np.flatnonzero(of == k)), body == k
        center = 0.5 * (part.low + part.high)
        length[mine], slope[mine] = _chords(
            *_mesh(part), center, part.inside, start[mine], normal[mine], clear[mine]
        )
    met = np.isfinite(length)
    return length[met], slope[met] < THICK_EDGE, _shells(solid)[face[met]]


def _shells(solid: Solid) -> Ints:
    """(T,) a number for each shell of the surfaces, of each triangle of `_mesh`."""
    labels, count = [], 0
    for surface in solid.surfaces:
        labels.append(count + surface.welded.shell)
        count += 1 + int(surface.welded.shell.max(initial=-1))
    return np.concatenate(labels)


def chords(solid: Solid, start: Floats, normal: Floats, clear: Floats) -> Floats:
    """(n,) [m] lengths of inward rays from points (n, 3) on the surface of the union.

    nan for points inside another surface, and for rays that leave through a hole.

    normal : (n, 3) unit, outward or inward; clear : (n,) [m] offset from the surface for an
        unambiguous inside test.
    """
    center = 0.5 * (solid.low + solid.high)
    return _chords(*_mesh(solid), center, solid.inside, start, normal, clear)[0]


def shell_chords(
    points: Floats, faces: Ints, start: Floats, normal: Floats, clear: Floats
) -> Floats:
    """`chords` of a shell of points (V, 3) [m] and triangles as if there were no other.

    That of a plate on a body is as long as the plate is thick; that of a hollow ball its diameter.
    """
    used, local = np.unique(faces, return_inverse=True)
    points, faces = points[used], np.ascontiguousarray(local.reshape(-1, 3), np.int64)
    center = 0.5 * (points.min(axis=0) + points.max(axis=0))
    return _chords(points, faces, center, Bounds(points, faces).inside, start, normal, clear)[0]


def _chords(
    points: Floats,
    faces: Ints,
    center: Floats,
    contains: Callable[[Floats], Flags],
    start: Floats,
    normal: Floats,
    clear: Floats,
) -> tuple[Floats, Floats]:
    """See `chords`; second: (n,) the cosine of the angle between a ray and the normal of the face
    where it ends, nan where the length is.

    contains : X (n, 3) [m] -> (n,) whether these points are inside.
    """
    points = points - center
    length, slope = np.full((2, len(start)), np.nan)
    start, clear = start - center, clear[:, None]
    ahead, behind = (contains(start + side * clear * normal + center) for side in (1.0, -1.0))
    bounds = ahead != behind
    inward = np.where(ahead[bounds, None], 1.0, -1.0) * normal[bounds]
    clear = clear[bounds]
    start = start[bounds] + clear * inward
    unit = _ray_unit(points, faces)
    scaled = points / unit
    tree = igl.AABB()
    tree.init(scaled, faces)
    hits = [
        sorted((unit * hit[1], hit[0]) for hit in row)
        for row in tree.intersect_ray(scaled, faces, start / unit, inward)
    ]
    ends = np.full((len(hits), 1 + max(map(len, hits), default=0)), np.inf)
    met = np.zeros(ends.shape, np.int64)  # the face of each
    for row, face, found in zip(ends, met, hits):
        row[: len(found)] = [at for at, _ in found]
        face[: len(found)] = [number for _, number in found]
    with np.errstate(invalid="ignore"):  # of two that are not met
        gap = np.diff(ends, axis=1, append=np.inf)
    goes_on = gap <= clear  # two surfaces meet there
    ends_inside = np.isfinite(gap) & ~goes_on
    middle = np.where(ends_inside, ends + 0.5 * np.where(ends_inside, gap, 0.0), 0.0)
    probes = start[:, None, :] + middle[:, :, None] * inward[:, None, :]
    goes_on[ends_inside] = contains(probes[ends_inside] + center)
    last = np.argmin(goes_on, axis=1)
    rows = np.arange(len(ends))
    found = ends[rows, last] + clear[:, 0]
    left = np.isfinite(found)
    length[bounds] = np.where(left, found, np.nan)
    a, b, c = np.moveaxis(points[faces[met[rows, last]]], 1, 0)
    across = cross(b - a, c - a)
    along = np.abs(np.einsum("ij,ij->i", across, inward))
    with np.errstate(invalid="ignore"):  # of those that meet nothing
        slope[bounds] = np.where(left, along / np.linalg.norm(across, axis=1), np.nan)
    return length, slope


def gaps(solid: Solid, start: Floats, normal: Floats, clear: float) -> Floats:
    """(n,) [m] distance from points (n, 3) on the surface to the nearest other surface along either
    direction of the normal; inf: there is none.

    normal : (n, 3) unit; clear : [m] of the surface: hits nearer than that are of its own triangle.
    """
    points, faces = _mesh(solid)
    center = 0.5 * (solid.low + solid.high)
    unit = _ray_unit(points, faces)
    tree = igl.AABB()
    tree.init((points - center) / unit, faces)
    out = np.full(len(start), np.inf)
    for way in (normal, -normal):
        rows = tree.intersect_ray(
            (points - center) / unit, faces, (start + clear * way - center) / unit, way
        )
        hits = [min((unit * hit[1] for hit in row), default=np.inf) for row in rows]
        out = np.minimum(out, np.array(hits) + clear)
    return out


def _ray_unit(points: Floats, faces: Ints) -> float:
    """A length [m] in which triangles are large enough for the ray test of libigl.

    That takes a ray as parallel to a triangle where its direction times the doubled area vector is
    below 1e-6, whatever the unit: it missed all of a ball 2 cm wide with 5,000 triangles.
    """
    twice = 2.0 * areas(points, faces)
    some = twice[twice > 0.0]
    return float(np.sqrt(np.quantile(some, SMALL_SHARE))) if len(some) else 1.0


def _mesh(solid: Solid) -> tuple[Floats, Ints]:
    """Points (V, 3) [m] and triangles of all surfaces."""
    points = np.concatenate([s.points for s in solid.surfaces])
    first = np.cumsum([0, *(len(s.points) for s in solid.surfaces)])
    return points, np.concatenate([t + o for t, o in zip(solid.triangles, first)])


def spread(points: Floats, faces: Ints, count: int) -> tuple[Floats, Floats]:
    """(count, 3) points on triangles, sampled uniformly by area, and their unit normals."""
    X, normal, _ = _spread(points, faces, count)
    return X, normal


def _spread(points: Floats, faces: Ints, count: int) -> tuple[Floats, Floats, Ints]:
    """See `spread`; third: (count,) the triangle of each point."""
    a, b, c = np.moveaxis(points[faces], 1, 0)
    normal = cross(b - a, c - a)
    twice = np.linalg.norm(normal, axis=1)
    rng = np.random.default_rng(0)
    share = (np.arange(count) + rng.random(count)) / count * twice.sum()
    face = np.minimum(np.searchsorted(np.cumsum(twice), share), len(faces) - 1)
    u, v = rng.random((2, count, 1))
    over = u + v > 1.0
    u, v = np.where(over, 1.0 - u, u), np.where(over, 1.0 - v, v)
    X = a[face] + u * (b - a)[face] + v * (c - a)[face]
    return X, normal[face] / twice[face, None], face
