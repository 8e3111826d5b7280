"""Once a frame: the paper's shape correction, and F anew from where the particles are.

Both come after the substeps of a frame, in this order, and act on the state, which is all there is:
what rides on the body, and the points that feel the floor, follow by the same rows as ever.

Shape correction of strength alpha (GaussianFlesh section 4.3, "Procrustes"), on positions only,
towards the rest shape as it lies, without rotation (docs/physics.md):

    x_p <- x_p + alpha (xbar + (X_p - Xbar) - x_p)         xbar, Xbar: means by mass

x - X is a displacement field, x = X + W u, and xbar - Xbar the mean ubar of that field.  So this is
u <- u + alpha (ubar - u) on the nodes, for particles and everything else alike.  Velocities stay.
A body that has turned is pulled back: that is what no rotation means.

WLS (section 3.2): F <- argmin sum_q w_pq |F (X_q - X_p) - (x_q - x_p)|^2 over the k nearest
particles at rest, weights Gaussian.  That is linear in x, one constant sparse operator for each
column: F = I + D u_particles.  From there on F = F0 + G u with F0 = F_wls - G u of that moment,
its singular values clipped where a clamp is set: the anchor (x0, F0, u0) = (X + W u, F_wls, u),
kept as one matrix for each particle.  x needs no anchor, since nothing but u ever moves it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import sparse

from gf_usd.core.arrays import Floats
from gf_usd.core.errors import UsageError
from gf_usd.core.neighbors import nearest, operator, slopes
from gf_usd.physics import taichi_arrays
from gf_usd.physics.total_lagrangian import layout
from gf_usd.physics.total_lagrangian.energies import stored_energy

if TYPE_CHECKING:
    from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
    from gf_usd.physics.total_lagrangian.state import Moment


CLOSE = 1e-6  # of the largest stretch, of which `singular_values` are exact to 1e-8
NEIGHBOURS = 20  # docs/physics.md, fitted
WIDTH = 0.2  # [r] standard deviation of the Gaussian, fitted for r = 1


def wls_gradient(X: Floats, width: float) -> sparse.csr_matrix:
    """The operator of `slopes` over the nearest particles, w = exp(-|d|^2 / 2 width^2).

    X : (N, 3) [m]; width : [m].
    """
    k = min(NEIGHBOURS, len(X) - 1)
    distance, near = nearest(X, X, k + 1)
    # By the nearest neighbour's weight, which leaves the fit as it is and cannot underflow.
    least = distance[:, 1:2] if k else distance
    # A twin at the same place may come before the particle itself: both then add nothing.
    return operator(near, X[near] - X[:, None], np.exp((least**2 - distance**2) / (2.0 * width**2)))


def clip_stretches(F: Floats, low: float, high: float) -> tuple[Floats, Floats]:
    """F (N, 3, 3) with singular values in [low, high], and which rows (N,) bool that changed.

    Where J < 0 the smallest singular value counts as negative, as in `option_kernel.clip`.
    """
    from gf_usd.physics.per_particle import strains

    near = to_be_clipped(*strains(F), low, high)
    out, changed = np.array(F), np.zeros(len(F), bool)
    if near.any():
        out[near], changed[near] = _clipped(F[near], low, high)
    return out, changed


def to_be_clipped(s: Floats, J: Floats, low: float, high: float) -> Floats:
    """(N,) bool: which of these strains may lie outside, and are worth an SVD."""
    slack = CLOSE * s[:, 2]  # wide of what the closed form may be off by
    return (s[:, 0] < low + slack) | (s[:, 2] > high - slack) | (J < 0.0)


def _clipped(F: Floats, low: float, high: float) -> tuple[Floats, Floats]:
    U, s, Vt = np.linalg.svd(F)
    s[:, 2] *= np.where(np.linalg.det(F) < 0.0, -1.0, 1.0)
    turned = np.where(np.linalg.det(U) * np.linalg.det(Vt) < 0.0, -1.0, 1.0)
    kept = np.clip(s, low, high)
    changed = (kept != s).any(1)
    kept[:, 2] *= turned
    clipped = np.einsum("nab,nb,nbc->nac", U, kept, Vt)
    return np.where(changed[:, None, None], clipped, F), changed


class Reanchor:
    """What a body keeps for it: the operator, and F0 of every particle.

    Raises UsageError for a shape correction of a body that pins hold: it has no mean of its own.
    """

    def __init__(self, solver: TotalLagrangian) -> None:
        s = solver.settings
        if s.procrustes > 0.0 and solver.holder is not None:
            raise UsageError(
                f"--procrustes {s.procrustes:g} moves the body towards its rest shape about its"
                " mean, and --pin holds it elsewhere",
                "leave one of the two out",
            )
        self.alpha = s.procrustes
        self.clamp = s.clamp
        X = solver.particles.X
        self.gradient = wls_gradient(X, WIDTH * solver.particles.radius) if s.wls else None
        # In the kernels' precision, so that what is saved is what they see.
        self.F0 = np.tile(np.eye(3, dtype=solver.real), (len(X), 1, 1))
        self._ahead = np.zeros((len(X), 3, 3))  # F0 - I

    @property
    def acts(self) -> bool:
        return self.alpha > 0.0 or self.gradient is not None

    def anchored(self, F: Floats) -> Floats:
        """F0 + G u of particles (N, 3, 3) in place of F = I + G u."""
        return F if self.gradient is None else F + self._ahead

    def put(self, solver: TotalLagrangian, F0: Floats) -> None:
        """Set F0 (N, 3, 3), here and for the kernels."""
        self.F0 = np.asarray(F0, solver.real)
        self._ahead = self.F0.astype(float) - np.eye(3)
        flat = layout.lanes(solver.batches, self.F0.reshape(-1, 9), fill=True)
        taichi_arrays.put(solver.arrays["F0"], flat.astype(solver.real))

    def start(self, solver: TotalLagrangian) -> dict[str, Any]:
        """The kernels' array of F0, at rest."""
        if self.gradient is None:
            return {}
        return {"F0": layout.lanes(solver.batches, self.F0.reshape(-1, 9), fill=True)}

    def frame(self, solver: TotalLagrangian, index: int) -> tuple[Floats, float]:
        """Act at the end of frame `index`: particles (N,) bool that were clipped, energy [J] given.

        A state that is no longer finite is left as it is, for the guard to see.
        """
        clipped = np.zeros(len(solver.particles), bool)
        if not self.acts or (first := solver.moment()).not_finite()[1]:
            return clipped, 0.0
        F = solver.gradients(first, index)
        if self.alpha > 0.0:
            self._correct(solver)
        now = solver.moment()
        if self.gradient is not None:
            clipped, of_first = self._recompute(solver, now, index, F)
        else:
            of_first = now.strains_beside(index, F)
        before = stored_energy(solver, first, *of_first)
        return clipped, stored_energy(solver, now, *now.strains(index)) - before

    def _correct(self, solver: TotalLagrangian) -> None:
        u = taichi_arrays.values(solver.arrays["u"]).astype(float).reshape(-1, 3)
        m = solver.stencil.mass
        mean = m @ u[: len(m)] / m.sum()
        u += self.alpha * (mean - u)
        taichi_arrays.put(solver.arrays["u"], u.astype(solver.real).ravel())

    def _recompute(
        self, solver: TotalLagrangian, now: Moment, index: int, first: Floats
    ) -> tuple[Floats, tuple[Floats, Floats]]:
        """Put F anew where the kernels see it.

        Which particles (N,) bool were clipped, and the strains of the F that was `first`.
        """
        assert self.gradient is not None
        pose, F0 = solver.pose_at(now, index), self.F0.astype(float)
        F = slopes(self.gradient, pose.x - solver.particles.X - solver.offset)
        F += np.eye(3)
        ridden = pose.F - F0  # G u
        self.put(solver, F - ridden)
        of_first = now.strains_beside(index, first)
        clipped = np.zeros(len(F), bool)
        # Rounding of F0 is far less than what `to_be_clipped` is wide of.
        if self.clamp and to_be_clipped(*now.strains(index), *self.clamp).any():
            F, clipped = clip_stretches(F, *self.clamp)
            self.put(solver, F - ridden)
        return clipped, of_first
