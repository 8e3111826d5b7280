"""Watching a run: a frame that gains energy from nowhere is not believed.

The step limit of `timestep` holds for the body at rest.  A material crushed to a tenth of its
volume is many times stiffer, and a step too long for it shows as energy: without a source of its
own a body under gravity, floor and damping can only lose some, up to the integrator's error.
"""

from __future__ import annotations

from gf_usd.model import Health

RETRIES = 6  # halvings of the step before giving up
CALM_FRAMES = 4  # good frames before a halved step is doubled again
# Position Verlet keeps a shadow energy; the energy itself swings by up to (w dt)^2 / 4 of what the
# stiffest vibrations hold.  In sound bakes of all looks no frame gained 1e-4 of the scale below
# (measured), and an unstable one gains many times it.
GAIN = 0.02


class Guard:
    """Judges frames and holds the number of halvings.

    scale : [J] an energy of the body, m g0 r: what counts as little.
    """

    def __init__(self, scale: float) -> None:
        self._scale = scale
        self._calm = 0
        self.halvings = 0

    def judge(self, last: Health, now: Health) -> str:
        """What is wrong with a frame, in words; "" where nothing is."""
        before, after = energy(last), energy(now)
        self._scale = max(self._scale, last.kinetic + last.elastic)
        # Written so that an energy that is no number fails too.
        if not after - before <= GAIN * self._scale:
            return (
                f"energy rose from {before:.4g} J to {after:.4g} J within the frame"
                f" (at most {GAIN * self._scale:.2g} J is rounding and integration error)"
            )
        return ""

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


def energy(h: Health) -> float:
    """Kinetic, elastic, potential and contact energy [J]."""
    return h.kinetic + h.elastic + h.potential + h.contact
