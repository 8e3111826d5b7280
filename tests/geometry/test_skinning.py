"""Skins on particles: exact where they must be, wrong where the paper's is, bounded in memory."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable

import numpy as np
import pytest
import solids
from embedded import pose

from gf_usd.core.arrays import Floats
from gf_usd.core.errors import UsageError
from gf_usd.core.frames.frame import Pose
from gf_usd.geometry.skinning import SKINS, InverseDistance, MeshSkin, PaperSkin, make_skin
from gf_usd.physics.grid.reference.build import build_stencil
from gf_usd.prepare.options.request import Request
from gf_usd.prepare.options.table import OPTIONS

ROUNDING = 1e-12  # positions near 1 in float64, sums of thousands of terms
BALL, _ = solids.ball(500)
VERTICES = solids.sphere(subdivisions=2).points
AFFINE = np.array([[1.3, 0.4, -0.2], [-0.5, 0.8, 0.1], [0.3, 0.2, 1.1]])
RATE = np.array([[0.2, -1.0, 0.4], [0.7, 0.1, 0.3], [-0.6, 0.5, -0.4]])
SHIFT = np.array([3.0, -2.0, 0.5])
DRIFT = np.array([-1.0, 4.0, 2.0])


def affine(A: Floats, dA: Floats, X: Floats = BALL.X) -> Pose:
    """x = A X + SHIFT, v = dA X + DRIFT."""
    return Pose(x=X @ A.T + SHIFT, v=X @ dA.T + DRIFT, F=np.broadcast_to(A, (len(X), 3, 3)))


def symmetric(A: Floats) -> Floats:
    return 0.5 * (A + A.T)


def quarter_turn(axis: Floats) -> Floats:
    a = axis / np.linalg.norm(axis)
    cross = np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])
    return np.outer(a, a) + cross


def distance(a: Floats, b: Floats) -> Floats:
    return np.linalg.norm(a - b, axis=-1)


def test_embedding_is_exact_for_affine_maps() -> None:
    stencil = build_stencil(BALL.X, BALL.V0, 2.0 * BALL.lattice, BALL.corner)
    nodes = affine(AFFINE, RATE, stencil.free_X)
    found = pose(stencil.rows(VERTICES), nodes.x - stencil.free_X, nodes.v, np.zeros(3))
    exact = affine(AFFINE, RATE, VERTICES)
    # Rows of nodes that no particle reaches invert a moment matrix with a condition near 1e3.
    for a, b in ((found.x, exact.x), (found.v, exact.v), (found.F, exact.F)):
        np.testing.assert_allclose(a, b, atol=1e3 * ROUNDING)


def test_idw_is_exact_for_affine_maps() -> None:
    found = InverseDistance(VERTICES, BALL.X).pose(affine(AFFINE, RATE))
    exact = affine(AFFINE, RATE, VERTICES)
    for a, b in ((found.x, exact.x), (found.v, exact.v), (found.F, exact.F)):
        np.testing.assert_allclose(a, b, atol=10 * ROUNDING)


def test_paper_is_exact_for_a_pure_stretch() -> None:
    S, dS = symmetric(AFFINE), symmetric(RATE)
    assert np.linalg.eigvalsh(S).min() > 0.0  # a stretch: its own U
    found = PaperSkin(VERTICES, BALL.X).pose(affine(S, dS))
    exact = affine(S, dS, VERTICES)
    np.testing.assert_allclose(found.x, exact.x, atol=10 * ROUNDING)
    np.testing.assert_allclose(found.v, exact.v, atol=10 * ROUNDING)


def test_paper_leaves_offsets_behind_in_a_turn() -> None:
    particles, _ = solids.ball(2000)
    R = quarter_turn(np.array([1.0, 1.0, 1.0]))
    skin = PaperSkin(VERTICES, particles.X)
    error = distance(
        skin.pose(affine(R, np.zeros((3, 3)), particles.X)).x, affine(R, R, VERTICES).x
    )
    np.testing.assert_allclose(error, distance(skin.offset @ R.T, skin.offset), atol=ROUNDING)
    # In a ball of many particles delta is half a radius, along the normal: docs/physics.md.
    # There are none within about half a spacing, that far the integrals may be off.
    off = 0.5 * particles.spacing
    assert error.mean() == pytest.approx(np.pi * np.sqrt(2.0) / 8.0, rel=off)
    assert error.max() > np.sqrt(0.5) * (1.0 - off)
    idw = InverseDistance(VERTICES, particles.X)
    assert distance(
        idw.pose(affine(R, R, particles.X)).x, affine(R, R, VERTICES).x
    ).max() == pytest.approx(0.0, abs=10 * ROUNDING)


@pytest.mark.parametrize("name", SKINS)
def test_rest_is_kept(name: str) -> None:
    found = make_skin(name, VERTICES, BALL.X).pose(affine(np.eye(3), np.zeros((3, 3))))
    np.testing.assert_allclose(found.x, VERTICES + SHIFT, atol=ROUNDING)
    np.testing.assert_allclose(found.v, np.broadcast_to(DRIFT, VERTICES.shape), atol=ROUNDING)


@pytest.mark.parametrize("name", SKINS)
def test_vertex_on_a_particle_goes_where_it_goes(name: str) -> None:
    rng = np.random.default_rng(1)
    n = len(BALL)
    wild = Pose(x=rng.normal(size=(n, 3)), v=rng.normal(size=(n, 3)), F=rng.normal(size=(n, 3, 3)))
    found = make_skin(name, BALL.X[[7, 123]], BALL.X).pose(wild)
    np.testing.assert_allclose(found.x, wild.x[[7, 123]], atol=ROUNDING)
    np.testing.assert_allclose(found.v, wild.v[[7, 123]], atol=ROUNDING)
    np.testing.assert_allclose(found.F, wild.F[[7, 123]], atol=ROUNDING)


def test_chunks_change_nothing() -> None:
    pose_in = twisting(BALL.X, 1.0)
    row = 8 * len(BALL)
    whole, five, one = (
        PaperSkin(VERTICES, BALL.X, chunk_bytes=size).pose(pose_in)
        for size in (len(VERTICES) * row, 5 * row, 1)
    )
    assert len(VERTICES) % 5  # the last chunk is a short one
    for part in (five, one):
        for name in ("x", "v", "F"):
            # BLAS adds in another order for another shape.
            np.testing.assert_allclose(getattr(part, name), getattr(whole, name), atol=ROUNDING)


@pytest.mark.slow
def test_memory_is_bounded() -> None:
    rng = np.random.default_rng(2)
    X, particles = rng.random((4000, 3)), rng.random((4000, 3))
    dense = 8 * len(X) * len(particles)
    budget = dense // 64
    tracemalloc.start()
    skin = PaperSkin(X, particles, chunk_bytes=budget)
    skin.pose(affine(AFFINE, RATE, particles))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    # 33 columns go in and out, and some copies of 9; the operators have 21 entries a row.  Each
    # chunk passes through half a dozen arrays of its size.
    linear = 8 * (len(X) + len(particles)) * 200
    assert peak < linear + 8 * budget
    assert linear + 8 * budget < dense / 4  # which would not be so, were it held as a whole


def twisting(X: Floats, s: float) -> Pose:
    """A turn about y by the angle s y, exactly: x, v = dx/ds and F."""
    x, y, z = X.T
    c, n = np.cos(s * y), np.sin(s * y)
    at = np.stack([c * x + n * z, y, c * z - n * x], 1)
    v = np.stack([y * at[:, 2], np.zeros_like(y), -y * at[:, 0]], 1)
    zero, one = np.zeros_like(y), np.ones_like(y)
    rows = [[c, s * at[:, 2], n], [zero, one, zero], [-n, -s * at[:, 0], c]]
    F = np.stack([np.stack(row, -1) for row in rows], -2)
    return Pose(x=at, v=v, F=F)


def moving(motion: Callable[[float], Pose], skin: InverseDistance | PaperSkin) -> Floats:
    """Central difference of the skin's positions at s = 1; its own error is near 1e-9."""
    e = 1e-5
    return (skin.pose(motion(1.0 + e)).x - skin.pose(motion(1.0 - e)).x) / (2.0 * e)


