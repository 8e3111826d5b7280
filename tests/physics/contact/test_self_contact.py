"""What of a body faces itself: places, signs and times, against closed forms and libigl."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from contact_scenes import bricks
from solids import solid, surface
from two_legs import SPACING, legs, sampled

from gf_usd.core.stage import Skin
from gf_usd.geometry.sampling.contact_samples import sample_surface
from gf_usd.physics.contact.detection.narrow_phase import ContactSearch
from gf_usd.physics.contact.planes.persistence import Outlook
from gf_usd.physics.contact.self_contact.bodies import OwnContacts
from gf_usd.physics.contact.self_contact.search import FACE, OFFSET, SelfContact

GAP = 0.5  # [m] at rest
REACH = FACE * SPACING


def made(gap: float = GAP):
    """Two legs half a meter apart, or as given, and their samples at rest."""
    skin, samples = sampled(legs(gap))
    return SelfContact(skin, samples.X, samples.normal, SPACING), samples


def closed(X, left: float):
    """Samples X (n, 3) [m] with the right leg sheared over until its tip is `left` [m] off."""
    y = np.clip((X[:, 1] - 0.2) / 1.0, 0.0, 1.0)
    over = np.where(X[:, 0] > 0.4 + 0.5 * GAP, (GAP - left) * y, 0.0)
    return X - np.stack([over, 0.0 * over, 0.0 * over], 1)


def test_nothing_is_near_a_body_at_rest():
    own, samples = made()
    x, still, nothing = samples.X, np.zeros_like(samples.X), np.full(len(samples.X), REACH)
    assert own.broad_phase(x, still)[1] > 1e20, "nothing moves"
    found = own.find(x, still, REACH, x, nothing)
    assert len(found.rows) == 0
    assert found.hold > 1e20
    assert not own.imminent(x, still, 10.0, x, nothing)
    v = np.where(x[:, :1] > 0.4 + 0.5 * GAP, [[-1.0, 0.0, 0.0]], 0.0)
    # The legs meet after 0.5 s at 1 m/s; it is looked again before that.
    hold = min(own.broad_phase(x, v)[1], own.find(x, v, REACH, x, nothing).hold)
    assert 0.05 < hold < GAP


@pytest.mark.parametrize("left", [1.6, 1.8, 2.0, 2.2, 2.6, 3.2, 4.0])
def test_an_opposite_surface_is_searched_for_before_it_touches(left):
    """A leg that comes from 1.6 spacings was searched for 0.3 of them too late."""
    own, samples = made()
    X, left = samples.X, left * SPACING
    bent = np.where(X[:, 0] > 0.4 + 0.5 * GAP, np.clip((X[:, 1] - 0.2) / 0.2, 0.0, 1.0), 0.0)
    v = np.stack([-bent, 0.0 * bent, 0.0 * bent], 1)  # at 1 m/s
    x = X + (GAP - left) * v
    patch_pairs, hold = own.broad_phase(x, v)
    found = own.find(x, v, REACH, x, np.full(len(X), REACH), patch_pairs)
    assert len(found.rows) or min(hold, found.hold) <= left - OFFSET * SPACING


def test_a_body_that_hardly_deforms_is_not_searched_again_in_a_frame(monkeypatch):
    own, samples = made()
    X, n = samples.X, len(samples.X)
    searches, broad_phase = [], own.broad_phase
    monkeypatch.setattr(own, "broad_phase", lambda *a: searches.append(a) or broad_phase(*a))
    contacts = OwnContacts({0: own}, [np.arange(n)], n, reach=REACH, spacing=SPACING)
    right = X[:, :1] > 0.4 + 0.5 * GAP
    # 0.625 spacings relative to the mean of the body may pass
    way = 0.6 * SPACING * np.where(right, [[-1.0, 0.0, 0.0]], [[1.0, 0.0, 0.0]])

    def search(x, speed: float, *, frame_begins: bool = False) -> int:
        outlook = Outlook(
            x=x, v=0.0 * x, mean=np.zeros((1, 3)), spread=np.array([speed]),
            near=np.zeros((1, 1), bool), moving=np.zeros(0, bool), pull=0.0, time=1.0, span=0.04,
        )  # fmt: skip
        contacts.search(
            ContactSearch(x, REACH, np.full(n, -np.inf)), outlook, np.zeros(1, bool), X, 0.04,
            every_sample=frame_begins,
        )  # fmt: skip
        return len(searches)

    assert search(X, 0.0, frame_begins=True) == 1
    assert search(X + 3.0, 0.0) == 1, "moved, not deformed"
    assert contacts.until[0] == -np.inf
    # a push within the frame: the legs will come together before it ends, or have
    assert search(X, 0.62 * SPACING / 0.04) == 1
    assert search(X, 0.63 * SPACING / 0.04) == 2
    assert search(X + way - way.mean(0), 0.0) == 2
    assert search(X + 1.5 * way, 0.0) == 3
    assert search(X, 0.0, frame_begins=True) == 4


def test_a_sample_is_pushed_before_it_touches_but_not_where_it_is_at_rest():
    most = OFFSET * SPACING
    assert (made()[0].offset == most).all()
    for gap in (0.5 * most, 0.1 * most):
        own, samples = made(gap)
        # Of the inner faces; beyond an edge of theirs nothing is faced.
        inner = np.abs(samples.X[:, 0] - 0.4 - 0.5 * gap) < 0.5 * gap + 1e-6
        inner &= (samples.X[:, 1] > 0.8) & (samples.X[:, 1] < 1.0)
        assert inner.any()
        np.testing.assert_allclose(own.offset[inner], gap, atol=1e-9)
        outer = np.abs(samples.X[:, 0] - 0.4) > 0.35
        assert (own.offset[outer] == most).all()


@pytest.mark.parametrize(("wide", "spacing"), [(1, 0.2), (3, 0.15), (3, 0.2)])
def test_thin_bars_near_each_other_at_rest_are_not_pushed(wide, spacing):
    """Samples of thin bars are far apart: the nearest is farther than the opposite surface.

    The frame of a chair next to its cushion began with 0.15 % of all energy in such springs.
    """
    shape = np.ones((3, 24, wide), bool)
    shape[1, 2:] = False
    bars = bricks(shape, 0.1)
    points = bars.points.copy()
    points[points[:, 0] > 0.15, 0] -= 0.07  # 3 cm are left between them
    filled = solid(surface(points, bars.triangles))
    skin, triangles = filled.outward(0)
    samples = sample_surface(filled, spacing)
    own = SelfContact(
        Skin(points=skin, triangles=triangles), samples.X, samples.normal, spacing
    )  # fmt: skip
    x, n = samples.X, len(samples.X)
    found = own.find(x, np.zeros_like(x), FACE * spacing, x, np.full(n, 2.0 * spacing))
    assert len(found.rows) > 0
    least = np.clip(found.gap, 0.0, OFFSET * spacing)
    np.testing.assert_allclose(own.offset[found.rows], least, atol=1e-12)


def test_legs_that_close_face_each_other():
    own, samples = made()
    x, nothing = closed(samples.X, 0.05), np.full(len(samples.X), REACH)
    assert own.broad_phase(x, np.zeros_like(x))[0]
    found = own.find(x, np.zeros_like(x), REACH, x, nothing)
    inner = np.abs(samples.X[:, 0] - 0.4) < 1e-6
    tip = inner & (samples.X[:, 1] > 1.0) & (np.abs(samples.X[:, 2] - 0.2) < 0.15)
    assert np.isin(np.flatnonzero(tip), found.rows).all()
    assert (found.gap > 0.0).all()
    # The faces are x = 0.4 and the sheared one: their distance in closed form.
    row = np.isin(found.rows, np.flatnonzero(tip & (samples.X[:, 1] < 1.15)))
    s = found.rows[row]
    slope = (GAP - 0.05) / 1.0
    across = 0.4 + GAP - slope * (x[s, 1] - 0.2) - x[s, 0]
    np.testing.assert_allclose(found.gap[row], across / np.hypot(1.0, slope), atol=1e-9)
    n = np.array([-1.0, -slope, 0.0]) / np.hypot(1.0, slope)
    np.testing.assert_allclose(found.normal[row], np.tile(n, (len(s), 1)), atol=1e-9)
    np.testing.assert_allclose(found.weights.sum(1), 1.0, rtol=1e-12)
    np.testing.assert_allclose(
        np.einsum("nk,nka->na", found.weights, x[found.carriers]), found.point, atol=1e-12
    )


def test_what_may_be_near_by_its_patches_is_found_as_if_all_were_looked_at():
    own, samples = made()
    x = closed(samples.X, 0.05)
    v = 0.1 * np.random.default_rng(0).normal(size=x.shape)
    nothing = np.full(len(x), REACH)
    patch_pairs, _ = own.broad_phase(x, v)
    assert patch_pairs is not None
    looks = own._patches.samples_near(patch_pairs, nothing < REACH)
    assert looks.sum() < 0.6 * len(x), "else all are looked at anyway"
    every, near = own.find(x, v, REACH, x, nothing), own.find(x, v, REACH, x, nothing, patch_pairs)
    assert len(every.rows) > 0
    for name in ("rows", "gap", "normal", "point", "carriers", "weights"):
        np.testing.assert_array_equal(getattr(near, name), getattr(every, name), name)
    # What was found stays looked at, whatever the patches say.
    known = nothing.copy()
    known[every.rows] = every.gap
    apart = replace(patch_pairs, near=np.zeros_like(patch_pairs.near))
    again = own.find(x, v, REACH, x, known, apart)
    assert np.isin(every.rows, again.rows).all()


def test_a_sample_is_inside_where_it_came_through():
    own, samples = made()
    before, x = closed(samples.X, 0.02), closed(samples.X, -0.03)
    still, nothing = np.zeros_like(x), np.full(len(x), REACH)
    came = own.find(x, still, REACH, before, nothing)
    assert came.gap.min() == pytest.approx(-0.03, abs=0.01)  # a slope of 0.5, edges of samples
    # What was there before anything was looked at was not crossed: shells may overlap at rest.
    was = own.find(x, still, REACH, x, nothing)
    assert was.gap.min() >= 0.0
    # What is known to be inside stays so.
    gap = nothing.copy()
    gap[came.rows] = came.gap
    again = own.find(x, still, REACH, x, gap)
    np.testing.assert_array_equal(again.rows[again.gap < 0.0], came.rows[came.gap < 0.0])


@pytest.mark.parametrize("gap", [0.05, GAP])
def test_what_did_not_move_did_not_come_through_a_crumpled_surface(gap):
    # Sharp folds have places on the outer side of one triangle and inside by its neighbors.
    own, samples = made(gap)
    random = np.random.default_rng(4)
    for _ in range(3):
        x = samples.X * [1.0, 0.3, 1.0] + 0.7 * SPACING * random.normal(size=samples.X.shape)
        found = own.find(x, np.zeros_like(x), REACH, x, np.full(len(x), REACH))
        assert len(found.rows) > 0
        assert found.gap.min() >= 0.0


def test_a_sample_inside_one_place_is_not_inside_what_it_lies_deeper_behind():
    own, samples = made()
    x, still = closed(samples.X, -0.03), np.zeros_like(samples.X)
    # All were found just inside of something; 0.3 spacings behind the other leg is elsewhere.
    shallow = np.full(len(x), -0.001)
    found = own.find(x, still, REACH, x, shallow)
    assert found.gap.min() >= -0.001 - 0.25 * SPACING - 1e-9
    deep = np.full(len(x), -0.03)
    assert own.find(x, still, REACH, x, deep).gap.min() == pytest.approx(-0.03, abs=0.01)


def test_the_two_sides_of_a_leg_that_is_squeezed_flat_do_not_face_each_other():
    own, samples = made()
    x = samples.X.copy()
    x[:, 2] *= 0.2  # from four spacings to less than one
    found = own.find(x, np.zeros_like(x), REACH, x, np.full(len(x), REACH))
    assert len(found.rows) == 0


def test_what_moves_together_holds():
    own, samples = made()
    x, nothing = closed(samples.X, 0.25), np.full(len(samples.X), REACH)
    v = np.tile([3.0, -2.0, 1.0], (len(x), 1))
    assert own.broad_phase(x, v)[1] > 1e6
    assert own.find(x, v, REACH, x, nothing).hold > 1e6
    assert not own.imminent(x, v, 1.0, x, nothing)
    v = np.where(samples.X[:, :1] > 0.4 + 0.5 * GAP, [[-2.0, 0.0, 0.0]], 0.0)
    assert own.imminent(x, v, 0.2, x, nothing), "0.25 m at 2 m/s"
