"""Patches of a surface: which may meet, and how soon, against every pair of samples."""

from __future__ import annotations

import numpy as np
import pytest
from two_legs import SPACING, legs, sampled

from gf_usd.core.stage import ContactSetup
from gf_usd.physics.contact.detection.broad_phase import Boxes, schedule
from gf_usd.physics.contact.obstacles.obstacle import box_gap
from gf_usd.physics.contact.self_contact.patch_tables import FOLDS, NEIGHBORS
from gf_usd.physics.contact.self_contact.patches import Patches, closing

GAP = 1.5  # [m] between the legs at rest


def made():
    """The patches of two legs, and their samples."""
    _, samples = sampled(legs(GAP))
    return Patches(samples.X, samples.normal, SPACING, see=4.0, thick=4.0), samples


@pytest.mark.slow
def test_pairs_of_patches_are_all_pairs_of_samples():
    patches, _ = made()
    of = patches._of
    pairs = np.array([0, 3, 17])
    i, j, start = patches.samples(pairs)
    for k, pair in enumerate(pairs):
        mine = slice(start[k], start[k + 1] if k + 1 < len(pairs) else len(i))
        a, b = np.flatnonzero(of == patches._a[pair]), np.flatnonzero(of == patches._b[pair])
        expected = {(x, y) for x in a.tolist() for y in b.tolist()}
        assert set(zip(i[mine].tolist(), j[mine].tolist())) == expected
        assert len(i[mine]) == len(expected), "each once"


def test_a_distance_shrinks_by_no_more_than_the_bound():
    random = np.random.default_rng(0)
    away, relative = random.normal(size=(50, 3)), random.normal(size=(50, 3))
    distance = np.linalg.norm(away, axis=1)
    bound = closing(tuple(away.T), distance, tuple(relative.T))
    step = 1e-6
    rate = (distance - np.linalg.norm(away + step * relative, axis=1)) / step
    assert (rate <= bound + 1e-5).all()
    # ... of which half the relative speed is for a change of it.
    speed = np.linalg.norm(relative, axis=1)
    np.testing.assert_allclose(bound, np.maximum(rate, 0.0) + 0.5 * speed, atol=1e-5)


def test_gaps_and_rates_are_those_of_bounding_spheres_of_all_samples():
    patches, samples = made()
    random = np.random.default_rng(1)
    x = samples.X + SPACING * random.normal(size=samples.X.shape)
    v = random.normal(size=samples.X.shape)
    patch_pairs = patches.pairs(x, v)
    members = [np.flatnonzero(patches._of == k) for k in range(patches._of.max() + 1)]
    spheres = []
    for m in members:
        c, mean = x[m].mean(0), v[m].mean(0)
        radius = np.linalg.norm(x[m] - c, axis=1).max()
        spheres.append((c, radius, mean, np.linalg.norm(v[m] - mean, axis=1).max()))
    for k, (i, j) in enumerate(zip(patches._a, patches._b)):
        (c, r, mean, spread), (d, s, other, far) = spheres[i], spheres[j]
        away, relative = d - c, other - mean
        distance = np.linalg.norm(away)
        rate = max(-away @ relative / distance, 0.0) + 0.5 * np.linalg.norm(relative)
        assert patch_pairs.gap[k] == pytest.approx(distance - r - s, abs=1e-12)
        assert patch_pairs.rate[k] == pytest.approx(rate + 1.5 * (spread + far), rel=1e-12)


def curled(n: int = 1500):
    """Points and normals of both walls of a tube that is slit along its length."""
    random = np.random.default_rng(2)
    a, z = 0.2 + 5.8 * random.random(n), 2.0 * random.random(n)
    outer = random.random(n) < 0.5
    r, sign = np.where(outer, 1.3, 1.0), np.where(outer, 1.0, -1.0)
    normal = np.stack([np.cos(a), np.sin(a), 0.0 * a], 1) * sign[:, None]
    return np.stack([r * np.cos(a), r * np.sin(a), z], 1), normal


