"""Where the contact samples of a solver's bodies are, and how they move."""

from __future__ import annotations

from weakref import ref

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.physics.contact.floor import FloorContact
from gf_usd.physics.contact.planes.layout import origin_of
from gf_usd.physics.grid.embedding import placed
from gf_usd.physics.total_lagrangian.state import StateView


class MovingSamples:
    """The n contact samples of some bodies.

    bodies : their number B.
    """

    def __init__(self, contact: FloorContact, bodies: int) -> None:
        self._contact, samples = contact, contact.samples
        self.X = samples.X  # (n, 3) [m] at rest
        self.of = np.zeros(len(self.X), np.int64) if samples.body is None else samples.body
        self.members = [np.flatnonzero(self.of == k) for k in range(bodies)]
        self.origin = origin_of(self.X)
        self._placed: tuple[ref[StateView], Floats, Floats] | None = None  # `motion` of a view

    def motion(self, now: StateView) -> tuple[Floats, Floats]:
        """x [m] and v [m/s], (n, 3), not to be changed."""
        if self._placed is not None and self._placed[0]() is now:
            return self._placed[1:]
        constants = self._contact.constants
        x, rate = placed(self._contact.rows, now.u, now.v)
        x += self.X + now.offset
        if constants is not None:
            c, c_rate = now.constants
            x, rate = x + constants @ c, rate + constants @ c_rate
        x.flags.writeable = rate.flags.writeable = False
        self._placed = ref(now), x, rate
        return x, rate

    def without_nodes(self, now: StateView, dt: float) -> tuple[Floats, Floats | None]:
        """X (n, 3) [m] from the origin, moved by pins to the middle of a substep of dt [s], and the
        rate (n, 3) [m/s] of that; None: no pin moves.
        """
        driven = self._contact.driven
        if driven is None:
            return self.X - self.origin, None
        c, rate = now.constants
        return self.X - self.origin + driven @ (c + 0.5 * dt * rate), driven @ rate
