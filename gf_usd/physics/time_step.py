"""The largest stable step, from waves, damping and contact.

Symplectic Euler on a linear system whose stiffest vibration has angular frequency w and damping
ratio z is stable for (Belytschko, Liu and Moran 2000, section 6.6.6)

    dt <= (2 / w) (sqrt(1 + z^2) - z)

How much stiffer a strained material is: what the step of the next frame has to follow.

A wave in direction N that moves matter along n changes F by n (x) N, along which J is linear.  So
of a law psi = (shear part) + U(J) it feels at most (`moduli` of the law)

    k = shear + U''(J) (J / s_min)^2,        s_min the smallest singular value of F

which at rest is lam + 2 mu.  A node's frequency is that of all the particles in its cells, so that
the mean of k over a cell is what counts, not a single particle.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.errors import InputError
from gf_usd.core.frames import Particles

if TYPE_CHECKING:
    from gf_usd.physics.laws.registry import ParticleLaws


# Highest frequency of the quadratic stencil in units of c/h: measured with 8 random strata a cell,
# 1.9; with 4, 2.2; with one particle in two cells (the paper's density), 3.1.
GRID_FREQUENCY = ((4.0, 2.2), (1.0, 2.7), (0.0, 3.3))

MARGIN = 0.8  # of the limit with contact


@dataclass(frozen=True, kw_only=True)
class StableStep:
    """What limits the step."""

    elastic: float  # [rad/s]
    contact: float  # [rad/s]
    viscous_time: float  # [s] as scaled to the pressure wave
    contact_damping: float  # [1/s]
    safety: float  # of the body's own limit

    @property
    def damping_ratio(self) -> float:
        """z of the stiffest vibration."""
        w = np.hypot(self.elastic, self.contact)
        return float(0.5 * (self.viscous_time * self.elastic**2 + self.contact_damping) / w)

    def crowded(self, by: float) -> StableStep:
        """With so many times the contact springs on a sample."""
        return replace(
            self, contact=np.sqrt(by) * self.contact, contact_damping=by * self.contact_damping
        )

    def hardened(self, by: float) -> StableStep:
        """With contact springs so many times as stiff, and damped as before."""
        return replace(self, contact=np.sqrt(by) * self.contact)

    @property
    def limit(self) -> float:
        """[s] (2 / w) (sqrt(1 + z^2) - z)."""
        z = self.damping_ratio
        return float(2.0 / np.hypot(self.elastic, self.contact) * (np.sqrt(1.0 + z * z) - z))

    @property
    def dt(self) -> float:
        """[s] the step: `safety` of the body's own limit, and MARGIN of that with contact.

        The body's limit grows with its strain, which safety is for; contact has springs that do
        not, and a bound that is exact.
        """
        body = replace(self, contact=0.0, contact_damping=0.0)
        return min(self.safety * body.limit, max(self.safety, MARGIN) * self.limit)


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
    frequency: float | None = None,
) -> StableStep:
    """Step for waves of speed c [m/s] on cells of h [m] with contact and Kelvin-Voigt damping.

    viscous_time : tau scaled to the pressure wave, tau * 2 mu / (lam + 2 mu) [s]: the damping of
        the stiffest grid vibration w is then viscous_time * w^2.
    contact_omega2 : [1/s^2], contact_damping : [1/s], from `contact.build_contact`.
    frequency : the highest of the grid in units of c/h; None: `grid_frequency`.
    """
    highest = grid_frequency(per_cell) if frequency is None else frequency
    step = StableStep(
        elastic=float(highest * wave_speed / h),
        contact=float(np.sqrt(contact_omega2)),
        viscous_time=viscous_time,
        contact_damping=contact_damping,
        safety=safety,
    )
    if not 0.0 < step.dt < np.inf:
        raise InputError(
            f"there is no stable time step: waves travel at {wave_speed:.3g} m/s through cells "
            f"of {h:.3g} m, and contact springs oscillate at {step.contact:.3g} rad/s",
            "check the unit (--meters-per-unit), the material, --drop and --gravity",
        )
    return step


def per_cell(particles: Particles, h: float) -> float:
    """Particles in a full cell of h [m]."""
    return len(particles) * h**3 / particles.volume


SMALLEST = 1e-3  # a stretch below this counts as this: the guard sees to what is flat


def stiffness(law: ParticleLaws, stretch: Floats, J: Floats) -> Floats:
    """k (N,) [Pa] of elastic stretches (N, 3), ascending, and J (N,)."""
    area = J / np.maximum(stretch[:, 0], SMALLEST)
    shear, bulk = law.moduli(stretch, J)
    return shear + np.maximum(bulk, 0.0) * area**2


def wave_speed(k: Floats, density: Floats, order: np.ndarray, cell_start: np.ndarray) -> float:
    """Largest over cells of sqrt(mean k / mean density) [m/s]; order, cell_start : see Stencil."""
    k, density = (np.add.reduceat(v[order], cell_start[:-1]) for v in (k, density))
    return float(np.sqrt((k / density).max()))


def strained_step(
    rest: StableStep, speed: float, h: float, per_cell: float, frequency: float | None = None
) -> float:
    """The stable step [s] with waves of this speed [m/s]; contact and damping as at rest.

    No safety is taken off: the mean over a cell is on the safe side, and the guard behind it.
    frequency : see `stable_step`.
    """
    highest = grid_frequency(per_cell) if frequency is None else frequency
    elastic = highest * speed / h
    return replace(rest, elastic=max(elastic, rest.elastic), safety=1.0).dt