def reference(patches: Patches, x, v, normal_at, see: float, spacing: float):
    """near, until and fold of `Patches.pairs`, pair by pair.

    normal_at : (n, 3) positions -> (p, 3) normals of the patches.
    """
    members = [np.flatnonzero(patches._of == k) for k in range(patches._of.max() + 1)]
    c, mean = (np.array([q[m].mean(0) for m in members]) for q in (x, v))
    time = 1e-3 * spacing / np.linalg.norm(v, axis=1).max()
    n, turned = normal_at(x), normal_at(x + time * v)
    pairs, fold, near, until = patches.pairs(x, v), np.inf, [], []

    def cosine(i, j, c, n):
        away = (c[j] - c[i]) / np.linalg.norm(c[j] - c[i])
        return min(away @ n[i], -away @ n[j])

    for k, (i, j) in enumerate(zip(patches._a, patches._b)):
        gap, now, rest = pairs.gap[k], cosine(i, j, c, n), patches._cosine_at_rest[k]
        unfolded = patches._kind[k] == NEIGHBORS | FOLDS and now <= rest + 0.25
        near.append(gap < see and not unfolded and (patches.adjacent[k] or now > -0.5))
        later = np.inf if unfolded else max(gap - 0.5 * see, 0.5 * see) / pairs.rate[k]
        until.append(0.0 if near[-1] else later)
        if unfolded and gap < see:
            rate = (cosine(i, j, c + time * mean, turned) - now) / time
            if rate > 1e-9:
                fold = min(fold, (rest + 0.75 - now) / rate / 1.5)
    return near, until, fold


@pytest.mark.parametrize("squeeze", [0.6, 0.2])
def test_pairs_are_near_and_fold_as_compared_one_by_one(squeeze: float):
    X, normal = curled()
    spacing = 0.08
    patches = Patches(X, normal, spacing, see=2.0, thick=3.0)

    def normals(x):
        t = [np.zeros((len(patches._count), 3)) for _ in range(2)]
        for column, out in enumerate(t):
            values = patches._slopes[:, column, None] * x[patches._order]
            np.add.at(out, patches._of[patches._order], values)
        n = np.cross(*t)
        length = np.linalg.norm(n, axis=1, keepdims=True)
        return n / np.where(length > 0.0, length, 1.0)  # a patch of few samples has none

    random = np.random.default_rng(3)
    x = X * [squeeze, 1.0, 1.0] + 0.02 * random.normal(size=X.shape)
    v = np.stack([-X[:, 0] * np.abs(X[:, 1]), 0.3 * X[:, 0], 0.0 * X[:, 2]], 1)
    near, until, fold = reference(patches, x, v, normals, 2.0 * spacing, spacing)
    found = patches.pairs(x, v)
    assert found.near.tolist() == near
    assert 0 < sum(near) < len(near)
    assert np.isinf(until).any()
    np.testing.assert_allclose(found.until, until, rtol=1e-9)
    assert found.fold == pytest.approx(fold, rel=1e-5)
    assert np.isfinite(fold)


def test_a_surface_of_one_patch_has_no_pairs():
    X = SPACING * np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    patches = Patches(X, np.tile([0.0, 0.0, 1.0], (3, 1)), SPACING, see=4.0, thick=4.0)
    patch_pairs = patches.pairs(X, np.ones_like(X))
    assert len(patch_pairs.near) == 0
    assert patch_pairs.fold == np.inf


def test_patches_that_are_apart_wait_until_they_may_meet():
    patches, samples = made()
    x = samples.X
    right = x[:, 0] > 0.4 + 0.5 * GAP
    v = np.where(right[:, None], [[-1.0, 0.0, 0.0]], 0.0)
    patch_pairs = patches.pairs(x, v)
    assert not patch_pairs.near.any()
    assert 0.0 < patch_pairs.until.min() < GAP, "the legs meet after 1.5 s"
    # The bound holds for each pair: no sample of it is nearer by then, at twice that speed even.
    pairs = patches.soonest(patch_pairs.until, np.inf, 10**9)
    i, j, start = patches.samples(pairs)
    t = np.repeat(patch_pairs.until[pairs], np.diff(np.append(start, len(i))))
    later = x[j] - x[i] + t[:, None] * (v[j] - v[i])
    assert (np.linalg.norm(later, axis=1) >= 2.0 * SPACING - 1e-9).all()
    assert len(patches.soonest(patch_pairs.until, 0.5 * float(patch_pairs.until.min()), 10**9)) == 0


