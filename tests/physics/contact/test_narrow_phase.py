"""What a contact sample faces: the deepest of what it can have come to."""

from __future__ import annotations

import numpy as np

from gf_usd.core.arrays import Ints
from gf_usd.physics.contact.narrow_phase import CLOSER, LOOK, NOBODY, OBSTACLE, Looking

UP = np.array([[0.0, 0.0, 1.0]])
HERE = np.array([[0.0, 0.0, 0.0]])


def offer(seen: Looking, gap: float, carrier: Ints | None = None) -> None:
    seen.plane(np.array([0]), np.array([gap]), UP, HERE - gap * UP, carrier)


def looking(before: float) -> Looking:
    """A look at one sample that had this gap [spacings] at the last one."""
    return Looking(HERE, 2.0, np.array([before - CLOSER]))


def test_the_deepest_is_faced() -> None:
    seen = looking(0.0)
    for gap in (1.9, -0.4, 0.1):
        offer(seen, gap)
    assert (seen.faced.partner[0], seen.gap[0], seen.let_go) == (OBSTACLE, -0.4, 0)


def test_what_is_out_of_reach_is_not_faced() -> None:
    seen = looking(2.0)
    offer(seen, 2.1)
    assert (seen.faced.partner[0], seen.gap[0], seen.let_go) == (NOBODY, 2.0, 0)


def test_a_surface_inside_out_lets_go() -> None:
    # A sample .3 outside at the last look cannot be 1.4 deep now; .3 - LOOK it can.
    seen = looking(0.3)
    offer(seen, -1.4)
    assert (seen.faced.partner[0], seen.let_go) == (NOBODY, 1)
    offer(seen, 0.3 - LOOK)
    assert (seen.faced.partner[0], seen.gap[0], seen.let_go) == (OBSTACLE, 0.3 - LOOK, 1)


def test_at_the_first_look_anything_may_be() -> None:
    seen = Looking(HERE, 2.0, np.array([-np.inf]))
    offer(seen, -1.9)
    assert (seen.faced.partner[0], seen.let_go) == (OBSTACLE, 0)
