"""Whether a body is so nearly convex and compact that it cannot touch itself.

The volume of the convex hull is bounded from above and from below before the hull is computed, by
Qhull: that takes 8 s for a ball of 1.3 million triangles, and its bounds 0.3 s (measured).
"""

from __future__ import annotations

import numpy as np

from gf_usd.core.arrays import Floats, Ints, cross, row_dots
from gf_usd.core.mesh.measures import signed_volume
from gf_usd.core.mesh.topology import shells, used_points, weld
from gf_usd.core.stage import Skin

CONVEX = 0.9  # of the volume of its convex hull: a body that fills as much of it ...
STOUT = 3.0  # ... and is at most so many times as long as thick cannot be folded onto itself

ROWS = 256  # triangles whose products with all points are worked out at a time
SIDE = 6  # parts of an octahedron's edges: 146 directions, which hold 0.98 of a ball
MANY = 1 << 25  # triangles times points, from where a hull is found sooner than its bound


def cannot_touch_itself(skin: Skin, shell: Ints | None = None) -> bool:
    """Whether a body is one shell, nearly convex and so compact that it cannot touch itself.

    shell : (T,) see `shells`, of a skin whose triangles are welded; None: they are not.
    """
    welded = skin.triangles if shell is not None else weld(skin.points)[0][skin.triangles]
    if (shells(welded) if shell is None else shell).max(initial=0) > 0:
        return False
    used, triangles = used_points(welded)
    points = skin.points[used]
    center = points - points.mean(0)
    length = np.ptp(center @ np.linalg.svd(center, full_matrices=False)[2].T, axis=0)
    if length.max() > STOUT * length.min():
        return False
    volume = signed_volume(skin.points, skin.triangles)
    if len(points) * len(triangles) < MANY and volume >= CONVEX * star_hull_upper_bound(
        points, triangles
    ):
        return True
    supports = SupportPoints(points)
    if volume < CONVEX * supports.hull_lower_bound():
        return False
    from scipy.spatial import ConvexHull, QhullError  # takes longer to import than all of this

    try:
        if volume >= CONVEX * supports.hull_upper_bound():
            return True
        hull = ConvexHull(points).volume
    except QhullError:  # flat to rounding
        return False
    return volume >= CONVEX * hull


class SupportPoints:
    """The points of a body that are farthest along directions on all sides, from the center of its
    bounding box.

    points : (V, 3) [m]; of those kept, from that center, one for each direction.
    """

    def __init__(self, points: Floats) -> None:
        self._directions, self._triangles = _octahedron(SIDE)
        X = points - 0.5 * (points.min(0) + points.max(0))
        # One direction at a time: all products at once take a gigabyte for a million points.
        self.points = X[[int((X @ way).argmax()) for way in self._directions]]

    def hull_lower_bound(self) -> float:
        """[m^3] lower bound of the volume of the convex hull; 0 where there is none.

        The support points, connected as the directions are, form a surface within the hull.  Seen
        from the center c of the bounding box, this surface covers all directions once if its solid
        angles O_i sum to 4 pi, or k + 1 times where k triangles face inward.  With V_i the signed
        volumes of the cones over its triangles, and R the distance from c to the farthest point,

            V >= sum_i V_i - 1/3 R^3 sum_{O_i < 0} |O_i|

        The solid angle is that of van Oosterom and Strackee (1983).
        """
        corners = self.points[self._triangles]
        a, b, c = np.moveaxis(corners, 1, 0)
        la, lb, lc = np.moveaxis(np.linalg.norm(corners, axis=2), 1, 0)
        cone = row_dots(cross(a, b), c)  # 6 V_i
        below = la * lb * lc + row_dots(a, b) * lc + row_dots(b, c) * la + row_dots(c, a) * lb
        angle = 2.0 * np.arctan2(cone, below)
        if abs(angle.sum() - 4.0 * np.pi) > 1e-6:
            return 0.0
        farthest = max(la.max(), lb.max(), lc.max())
        return max(0.0, float(cone.sum() / 6.0 + np.minimum(angle, 0.0).sum() * farthest**3 / 3.0))

    def hull_upper_bound(self) -> float:
        """[m^3] upper bound of the volume of the convex hull: that of the polytope
        {x: d_i . x <= h_i} of the directions d_i, with h_i = d_i . p_i of their support points p_i;
        inf where the center is not within it.

        Raises scipy.spatial.QhullError where the points are flat to rounding.
        """
        from scipy.spatial import ConvexHull, HalfspaceIntersection

        height = row_dots(self.points, self._directions)
        if (height <= 0.0).any():
            return np.inf
        planes = np.column_stack([self._directions, -height])
        return float(ConvexHull(HalfspaceIntersection(planes, np.zeros(3)).intersections).volume)


def star_hull_upper_bound(points: Floats, triangles: Ints) -> float:
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
