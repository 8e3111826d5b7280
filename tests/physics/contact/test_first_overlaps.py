"""Bodies that are inside each other when contact between bodies begins."""

from __future__ import annotations

import numpy as np
import pytest
from solids import CUBE_POINTS, CUBE_TRIANGLES

from gf_usd.physics.contact.detection.body_skins import PosedSkin
from gf_usd.physics.contact.distance.first_overlaps import FirstOverlaps, depths
from gf_usd.physics.contact.distance.tree import SurfaceTree
from gf_usd.system.taichi_runtime import ensure_running

LOW, THIN = np.array([0.0, 0.0, 0.0]), np.array([1.0, 0.2, 1.0])
ROD = np.stack([np.full(9, 0.5), np.linspace(-0.27, 0.53, 9), np.full(9, 0.5)], axis=1)
FAR_ROD = ROD + (0.0, 0.0, 0.4)
TOP = 0.2  # [m] of the slab


@pytest.fixture(autouse=True)
def running() -> None:
    ensure_running()


def slab() -> PosedSkin:
    """1 m wide, 0.2 m thick."""
    points = LOW + THIN * CUBE_POINTS
    tree = SurfaceTree(points, CUBE_TRIANGLES)
    return PosedSkin(points, CUBE_TRIANGLES, tree, None)


def far() -> PosedSkin:
    """A cube in which nothing is."""
    points = 10.0 + CUBE_POINTS
    return PosedSkin(points, CUBE_TRIANGLES, SurfaceTree(points, CUBE_TRIANGLES), None)


def test_depths_are_exact_also_far_from_the_surface() -> None:
    points = 10.0 * CUBE_POINTS
    body = PosedSkin(points, CUBE_TRIANGLES, SurfaceTree(points, CUBE_TRIANGLES), None)
    X = np.array([[5.0, 5.0, 5.0], [5.0, 1.0, 5.0], [5.0, -1.0, 5.0], [20.0, 5.0, 5.0]])
    np.testing.assert_allclose(depths(X, body), [5.0, 1.0, 0.0, 0.0], atol=1e-12)


def test_a_group_has_no_contact_until_all_of_it_is_outside() -> None:
    """Rods pierce a slab at two places: also their ends beyond it have no contact."""
    x = np.concatenate([ROD, FAR_ROD, [[0.1, 2.0, 0.1]]])
    one = np.arange(len(x) - 1)
    overlaps = FirstOverlaps([one, np.array([len(x) - 1])], meet_from=5, spacing=0.1)
    pairs, others = [(0, 1), (1, 0)], np.ones(len(one), np.int64)
    skins = {0: far(), 1: slab()}

    def update(frame: float) -> list[int]:
        return overlaps.update(frame, pairs, x, skins.__getitem__).tolist()

    assert update(4.0) == []
    assert overlaps.apart(one, others).all()
    assert update(5.0) == []
    # inside are those at 0.03 and 0.13, 0.07 deep; the others of a group are two spacings farther
    near = (x[one, 1] > 0.03 - 0.27) & (x[one, 1] < 0.13 + 0.27)
    np.testing.assert_array_equal(overlaps.apart(one, others), ~near)
    assert overlaps.apart(one, 0 * others).all()  # of other bodies
    x[:9, 1] += 0.3  # the first rod has left the slab, but for the last of its group
    assert update(6.0) == []
    x[:9, 1] += 0.1
    assert update(7.0) == [0]
    np.testing.assert_array_equal(overlaps.apart(one, others), (one < 9) | ~near)
    x[:9, 1] -= 0.3  # it is pushed out of the slab from now on
    assert update(8.0) == []
    assert overlaps.apart(one[:9], others[:9]).all()


def test_a_saved_state_keeps_the_groups() -> None:
    x = np.concatenate([ROD, [[0.1, 2.0, 0.1]]])
    members = [np.arange(9), np.array([9])]
    one, other = (FirstOverlaps(members, meet_from=5, spacing=0.1) for _ in range(2))
    skins = {0: far(), 1: slab()}
    one.update(5.0, [(0, 1)], x, skins.__getitem__)
    other.load(one.save())
    rows, others = np.arange(9), np.ones(9, np.int64)
    np.testing.assert_array_equal(other.apart(rows, others), one.apart(rows, others))
    x[:9, 1] += 1.0
    assert other.update(6.0, [(0, 1)], x, skins.__getitem__).tolist() == [0]
