"""One state of a Total Lagrangian body, and what several questions of a frame have in common.

The shape correction wants the energy of a state before and after it, the report of the frame wants
it again, and each of them where the nodes and particles are.  What was answered of a state once is
kept for as long as the state stands: a small body spends more on such calls than on substeps.

The constants of nodes that follow a pin, as they stand on a solver's device.
"""

from __future__ import annotations

import weakref
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.frames import Pose
from gf_usd.physics import taichi_arrays
from gf_usd.physics.grid.embedding import gradient, placed

if TYPE_CHECKING:
    from gf_usd.physics.grid.reference import Stencil
    from gf_usd.physics.total_lagrangian.solver import TotalLagrangian


Given = tuple[Floats, ...]


def given(solver: TotalLagrangian) -> Given:
    """Copies of all that a moment follows from: u, v, the offset, and with pins the constants."""
    names = ("u", "v") if solver.holder is None else ("u", "v", "anchor", "anchor_rate")
    return (*(taichi_arrays.values(solver.arrays[name]) for name in names), solver.offset.copy())


class Moment:
    """A solver's state as it stands.

    u, v : (free, 3) [m], [m/s] of the free nodes, u without the offset; float64, not to be changed.
    """

    def __init__(self, solver: TotalLagrangian, given: Given) -> None:
        # The solver keeps its moment: else both would wait for the search for cycles, and the
        # memory of a large body with them.
        self._solver, self._given = weakref.proxy(solver), given
        self._strains: tuple[int, Floats, tuple[Floats, Floats]] | None = None
        free = solver.stencil.free_count
        self.u, self.v = (a.astype(float).reshape(-1, 3)[:free] for a in given[:2])
        self.u.flags.writeable = self.v.flags.writeable = False

    def stands(self, given: Given) -> bool:
        """Whether it is still the state; never where something is no number."""
        return all((then == now).all() for then, now in zip(self._given, given))

    def not_finite(self) -> tuple[int, str]:
        """The particle nearest to what is no number, and the fault; (-1, "") where all is sound."""
        if np.isfinite(self.u).all() and np.isfinite(self.v).all():
            return -1, ""
        bad = ~(np.isfinite(self.u).all(1) & np.isfinite(self.v).all(1))
        X, nodes = self._solver.particles.X, self._solver.stencil.free_X
        worst = int(np.linalg.norm(X - nodes[np.argmax(bad)], axis=1).argmin())
        return worst, (
            f"{int(bad.sum())} of {len(self.u)} grid nodes are no longer finite, first near"
            f" particle {worst} at rest position {X[worst].round(4).tolist()} m"
        )

    def strains(self, index: int, F: Floats | None = None) -> tuple[Floats, Floats]:
        """Singular values (N, 3), ascending, and determinants (N,) of F at frame `index`.

        F : (N, 3, 3) where it is known.  What comes of it is kept for the frame and F0 of the last
        call; F0 is another array whenever it changes.
        """
        from gf_usd.physics.per_particle import strains

        known, F0 = self._strains, self._solver.reanchor.F0
        if known is None or known[0] != index or known[1] is not F0:
            found = self._solver.gradients(self, index) if F is None else F
            self._strains = known = index, F0, strains(found)
        return known[2]

    def strains_beside(self, index: int, other: Floats) -> tuple[Floats, Floats]:
        """Strains of another F (N, 3, 3), in the same call as those of F at `index`."""
        from gf_usd.physics.per_particle import strains

        n = len(other)
        s, J = strains(np.concatenate([other, self._solver.gradients(self, index)]))
        self._strains = index, self._solver.reanchor.F0, (s[n:], J[n:])
        return s[:n], J[:n]

    @property
    def constants(self) -> tuple[Floats, Floats]:
        """c (followers, 3) [m] of held nodes, and its rate [m/s]."""
        return of_followers(self._solver.stencil, *self._given[2:4])

    @cached_property
    def nodes(self) -> tuple[Floats, Floats]:
        """u and v as `Rows` stack them: with pins, the followers' constants too."""
        if self._solver.holder is None:
            return self.u, self.v
        c, rate = self.constants
        return np.concatenate([self.u, c]), np.concatenate([self.v, rate])

    @cached_property
    def x(self) -> Floats:
        """(free, 3) [m] where the free nodes are."""
        return self._solver.stencil.free_X + self._given[-1] + self.u

    @cached_property
    def F(self) -> Floats:
        """(N, 3, 3) I + G u of the particles."""
        return gradient(self._solver.rows, self.nodes[0])

    @cached_property
    def particles(self) -> Pose:
        """Where the particles are, but for what holds them."""
        rows, (u, v) = self._solver.rows, self.nodes
        x, v = placed(rows, u, v)
        return Pose(x=rows.X + self._given[-1] + x, v=v, F=self.F)

    @cached_property
    def potential(self) -> float:
        """-sum_i m_i x_i . (g + b) [J], heights over the floor."""
        solver = self._solver
        s, m = solver.settings, solver.stencil.mass
        datum = s.floor if s.floor is not None else 0.0
        height = self.x - datum * np.asarray(s.up)
        work = height @ np.asarray(s.gravity)
        if solver.acceleration.any():
            work = work + (self.x * solver.acceleration).sum(1)
        return float(-(m @ work))

    @cached_property
    def contact(self) -> float:
        """sum_s k d^2 / 2 [J] stored in the floor's springs."""
        solver = self._solver
        if solver.contact is None or solver.settings.floor is None:
            return 0.0
        rows = solver.contact.rows
        x = rows.X + self._given[-1] + rows.W @ self.u
        if solver.contact.constants is not None:
            x = x + solver.contact.constants @ self.constants[0]
        height = x @ solver.normal - solver.settings.floor
        depth = np.maximum(0.0, -height)
        return float(0.5 * solver.contact.stiffness @ depth**2)


def constants(solver: TotalLagrangian) -> tuple[Floats, Floats]:
    """c (followers, 3) [m] of the followers now, and its rate [m/s]."""
    anchor, rate = (taichi_arrays.values(solver.arrays[name]) for name in ("anchor", "anchor_rate"))
    return of_followers(solver.stencil, anchor, rate)


def of_followers(stencil: Stencil, anchor: Floats, rate: Floats) -> tuple[Floats, Floats]:
    """The kernels' arrays as c and its rate, (followers, 3): they are never empty."""
    count = stencil.node_count - stencil.free_count
    c, c_rate = (a.astype(float).reshape(-1, 3)[:count] for a in (anchor, rate))
    return c, c_rate


def node_motion(solver: TotalLagrangian) -> tuple[Floats, Floats]:
    """u and v as `Rows` stack them: with pins, the followers' constants too."""
    return solver.moment().nodes


def anchor(solver: TotalLagrangian, index: int) -> None:
    """Set the constants of held nodes for the way from frame `index` - 1 to `index`."""
    taichi_arrays.clear(solver.arrays["work"])
    if solver.holder is None or not solver.holder.moving:
        return
    free, nodes = solver.stencil.free_count, solver.stencil
    start, end = (
        solver.holder.constants(
            nodes.held.pin[free:], nodes.node_X[free:], nodes.mirror[free:], frame
        )
        for frame in (index - 1, index)
    )
    taichi_arrays.put(solver.arrays["anchor"], start.astype(solver.real).ravel())
    rate = (end - start) / solver.frame_time
    taichi_arrays.put(solver.arrays["anchor_rate"], rate.astype(solver.real).ravel())
