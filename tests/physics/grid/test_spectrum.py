"""The largest eigenvalue of a product of symmetric matrices, from below and never too low."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import eigh

from gf_usd.physics.grid.spectrum import ACCURACY, largest_eigenvalue


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("rank", [3, 40])
def test_it_bounds_the_largest_eigenvalue_closely(seed, rank):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(40, rank))
    K = root @ root.T
    B = rng.normal(size=(40, 40))
    A = B @ B.T + np.eye(40)
    # of A K: A K x = w x is K x = w A^-1 x
    true = float(eigh(K, np.linalg.inv(A), eigvals_only=True)[-1])
    found = largest_eigenvalue(lambda f: A @ f, lambda u: K @ u, rng.normal(size=(40, 3)))
    assert true * (1.0 - 1e-9) <= found <= true * (1.0 + 2.0 * ACCURACY)


def test_without_stiffness_it_is_zero():
    assert largest_eigenvalue(lambda f: f, lambda u: 0.0 * u, np.ones((4, 3))) == 0.0
