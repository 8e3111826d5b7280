"""The closed surface around captures whose true surface is known."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from captures import COLOR, ball, facing, sphere_directions, together
from slow_parameters import longest_but

from gf_usd.core.asset import Asset, Splats, StageFacts
from gf_usd.core.errors import InputError
from gf_usd.core.mesh.measures import signed_volume
from gf_usd.core.mesh.topology import boundary_edges, shells
from gf_usd.core.radiance import srgb_to_linear
from gf_usd.core.units import StageUnits
from gf_usd.geometry import splat_hull
from gf_usd.geometry.diagnosis import diagnose
from gf_usd.geometry.solid import build_solid
from gf_usd.geometry.splat_hull import RESOLUTION, hull, with_hulls

BALL = 4.0 / 3.0 * np.pi * 0.5**3
CELL = 1.0 / RESOLUTION  # of a ball of width 1
# A tenth of the centers lie outside, on a surface that is smoothed over a cell: it is within half
# a cell of the true one.
NEAR = 0.5 * CELL


def volume(surface):
    return signed_volume(surface.points, surface.triangles)


def off(surface, radius=0.5):
    """[m] from the sphere of a radius, of every point."""
    return np.abs(np.linalg.norm(surface.points, axis=1) - radius)


@pytest.mark.slow
def test_a_hollow_ball_is_closed_and_filled():
    surface, notes = hull(ball(2000), up=1)
    assert len(boundary_edges(surface.triangles)) == 0
    assert shells(surface.triangles).max() == 0
    assert diagnose(surface).collapsed == 0
    assert off(surface).max() < NEAR
    # a layer of half a cell all around, at most
    assert volume(surface) == pytest.approx(BALL, rel=3 * NEAR / 0.5)
    assert [n for n in notes if "2000 of 2000 Gaussians" in n]
    assert surface.path == "/ball"


@pytest.mark.slow
def test_it_has_the_colors_of_the_capture():
    surface, _ = hull(ball(500), up=1)
    assert surface.triangle_colors is not None
    expected = np.broadcast_to(srgb_to_linear(np.array(COLOR)), surface.triangle_colors.shape)
    np.testing.assert_allclose(surface.triangle_colors, expected, atol=1e-6)


def test_sparse_discs_are_closed():
    """Discs of a fifth of their spacing leave gaps of several cells."""
    rest = ball(400)
    sparse = replace(rest, scales=0.25 * rest.scales)
    surface, notes = hull(sparse, up=1)
    assert volume(surface) == pytest.approx(BALL, rel=0.1)  # two cells all around would be 0.12
    assert any("closed" in note for note in notes)


@pytest.mark.slow
def test_the_size_does_not_matter():
    big, _ = hull(ball(800, radius=500.0), up=1)
    assert volume(big) == pytest.approx(BALL * 1e9, rel=3 * NEAR / 0.5)


def torus(count=6000, large=1.0, small=0.3):
    rng = np.random.default_rng(0)
    u, v = rng.random((2, count)) * 2 * np.pi
    keep = rng.random(count) < (large + small * np.cos(v)) / (large + small)
    u, v = u[keep], v[keep]
    out = np.stack([np.cos(u) * np.cos(v), np.sin(v), np.sin(u) * np.cos(v)], axis=1)
    around = np.stack([np.cos(u), 0 * u, np.sin(u)], axis=1)
    n = len(u)
    return Splats(
        positions=large * around + small * out,
        orientations=facing(out),
        scales=np.tile([0.04, 0.04, 0.01], (n, 1)),
        opacities=np.ones(n),
        harmonics=np.zeros((n, 1, 3)),
        path="/torus",
    )


@pytest.mark.slow
def test_a_ring_keeps_its_hole():
    surface, _ = hull(torus(), up=1)
    # V - E + F = 2 - 2 g for a closed surface of genus g; here E = 3 F / 2
    points = len(np.unique(surface.triangles))
    assert points - len(surface.triangles) // 2 == 0
    # within half a cell of 2.6 / 96, as above, of a tube of radius 0.3
    cell = 2.6 / RESOLUTION
    assert volume(surface) == pytest.approx(2 * np.pi**2 * 0.3**2, rel=2 * 0.5 * cell / 0.3)


def open_below(count=3000, height=0.9):
    """A tall hollow cylinder with a lid and no bottom, as an object on a table is captured."""
    rng = np.random.default_rng(1)
    angle = rng.random(count) * 2 * np.pi
    side = np.stack([np.cos(angle), np.sin(angle), rng.random(count)], axis=1)
    lid = rng.random(count) < 0.25
    out = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    place = 0.4 * out + side * [0, 0, height]
    place[lid] = 0.4 * out[lid] * np.sqrt(rng.random((lid.sum(), 1))) + [0, 0, height]
    place[~lid, :2] = 0.4 * out[~lid, :2]
    out[lid] = [0, 0, 1]
    return Splats(
        positions=place,
        orientations=facing(out),
        scales=np.tile([0.03, 0.03, 0.005], (count, 1)),
        opacities=np.ones(count),
        harmonics=np.zeros((count, 1, 3)),
        path="/cup",
    )


@pytest.mark.slow
@pytest.mark.acceptance
def test_what_is_open_below_is_closed_flat():
    surface, notes = hull(open_below(), up=2)
    assert any("its open bottom" in note for note in notes)
    # half a cell of the sides, the lid and the bottom
    cell = 0.9 / RESOLUTION
    assert volume(surface) == pytest.approx(np.pi * 0.4**2 * 0.9, rel=3 * cell / 0.4)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("axis", "end", "level"),
    longest_but(
        product((0, 1), (-1.0, 1.0), (0.35, 0.45)),
        (0, 1.0, 0.35),
        (1, -1.0, 0.35),
    ),
)
def test_a_missing_side_is_closed_flat(axis, end, level):
    """A ball that stood on a table, or of which no camera saw one side."""
    rest = ball(5000)
    kept = np.flatnonzero(end * rest.positions[:, axis] < level)
    surface, notes = hull(rest.take(kept), up=1)
    high = 0.5 - level
    cap = np.pi * high**2 * (1.5 - high) / 3.0
    # from flat to the whole ball, and half a cell of an area of 3.1 all around, as above
    assert BALL - cap - 3 * NEAR < volume(surface) < BALL * (1 + 3 * NEAR / 0.5)
    assert any("a missing side was closed with a flat face" in note for note in notes)


@pytest.mark.slow
def test_what_is_no_part_of_the_body_is_set_aside():
    rest = ball(2000)
    far = replace(rest.take(np.arange(3)), positions=np.array([[9, 0, 0], [0, 9, 0], [0, 0, -9.0]]))
    island = replace(ball(30, radius=0.02), positions=ball(30, radius=0.02).positions + 0.7)
    haze = replace(rest.take(np.arange(40)), opacities=np.full(40, 0.05))
    giant = replace(rest.take(np.arange(2)), scales=np.full((2, 3), 3.0))
    everything = together(rest, far, island, haze, giant)
    surface, notes = hull(everything, up=1)
    assert off(surface).max() < NEAR
    text = "\n".join(notes)
    assert f"40 of {len(everything)} Gaussians are faint" in text
    assert "3 of 2075 Gaussians are strays" in text
    assert "2 of 2075 Gaussians are giants" in text
    assert "30 of 2075 Gaussians are islands" in text
    # they ride all the same, those outside on the nearest point of the surface
    assert surface.splats is not None
    assert len(surface.splats) == len(everything)
    carriers = surface.splats.embedded_points
    np.testing.assert_allclose(carriers[2000], [0.5, 0, 0], atol=NEAR)
    np.testing.assert_array_equal(carriers[:2000], everything.points[:2000])


def facts():
    return StageFacts(
        path=Path("x.usda"), units=StageUnits(), up_axis="Y", time_codes_per_second=None,
        start_time_code=None, end_time_code=None, root_prims=("/ball",), default_prim="/ball",
    )  # fmt: skip


@pytest.mark.slow
def test_an_asset_gets_one_for_each_capture():
    other = replace(ball(500, radius=0.25), path="/other", to_world=np.diag([2.0, 2.0, 2.0, 1.0]))
    asset = with_hulls(Asset(facts=facts(), surfaces=(), splats=(ball(500), other)))
    assert [s.path for s in asset.surfaces] == ["/ball", "/other"]
    assert asset.splats == ()
    # the second is as large as the first where its prim stands
    assert off(asset.surfaces[1]).max() < 2 * NEAR
    assert [n.split(":")[0] for n in asset.facts.notes] == ["</ball>", "</other>"]
    assert build_solid(asset).volume == pytest.approx(BALL, rel=0.1)


@pytest.mark.slow
def test_cells_grow_where_too_many_would_be_looked_at(monkeypatch):
    rest = ball(800)
    few = 2_000_000
    monkeypatch.setattr(splat_hull, "PAIRS", few)
    grid, rho = splat_hull.field(rest.points, rest.axes, rest.opacities, 0.03)
    assert grid.h > 1.0 / RESOLUTION
    longest = rest.scales.max()
    reach = np.ceil(splat_hull.REACH * np.hypot(longest, 0.5 * grid.h) / grid.h)
    assert 800 * (2 * reach + 1) ** 3 <= few
    assert rho.shape == grid.shape
    surface, _ = hull(rest, up=1)
    assert volume(surface) == pytest.approx(
        BALL, rel=3 * 0.5 * grid.h / 0.5
    )  # half a cell, as above


def test_too_few_are_refused():
    with pytest.raises(InputError, match="9 of its 9 Gaussians can bound a body"):
        hull(ball(9), up=1)
    haze = replace(ball(800), opacities=np.full(800, 0.01))
    with pytest.raises(InputError, match="0 of its 800 Gaussians can bound a body"):
        hull(haze, up=1)


@pytest.mark.slow
def test_the_same_discs_in_bytes_give_the_same_surface():
    """Formats round opacities to bytes: the surface does not hang on that."""
    rest = ball(500)
    a, _ = hull(rest, up=1)
    b, _ = hull(replace(rest, opacities=rest.opacities - 1e-4), up=1)
    np.testing.assert_array_equal(a.points, b.points)


@pytest.mark.slow
def test_a_solid_cloud_needs_no_filling():
    """Gaussians all through the body, as gf-usd itself makes them."""
    rng = np.random.default_rng(3)
    count = 4000
    inside = sphere_directions(count) * (0.5 * rng.random((count, 1)) ** (1 / 3))
    cloud = Splats(
        positions=inside,
        orientations=np.tile([1.0, 0, 0, 0], (count, 1)),
        scales=np.full((count, 3), 0.03),
        opacities=np.ones(count),
        harmonics=np.zeros((count, 1, 3)),
        path="/cloud",
    )
    surface, _ = hull(cloud, up=1)
    # a tenth of the centers are outside: r = 0.9^(1/3) of the ball at most
    assert volume(surface) == pytest.approx(0.9 * BALL, rel=0.1)
    assert shells(surface.triangles).max() == 0
