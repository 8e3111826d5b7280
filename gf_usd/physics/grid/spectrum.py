"""The highest frequency of a body: the largest eigenvalue of A K, with A and K symmetric.

Lanczos iteration in the inner product of K (Parlett 1998, section 13), in which A K is
self-adjoint, so that no root of A is needed. Sums are by NumPy, not BLAS: bit-identical for any
number of threads.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gf_usd.core.arrays import Floats

ACCURACY = 0.01  # of the eigenvalue: residual that ends the iteration, and is added to it
MOST = 60  # steps, more than the balls, boxes and bars of the tests need
Operator = Callable[[Floats], Floats]


def largest_eigenvalue(
    inverse_mass: Operator, stiffness: Operator, start: Floats, accuracy: float = ACCURACY
) -> float:
    """Largest eigenvalue of A K, with the residual added.

    inverse_mass, stiffness : A and K on fields shaped as `start`, K positive semi-definite.
    accuracy : relative residual that ends the iteration.

    The Lanczos value approaches from below, and some eigenvalue is within its residual, beta
    |s_last|. In a cluster of large eigenvalues it may be a neighbor of the largest.
    """
    q_old, q, beta = np.zeros_like(start), start, 0.0
    Kq = stiffness(q)
    size = float(np.sqrt(max((q * Kq).sum(), 0.0)))
    if not size > 0.0:
        return 0.0
    q, Kq = q / size, Kq / size
    T = np.zeros((MOST + 1, MOST + 1))  # tridiagonal, of which `eigh` reads the lower half
    value = bound = 0.0
    for k in range(MOST):
        r = inverse_mass(Kq)
        T[k, k] = (r * Kq).sum()
        r = r - T[k, k] * q - beta * q_old
        Kr = stiffness(r)
        T[k + 1, k] = beta = float(np.sqrt(max((r * Kr).sum(), 0.0)))
        values, vectors = np.linalg.eigh(T[: k + 1, : k + 1])
        value, bound = float(values[-1]), beta * abs(float(vectors[-1, -1]))
        if bound <= accuracy * value or beta <= 1e-12 * value:
            break
        q_old, q, Kq = q, r / beta, Kr / beta
    return value + bound
