"""Pins: nodes with a prescribed displacement, and the motion of pinned regions.

A pin is a region of the rest body with a motion g(X, t). Nodes inside it are no unknowns. A node
deep inside follows the motion, u_l = g(X_l). A node in the support of particles outside is on the
line through the boundary value and the field across it, like a ghost node of finite differences:
with b the nearest point of the boundary, n the unit normal there into the body, and the node at
distance s behind it, X_l = b - s n,

    u_l - g(X_l) = e (u - g)(X'_l),     X'_l = b + D n,   e = -s / D,   D = max(s, h - s)

so that u = g on the boundary to second order in h, and uniform strain is exact up to the boundary.
(u_l = g alone would clamp the body up to half a cell away from the boundary.) A node of the body
within NEAR of the boundary is prescribed likewise, with s < 0 and D = h - s; where the field at X'
depends on such nodes, D is 2 h - s. With D = s alone, a hanging bar of 10 cells sags by 3.7 times
the exact value where nodes are on the boundary, and by .88 where they are just behind it; with
these rules the error is .7 to 1 % for any position of the nodes.

A pin that is not `sharp`, such as a bone's core, has no mirrored nodes: all nodes inside it follow
the motion, and the particles there keep their mass and stress.

A node outside of a pin in the support of pinned particles only (`fully_prescribed`) acts on no free
particle, and follows the motion as a deep one does.

Both kinds are rows like those of light nodes, u_l = sum_j e_lj u_j + c_l(t), and forces are
distributed by the transpose. Particles inside a pin move as prescribed and carry no stress.

A pin may fix some axes and let the others slide, like a symmetry plane: the field is continued
across the boundary, odd in pinned and even in free components, with D = s,

    u_la = +u_a(X'_l)  for a free axis a

and beyond the range of mirrored nodes by an affine fit. The row of such a node is that of a pinned
one times a factor per axis: 1 pinned, -1 free; 0 pinned and deep. Where pins of different axes
overlap, like the planes of a quarter model, a node has the pinned axes of all, mirrored at one
boundary after another.

The motion of a pinned region is interpolated from its anchors, points with a given position at
every frame. Any other point of the region moves by the affine least squares fit of the anchors,
with weights w_j that decrease with distance,

    x(X) = xbar + A (X - Xbar),    A = argmin sum_j w_j |A (X_j - Xbar) - (x_j - xbar)|^2

or by the nearest rotation (Kabsch 1976) where the anchors are nearly coplanar, since they do not
determine the stretch across their plane.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.errors import InputError
from gf_usd.core.frames.differences import velocity_at
from gf_usd.core.frames.frame import Pose
from gf_usd.core.matrices import signed_polar
from gf_usd.core.neighbors import kd_tree
from gf_usd.core.stage import Pin

# The soft material begins 0.21 cells before the last pinned node, and the last node inside a region
# is half a cell from its boundary on average, so that nodes up to 0.71 cells outside are included:
# this is the fraction of such a node's mass beyond a plane, (1.5 - 0.71)^3 / 6.
OWNED = 0.082
REACH = 2.0  # [cells] ghost nodes lie no deeper: the stencil of a particle outside ends at 1.5
NEAR = 0.45  # [cells] below one half, where a row of nodes is equally near across the boundary
ALIKE = 1e-6  # tolerance for nodes that are equally near to a small patch
HANGS = 0.01  # weight of a row on prescribed nodes above which X' moves farther inward


@dataclass(frozen=True, kw_only=True)
class PinnedPoints:
    """The pin of each axis of a set of points."""

    axes: Ints  # (n, 3) index of the pin of each axis; -1: free

    @cached_property
    def pin(self) -> Ints:
        """(n,) the first pin of a point along any axis; -1: free."""
        first = np.where(self.free, np.iinfo(self.axes.dtype).max, self.axes).min(1)
        return np.where(self.free.all(1), -1, first)

    @property
    def any(self) -> bool:
        """Whether a point is pinned."""
        return bool((self.axes >= 0).any())

    @property
    def free(self) -> NDArray[np.bool_]:
        """(n, 3) axes without a pin."""
        return np.asarray(self.axes < 0)

    @property
    def slide(self) -> NDArray[np.bool_]:
        """(n,) whether a point is pinned along some axes only."""
        return np.asarray(self.free.any(1) & ~self.free.all(1))

    def at(self, rows: Any) -> PinnedPoints:
        """A subset of the points."""
        return PinnedPoints(axes=self.axes[rows])


def pinned_by(pins: Sequence[Pin], X: Floats, body: Ints | None = None) -> PinnedPoints:
    """The first pin that contains each point X (n, 3) [m], and later ones of other axes.

    body : (n,) of each point; None: all are of the first.
    """
    body = np.zeros(len(X), np.int64) if body is None else body
    out = np.full((len(X), 3), -1)
    for index, pin in enumerate(pins):
        if pin.rigid:  # its nodes are chosen by mass: see `rigid`
            continue
        axes = np.asarray(pin.axes, bool)
        mine = True if pin.body is None else body == pin.body
        free = np.flatnonzero((out[:, axes] < 0).all(1) & mine)
        inside = free[np.asarray(pin.inside(X[free]), bool)]
        out[np.ix_(inside, axes)] = index
    return PinnedPoints(axes=out)


def region_of_nodes(
    of_region: Sequence[Floats], mass: Floats, held: Ints, numbers: Sequence[int]
) -> Ints:
    """(M,) pin of the rigid region that each node belongs to; -1: none.

    of_region : (M,) [kg] mass per node of each region's particles; mass : (M,) [kg] of all
    particles.
    held : (M,) whether a node is pinned already; numbers : of the regions' pins.
    """
    out = np.full(len(mass), -1)
    best = OWNED * mass
    for number, mine in zip(numbers, of_region):
        more = (mine > best) & ~held
        out[more], best[more] = number, np.maximum(mine, best)[more]
    return out


def boundary_held(pins: Sequence[Pin], X: Floats, body: Ints | None = None) -> PinnedPoints:
    """`pinned_by` for pins with prescribed boundaries, inside of which nothing is simulated."""
    axes = pinned_by(pins, X, body).axes
    cores = [index for index, pin in enumerate(pins) if not pin.sharp]
    return PinnedPoints(axes=np.where(np.isin(axes, cores), -1, axes))


def surface_held(pins: Sequence[Pin], X: Floats, body: Ints | None = None) -> PinnedPoints:
    """`boundary_held` with the points on the boundary of a pin, such as those of its own mesh.

    Whether the winding number counts them as inside is a matter of rounding.  u = g there.
    """
    axes = boundary_held(pins, X, body).axes.copy()
    of = np.zeros(len(X), np.int64) if body is None else body
    for index, pin in enumerate(pins):
        if not _holds(pin):
            continue
        mine = True if pin.body is None else of == pin.body
        rows = np.flatnonzero((axes < 0).all(1) & mine)
        away = np.linalg.norm(pin.nearest(X[rows]) - X[rows], axis=1)
        reach = SAME * float(np.linalg.norm(np.ptp(pin.anchors, axis=0)))
        axes[rows[away <= reach]] = index
    return PinnedPoints(axes=axes)


Given = Callable[[Ints, Floats], NDArray[np.float64]]  # of nodes by number, and X' [m] of each


def prescribed_nearby(
    pins: Sequence[Pin], held: PinnedPoints, X: Floats, h: float, body: Ints | None = None
) -> PinnedPoints:
    """Pins of nodes X (n, 3) [m], with those of the body within NEAR of a pinned boundary.

    body : (n,) of each node; None: all are of the first.

    A pin that contains no node pins none nearby, except for a patch, which may be smaller than
    a cell: it pins the nearest ones.
    """
    body = np.zeros(len(X), np.int64) if body is None else body
    axes = held.axes.copy()
    for index, pin in enumerate(pins):
        empty = not (held.axes == index).any()
        if _holds(pin) and (pin.patch or not empty):
            mine = True if pin.body is None else body == pin.body
            rows = np.flatnonzero((axes < 0).all(1) & mine)
            s = np.linalg.norm(pin.nearest(X[rows]) - X[rows], axis=1)
            reach = NEAR * h
            if empty and len(s) and reach <= s.min() < h:
                reach = (1.0 + ALIKE) * float(s.min())
            axes[rows[s < reach]] = index
    return PinnedPoints(axes=axes)


def fully_prescribed(
    held: PinnedPoints, mass: Floats, body: Ints, X: Floats,
    particles: PinnedPoints, particle_X: Floats, particle_body: Ints,
) -> PinnedPoints:  # fmt: skip
    """Pins of nodes X (n, 3) [m], with those of nodes that only pinned particles reach.

    mass : (n,) [kg] of free particles; body : (n,) of each node. particles : pins of the particles
    at particle_X (N, 3) [m]; particle_body : (N,).

    A node without mass does not act on a free particle, but moves points of the surface.  The
    nearest free node may be many cells away, and an affine fit multiplies its motion: the handle of
    a pinned mug grew spikes. The node moves with the nearest pinned particle instead, unless that
    slides; with the nearest that does not where the body has no free particle at all.
    """
    axes = held.axes.copy()
    bare = (mass == 0.0) & held.free.all(1)
    whole = np.bincount(body, mass) == 0.0
    firm = np.asarray(~particles.free.any(1))
    for number in np.unique(body[bare]):
        rows = np.flatnonzero(bare & (body == number))
        which = firm if whole[number] else particles.pin >= 0
        held_by = np.flatnonzero(which & (particle_body == number))
        if len(held_by):
            near = held_by[kd_tree(particle_X[held_by]).query(X[rows])[1]]
            axes[rows[firm[near]]] = particles.axes[near[firm[near]]]
    return PinnedPoints(axes=axes)


def _holds(pin: Pin) -> bool:
    """Whether a pin fixes the body at its boundary along all axes."""
    return pin.sharp and not pin.rigid and all(pin.axes)


def mirror_points(
    pins: Sequence[Pin], held: PinnedPoints, X: Floats, h: float, given: Given | None = None
) -> tuple[Floats, Floats]:
    """X' (n, 3) [m] of pinned nodes near the boundary of their pins, nan for free and deep nodes; e
    (n,).

    given : weights of the fields at X' on nodes that are prescribed themselves; None: none.
    """
    out = np.where(held.free.all(1, keepdims=True), np.nan, X)
    share = np.full(len(X), -1.0)
    for index, pin in enumerate(pins):
        mine = np.flatnonzero((held.axes == index).any(1) & np.isfinite(out).all(1))
        if not pin.sharp:
            out[mine] = np.nan
        elif len(mine):
            b = pin.nearest(out[mine])
            s = np.linalg.norm(b - out[mine], axis=1)
            across = 2.0 * b - out[mine]
            if _holds(pin):
                behind = np.where(np.asarray(pin.inside(X[mine]), bool), s, -s)
                n = (b - X[mine]) / np.where(s == 0.0, np.inf, behind)[:, None]
                D = np.where(behind > 0.0, np.maximum(s, h - s), h + s)
                across = b + D[:, None] * n
                if given is not None:
                    D = np.where(given(mine, across) > HANGS, np.maximum(D, 2.0 * h - behind), D)
                    across = b + D[:, None] * n
                share[mine] = -behind / D
            out[mine] = np.where((s < REACH * h)[:, None], across, np.nan)
    return out, share


def axis_factors(held: PinnedPoints, mirror: Floats) -> Floats | None:
    """(n, 3) factors of the rows of pinned nodes: see the module; None where no pin slides.

    mirror : (n, 3) of `mirror_points`.
    """
    if not held.slide.any():
        return None
    out = np.where(held.free, -1.0, 1.0)
    out[np.isnan(mirror).any(1, keepdims=True) & ~held.free] = 0.0
    out[held.free.all(1)] = 1.0
    return out


def weight_on(at: Floats, nodes: Ints) -> NDArray[np.float64]:
    """(n,) sum of the trilinear weights at grid positions (n, 3) [cells] of nodes (m, 3)."""
    out = np.zeros(len(at))
    if not len(nodes):
        return out
    tree = kd_tree(nodes)
    base = np.floor(at + 1e-9).astype(int)
    f = np.clip(at - base, 0.0, 1.0)
    for corner in np.ndindex(2, 2, 2):
        w = np.prod(np.where(corner, f, 1.0 - f), axis=1)
        out += np.where(tree.query(base + np.array(corner))[0] < 0.5, w, 0.0)
    return out


def interpolation(at: Floats, nodes: Ints) -> sparse.csr_matrix:
    """Trilinear weights (n, m) of a nodal field at grid positions `at` (n, 3) [cells].

    Corners that are not in `nodes` (m, 3) are omitted and the other weights normalized; without any
    corner the row is empty.
    """
    tree = kd_tree(nodes)
    base = np.floor(at + 1e-9).astype(int)
    f = np.clip(at - base, 0.0, 1.0)
    rows, columns, values = [], [], []
    for corner in np.ndindex(2, 2, 2):
        w = np.prod(np.where(corner, f, 1.0 - f), axis=1)
        gap, found = tree.query(base + np.array(corner))
        use = (gap < 0.5) & (w > 1e-6)
        rows.append(np.flatnonzero(use))
        columns.append(found[use])
        values.append(w[use])
    r, c, w = (np.concatenate(parts) for parts in (rows, columns, values))
    total = np.bincount(r, w, minlength=len(at))
    return sparse.csr_matrix((w / total[r], (r, c)), shape=(len(at), len(nodes)))


class PinConstraint:
    """The pins of a solver: pinned points, and their prescribed positions.

    X : (N, 3) [m] particles; body : (N,) of each, None: there is one.

    Raises InputError for pins that contain all particles; `check` for one that contains no node.
    """

    def __init__(self, pins: Sequence[Pin], X: Floats, body: Ints | None = None) -> None:
        self.pins = tuple(pins)
        self.particles = boundary_held(self.pins, X, body)
        self.motions = [Motion(pin.anchors, pin.path) for pin in self.pins]
        if (self.particles.pin >= 0).all():
            raise InputError(
                f"the pins {self._names()} contain all {len(X)} particles: none is free to move",
                "make the regions of --pin smaller",
            )

    def _names(self) -> str:
        return ", ".join(pin.name for pin in self.pins)

    @property
    def prescribed(self) -> bool:
        """Whether a pin prescribes a position."""
        return not all(pin.rigid for pin in self.pins)

    @property
    def moving(self) -> bool:
        """Whether a pin is animated."""
        return any(motion.moving for motion in self.motions)

    def check(self, nodes: PinnedPoints) -> None:
        """Raise InputError for a pin that contains no node of the grid; of cores, if none does."""
        characters: dict[int | None, list[int]] = {}
        for k, pin in enumerate(self.pins):
            if not pin.sharp and not pin.rigid:
                characters.setdefault(pin.body, []).append(k)
        for cores in characters.values():
            if np.isin(nodes.axes, cores).any():
                continue
            which = f", such as {self.pins[cores[0]].name}," if len(characters) > 1 else ""
            raise InputError(
                f"none of the {len(cores)} bones of --flesh{which} contains a node of the grid",
                "use more particles (--particles), or a larger --bone-radius",
            )
        for index, pin in enumerate(self.pins):
            if pin.sharp and not (nodes.axes == index).any():
                raise InputError(
                    f"the pin {pin.name} contains no node of the grid: it is smaller than a cell"
                    " or outside the body",
                    "enlarge it, or use more particles (--particles) for a finer grid",
                )

    def constants(
        self, held: PinnedPoints, X: Floats, mirror: Floats, share: Floats, frame: float
    ) -> Floats:
        """c (n, 3) [m] of dependent nodes at X: g(X), and of ghosts g(X) - e g(X'); 0 if free.

        mirror : X' (n, 3) [m]; share : e (n,).
        """
        out = self.pose(held, X, frame)[0] - X
        ghost = np.isfinite(mirror).all(1)
        across = self.pose(held.at(ghost), mirror[ghost], frame)[0] - mirror[ghost]
        out[ghost] -= share[ghost, None] * across
        return out

    def pose(self, held: PinnedPoints, X: Floats, frame: float) -> tuple[Floats, Floats]:
        """x (n, 3) [m] and F (n, 3, 3) of pinned points; X and I along what is free."""
        x, F = X.copy(), np.broadcast_to(np.eye(3), (len(X), 3, 3)).copy()
        for index, motion in enumerate(self.motions):
            own = held.axes == index
            mine = np.flatnonzero(own.any(1))
            if len(mine) and motion.moving:
                goes, A = motion.at(X[mine], frame)
                x[mine] = np.where(own[mine], goes, x[mine])
                F[mine] = np.where(own[mine][:, :, None], A, F[mine])
        return x, F

    def override(
        self,
        held: PinnedPoints,
        X: Floats,
        pose: Pose,
        index: int,
        frame_time: float,
        offset: Floats,
    ) -> Pose:
        """A pose with the pinned points at their prescribed positions; offset (3,) [m] of the
        moving frame.

        Along a free axis they are interpolated from the grid, like all others.
        """
        mine = np.flatnonzero(held.pin >= 0)
        if not len(mine):
            return pose
        part = held.at(mine)
        fixed = ~part.free
        x, F = self.pose(part, X[mine], index)
        last = np.array([len(motion.path) - 1 for motion in self.motions])[part.axes]
        rate = velocity_at(lambda k: self.pose(part, X[mine], k)[0], index, frame_time, last)
        out_x, out_v, out_F = pose.x.copy(), pose.v.copy(), pose.F.copy()
        out_x[mine] = np.where(fixed, x + offset, out_x[mine])
        out_v[mine] = np.where(fixed, rate, out_v[mine])
        out_F[mine] = np.where(fixed[:, :, None], F, out_F[mine])
        return Pose(x=out_x, v=out_v, F=out_F)


NEIGHBORS = 24
SAME = 1e-6  # of the region's size: a point this near to an anchor moves with it
FLAT = 1e-3  # ratio of the extents of the anchors below which they are coplanar


class Motion:
    """The motion of one pin, constant before the first and after the last frame of its path."""

    def __init__(self, anchors: Floats, path: Floats) -> None:
        self.anchors, self.path = np.asarray(anchors, float), np.asarray(path, float)
        still = len(self.path) < 2 or np.array_equal(self.path, self.path[:1].repeat(len(path), 0))
        self.moving = not (still and np.array_equal(self.path[0], self.anchors))
        self._tree = kd_tree(self.anchors)
        self._extent = float(np.linalg.norm(np.ptp(self.anchors, axis=0)))

    def targets_at(self, frame: float) -> Floats:
        """(k, 3) [m] positions of the anchors, linearly interpolated between frames."""
        frame = float(np.clip(frame, 0.0, len(self.path) - 1))
        low = min(int(frame), max(len(self.path) - 2, 0))
        high = min(low + 1, len(self.path) - 1)
        t = frame - low
        return (1.0 - t) * self.path[low] + t * self.path[high]

    def at(self, X: Floats, frame: float) -> tuple[Floats, Floats]:
        """x (n, 3) [m] and A (n, 3, 3) of points X (n, 3) [m]."""
        now = self.targets_at(frame)
        k = min(NEIGHBORS, len(self.anchors))
        distance, near = self._tree.query(X, k=k)
        distance, near = distance.reshape(len(X), k), near.reshape(len(X), k)
        scale = distance.mean(1, keepdims=True) + 1e-300
        w = 1.0 / (1.0 + (distance / scale) ** 2)
        w /= w.sum(1, keepdims=True)
        P, Q = self.anchors[near], now[near]
        Pbar, Qbar = (np.einsum("nk,nka->na", w, S) for S in (P, Q))
        P, Q = P - Pbar[:, None], Q - Qbar[:, None]
        C = np.einsum("nk,nka,nkb->nab", w, P, P)
        B = np.einsum("nk,nka,nkb->nab", w, Q, P)
        spread = np.linalg.eigvalsh(C)
        solid = spread[:, 0] > FLAT * spread[:, 2]
        safe = np.where(solid[:, None, None], C, np.eye(3))
        A = np.where(solid[:, None, None], B @ np.linalg.inv(safe), signed_polar(B))
        x = Qbar + np.einsum("nab,nb->na", A, X - Pbar)
        known = distance[:, 0] <= SAME * self._extent
        x[known] = now[near[known, 0]]
        return x, A
