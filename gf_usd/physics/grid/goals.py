"""Goals: positions toward which springs pull the nodes, their stiffness, and distance limits.

A limit D on a distance d is a restoring acceleration that begins at D / 2 and continues beyond D.
With s = (d - D / 2) / (D / 2),

    a = A s^2 / (1 - s)                        0 <= s <= s*
    a = A s*^2 / (1 - s*) + K (d - d*)         beyond, with da/dd = K at s*

A is five times gravity, so that s = 0.36 under the body's weight. K is bounded by the step: with M~
>= m / l, waves of w dt <= 1 and springs of l K dt^2 <= 1 / 2 are stable together, since (w^2 + l K)
dt^2 < 4. s* = 1 - 1 / sqrt(1 + K D / (2 A)).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.materials.dimensionless import G0
from gf_usd.core.stage import AttachedPoints, FleshLimits, Goals

STIFFEST = 1.0  # [1/dt] bound of w: the grid's own highest frequency
DAMPED = 200.0  # [1/dt] bound of c of springs of single points
HARDEST = 0.5  # [1/dt^2] bound of l K
PULL = 5.0 * G0  # [m/s^2] A
BEGIN = 0.5  # fraction of a limit at which its acceleration begins
# Layout of the GOAL values per node: G, dG/dt from RATE on, k and c from SPRING on, and WORK. With
# limits also K, the distances D / 2 from G and toward the bone (0: no limit), the position B given
# by the bone, like G, and the direction N from the bone, each with its rate.
GOAL, RATE, SPRING, WORK = 24, 3, 6, 8
HARD, AWAY, TOWARD, CARRIED, NORMAL = 9, 10, 11, 12, 18


class NodeGoals:
    """The goals of free nodes at X (n, 3) [m].

    dt : [s] the stable step; lightest : l, of M~; attached : springs of single points.
    body : (n,) of each node; None: all are of the first.
    """

    def __init__(
        self,
        goals: Goals,
        X: Floats,
        dt: float,
        lightest: float = 1.0,
        attached: NodeSprings | None = None,
        body: Ints | None = None,
    ) -> None:
        parts = _parts(goals, np.zeros(len(X), np.int64) if body is None else body)
        self._X, self._poses = X, [(rows, one.pose(X[rows])) for one, rows in parts]
        self._stiffest, self._damping = STIFFEST / dt, goals.damping
        self._rates = [(rows, one.rates(X[rows])) for one, rows in parts if one.rates]
        self._rate = _filled(X, [(rows, one.rate(X[rows])) for one, rows in parts])
        self._still = self._of_rate(self._rate)
        self._attached = attached
        self._more = np.zeros((len(X), 2))
        if attached is not None:
            self._more = np.minimum(attached.springs, [(STIFFEST / dt) ** 2, DAMPED / dt])
        self.springs = self._still + self._more  # (n, 2) initial k and c
        self.moving = any(one.moving for one, _ in parts)
        self.moving = self.moving or (attached is not None and attached.moving)
        limits = [(one.limits, rows) for one, rows in parts if one.limits]
        self._limits = _NodeLimits(limits, X, HARDEST / (lightest * dt**2))

    def between(self, index: int, frame_time: float) -> NDArray[np.float64]:
        """(n GOAL,) the kernels' values between frames `index` - 1 and `index`.

        frame_time : [s] between them.
        """
        springs = self._more + self._still
        if self._rates:
            w = self._rate.copy()
            for rows, rates in self._rates:
                w[rows] = rates(index)
            springs = self._more + self._of_rate(w)
        part = self._more[:, 0] / np.maximum(springs[:, 0], np.finfo(float).tiny)
        start, end = (self._way(frame, part) for frame in (index - 1, index))
        out = np.zeros((len(self._X), GOAL))
        out[:, :RATE] = start
        out[:, RATE:SPRING] = (end - start) / frame_time
        out[:, SPRING:WORK] = springs
        self._limits.fill(out, self._X, index, frame_time)
        return out.ravel()

    def _of_rate(self, w: Floats) -> NDArray[np.float64]:
        """(n, 2) k and c of springs of w (n,) [rad/s]."""
        w = np.minimum(w, self._stiffest)
        return np.stack([w**2, 2.0 * self._damping * w], 1)

    def _way(self, frame: int, part: Floats) -> NDArray[np.float64]:
        """(n, 3) [m] displacement of the goal of each node; part (n,) is the fraction of k from
        single points.
        """
        way = _filled(self._X, [(rows, pose(frame)) for rows, pose in self._poses]) - self._X
        if self._attached is None:
            return way
        return way + part[:, None] * (self._attached.way(frame) - way)


def _parts(goals: Goals, body: Ints) -> list[tuple[Goals, Ints]]:
    """Goals, and the nodes (k,) that each applies to; body : (n,) of the nodes."""
    others = np.isin(body, list(goals.of_body))
    found = [(goals, np.flatnonzero(~others))]
    found += [(one, np.flatnonzero(body == number)) for number, one in goals.of_body.items()]
    return [(one, rows) for one, rows in found if len(rows)]


def _filled(X: Floats, parts: Sequence[tuple[Ints, Floats]]) -> NDArray[np.float64]:
    """Values (n, ...) of all nodes X (n, 3) from values of subsets of them."""
    out = np.zeros((len(X), *parts[0][1].shape[1:]) if parts else 0)
    for rows, values in parts:
        out[rows] = values
    return out


class NodeSprings:
    """Springs of single points p, distributed to free nodes i by the interpolation weights.

        k_i = sum_p W_pi k_p / M_i    c_i = sum_p W_pi c_p / M_i
        G_i = sum_p W_pi k_p (y_p - X_p) / (k_i M_i)

    with y_p the target of p. Since sum_i W_pi = 1, the forces on the nodes sum to those on the
    points. Negative weights, beyond the outermost nodes, are omitted.

    W : (p, n) weights of the free nodes; mass : (n,) [kg] of these.
    """

    def __init__(self, attached: AttachedPoints, W: sparse.csr_matrix, mass: Floats) -> None:
        self._attached = attached
        W = sparse.csr_matrix(W.maximum(0.0))
        W = sparse.csr_matrix(sparse.diags_array(1.0 / np.asarray(W.sum(1)).ravel()) @ W)
        share = sparse.csr_matrix(W.T @ sparse.diags_array(attached.stiffness))
        total = np.asarray(share.sum(1)).ravel()
        self._mean = sparse.diags_array(1.0 / np.where(total > 0.0, total, 1.0)) @ share
        self.springs = np.stack([total, W.T @ attached.damping], 1) / mass[:, None]  # (n, 2) k, c
        path = attached.path
        self.moving = bool((path != path[:1]).any() or (path[0] != attached.X).any())

    def way(self, frame: int) -> NDArray[np.float64]:
        """(n, 3) [m] G at a frame; 0 for nodes without a point in their support."""
        path = self._attached.path
        at = path[int(np.clip(frame, 0, len(path) - 1))]
        return np.asarray(self._mean @ (at - self._attached.X))


class _NodeLimits:
    """The values of limits for nodes (k,) that have them; hardest : [1/s^2] K."""

    def __init__(
        self, limits: Sequence[tuple[FleshLimits, Ints]], X: Floats, hardest: float
    ) -> None:
        self._carried = [(rows, one.carried(X[rows])) for one, rows in limits]
        self._hardest = hardest
        self._rooms = np.zeros((len(X), 2))
        for one, rows in limits:
            ways = np.stack([one.away(X[rows]), one.toward(X[rows])], 1)
            self._rooms[rows] = (1.0 - BEGIN) * np.where(np.isfinite(ways), ways, 0.0)

    def fill(self, out: Floats, X: Floats, index: int, frame_time: float) -> None:
        """Write the values to rows (n, GOAL)."""
        if not self._carried:
            return
        out[:, HARD] = self._hardest
        out[:, AWAY : TOWARD + 1] = self._rooms
        for rows, carried in self._carried:
            (start, n0), (end, n1) = carried(index - 1), carried(index)
            out[rows, CARRIED : CARRIED + 3] = start - X[rows]
            out[rows, CARRIED + 3 : NORMAL] = (end - start) / frame_time
            out[rows, NORMAL : NORMAL + 3] = n0
            out[rows, NORMAL + 3 : GOAL] = (n1 - n0) / frame_time


def work_of(numbers: Floats) -> float:
    """[J] work of the goals, from the kernels' values."""
    return float(numbers.reshape(-1, GOAL)[:, WORK].astype(float).sum())
