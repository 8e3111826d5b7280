"""The surface of particles: closed, where the material ends, and the same at every run."""

from __future__ import annotations

import numpy as np
import pytest

from gf_usd.core.errors import BakeError
from gf_usd.physics.output.surface import DEPTH, SLOPE, ParticleSurface, reach, surface
from gf_usd.physics.output.surface_kernels import BLOCK, HIGH, LOW

S = 0.1  # [m] spacing
RADIUS = 10.0 * S
# Layers S apart above which a plane lies S / 2: the sum over layers of (k + 1/2) (1 - t^2)^4, t =
# (k + 1/2) S / R, is not the integral.  Planes in other directions have finer layers.
LAYERS = 0.08 * S


def lattice(jitter: float = 0.0) -> np.ndarray:
    """A ball of particles about a middle that is no node of anything."""
    steps = np.arange(-12, 13)
    x = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), -1).reshape(-1, 3) * S
    x += jitter * S * (np.random.default_rng(0).random(x.shape) - 0.5)
    return x[np.linalg.norm(x, axis=1) < RADIUS] + np.array([0.31, -0.17, 5.03])


def drawn(x: np.ndarray, values: np.ndarray | None = None) -> ParticleSurface:
    return surface(x, np.full(len(x), S**3), np.ones((len(x), 1)) if values is None else values)


def edges(found: ParticleSurface) -> np.ndarray:
    t = found.triangles
    return np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])


def volume(found: ParticleSurface) -> float:
    a, b, c = (found.points[found.triangles[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


@pytest.mark.parametrize(
    "x",
    [
        pytest.param(lattice(), id="ball"),
        pytest.param(np.random.default_rng(1).random((2000, 3)), id="cloud"),
        pytest.param(1.5 * np.random.default_rng(2).random((250, 3)), id="spray"),
        pytest.param(np.array([[0.2, 0.3, 0.4]]), id="drop"),
        pytest.param(np.array([[0.0, 0.0, 0.0], [2e4, 0.0, -3e4]]), id="far apart"),
    ],
)
def test_every_edge_has_one_triangle_on_either_side(x: np.ndarray) -> None:
    found = drawn(x)
    once = edges(found)
    _, times = np.unique(once, axis=0, return_counts=True)
    assert (times == 1).all()
    assert {tuple(e) for e in once} == {tuple(e) for e in once[:, ::-1]}
    assert np.array_equal(np.unique(found.triangles), np.arange(len(found.points)))
    assert volume(found) > 0.0, "outside is outside"
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1.0, atol=1e-12)


def test_a_ball_of_particles_has_their_volume() -> None:
    x = lattice()
    whole = len(x) * S**3
    radius = np.cbrt(0.75 / np.pi * whole)
    r = DEPTH * reach(np.full(len(x), S**3))
    f = 1.0 - (1.0 - (HIGH - 1.0) / (HIGH - LOW)) ** 3  # grad x_mean is the identity inside
    chord = (reach(np.full(len(x), S**3)) / BLOCK) ** 2 / (8.0 * radius)
    inside = r * r / (radius * SLOPE) + (1.0 - f) * r / SLOPE + chord
    expected = 1.0 - 3.0 * inside / radius
    assert volume(drawn(x)) / whole == pytest.approx(expected, abs=3.0 * LAYERS / radius)


@pytest.mark.parametrize("jitter", [0.0, 1.0])
def test_a_ball_of_particles_is_drawn_where_it_ends(jitter: float) -> None:
    # What a particle stands for is within half a diagonal of its cell; a jittered one as far off.
    found = drawn(lattice(jitter))
    off = np.linalg.norm(found.points - np.array([0.31, -0.17, 5.03]), axis=1) - RADIUS
    r = DEPTH * reach(np.full(1, S**3))
    bound = 0.5 * np.sqrt(3.0) * S * (1.0 + 0.5 * jitter) + r * r / (RADIUS * SLOPE) + LAYERS
    assert np.abs(off).max() < bound
    # And back: every direction has a vertex within a cell's diagonal of it.
    ways = np.random.default_rng(3).standard_normal((200, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    ball = np.array([0.31, -0.17, 5.03]) + RADIUS * ways
    away = np.linalg.norm(found.points[None] - ball[:, None], axis=-1).min(1)
    assert away.max() < bound + np.sqrt(3.0) * reach(np.full(1, S**3)) / BLOCK


def parts(found: ParticleSurface) -> int:
    from scipy.sparse import coo_matrix

    from gf_usd.core.neighbors import components

    a, b = edges(found).T
    return components(coo_matrix((np.ones(len(a)), (a, b)), shape=(len(found.points),) * 2))[0]


@pytest.mark.parametrize(("apart", "count"), [(1.0, 1), (3.2, 2), (4.0, 2)])
def test_nothing_is_drawn_between_drops(apart: float, count: int) -> None:
    # For two particles e = 6 t^2 / (1 - t^2) in their middle, t = apart / 2 R: HIGH at 3.06 S.
    assert parts(drawn(np.array([[0.0, 0.0, 0.0], [apart * S, 0.0, 0.0]]))) == count


def test_vertices_carry_the_means_of_values_around_them() -> None:
    x = lattice()
    found = drawn(x, np.concatenate([np.full((len(x), 1), 0.3), x], axis=1))
    assert found.interpolated[:, 0] == pytest.approx(0.3, rel=1e-6)
    # The mean of places is r away from where phi is 0; smoothing moves vertices by less than a cell
    away = np.linalg.norm(found.interpolated[:, 1:] - found.points, axis=1)
    r = DEPTH * reach(np.full(1, S**3))
    assert away == pytest.approx(np.full(len(away), r), abs=reach(np.full(1, S**3)) / BLOCK)


def test_the_same_particles_have_the_same_surface_to_the_bit() -> None:
    x = lattice(jitter=1.0)
    one, other = drawn(x), drawn(x.copy())
    for name in ("points", "triangles", "normals", "interpolated"):
        assert getattr(one, name).tobytes() == getattr(other, name).tobytes()


def test_what_is_beyond_every_block_is_refused() -> None:
    with pytest.raises(BakeError, match=r"particle 1 is \d+ surface blocks"):
        drawn(np.array([[0.0, 0.0, 0.0], [1e9, 0.0, 0.0]]))
