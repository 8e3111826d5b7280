"""Filling with particles and spreading contact samples."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree
from solids import CUBE_POINTS, ball, cube, fill, solid, sphere, surface

from gf_usd.core.errors import InputError
from gf_usd.geometry.sampling.contact_samples import sample_surface, thin
from gf_usd.geometry.sampling.filling import SLIVER
from gf_usd.geometry.sampling.particles import (
    LEAST_PARTICLES,
    SIGMA_R,
    SIGMA_T,
    quaternion_from_axis,
    sample_solid,
)
from gf_usd.geometry.sampling.rules import MANY
from gf_usd.geometry.surface import nearest
from gf_usd.physics.grid.reference.build import build_stencil


def sheared(body):
    """A body without any symmetry: no plane of it is one of the grid."""
    turn = np.array([[0.9, 0.3, 0.1], [-0.2, 1.0, 0.25], [0.15, -0.3, 0.8]])
    return surface(body.points @ turn.T, body.triangles)


@pytest.mark.parametrize("wanted", [1000, 8000, 64000])
def test_about_as_many_particles_as_asked_for(wanted):
    particles = sample_solid(solid(sheared(sphere())), particles=wanted, spacing=None, seed=0)
    # A cell that is cut to the share f has 0, 4 or 8 particles for 8 f: each is off by up to 2,
    # evenly spread a standard deviation of 1.15.  The surface, 5 N^(2/3) cubes, cuts 1.5 cells
    # for every four of them.  Three sigma, and 1 % for what that mean leaves out.
    sigma = 1.15 * np.sqrt(1.5 * 5.0 / 4.0 * wanted ** (2.0 / 3.0))
    assert abs(len(particles) - wanted) < 3.0 * sigma + 0.01 * wanted


def test_particles_lie_inside_and_share_the_volume():
    body = solid(sphere(0.3, center=(5.0, -2.0, 1.0)))
    particles, _ = fill(body, 700)
    assert body.inside(particles.X).all()
    assert particles.outside == 0
    assert particles.V0.sum() == pytest.approx(body.volume, rel=1e-12)
    # Four stand for a quarter of a cell at least, and for three quarters at most; eight for those,
    # or for a full cell with the slivers of two sides, a quarter each.
    share = particles.V0 / particles.lattice**3
    assert 8.0 * SLIVER / 4.0 <= share.min() <= 1.0 < share.max() <= 8.0 * MANY / 4.0
    assert particles.volume == pytest.approx(body.volume, rel=1e-12)
    assert particles.spacing == pytest.approx(np.cbrt(body.volume / len(particles)), rel=1e-14)
    assert particles.radius == pytest.approx(0.3, rel=0.01)  # a geodesic sphere is a little less


def test_a_spacing_is_kept_in_place_of_a_number():
    particles = sample_solid(solid(cube()), particles=None, spacing=0.125, seed=0)
    assert len(particles) == 512
    assert particles.lattice == 0.125
    assert particles.spacing == pytest.approx(0.125, rel=1e-12)


def test_full_cells_have_the_points_of_the_gauss_rule():
    particles = sample_solid(solid(cube()), particles=None, spacing=0.1, seed=0)
    place = (particles.X - particles.corner) / particles.lattice
    stratum = np.floor(place).astype(int)
    assert len(np.unique(stratum, axis=0)) == len(particles) == 1000
    # cells are pairs of strata: the Gauss points lie 1 / (2 sqrt 3) of a cell from its middle
    middle = 2.0 * (stratum // 2) + 1.0
    gauss = middle + np.where(stratum % 2, 1.0, -1.0) / np.sqrt(3.0)
    np.testing.assert_allclose(place, gauss, atol=1e-9)
    np.testing.assert_allclose(particles.V0, 0.1**3, rtol=1e-9)


@pytest.mark.parametrize("edge", [(1.0, 1.0, 1.0), (1.2, 0.8, 1.6)])
def test_every_full_cell_of_the_grid_holds_eight(edge):
    particles = sample_solid(solid(cube(edge=edge)), particles=None, spacing=0.1, seed=0)
    h = 2.0 * particles.lattice
    made = build_stencil(particles.X, particles.V0, h, particles.corner)
    counts = np.diff(made.cell_start)
    assert set(counts) == {8}
    assert len(counts) == round(np.prod(edge) / h**3)


def test_full_cells_inside_a_ball_hold_eight_too():
    particles, _ = ball(4000)
    h = 2.0 * particles.lattice
    made = build_stencil(particles.X, particles.V0, h, particles.corner)
    base, _ = made.base(particles.X[made.order[made.cell_start[:-1]]])
    center = made.origin + h * (base + 1)  # cells lie about the middle one of their nodes
    deep = np.linalg.norm(center, axis=1) < 0.97 - h * np.sqrt(3.0) / 2.0
    assert deep.sum() > 100
    assert set(np.diff(made.cell_start)[deep]) == {8}


def test_the_points_are_the_same_each_time_and_draws_follow_the_seed():
    one, again, other = (ball(300, seed=s) for s in (4, 4, 5))
    for a, b, c in zip(one, again, other):
        for name in a.__dataclass_fields__:
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
            np.testing.assert_array_equal(getattr(a, name), getattr(c, name))
    body = solid(sphere())
    drawn = [
        sample_solid(body, particles=300, spacing=None, seed=s, uniform=True).X for s in (4, 4, 5)
    ]
    np.testing.assert_array_equal(drawn[0], drawn[1])
    assert not np.array_equal(drawn[0], drawn[2])


def test_the_lattice_is_centered_on_the_asset():
    # Mirror images get mirrored lattices: a symmetric asset is filled evenly on both sides.
    particles = sample_solid(solid(cube(edge=1.0)), particles=None, spacing=0.3, seed=0)
    middle = particles.corner + 0.5 * 0.6 * np.ceil(1.0 / 0.6)
    np.testing.assert_allclose(middle, 0.5, atol=1e-12)


def test_rest_gaussians_are_discs_along_the_nearest_surface():
    particles, _ = ball(500)
    s = particles.spacing
    np.testing.assert_allclose(
        particles.scale, np.tile(s * np.array([SIGMA_R, SIGMA_T, SIGMA_T]), (len(particles), 1))
    )
    assert SIGMA_R < 0.5 * SIGMA_T
    w, x, y, z = particles.orientation.T
    axis = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)], 1)
    r = np.linalg.norm(particles.X, axis=1)
    outer = r > 0.5
    # Facets of the geodesic sphere turn by up to 5 degrees, and the nearest one of a point inside
    # is not the one on its ray.
    along = (axis * particles.X).sum(1)[outer] / r[outer]
    assert along.min() > np.cos(np.radians(10.0))


def test_the_orientation_takes_its_first_axis_to_the_normal():
    n = np.random.default_rng(0).normal(size=(100, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    n = np.concatenate([n, np.eye(3), -np.eye(3)])
    q = quaternion_from_axis(n)
    w, x, y, z = q.T
    axis = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)], 1)
    # 1 + n_x loses half the digits near -1, where the shortest turn is not unique anyway.
    np.testing.assert_allclose(axis, n, atol=1e-7)
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0, atol=1e-15)


def test_uniform_sampling_gives_exactly_as_many_as_asked_for():
    body = solid(sphere())
    particles = sample_solid(body, particles=120, spacing=None, seed=0, uniform=True)
    assert len(particles) == 120
    assert body.inside(particles.X).all()
    # One third of the volume within .69 r: 40 of 120, 3 sigma = 15.
    assert abs((np.linalg.norm(particles.X, axis=1) < 0.693).sum() - 40) < 16


def test_too_few_particles_are_refused_in_words():
    with pytest.raises(InputError) as caught:
        sample_solid(solid(cube()), particles=None, spacing=0.5, seed=0)
    message = "only 8 particles fit at a spacing of 50 cm into 1 m³ (at least 16)"
    assert caught.value.message == message
    assert LEAST_PARTICLES == 16
    assert caught.value.hint == "lower --spacing or raise --particles"


def test_too_many_particles_are_refused_before_any_is_made():
    with pytest.raises(InputError, match="1e\\+09 particles") as caught:
        sample_solid(solid(cube()), particles=None, spacing=0.001, seed=0)
    assert caught.value.hint == "raise --spacing or lower --particles"


def test_contact_samples_stand_for_the_whole_surface():
    body = solid(sphere())
    samples = sample_surface(body, 0.15)
    a, b, c = np.moveaxis(body.surfaces[0].points[body.triangles[0]], 1, 0)
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
    assert samples.area.sum() == pytest.approx(area, rel=1e-12)
    assert samples.area.min() > 0.0
    # Each end of every axis has its share: sum a x = 0 to the scatter of 12 draws a sample.
    scatter = 3.0 * area / np.sqrt(12.0 * area / 0.15**2)
    assert np.abs(samples.area @ samples.X).max() < scatter


def test_contact_samples_are_spread_and_leave_no_gap():
    spacing = 0.15
    body = solid(sphere())
    samples = sample_surface(body, spacing)
    tree = cKDTree(samples.X)
    assert tree.query(samples.X, k=2)[0][:, 1].min() >= 0.7 * spacing * (1.0 - 1e-12)
    # Every candidate has a kept one within .7 s, and with 12 candidates to s^2 no place is farther
    # than a third of s or so from a candidate.
    d = np.random.default_rng(1).normal(size=(4000, 3))
    on = d / np.linalg.norm(d, axis=1, keepdims=True)
    assert tree.query(on)[0].max() < 1.25 * spacing
    assert (np.abs(np.linalg.norm(samples.X, axis=1) - 1.0) < 0.02).all()


def test_contact_samples_lie_on_the_surface():
    # Facets of an icosahedron: what lies off a triangle lies off the surface by up to .2 r.
    body = solid(sphere(subdivisions=0))
    samples = sample_surface(body, 0.2)
    assert nearest(body, samples.X).distance.max() < 1e-12


def test_sharp_corners_feel_the_floor():
    samples = sample_surface(solid(cube(edge=2.0)), 0.3)
    near = cKDTree(samples.X).query(2.0 * CUBE_POINTS)[0]
    np.testing.assert_allclose(near, 0.0, atol=1e-12)


def test_contact_samples_of_several_surfaces_share_one_spacing():
    body = solid(cube(path="/A"), cube(low=(3.0, 0.0, 0.0), edge=2.0, path="/B"))
    samples = sample_surface(body, 0.25)
    assert samples.area.sum() == pytest.approx(6.0 + 24.0, rel=1e-12)
    small = samples.X[:, 0] < 2.0
    # Area by the nearest candidates: a fifth of 12 / .0625 = 5760 draws, 3 sigma.
    assert samples.area[small].sum() == pytest.approx(6.0, rel=0.01)


def test_thinning_keeps_the_first_of_each_crowd():
    points = np.array([[0.0, 0, 0], [0.5, 0, 0], [1.1, 0, 0], [1.2, 0, 0], [9.0, 0, 0]])
    assert thin(points, 1.0).tolist() == [0, 2, 4]


def test_thinning_leaves_no_hole_behind_a_point_that_was_dropped_itself():
    # .5 gives way to 1.2, so that 0, which .5 would have excluded, has to stay.
    points = np.array([[1.2, 0, 0], [0.5, 0, 0], [0.0, 0, 0]])
    assert thin(points, 1.0).tolist() == [0, 2]


@pytest.mark.parametrize("radius", [0.03, 0.1, 0.4])
def test_thinning_spaces_the_kept_and_covers_the_rest(radius):
    points = np.random.default_rng(2).random((2000, 3))
    kept = thin(points, radius)
    tree = cKDTree(points[kept])
    assert tree.query(points[kept], k=2)[0][:, 1].min() > radius
    assert tree.query(points)[0].max() <= radius


@pytest.mark.parametrize("gap", [0.1, 0.4])
def test_both_walls_of_a_narrow_gap_have_samples_of_their_own(gap):
    """Two boxes, one above the other, with less than the distance of two samples between them."""
    spacing = 0.2
    low, high = cube(path="/A"), cube(low=(0.1, 1.0 + gap * spacing, 0.2), edge=1.2, path="/B")
    samples = sample_surface(solid(low, high), spacing)
    of = samples.X[:, 1] > 1.0 + 0.5 * gap * spacing
    flat = [0.1, 0.2] + [0.9, 0.8] * np.random.default_rng(3).random((2000, 2))
    for side, y, edge in ((~of, 1.0, 1.0), (of, 1.0 + gap * spacing, 1.2)):
        tree = cKDTree(samples.X[side])
        assert tree.query(samples.X[side], k=2)[0][:, 1].min() >= 0.7 * spacing * (1.0 - 1e-12)
        # 0.7 from a candidate to a sample, a third of a spacing from a place to a candidate.
        assert tree.query(np.insert(flat, 1, y, axis=1))[0].max() < (0.7 + 1 / 3) * spacing
        # Of walls across the edges of the gap, 4 m, a sample may have what is nearest to it.
        assert samples.area[side].sum() == pytest.approx(6.0 * edge**2, abs=4.0 * 0.35 * spacing)


def test_thinning_keeps_both_walls_of_a_gap_and_not_both_sides_of_a_sheet():
    points = np.array([[0.0, 0, 0], [0.2, 0, 0.1], [0.1, 0, 0.1], [0.3, 0, -0.1], [0.4, 0, 0.1]])
    normal = np.array([[0.0, 0, 1], [0, 0, -1], [0, 0.6, -0.8], [0, 0, -1], [0, 0, 0]])
    # The second is ahead of the first, which it looks at; the fourth is behind it, the third beside
    # the second, and the last has no side.
    assert thin(points, 1.0, normal).tolist() == [0, 1]
    assert thin(points, 1.0).tolist() == [0]


def test_thinning_nothing_and_a_crowd_in_one_place():
    assert thin(np.zeros((0, 3)), 1.0).tolist() == []
    assert thin(np.ones((50, 3)), 1.0).tolist() == [0]


def test_what_flows_is_at_random_places_below_its_outermost_layer() -> None:
    """Of two cubes the second flows: seen along an axis, its rows no longer hide each other."""
    low = np.array([3.0, 0.0, 0.0])
    body = solid(cube(), cube(low))
    plain = sample_solid(body, particles=2000, spacing=None, seed=1)
    flowing = np.array([False, True])
    made = sample_solid(body, particles=2000, spacing=None, seed=1, scattered=flowing)
    again = sample_solid(body, particles=2000, spacing=None, seed=1, scattered=flowing)
    other = sample_solid(body, particles=2000, spacing=None, seed=2, scattered=flowing)
    np.testing.assert_array_equal(made.X, again.X)
    assert (made.X != other.X).any()
    np.testing.assert_array_equal(made.V0, plain.V0)
    moved = (made.X != plain.X).any(1)
    assert moved.any()
    assert (plain.surface[moved] == 1).all()
    a = plain.lattice
    depth = np.minimum(plain.X - low, low + 1.0 - plain.X).min(1)
    np.testing.assert_array_equal(moved[plain.surface == 1], depth[plain.surface == 1] > a)
    assert np.abs(made.X - plain.X).max() <= 0.5 * a
    assert body.inside(made.X).all()
    columns = [len(np.unique(np.round(p.X[moved][:, :2] / a, 6), axis=0)) for p in (plain, made)]
    assert columns[1] == moved.sum() > 5 * columns[0]


def test_what_flows_is_at_the_same_places_whichever_axis_is_up() -> None:
    turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    tall = cube(edge=(1.0, 1.5, 0.8))
    wide = surface(tall.points @ turn, tall.triangles)
    flowing = np.array([True])
    one, other = (
        sample_solid(solid(body), particles=2000, spacing=None, seed=3, up=up, scattered=flowing).X
        for body, up in ((tall, "Y"), (wide, "Z"))
    )
    np.testing.assert_allclose(one @ turn, other, atol=1e-12)
