"""Repairs of how triangles face and of those that enclose nothing, before and after."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from solids import (
    CUBE_POINTS,
    CUBE_TRIANGLES,
    asset,
    cube,
    joined,
    moebius,
    sphere,
    surface,
    turned,
    volume,
    without,
)

from gf_usd.core.errors import InputError
from gf_usd.geometry.diagnosis import diagnose
from gf_usd.geometry.repair import repair_asset, repair_surface
from gf_usd.geometry.solid import build_solid


def test_triangles_against_the_rest_are_turned():
    whole = sphere()
    rng = np.random.default_rng(1)
    rows = rng.choice(len(whole.triangles), 400, replace=False)
    body = turned(whole, rows)
    assert diagnose(body).shells[0].winding == "mixed"
    mended, done = repair_surface(body)
    assert (done.turned, done.turned_parts) == (400, 0)
    assert diagnose(mended).shells[0].winding == "outward"
    assert volume(mended) == pytest.approx(volume(whole), rel=1e-12)
    # The same directions, though a triangle may start at another of its corners.
    assert mended.triangles.shape == whole.triangles.shape
    assert "turned 400 triangles" in done.messages()[0]


@pytest.mark.slow
def test_a_part_that_is_inside_out_is_turned():
    good, bad = sphere(), sphere(radius=0.8, center=(1.2, 0.0, 0.0))  # neither in the other
    body = joined(good, turned(bad, slice(None)))
    assert [s.winding for s in diagnose(body).shells] == ["outward", "inside out"]
    mended, done = repair_surface(body)
    assert (done.turned, done.turned_parts) == (0, 1)
    assert [s.winding for s in diagnose(mended).shells] == ["outward", "outward"]
    # Unmended, the winding numbers cancel where the balls overlap.
    lens = np.array([[0.6, 0.0, 0.0]])
    assert not build_solid(asset(body)).inside(lens)[0]
    assert build_solid(asset(mended)).inside(lens)[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    "flipped",
    [pytest.param(False, marks=pytest.mark.slow), True],
    ids=["outward", "inside out"],
)
def test_a_cavity_stays_a_cavity(flipped):
    hollow = joined(sphere(), turned(sphere(radius=0.6), slice(None)))
    body = turned(hollow, slice(None)) if flipped else hollow
    mended, done = repair_surface(body)
    assert done.cavities == 1
    assert done.turned_parts == (2 if flipped else 0)
    assert volume(mended) == pytest.approx(volume(hollow), rel=1e-12)
    inside = build_solid(asset(mended)).inside(np.array([[0.0, 0.0, 0.0], [0.8, 0.0, 0.0]]))
    assert inside.tolist() == [False, True]


def test_a_solid_inside_a_cavity_faces_outward():
    body = joined(sphere(), turned(sphere(radius=0.7), slice(None)), sphere(radius=0.3))
    _, done = repair_surface(body)
    assert (done.cavities, done.turned_parts) == (1, 0)


def test_a_triangle_that_is_there_twice_is_dropped():
    whole = cube()
    body = surface(whole.points, np.concatenate([whole.triangles, whole.triangles[:3]]))
    assert diagnose(body).duplicates == 3
    mended, done = repair_surface(body)
    assert done.duplicates == 3
    np.testing.assert_array_equal(mended.triangles, whole.triangles)
    assert "dropped triangles: 3 duplicate" in done.messages()[0]


def test_a_body_modeled_with_both_sides_keeps_one():
    whole = sphere()
    body = surface(whole.points, np.concatenate([whole.triangles, whole.triangles[:, ::-1]]))
    with pytest.raises(InputError, match="flat"):
        build_solid(asset(body))
    mended, (done,) = repair_asset(asset(body))
    assert done.other_sides == len(whole.triangles)
    assert build_solid(mended).volume == pytest.approx(volume(whole), rel=1e-12)


def test_a_flap_without_thickness_is_dropped():
    whole = cube()
    points = np.concatenate([whole.points, [[2.0, 2.0, 2.0]]])
    flap = np.array([[1, 3, 8], [3, 1, 8]])
    mended, done = repair_surface(surface(points, np.concatenate([whole.triangles, flap])))
    assert done.walls == 2
    np.testing.assert_array_equal(mended.triangles, whole.triangles)


def test_collapsed_triangles_are_dropped():
    whole = cube()
    # The second is collapsed only once the points that coincide are one.
    points = np.concatenate([whole.points, whole.points[:1]])
    bad = np.array([[0, 1, 1], [0, 8, 5]])
    mended, done = repair_surface(surface(points, np.concatenate([whole.triangles, bad])))
    assert done.collapsed == 2
    np.testing.assert_array_equal(mended.triangles, whole.triangles)


def split_edge(*, sealed: bool):
    """A box with a vertex in the middle of an edge that only one of its faces has."""
    points = np.concatenate([CUBE_POINTS, [[0.5, 0.0, 0.0]]])
    row = CUBE_TRIANGLES.tolist().index([0, 1, 5])  # one triangle at the edge 0-1, made two
    triangles = np.delete(CUBE_TRIANGLES, row, axis=0).tolist() + [[0, 8, 5], [8, 1, 5]]
    return surface(points, triangles + [[0, 1, 8]] if sealed else triangles)


def test_a_sliver_that_holds_a_seam_together_stays():
    body = split_edge(sealed=True)
    assert diagnose(body).slivers == 1
    assert diagnose(body).watertight
    mended, done = repair_surface(body)
    assert mended is body
    assert done.slivers == 0


def test_a_seam_without_its_sliver_gets_one():
    body = split_edge(sealed=False)
    assert not diagnose(body).watertight
    mended, done = repair_surface(body)
    assert (done.holes_closed, done.caps) == (1, 1)
    assert diagnose(mended).watertight


def test_a_loose_sliver_is_dropped():
    whole = cube()
    points = np.concatenate([whole.points, [[3.0, 0.0, 0.0], [4.0, 0.0, 0.0], [5.0, 0.0, 0.0]]])
    body = surface(points, np.concatenate([whole.triangles, [[8, 9, 10]]]))
    mended, done = repair_surface(body)
    assert done.slivers == 1
    np.testing.assert_array_equal(mended.triangles, whole.triangles)


@pytest.mark.parametrize("turned", [(), range(0, 80, 3)])
def test_a_one_sided_strip_has_no_volume_and_no_hole(turned):
    """It had a volume, and boundary edges that "form no closed loop", though they are its rim."""
    body = moebius(turned)
    seen = diagnose(body)
    assert (seen.volume, seen.shells[0].volume, seen.boundary_edges) == (0.0, 0.0, 80)
    _, done = repair_surface(body)
    assert (done.one_sided_edges, done.loose_edges, done.holes_closed) == (80, 0, 0)
    assert done.messages() == (
        "left 80 boundary edges of one-sided strips, which have no inside to close",
    )


def test_the_holes_next_to_a_one_sided_strip_are_closed():
    ball, strip = without(sphere(subdivisions=3), [5]), moebius()
    moved = replace(strip, points=np.asarray(strip.points) + 9.0)
    _, done = repair_surface(joined(ball, moved))
    assert (done.one_sided_edges, done.loose_edges, done.holes_closed) == (80, 0, 1)


def test_a_one_sided_surface_is_no_solid_until_it_is_thick():
    body = moebius()
    assert diagnose(body).shells[0].winding == "one-sided"
    mended, done = repair_surface(body)
    assert done.turned == 0
    for candidate in (body, mended):
        with pytest.raises(InputError):
            build_solid(asset(candidate))
