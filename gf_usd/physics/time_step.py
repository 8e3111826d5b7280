"""The largest stable time step, from waves, damping, contact and strain.

Symplectic Euler for a linear system whose stiffest vibration has the angular frequency w and the
damping ratio z is stable for (Belytschko, Liu and Moran 2000, section 6.6.6)

    dt <= (2 / w) (sqrt(1 + z^2) - z)

which is w^2 dt^2 / 4 + z w dt <= 1. In general, with a stiffness K and a damping C that need not
have the same modes, M - C dt / 2 - K dt^2 / 4 must be positive semi-definite.

Under strain the material stiffens. A plane wave with normal N and displacement along n changes F by
n (x) N, along which J is linear. For a law psi = (shear part) + U(J) its stiffness is at most
(`moduli` of the law)

    k = shear + U''(J) (J / s_min)^2,        s_min the smallest singular value of F

which is lam + 2 mu at rest. The frequency of a node depends on all particles in its cells, so that
the mean of k over a cell is used.

The damping does not stiffen as much. The stress of Kelvin-Voigt damping is
2 mu tau F sym(F^T dF/dt), and its power 2 mu tau |sym(F^T dF/dt)|^2 is at most s_max^2 times that
at rest, with s_max the largest singular value of F.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.errors import InputError
from gf_usd.core.frames.particles import Particles
from gf_usd.core.units import length_text

if TYPE_CHECKING:
    from gf_usd.physics.laws.registry import ParticleLaws


# Highest frequency of the quadratic stencil in units of c/h, measured: 1.9 with 8 stratified random
# particles per cell, 2.2 with 4, and 3.1 with one in two cells (the paper's density).
GRID_FREQUENCY = ((4.0, 2.2), (1.0, 2.7), (0.0, 3.3))

MARGIN = 0.8  # factor on the limit with contact
SHORT = 0.9  # of the step at rest: a substep below it is that of a strained body
# The number of substeps with contact: the first guess, the ratio of its bounds that is close
# enough, and the largest number of guesses.
FIRST_GUESS, CLOSE, GUESSES = 1.3, 1.1, 4


@dataclass(frozen=True, kw_only=True)
class StableStep:
    """The quantities that limit the step."""

    elastic: float  # [rad/s]
    contact: float  # [rad/s]
    viscous_time: float  # [s] scaled to the pressure wave
    contact_damping: float  # [1/s]
    safety: float  # factor on the limit without contact

    @property
    def damping_ratio(self) -> float:
        """z of the stiffest vibration."""
        w = np.hypot(self.elastic, self.contact)
        return float(0.5 * (self.viscous_time * self.elastic**2 + self.contact_damping) / w)

    @property
    def contact_factor(self) -> float:
        """Substeps with contact springs, relative to those that the body needs without."""
        return replace(self, contact=0.0, contact_damping=0.0).dt / self.dt

    def crowded(self, by: float) -> StableStep:
        """With `by` times as many contact springs on a sample."""
        return replace(
            self, contact=np.sqrt(by) * self.contact, contact_damping=by * self.contact_damping
        )

    def hardened(self, by: float) -> StableStep:
        """With contact springs `by` times as stiff, and the same damping."""
        return replace(self, contact=np.sqrt(by) * self.contact)

    def contact_share(self, dt: float) -> float:
        """(w_c dt / 2)^2 + c_c dt / 2 of its contact springs with a step dt [s]."""
        return (0.5 * self.contact * dt) ** 2 + 0.5 * self.contact_damping * dt

    def substeps_with_contact(
        self, dt: float, share: Callable[[float], float], strained: float = np.inf
    ) -> float:
        """Substeps with contact springs for one of dt [s] without: >= 1, as a rule up to `CLOSE`
        times more than needed.

        dt : stable without them, and at most that of this step; shorter where the body is strained.
        share : the largest eigenvalue of M~^-1 (K d^2 / 4 + C d / 2) of the springs, for a step d
        [s]; with that of the body it is at most 1.
        strained : [s] limit of the body in its strain, with its own contact.

        With e its value at the step d, it is at most the larger, and at least the smaller, of e s
        and e s^2 at the step s d: one value bounds the number from both sides. A body that is
        hardly strained has the damping that it has at rest, and the stiffness by which `strained`
        is its limit. How stiff and how damped one is that takes a shorter step need not be known:
        its part is at most 1 at dt, and at most 1 / n at dt / n.
        """
        d = dt / max(self.safety, MARGIN)
        stiff, damped = 0.0, 1.0
        if dt >= SHORT * self.dt:
            rate = self.viscous_time * self.elastic**2
            stiff, damped = (0.5 * self.elastic * d) ** 2, 0.5 * rate * d
            if strained < np.inf:
                left = 1.0 - self.contact_share(strained) - 0.5 * rate * strained
                stiff = max(stiff, left * (dt / strained) ** 2)
        n, least, most = FIRST_GUESS, 1.0, np.inf
        for _ in range(GUESSES):
            part = share(d / n)
            bounds = (
                _substeps(stiff + part * n * n, damped),
                _substeps(stiff, damped + part * n),
            )
            least, most = max(least, min(bounds)), min(most, max(bounds))
            if most <= CLOSE * least:
                break
            n = float(np.sqrt(least * most))
        return max(1.0, most)

    @property
    def limit(self) -> float:
        """[s] (2 / w) (sqrt(1 + z^2) - z)."""
        z = self.damping_ratio
        return float(2.0 / np.hypot(self.elastic, self.contact) * (np.sqrt(1.0 + z * z) - z))

    @property
    def dt(self) -> float:
        """[s] the step: `safety` times the limit without contact, and MARGIN times that with
        contact.

        The limit of the body decreases with strain, which `safety` allows for; the bound for
        contact springs is exact.
        """
        body = replace(self, contact=0.0, contact_damping=0.0)
        return min(self.safety * body.limit, max(self.safety, MARGIN) * self.limit)


def _substeps(stiff: float, damped: float) -> float:
    """The n with stiff / n^2 + damped / n = 1."""
    return float(0.5 * (damped + np.sqrt(damped**2 + 4.0 * stiff)))


def grid_frequency(per_cell: float) -> float:
    """Bound of the grid's highest frequency in units of c/h, from the particles per cell."""
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
    contact_omega2 : [1/s^2], contact_damping : [1/s], from `floor.build_contact`.
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
            f"of {length_text(h)}, and contact springs oscillate at {step.contact:.3g} rad/s",
            "check the unit (--meters-per-unit), the material, --drop and --gravity",
        )
    return step


