"""What samples of a folded body face, against sorting all pairs and libigl."""

from __future__ import annotations

import igl
import numpy as np
import pytest
from two_legs import SPACING, legs, sampled

from gf_usd.core.arrays import Floats, Ints
from gf_usd.physics.contact.distance.closest import (
    LEAST,
    NORMAL,
    PSEUDO,
    SEED,
    TIES,
    TRIANGLE,
    WEIGHTS,
)
from gf_usd.physics.contact.self_contact.search import ASIDE, SEE, TURN, WIDEST, SelfContact

GAP = 0.3  # [m] between the legs at rest
REACH = 2.5 * SPACING


@pytest.fixture(scope="module")
def own() -> SelfContact:
    skin, samples = sampled(legs(GAP))
    assert samples.normal is not None
    return SelfContact(skin, samples.X, samples.normal, SPACING)


def folded(own: SelfContact, left: float) -> Floats:
    """The samples with the right leg sheared over, and all of them out of line."""
    X = own._X
    y = np.clip((X[:, 1] - 0.2) / 1.0, 0.0, 1.0)
    over = np.where(X[:, 0] > 0.4 + 0.5 * GAP, (GAP - left) * y, 0.0)
    stir = 0.1 * SPACING * np.random.default_rng(0).normal(size=X.shape)
    return X - np.stack([over, 0.0 * over, 0.0 * over], 1) + stir


def near(own: SelfContact) -> Ints:
    """(n, n) whether samples are near each other at rest."""
    n = len(own._X)
    i, j = np.divmod(np.arange(n * n), n)
    return own._mesh[1].near(i, j).reshape(n, n)


def normals(own: SelfContact, x: Floats) -> Floats:
    triangles = own._mesh[0].triangles.astype(np.int64)
    return igl.per_vertex_normals(x, triangles, igl.PER_VERTEX_NORMALS_WEIGHTING_TYPE_ANGLE)


def seeds_of(own: SelfContact, x: Floats, n: Floats, close: Ints, i: int) -> Ints:
    """Of the eight that face a sample most those that are not near it, by their distance."""
    away = np.linalg.norm(x - x[i], axis=1)
    both = away**2 + (TURN * SPACING) ** 2 * ((n[i] + n) ** 2).sum(1)
    both[(n @ n[i] >= 0.0) | (both >= (WIDEST * SPACING) ** 2)] = np.inf
    most = np.argsort(both, kind="stable")[:8]
    most = most[np.isfinite(both[most]) & ~close[i, most]]
    return most[np.lexsort((most, away[most]))][:3]


@pytest.mark.slow
@pytest.mark.parametrize("left", [0.05, 0.2, -0.05])
def test_the_closest_place_is_on_a_triangle_at_the_opposite_samples(
    own: SelfContact, left: float
) -> None:
    x, close = folded(own, left), near(own)
    every = np.ones(len(x), bool)
    found, which = own._closest(x, ~every, every, REACH)
    n = normals(own, x)
    np.testing.assert_allclose(found[:, NORMAL : NORMAL + 3], n, atol=1e-9)
    mesh, faced = own._mesh[0], 0
    face = np.cross(*(x[mesh.triangles[:, k]] - x[mesh.triangles[:, 0]] for k in (1, 2)))
    face /= np.linalg.norm(face, axis=1, keepdims=True)
    for i in range(len(x)):
        seeds = seeds_of(own, x, n, close, i)
        assert which[i, SEED] == (seeds[0] if len(seeds) else -1)
        triangles = np.unique(mesh.around[seeds])
        triangles = triangles[triangles >= 0]
        triangles = triangles[face[triangles] @ n[i] < ASIDE]
        triangles = triangles[~close[i, mesh.triangles[triangles]].any(1)]
        if not len(seeds) or np.linalg.norm(x[i] - x[seeds[0]]) >= REACH or not len(triangles):
            assert which[i, TRIANGLE] == -1
            continue
        faced += 1
        corners = mesh.triangles[triangles].astype(np.int64)
        square = np.asarray(igl.point_mesh_squared_distance(x[i : i + 1], x, corners)[0]).item()
        assert found[i, LEAST] == pytest.approx(np.sqrt(square), abs=1e-12)
        assert which[i, TRIANGLE] in triangles
        w = found[i, WEIGHTS:PSEUDO]
        place = w @ x[mesh.triangles[which[i, TRIANGLE]]]
        # of places that are as near, to a millionth of a spacing, the one of the first triangle
        assert np.linalg.norm(x[i] - place) == pytest.approx(found[i, LEAST], abs=1e-6 * SPACING)
        assert found[i, PSEUDO:LEAST] @ n[i] < ASIDE * np.linalg.norm(found[i, PSEUDO:LEAST]) + 0.1
    assert faced > 20


def test_samples_with_an_opposite_one_ahead_search_and_so_do_these(own: SelfContact) -> None:
    x, close = folded(own, 0.1), near(own)
    every = np.ones(len(x), bool)
    which = own._closest(x, every, ~every, REACH)[1]
    whole = own._closest(x, ~every, every, REACH)[1]
    radius = SEE * SPACING
    center = x + radius * normals(own, x)
    inside = np.linalg.norm(x[None] - center[:, None], axis=2) < radius - 1e-6 * SPACING
    far = inside & ~close
    wanted = far.any(1) | far.any(0) | (inside.sum(1) >= 8)
    assert 0 < wanted.sum() < len(x)
    np.testing.assert_array_equal(which[:, SEED], np.where(wanted, whole[:, SEED], -1))
    assert (own._closest(x, ~every, ~every, REACH)[1][:, SEED] == -1).all()


def test_a_body_that_flies_apart_has_few_cells(own: SelfContact) -> None:
    x = own._X.copy()
    x[0] += 1e12
    found, which = own._closest(x, np.ones(len(x), bool), np.zeros(len(x), bool), REACH)
    assert np.isfinite(found[:, NORMAL : NORMAL + 3]).all()
    assert which[0, TRIANGLE] == -1


@pytest.mark.parametrize(("length", "kept"), [(1.0, True), (1e-17, False), (0.0, False)])
def test_a_sample_exactly_between_opposite_faces_has_no_plane(
    own: SelfContact, length: float, kept: bool
) -> None:
    """The normal of such a plane was 0, and a chair with a double-sided seat became nan."""
    x, mesh = own._X.copy(), own._mesh[0]
    triangle = next(
        t for t, corners in enumerate(mesh.triangles) if not own._mesh[1].near(0, corners).any()
    )
    x[0] = x[mesh.triangles[triangle]].mean(0)
    found = np.zeros((1, PSEUDO + 4))
    found[0, WEIGHTS:PSEUDO], found[0, PSEUDO], found[0, LEAST] = 1.0 / 3.0, length, 0.0
    which = np.full((1, 3), -1, np.int32)
    which[0, TRIANGLE], which[0, TIES] = triangle, 2
    seen = own._sided(np.array([0]), found, which, x, x, np.zeros(len(x)))
    assert seen.rows.tolist() == [0] * kept
    assert np.allclose(np.linalg.norm(seen.normal, axis=1), 1.0)
