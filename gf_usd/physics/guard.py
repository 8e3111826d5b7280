"""Watching a run: what no sound frame does is not believed.

The step limit of `timestep` holds for the body at rest.  A material crushed to a tenth of its
volume is many times stiffer, and a step too long for it shows as energy: without a source of its
own a body under gravity, floor and damping can only lose some, up to the integrator's error.
"""

from __future__ import annotations

import numpy as np

from gf_usd.model import Floats, Health, Ints, Pose
from gf_usd.rows import corners

RETRIES = 6  # halvings of the step before giving up
CALM_FRAMES = 4  # good frames before a halved step is doubled again
# Position Verlet keeps a shadow energy; the energy itself swings by up to (w dt)^2 / 4 of what the
# stiffest vibrations hold.  In sound bakes of all looks no frame gained 1e-4 of the scale below
# (measured), and an unstable one gains many times it.
GAIN = 0.02
# No look, falling or pulled at, is ever this many radii long; a piece that flew off is.
ESCAPE = 100.0


class Guard:
    """Judges frames and holds the number of halvings.

    scale : [J] an energy of the body, m g0 r: what counts as little.
    reach : [m] the body's own extent at rest; a particle a hundred times as far off has escaped.
    body : (N,) the body of each particle; None: all are one.
    """

    def __init__(self, scale: float, reach: float, body: Ints | None = None) -> None:
        self._scale, self._reach, self._body = scale, reach, body
        self._calm = 0
        self._inverted = 0  # that a shorter step did not help: the law's doing, not the step's
        self._tried = -1  # inverted particles before the last refinement; -1: none was for them
        self.halvings = 0

    def judge(self, last: Health, now: Health, particles: Pose) -> tuple[int, str]:
        """The particle and the fault of a frame, in words; (-1, "") where nothing is wrong."""
        before, after = energy(last), energy(now)
        self._scale = max(self._scale, last.kinetic + last.elastic)
        gain = after - before - now.work - now.injected
        # A clipped F or a cut stress is no gradient of an energy: what it gains says nothing of
        # the step.  Written so that an energy that is no number fails too.
        limited = now.clamped + now.stress_capped > 0 and np.isfinite(gain)
        if not (gain <= GAIN * self._scale or limited):
            return worst(particles), (
                f"energy rose from {before:.4g} J to {after:.4g} J within the frame"
                f" (at most {GAIN * self._scale:.2g} J is rounding and integration error)"
            )
        # A particle is no further from the middle of its body than the box around all is long.
        low, high = corners(particles.x)
        if not np.linalg.norm(high - low) <= ESCAPE * self._reach:
            far = self._distances(particles.x)
            if far.max() > ESCAPE * self._reach:
                return int(far.argmax()), (
                    f"a particle is {far.max():.4g} m from the others, the body is"
                    f" {self._reach:.3g} m long at rest"
                )
        return self._judge_inversion(last, now, particles)

    def _distances(self, x: Floats) -> Floats:
        """(N,) [m] of particles from the middle of their body."""
        body = np.zeros(len(x), np.int64) if self._body is None else self._body
        middles = [np.median(x[body == k], axis=0) for k in range(int(body.max()) + 1)]
        return np.linalg.norm(x - np.array(middles)[body], axis=1)

    def _judge_inversion(self, last: Health, now: Health, particles: Pose) -> tuple[int, str]:
        """A new inversion is worth one try with half the step; what that leaves is believed."""
        known = max(self._inverted, last.inverted)
        if now.inverted > known and self._tried < 0:
            self._tried = now.inverted
            return worst(particles), f"{now.inverted} particles turned inside out"
        if self._tried >= 0:
            self._inverted = max(self._inverted, now.inverted)
        self._tried = -1
        return -1, ""

    def refine(self) -> None:
        """Halve the step."""
        self.halvings += 1
        self._calm = 0

    def passed(self) -> None:
        """Count a good frame; after enough of them double a halved step."""
        self._calm += 1
        if self.halvings and self._calm >= CALM_FRAMES:
            self.halvings -= 1
            self._calm = 0

    def state(self) -> dict[str, float]:
        """What a checkpoint keeps of it."""
        return {
            "scale": self._scale,
            "calm": self._calm,
            "inverted": self._inverted,
            "halvings": self.halvings,
        }

    def recall(self, state: dict[str, float]) -> None:
        """Go on from `state`."""
        self._scale = float(state["scale"])
        self._calm, self._inverted = int(state["calm"]), int(state["inverted"])
        self.halvings = int(state["halvings"])


def energy(h: Health) -> float:
    """Kinetic, elastic, potential and contact energy [J]."""
    return h.kinetic + h.elastic + h.potential + h.contact


def worst(particles: Pose) -> int:
    """The particle that is most strained: least J."""
    return int(np.argmin(np.linalg.det(particles.F)))
