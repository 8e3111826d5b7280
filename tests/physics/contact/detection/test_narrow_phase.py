"""What a contact sample faces: the deepest of what it can have come to."""

from __future__ import annotations

from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.physics.contact.detection.narrow_phase import CLOSER, TRAVEL, ContactSearch
from gf_usd.physics.contact.planes.contact_planes import NOBODY, OBSTACLE

UP = np.array([[0.0, 0.0, 1.0]])
HERE = np.array([[0.0, 0.0, 0.0]])


def offer(seen: ContactSearch, gap: float, carrier: Ints | None = None) -> None:
    seen.offer(np.array([0]), np.array([gap]), UP, HERE - gap * UP, carrier)


def search(before: float) -> ContactSearch:
    """A search for one sample that had this gap [spacings] at the last one."""
    return ContactSearch(HERE, 2.0, np.array([before - CLOSER]))


def test_a_sample_gets_the_plane_in_which_it_is_deepest() -> None:
    seen = search(0.0)
    for gap in (1.9, -0.4, 0.1):
        offer(seen, gap)
    assert (seen.planes.partner[0], seen.gap[0], seen.released) == (OBSTACLE, -0.4, 0)


def test_a_surface_out_of_reach_gives_no_plane() -> None:
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


class Skin:
    """A flat one, whose samples are all near."""

    def __init__(self, samples: Ints) -> None:
        self.samples = samples

    def nearest(self, places: Floats) -> Ints:
        return np.tile(self.samples, (len(places), 1))


def test_carriers_are_found_only_for_the_planes_that_are_selected() -> None:
    corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    X = np.array([*corners, [0.2, 0.2, 0.5], [0.3, 0.4, 0.5]])
    x, rows, up = X + [5.0, 0.0, 0.0], np.array([3, 4]), np.repeat(UP, 2, 0)
    seen = ContactSearch(x, 2.0, np.full(5, -np.inf))
    point = x[rows] * [1.0, 1.0, 0.0]
    seen.offer(rows, np.array([0.9, 0.4]), up, point + [0.0, 0.0, -0.4], obstacle=0)
    seen.offer_places(rows, np.array([0.5, 0.5]), up, point, 0, point - [5.0, 0.0, 0.0])
    skins: Any = {0: Skin(np.array([2, 0, 1, -1, -1, -1]))}
    seen.carry(skins, X)
    f = seen.planes
    assert f.partner.tolist() == [NOBODY, NOBODY, NOBODY, 0, OBSTACLE]
    assert f.obstacle.tolist() == [-1, -1, -1, -1, 0]
    np.testing.assert_array_equal(np.sort(f.carriers[3]), [0, 1, 2])
    np.testing.assert_allclose(f.weights[3], [0.6, 0.2, 0.2], atol=1e-12)
    np.testing.assert_allclose(f.interpolated(x)[3] + f.point[3], point[0], atol=1e-12)
    # What is nearer afterwards takes the place of what is to be carried.
    seen = ContactSearch(x, 2.0, np.full(5, -np.inf))
    seen.offer_places(rows, np.array([0.5, 0.5]), up, point, 0, point - [5.0, 0.0, 0.0])
    seen.offer(rows[:1], np.array([0.1]), UP, point[:1], obstacle=0)
    seen.carry(skins, X)
    assert seen.planes.partner.tolist()[3:] == [OBSTACLE, int(seen.planes.carriers[4, 0])]
    assert seen.planes.carriers[3].tolist() == [NOBODY] * 3


def test_of_several_places_for_a_sample_the_nearest_that_is_possible_is_taken() -> None:
    """The same as if they were offered one after the other."""
    least = np.array([-0.5, -np.inf, -0.5])
    rows = np.array([0, 1, 0, 2, 1, 0, 2])
    gap = np.array([0.3, 0.2, -0.2, 3.0, 0.2, -0.9, -0.8])
    point = np.arange(21.0).reshape(7, 3)
    body, rest, up = np.array([3, 4, 5, 3, 6, 7, 8]), 2.0 * point, np.repeat(UP, 7, 0)
    x = np.zeros((3, 3))
    seen, alone = ContactSearch(x, 2.0, least), ContactSearch(x, 2.0, least)
    seen.offer_places(rows, gap, up, point, body, rest)
    for k in range(7):
        one = slice(k, k + 1)
        alone.offer_places(rows[one], gap[one], up[one], point[one], int(body[k]), rest[one])
    assert seen.gap.tolist() == alone.gap.tolist() == [-0.2, 0.2, 2.0]
    assert seen.released == alone.released == 2  # -0.9 and -0.8
    assert seen._owner.tolist() == alone._owner.tolist() == [5, 4, -1]
    np.testing.assert_array_equal(seen.planes.point, alone.planes.point)
    np.testing.assert_array_equal(seen._rest, alone._rest)
