"""The surface of a body as others meet it: its own triangles, where they are now."""

from __future__ import annotations

import numpy as np

from gf_usd.encounters import Skin
from gf_usd.model import Floats, Ints
from gf_usd.nearby import kd_tree
from gf_usd.physics.distance import Closest, closest, outside_where_unwound
from gf_usd.physics.stencil import Rows

SLACK = 2.0  # a triangle may have grown by as much since it was at rest


class BodySkin:
    """One body's surface.

    skin : at rest; rows : of its points on the grid; samples : (n,) indices of the body's contact
    samples; X : (n, 3) [m] of those at rest.
    """

    def __init__(self, skin: Skin, rows: Rows, samples: Ints, X: Floats) -> None:
        self.skin, self.samples = skin, samples
        self._W = rows.W
        self._tree = kd_tree(X)
        corners = skin.points[skin.triangles]
        centre = corners.mean(1)
        gap, self._cover = self._tree.query(centre)
        reach = np.linalg.norm(corners - centre[:, None], axis=2).max(1)
        self._reach = SLACK * (gap + reach)

    def near(
        self, X: Floats, known: Floats, x: Floats, u: Floats, offset: Floats, reach: float
    ) -> tuple[Closest, Ints]:
        """The surface as points X (m, 3) [m] see it, and the sample nearest to each place seen.

        known : (m,) [m] <= 0, from where on a signed distance is believed; what seems deeper is
        asked of the whole surface.  x : (n, 3) [m] of the body's samples now; u : (nodes, 3) [m]
        as `Rows` stack them, without offset (3,) [m].
        """
        bound = reach + float(self._reach.max())
        gap = kd_tree(X).query(x, distance_upper_bound=bound)[0]
        triangles = self.skin.triangles[gap[self._cover] < reach + self._reach]
        used, local = np.unique(triangles, return_inverse=True)
        points = self.skin.points[used] + offset + self._W[used] @ u
        local = local.reshape(-1, 3)
        if len(local) == 0:
            local = np.zeros((0, 3), np.int64)
        seen = closest(X, points, local, reach)
        doubtful = np.flatnonzero(seen.gap < known[seen.rows])
        if len(doubtful):
            whole = self.skin.points + offset + self._W @ u
            seen = outside_where_unwound(seen, doubtful, X, whole, self.skin.triangles)
        rest = np.einsum("nk,nka->na", seen.weights, self.skin.points[used][local[seen.triangle]])
        _, nearest = self._tree.query(rest) if len(rest) else (None, np.zeros(0, np.int64))
        return seen, self.samples[nearest]
