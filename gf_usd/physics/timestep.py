"""The largest stable step, from waves, damping and contact.

Symplectic Euler on a linear system whose stiffest vibration has angular frequency w and damping
ratio z is stable for (Belytschko, Liu and Moran 2000, section 6.6.6)

    dt <= (2 / w) (sqrt(1 + z^2) - z)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# Highest frequency of the quadratic stencil in units of c/h: measured with 8 random strata a cell,
# 1.9; with 4, 2.2; with one particle in two cells (the paper's density), 3.1.
GRID_FREQUENCY = ((4.0, 2.2), (1.0, 2.7), (0.0, 3.3))


@dataclass(frozen=True, kw_only=True)
class StableStep:
    """What limits the step."""

    dt: float  # [s] stable limit times safety
    elastic: float  # [rad/s]
    contact: float  # [rad/s]
    damping_ratio: float


def grid_frequency(per_cell: float) -> float:
    """Bound of the grid's highest frequency in units of c/h, by particles per cell."""
    return next(value for least, value in GRID_FREQUENCY if per_cell >= least)


def stable_step(
    *,
    wave_speed: float,
    h: float,
    per_cell: float,
    viscous_time: float,
    contact_omega2: float,
    contact_damping: float,
    safety: float,
) -> StableStep:
    """Step for waves of speed c [m/s] on cells of h [m] with contact and Kelvin-Voigt damping.

    viscous_time : tau scaled to the pressure wave, tau * 2 mu / (lam + 2 mu) [s]: the damping of
        the stiffest grid vibration w is then viscous_time * w^2.
    contact_omega2 : [1/s^2], contact_damping : [1/s], from `contact.build_contact`.
    """
    elastic = grid_frequency(per_cell) * wave_speed / h
    w = np.sqrt(elastic**2 + contact_omega2)
    z = 0.5 * (viscous_time * elastic**2 + contact_damping) / w
    limit = 2.0 / w * (np.sqrt(1.0 + z * z) - z)
    return StableStep(
        dt=float(safety * limit),
        elastic=float(elastic),
        contact=float(np.sqrt(contact_omega2)),
        damping_ratio=float(z),
    )