def test_parts_of_patches_wait_longer_and_no_sample_comes_too_near_in_that_time():
    """One leg closes and turns, fast: the patches' velocities spread, those of their parts less."""
    patches, samples = made()
    x, clear, see = samples.X, 0.75 * SPACING, 4.0 * SPACING
    right = x[:, 0] > 0.4 + 0.5 * GAP
    spin = np.cross([0.0, 6.0, 0.0], x - x[right].mean(0)) + [-1.0, 0.0, 0.0]
    v = np.where(right[:, None], spin, 0.0)
    patch_pairs = patches.pairs(x, v)
    coarse = patches.unseen(patch_pairs, x, v, 0.0, clear)  # nothing is sooner than 0 s
    until = patches.unseen(patch_pairs, x, v, np.inf, clear)
    assert (until >= coarse).all()
    assert until.min() > 1.2 * coarse.min()
    pairs = np.flatnonzero(np.isfinite(until))
    i, j, start = patches.samples(pairs)
    size = np.diff(np.append(start, len(i)))
    t, near = np.repeat(until[pairs], size), np.repeat(patch_pairs.near[pairs], size)
    left = np.where(near, clear, 0.5 * see)
    unseen = np.linalg.norm(x[j] - x[i], axis=1) >= see
    later = x[j] - x[i] + t[:, None] * (v[j] - v[i])
    assert unseen.sum() > 1000
    assert (np.linalg.norm(later, axis=1) >= left - 1e-9)[unseen].all()


def test_what_moves_as_one_never_meets():
    patches, samples = made()
    v = np.tile([3.0, -2.0, 1.0], (len(samples.X), 1))
    patch_pairs = patches.pairs(samples.X, v)
    assert patch_pairs.until.min() > 1e6
    assert patch_pairs.fold > 1e6


def test_a_fold_is_looked_at_before_it_closes():
    """A strip that is bent about its middle until its halves meet."""
    n = np.arange(60) * 0.1 * SPACING * 10.0
    X = np.stack([np.repeat(n, 8), np.tile(np.arange(8) * SPACING, 60), np.zeros(480)], 1)
    up = np.tile([0.0, 0.0, 1.0], (480, 1))
    patches = Patches(X, up, SPACING, see=4.0, thick=4.0)
    middle = 0.5 * n[-1]

    def bent(angle: float) -> np.ndarray:
        away = np.maximum(X[:, 0] - middle, 0.0)
        over = np.minimum(X[:, 0], middle) + away * np.cos(angle)
        return np.stack([over, X[:, 1], away * np.sin(angle)], 1)

    assert not patches.pairs(bent(0.0), np.zeros_like(X)).near.any()
    assert patches.pairs(bent(2.0), np.zeros_like(X)).near.any(), "of pi, at which they meet"
    step = 1e-6
    turning = (bent(0.3 + step) - bent(0.3)) / step  # a radian a second
    assert patches.pairs(bent(0.3), turning).fold < np.pi - 0.3


def test_a_sample_without_a_normal_is_treated_as_its_neighbors_are():
    samples = sampled(legs(GAP))[1]
    normal = samples.normal.copy()
    normal[::7] = 0.0
    patches = Patches(samples.X, normal, SPACING, see=4.0, thick=4.0)
    right = samples.X[:, 0] > 0.4 + 0.5 * GAP
    v = np.where(right[:, None], [[-1.0, 0.0, 0.0]], 0.0)
    patch_pairs = patches.pairs(samples.X, v)
    assert np.isfinite(patch_pairs.rate).all()
    assert patch_pairs.until.min() < GAP


@pytest.mark.parametrize("block", [1, 70, 100_000])
@pytest.mark.parametrize("resting", [False, True])
def test_bodies_are_scheduled_as_pair_by_pair(resting: bool, block: int, monkeypatch):
    monkeypatch.setattr("gf_usd.physics.contact.detection.broad_phase.BLOCK", block)
    random = np.random.default_rng(1)
    middle, size = 6.0 * random.random((20, 3)), 0.3 + random.random((20, 3))
    low, high = middle - size, middle + size
    mean, spread = random.normal(size=(20, 3)), random.random(20)
    through = frozenset({(3, 8), (12, 2)})
    still = random.random(20) < 0.5 if resting else None
    reach, spacing, pull = 0.2, 0.1, 9.81
    near, hold = schedule(
        Boxes(low=low, high=high, mean=mean, spread=spread), (),
        ContactSetup(skins=(), through=through), frame=0.0, pull=pull, reach=reach,
        spacing=spacing, still=still,
    )  # fmt: skip
    expected, least = [], np.inf
    for a in range(20):
        for b in range(a):
            if {(a, b), (b, a)} & through or (resting and still[a] and still[b]):
                continue
            gap = box_gap(low[a], high[a], low[b], high[b])
            speed = np.linalg.norm(mean[a] - mean[b]) + spread[a] + spread[b]
            left = max(reach, gap - spacing)
            least = min(least, max(np.roots([0.5 * pull, speed, -left])))
            if gap < reach:
                expected += [(a, b), (b, a)]
    assert near == expected
    assert 0 < len(near) < 20 * 19
    np.testing.assert_allclose(hold, least, rtol=1e-12)  # the roots of a quadratic