def per_cell(particles: Particles, h: float) -> float:
    """Number of particles in a full cell of edge h [m]."""
    return len(particles) * h**3 / particles.volume


SMALLEST = 1e-3  # lower bound of a stretch here: `Guard` handles flatter particles


def stiffness(law: ParticleLaws, stretch: Floats, J: Floats) -> Floats:
    """k (N,) [Pa] of elastic stretches (N, 3), ascending, and J (N,)."""
    area = J / np.maximum(stretch[:, 0], SMALLEST)
    shear, bulk = law.moduli(stretch, J)
    return shear + np.maximum(bulk, 0.0) * area**2


def wave_speed(k: Floats, density: Floats, order: np.ndarray, cell_start: np.ndarray) -> float:
    """Largest over cells of sqrt(mean k / mean density) [m/s]; order, cell_start : see Stencil."""
    k, density = (_cell_sums(v, order, cell_start) for v in (k, density))
    return float(np.sqrt((k / density).max()))


def largest_mean(values: Floats, order: np.ndarray, cell_start: np.ndarray) -> float:
    """Largest over cells of the mean of particle values (N,); order, cell_start : see Stencil."""
    return float((_cell_sums(values, order, cell_start) / np.diff(cell_start)).max())


def _cell_sums(values: Floats, order: np.ndarray, cell_start: np.ndarray) -> Floats:
    """(cells,) sums of particle values (N,)."""
    return np.add.reduceat(values[order], cell_start[:-1])


def substeps_of(frame_time: float, dt: float) -> int:
    """Substeps of a frame [s] with steps of at most dt [s].

    The stable step of a state that blew up can round to 0: then 1, the guard judges the frame, and
    its step is halved from that at rest.
    """
    return 1 if dt == 0.0 else int(np.ceil(frame_time / dt))


def strained_step(
    rest: StableStep,
    speed: float,
    h: float,
    per_cell: float,
    frequency: float | None = None,
    *,
    damping: float | None = None,
) -> float:
    """The stable step [s] for waves of this speed [m/s]; contact as at rest.

    Without a safety factor: the mean over a cell is conservative, and `Guard` detects instability.

    frequency : see `stable_step`.
    damping : factor >= 1 on the damping of the stiffest vibration at rest; None: it grows with the
        square of the frequency.
    """
    highest = grid_frequency(per_cell) if frequency is None else frequency
    elastic = max(highest * speed / h, rest.elastic)
    viscous_time = rest.viscous_time
    if damping is not None:
        viscous_time *= damping * (rest.elastic / elastic) ** 2
    return replace(rest, elastic=elastic, viscous_time=viscous_time, safety=1.0).dt
