"""What a contact sample faces: the deepest of what it can have come to."""

from __future__ import annotations

import numpy as np

from gf_usd.core.arrays import Ints
from gf_usd.physics.contact.narrow_phase import CLOSER, NOBODY, OBSTACLE, TRAVEL, ContactSearch

UP = np.array([[0.0, 0.0, 1.0]])
HERE = np.array([[0.0, 0.0, 0.0]])


def offer(seen: ContactSearch, gap: float, carrier: Ints | None = None) -> None:
    seen.offer(np.array([0]), np.array([gap]), UP, HERE - gap * UP, carrier)


def search(before: float) -> ContactSearch:
    """A search for one sample that had this gap [spacings] at the last one."""
    return ContactSearch(HERE, 2.0, np.array([before - CLOSER]))


def test_the_deepest_is_faced() -> None:
    seen = search(0.0)
    for gap in (1.9, -0.4, 0.1):
        offer(seen, gap)
    assert (seen.planes.partner[0], seen.gap[0], seen.released) == (OBSTACLE, -0.4, 0)


def test_what_is_out_of_reach_is_not_faced() -> None:
    seen = search(2.0)
    offer(seen, 2.1)
    assert (seen.planes.partner[0], seen.gap[0], seen.released) == (NOBODY, 2.0, 0)


def test_a_surface_inside_out_releases() -> None:
    # A sample .3 outside at the last detection cannot be 1.4 deep now; .3 - TRAVEL it can.
    seen = search(0.3)
    offer(seen, -1.4)
    assert (seen.planes.partner[0], seen.released) == (NOBODY, 1)
    offer(seen, 0.3 - TRAVEL)
    assert (seen.planes.partner[0], seen.gap[0], seen.released) == (OBSTACLE, 0.3 - TRAVEL, 1)


def test_at_the_first_detection_anything_may_be() -> None:
    seen = ContactSearch(HERE, 2.0, np.array([-np.inf]))
    offer(seen, -1.9)
    assert (seen.planes.partner[0], seen.released) == (OBSTACLE, 0)
