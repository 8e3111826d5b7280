"""What laws must give: stress by their formulas, and stiffness by differences of stress."""

from __future__ import annotations

import numpy as np
from lane_kernels import evaluate

from gf_usd.core.materials.laws import LAWS
from gf_usd.verify.cases.patch import stress

# Laws with an energy of their own: what flows over another has its functions.
ENERGIES = [token for token, row in LAWS.items() if not row.over]

# F of an affine map that every particle is given
A = np.array([[1.10, 0.06, -0.03], [0.02, 0.92, 0.05], [-0.04, 0.03, 1.05]])
MU, LAM = 2.0, 3.0  # [Pa]
STEP = 1e-4  # of a central second difference of P: its error is STEP^2 times the third derivative


def felt(token: str, F: np.ndarray, n: np.ndarray, N: np.ndarray) -> np.ndarray:
    """n (x) N : d^2 psi / dF^2 : n (x) N, by differences of P, per particle."""
    H = n[:, :, None] * N[:, None, :]
    mu, lam = np.full(len(F), MU), np.full(len(F), LAM)
    ahead = evaluate(token, F + STEP * H, mu, lam, np.float64)[1]
    behind = evaluate(token, F - STEP * H, mu, lam, np.float64)[1]
    return ((ahead - behind) * H).sum((1, 2)) / (2.0 * STEP)


def unit(rng: np.random.Generator, n: int) -> np.ndarray:
    v = rng.normal(size=(n, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def reference_stress(token: str, mu: float, lam: float) -> np.ndarray:
    """P(A) in numpy float64, by the formulas of the laws and an SVD."""
    return stress(token, A, mu, lam)


def von_mises(P: np.ndarray) -> float:
    sigma = P @ A.T / np.linalg.det(A)
    s = sigma - np.trace(sigma) / 3.0 * np.eye(3)
    return float(np.sqrt(1.5 * (s * s).sum()))
