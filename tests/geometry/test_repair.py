"""Holes closed, before and after; and that the asset itself is left as it was."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from solids import (
    CUBE_POINTS,
    CUBE_TRIANGLES,
    around,
    asset,
    sphere,
    surface,
    turned,
    volume,
    without,
)

from gf_usd.core.errors import InputError
from gf_usd.geometry.diagnosis import HOLE_LIMIT, diagnose
from gf_usd.geometry.repair import notes, repair_asset, repair_surface
from gf_usd.geometry.solid import build_solid


def test_a_sound_surface_is_handed_back_as_it_is():
    body = sphere()
    mended, done = repair_surface(body)
    assert mended is body
    assert not done.changed
    assert done.messages() == ()
    assert notes([done]) == ()


def test_a_small_hole_is_closed_without_a_new_point():
    whole = sphere()
    vertex = 20
    body = without(whole, around(whole, vertex))
    before = diagnose(body)
    assert (len(before.holes), before.watertight) == (1, False)
    mended, done = repair_surface(body)
    after = diagnose(mended)
    assert after.watertight
    ring = len(around(whole, vertex))
    assert (done.holes_closed, done.caps, done.holes_left) == (1, ring - 2, 0)
    assert done.largest_closed == pytest.approx(before.holes[0].share)
    # The cap cuts off a pyramid over the ring: a thousandth of the ball.
    assert volume(mended) == pytest.approx(volume(whole), rel=2e-3)
    assert f"closed 1 hole with {ring - 2} triangles" in done.messages()[0]


def test_the_authored_mesh_stays_as_it_is():
    whole = sphere()
    body = turned(without(whole, around(whole, 20)), np.arange(50))
    mended, _ = repair_surface(body)
    assert len(mended.triangles) > len(body.triangles)
    for name in ("points", "face_counts", "face_indices", "normals", "path", "type_name"):
        assert getattr(mended, name) is getattr(body, name)


def test_a_cap_takes_color_uv_and_material_from_its_neighbors():
    whole = sphere()
    body = without(whole, around(whole, 20))
    corners = body.triangles.reshape(-1)
    body = replace(
        body,
        # Every value is that of the point, so that a cap's can be recognized by its corners.
        triangle_colors=body.points[corners].reshape(-1, 3, 3),
        triangle_uvs=body.points[corners, :2].reshape(-1, 3, 2),
        triangle_materials=np.full(len(body.triangles), 4),
    )
    mended, done = repair_surface(turned_like(body, np.arange(7)))
    assert done.caps > 0
    assert len(mended.triangle_colors) == len(mended.triangles)
    np.testing.assert_array_equal(mended.triangle_colors, body.points[mended.triangles])
    np.testing.assert_array_equal(mended.triangle_uvs, body.points[mended.triangles][..., :2])
    np.testing.assert_array_equal(mended.triangle_materials, 4)
    np.testing.assert_array_equal(body.face_indices[mended.triangle_corners], mended.triangles)


def turned_like(body, rows):
    """Turned triangles with all that hangs on their corners."""
    made = {}
    for name in ("triangles", "triangle_corners", "triangle_colors", "triangle_uvs"):
        values = getattr(body, name).copy()
        values[rows] = values[rows, ::-1]
        made[name] = values
    return replace(body, **made)


def test_a_large_hole_is_left_and_said():
    body = surface(CUBE_POINTS, CUBE_TRIANGLES[2:])  # a box without its lid
    mended, done = repair_surface(body)
    assert mended is body
    assert (done.holes_closed, done.holes_left) == (0, 1)
    assert done.largest_left == pytest.approx(1 / 6)
    assert HOLE_LIMIT < 1 / 6
    assert "left 1 hole open, the largest 17 %" in done.messages()[0]


def test_holes_that_touch_in_a_vertex_are_both_closed():
    whole = sphere()
    fan = around(whole, 20)
    near = whole.triangles[fan]
    # Two triangles about one vertex without a common edge.
    other = next(row for row in fan if len(set(whole.triangles[row]) & set(near[0])) == 1)
    mended, done = repair_surface(without(whole, [fan[0], other]))
    assert (done.holes_closed, done.caps) == (2, 2)
    assert diagnose(mended).watertight
    # The holes were single triangles: their caps are what was there.
    assert volume(mended) == pytest.approx(volume(whole), rel=1e-12)


def test_a_boundary_may_run_along_an_edge_of_three_triangles():
    # A flap stands on the rim of a hole: that edge has two triangles and still is part of the rim.
    whole = sphere()
    gone = around(whole, 20)
    body = without(whole, gone)
    ring = np.setdiff1d(whole.triangles[gone], [20])
    rim = next(
        (a, b)
        for row in body.triangles
        for a, b in zip(row, np.roll(row, -1))
        if a in ring and b in ring
    )
    tip = 1.5 * whole.points[20]
    points = np.concatenate([body.points, [tip]])
    flap = [[rim[0], rim[1], len(body.points)]]
    body = surface(points, np.concatenate([body.triangles, flap]))
    mended, done = repair_surface(body)
    assert done.loose_edges == 0
    assert done.holes_closed >= 1
    assert volume(mended) == pytest.approx(volume(whole), rel=0.02)


@pytest.mark.slow
def test_many_small_holes_no_longer_stand_in_the_way():
    whole = sphere()
    rng = np.random.default_rng(0)
    edges_of = [
        {frozenset(pair) for pair in zip(row, np.roll(row, -1))} for row in whole.triangles.tolist()
    ]
    gone, taken = [], set()
    for row in rng.permutation(len(whole.triangles)).tolist():
        if not edges_of[row] & taken:
            gone.append(row)
            taken |= edges_of[row]
    body = without(whole, gone[:200])
    with pytest.raises(InputError, match="the surface is open"):
        build_solid(asset(body))
    mended, (done,) = repair_asset(asset(body))
    assert done.holes_closed > 150
    # Where holes touch, their rims may be capped together, flatter than the ball was; a triangle
    # that has lost all its neighbors is a shell of its own and stays.
    assert build_solid(mended).volume == pytest.approx(volume(whole), rel=0.01)


def test_open_cloth_stays_refused():
    cloth = surface([[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]], [[0, 2, 1], [0, 3, 2]])
    mended, (done,) = repair_asset(asset(cloth))
    assert (done.holes_left, done.changed) == (1, False)
    with pytest.raises(InputError, match="the surface is open"):
        build_solid(mended)


def test_seams_between_uv_islands_are_no_holes():
    mesh = trimesh.creation.box()
    apart = surface(mesh.vertices[mesh.faces].reshape(-1, 3), np.arange(36).reshape(-1, 3))
    mended, done = repair_surface(apart)
    assert mended is apart
    assert not done.changed


def test_notes_name_the_mesh():
    whole = sphere()
    _, repairs = repair_asset(asset(sphere(path="/A"), replace(turned(whole, [3]), path="/B")))
    assert notes(repairs) == ("</B> repaired for the fill: turned 1 triangle to match the rest",)
