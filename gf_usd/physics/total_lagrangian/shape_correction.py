"""Operations between frames: the shape correction, and F by weighted least squares (WLS).

Both act on the state after the substeps of a frame, in this order. Embedded points and contact
samples are evaluated from the state and so change with it.

Shape correction of strength alpha (GaussianFlesh section 4.3, "Procrustes") moves positions toward
the translated rest shape, without a rotation (docs/physics.md):

    x_p <- x_p + alpha (xbar + (X_p - Xbar) - x_p)         xbar, Xbar: mass-weighted means

The displacement x - X is an interpolated field, x = X + W u, with the mean ubar = xbar - Xbar. The
correction is therefore u <- u + alpha (ubar - u) on the nodes. Velocities are unchanged. Since no
rotation is fitted, a rotated body is pulled back to its original orientation.

WLS (section 3.2): F <- argmin sum_q w_pq |F (X_q - X_p) - (x_q - x_p)|^2 over the k particles that
are nearest at rest, with Gaussian weights. The result is linear in x, one constant sparse operator
for each column: F = I + D u_particles. Afterwards F = F0 + G u with F0 = F_wls - G u at the time of
the fit, where a stretch clamp also clips the singular values of F_wls. F0 is stored as one matrix
per particle. Positions need no such reference.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from gf_usd.core.arrays import Floats
from gf_usd.core.errors import UsageError
from gf_usd.core.frames.settings import Settings
from gf_usd.core.neighbors import nearest, operator, slopes
from gf_usd.physics.total_lagrangian.energies import stored_energy
from gf_usd.physics.total_lagrangian.setup.body import Body
from gf_usd.physics.total_lagrangian.state import State, StateView

CLOSE = 1e-6  # of the largest stretch; the error of `strains` is about 1e-8 of it
NEIGHBORS = 20  # docs/physics.md, fitted
WIDTH = 0.2  # [r] standard deviation of the Gaussian, fitted for r = 1


def wls_gradient(X: Floats, width: float) -> sparse.csr_matrix:
    """The operator of `slopes` over the nearest particles, w = exp(-|d|^2 / 2 width^2).

    X : (N, 3) [m]; width : [m].
    """
    k = min(NEIGHBORS, len(X) - 1)
    distance, near = nearest(X, X, k + 1)
    # Divided by the nearest neighbor's weight: the fit is unchanged, and nothing underflows.
    least = distance[:, 1:2] if k else distance
    # A particle at the same position may come first; neither of the two contributes to the fit.
    return operator(near, X[near] - X[:, None], np.exp((least**2 - distance**2) / (2.0 * width**2)))


def clip_stretches(F: Floats, low: float, high: float) -> tuple[Floats, Floats]:
    """F (N, 3, 3) with singular values clipped to [low, high], and (N,) bool which rows changed.

    Where J < 0 the smallest singular value is negative, as in `kernels.limits.clip`.
    """
    from gf_usd.physics.per_particle import strains

    near = may_need_clipping(*strains(F), low, high)
    out, changed = np.array(F), np.zeros(len(F), bool)
    if near.any():
        out[near], changed[near] = _clipped(F[near], low, high)
    return out, changed


def may_need_clipping(s: Floats, J: Floats, low: float, high: float) -> Floats:
    """(N,) bool: which strains may lie outside of [low, high], so that an SVD is needed."""
    slack = CLOSE * s[:, 2]  # above the error of the closed form
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


class ShapeCorrection:
    """The operations on a body between frames.

    Raises UsageError for a shape correction of a pinned body, whose mean position is prescribed.
    """

    def __init__(self, body: Body) -> None:
        s = body.settings
        if s.procrustes > 0.0 and body.pin_constraint is not None:
            raise UsageError(
                f"--procrustes {s.procrustes:g} moves the body toward its rest shape about its "
                f"mean position, but --pin holds it elsewhere",
                "leave out one of the two",
            )
        self._body, self._alpha, self._clamp = body, s.procrustes, s.clamp
        X = body.particles.X
        self.gradient = wls_gradient(X, WIDTH * body.particles.radius) if s.wls else None

    def frame(self, state: State, index: int) -> tuple[Floats, float]:
        """Act at the end of frame `index`; (N,) bool which particles were clipped, and the energy
        [J] added.

        A state that is not finite is left unchanged: `Guard` reports it.
        """
        clipped = np.zeros(len(self._body.particles), bool)
        if not is_active(self._body.settings) or (first := state.view()).not_finite()[1]:
            return clipped, 0.0
        F = first.gradients(index)
        if self._alpha > 0.0:
            self._correct(state)
        now = state.view()
        if self.gradient is not None:
            clipped, of_first = self._recompute(state, now, index, F)
        else:
            of_first = now.elastic_strains_of(index, F)
        law = self._body.law_at(index)
        before = stored_energy(self._body, law, first, *of_first)
        after = stored_energy(self._body, law, now, *now.elastic_strains(index))
        return clipped, after - before

    def _correct(self, state: State) -> None:
        u, m = state.rows("u"), self._body.stencil.mass
        mean = m @ u[: len(m)] / m.sum()
        u += self._alpha * (mean - u)
        state.put("u", u)

    def _recompute(
        self, state: State, now: StateView, index: int, first: Floats
    ) -> tuple[Floats, tuple[Floats, Floats]]:
        """Recompute F by WLS and store F0 for the kernels.

        Returns (N,) bool which particles were clipped, and the elastic strains of the F before.
        """
        assert self.gradient is not None
        assert state.rest is not None
        pose, F0 = now.pose(index), state.rest.F0.astype(float)
        F = slopes(self.gradient, pose.x - self._body.particles.X - now.offset)
        F += np.eye(3)
        strained = pose.F - F0  # G u
        state.put_F0(F - strained)
        of_first = now.elastic_strains_of(index, first)
        clipped = np.zeros(len(F), bool)
        # The rounding error of F0 is far below the margin of `may_need_clipping`.
        if self._clamp and may_need_clipping(*now.strains(index), *self._clamp).any():
            F, clipped = clip_stretches(F, *self._clamp)
            state.put_F0(F - strained)
        return clipped, of_first


def is_active(settings: Settings) -> bool:
    """Whether the settings have an operation between frames."""
    return settings.procrustes > 0.0 or settings.wls
