"""Polygons to triangles: quads along a diagonal, larger ones as fans or ear by ear."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints, cross


def triangulate(
    points: Floats, counts: Ints, indices: Ints
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Polygons to triangles of the same winding, in the order of the faces.

    A quad is cut along its shorter diagonal that leaves two upright triangles; a larger polygon is
    a fan where that is valid, and cut ear by ear where it is not (concave, or corners in line).
    Faces with fewer than three corners give nothing.

    Parameters
    ----------
    points : (V, 3).   counts : (P,) corners of each face.   indices : (sum of counts,) into points.

    Returns
    -------
    triangles (T, 3) into points, corners (T, 3) into indices, faces (T,) into counts.
    """
    points = np.asarray(points, dtype=np.float64)
    counts = np.asarray(counts, dtype=np.int64)
    indices = np.asarray(indices, dtype=np.int64)
    starts = np.cumsum(counts) - counts
    corners, faces = [np.zeros((0, 3), dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
    for n in np.unique(counts[counts >= 3]):
        group = np.flatnonzero(counts == n)
        rings = starts[group][:, None] + np.arange(n)
        cut = rings if n == 3 else _cut(points[indices[rings]], rings)
        corners.append(cut.reshape(-1, 3))
        faces.append(np.repeat(group, n - 2))
    corner, face = np.concatenate(corners), np.concatenate(faces)
    order = np.argsort(face, kind="stable")
    return indices[corner[order]], corner[order], face[order]


def _cut(polygons: Floats, rings: NDArray[np.int64]) -> NDArray[np.int64]:
    """(m, n - 2, 3) elements of `rings` (m, n) that triangulate `polygons` (m, n, 3)."""
    n = rings.shape[1]
    fan = np.stack([np.zeros(n - 2, dtype=np.int64), np.arange(1, n - 1), np.arange(2, n)], axis=1)
    local = polygons - polygons.mean(axis=1, keepdims=True)
    normal = cross(local, np.roll(local, -1, axis=1)).sum(axis=1)  # Newell: twice the area
    size = np.einsum("mi,mi->m", normal, normal)

    def worst(pattern: Ints) -> Floats:
        """(m,) smallest signed area of the pattern's triangles over the polygon's area."""
        a, b, c = np.moveaxis(local[:, pattern], 2, 0)
        area = np.einsum("mti,mi->mt", cross(b - a, c - a), normal)
        return area.min(axis=1) / np.where(size > 0.0, size, 1.0)

    # Relative to the polygon: below this a triangle is a line.
    flat = 1e-9
    fan_worst = worst(fan)
    cut = rings[:, fan]
    if n == 4:
        other = np.array([[0, 1, 3], [1, 2, 3]])
        other_worst = worst(other)
        length = np.linalg.norm(local[:, [0, 1]] - local[:, [2, 3]], axis=2)
        shorter = length[:, 1] < (1.0 - 1e-6) * length[:, 0]
        swap = np.where(fan_worst > flat, shorter & (other_worst > flat), other_worst > fan_worst)
        cut[swap] = rings[swap][:, other]
        return cut
    for row in np.flatnonzero((fan_worst <= flat) & (size > 0.0)):
        cut[row] = rings[row][_ears(local[row], normal[row])]
    return cut


def _ears(ring: Floats, normal: Floats) -> NDArray[np.int64]:
    """(n - 2, 3) corners of a simple polygon (n, 3), cut off ear by ear, shortest cut first.

    A polygon that crosses itself has no triangulation; what is left when no ear remains is a fan.
    """
    axis = int(np.argmax(np.abs(normal)))
    flat = np.delete(ring, axis, axis=1) * ([1.0, 1.0] if axis != 1 else [-1.0, 1.0])
    flat = flat * ([1.0, 1.0] if normal[axis] > 0 else [-1.0, 1.0])
    tiny = 1e-12 * float(np.ptp(flat, axis=0).max()) ** 2
    left, ears = np.arange(len(ring)), []
    while len(left) > 3 and (k := _next_ear(flat[left], tiny)) is not None:
        ears.append((left[k - 1], left[k], left[(k + 1) % len(left)]))
        left = np.delete(left, k)
    ears.extend((left[0], left[i], left[i + 1]) for i in range(1, len(left) - 1))
    return np.array(ears, dtype=np.int64)


def _next_ear(ring: Floats, tiny: float) -> int | None:
    """The corner of a plane polygon (n, 2) to cut off next; None where there is no ear."""
    before, after = np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0)
    reach = np.linalg.norm(after - before, axis=1)
    upright = _cross2(ring - before, after - ring) > tiny
    for k in np.argsort(reach, kind="stable"):
        if upright[k] and not _covers(before[k], ring[k], after[k], ring):
            return int(k)
    return None


def _covers(a: Floats, b: Floats, c: Floats, others: Floats) -> bool:
    """True where the triangle covers one of `others` (n, 2), its own corners' places aside."""
    inside = (_cross2(b - a, others - a) >= 0.0) & (_cross2(c - b, others - b) >= 0.0)
    inside &= _cross2(a - c, others - c) >= 0.0
    for corner in (a, b, c):
        inside &= np.any(others != corner, axis=1)
    return bool(inside.any())


def _cross2(u: Floats, v: Floats) -> Floats:
    """(...,) z of the cross product of plane vectors."""
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