@pytest.mark.parametrize("skin", [InverseDistance, PaperSkin])
def test_velocity_is_that_of_the_skin_in_an_affine_motion(skin: type) -> None:
    # Turning, shearing and stretching at once: dF is exact, so dU must be too.
    made = skin(VERTICES, BALL.X)
    found = made.pose(affine(AFFINE, RATE)).v - DRIFT
    expected = moving(lambda s: affine(AFFINE + (s - 1.0) * RATE, RATE), made)
    np.testing.assert_allclose(found, expected, atol=1e-8)


def blend_velocity(skin: InverseDistance | PaperSkin, X: Floats) -> Floats:
    """sum w v_k alone."""
    weights = skin.W if isinstance(skin, InverseDistance) else skin.weights
    return weights @ twisting(X, 1.0).v


@pytest.mark.parametrize("skin", [InverseDistance, PaperSkin])
def test_velocity_is_that_of_the_skin_in_a_twist(skin: type) -> None:
    particles, _ = solids.ball(2000)
    made = skin(VERTICES, particles.X)
    found = made.pose(twisting(particles.X, 1.0))
    expected = moving(lambda s: twisting(particles.X, s), made)
    carried = blend_velocity(made, particles.X)
    rate_term = np.linalg.norm(expected - carried, axis=1).max()
    # Neighbors up to two spacings away, a gradient that changes over a radius: the least squares
    # are off by that ratio, a quarter, at most; without them all of the term would be missing.
    assert 2.0 * particles.spacing < 0.3
    assert distance(found.v, expected).max() < 2.0 * particles.spacing * rate_term


def test_idw_converges_on_a_twist() -> None:
    errors, spacings = [], []
    for count in (500, 4000):
        particles, _ = solids.ball(count)
        skin = InverseDistance(VERTICES, particles.X)
        found = skin.pose(twisting(particles.X, 1.0)).x
        errors.append(distance(found, twisting(VERTICES, 1.0).x).mean())
        spacings.append(particles.spacing)
    order = np.log(errors[0] / errors[1]) / np.log(spacings[0] / spacings[1])
    assert order > 1.7  # second order: exact for affine maps; vertices lie at random distances


def test_meshes_share_a_skin() -> None:
    points = {"/a": VERTICES[:10], "/b": VERTICES[10:11], "/c": VERTICES[11:]}
    moved = twisting(BALL.X, 1.0)
    poses = MeshSkin("idw", points, BALL.X).poses(moved)
    assert list(poses) == ["/a", "/b", "/c"]
    whole = InverseDistance(VERTICES, BALL.X).pose(moved)
    for name in ("x", "v", "F"):
        joined = np.concatenate([getattr(p, name) for p in poses.values()])
        np.testing.assert_array_equal(joined, getattr(whole, name))


def test_names() -> None:
    assert set(OPTIONS["skin"].choices) == {"embed", *SKINS}
    with pytest.raises(UsageError) as refused:
        make_skin("glue", VERTICES, BALL.X)
    assert str(refused.value) == (
        "unknown skin 'glue' on particles\n\nhint: choose one of idw, paper"
    )
    with pytest.raises(UsageError) as refused:
        Request(skin="glue").check()
    assert str(refused.value) == "there is no skin 'glue'\n\nhint: choose embed, idw, paper"
