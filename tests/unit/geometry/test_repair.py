"""Each repair, before and after; and that the asset itself is left as it was."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from solids import CUBE_POINTS, CUBE_TRIANGLES, asset, cube, sphere, surface

from gf_usd.errors import InputError
from gf_usd.geometry.diagnosis import HOLE_LIMIT, diagnose
from gf_usd.geometry.repair import notes, repair_asset, repair_surface
from gf_usd.geometry.solid import build_solid
from gf_usd.topology import signed_volume, weld


def without(body, rows):
    """A surface that lacks some of its triangles."""
    kept = np.delete(body.triangles, rows, axis=0)
    return surface(body.points, kept)


def turned(body, rows):
    """A surface with some triangles turned over."""
    triangles = body.triangles.copy()
    triangles[rows] = triangles[rows, ::-1]
    return surface(body.points, triangles)


def joined(*bodies):
    """Several surfaces as the shells of one."""
    first = np.cumsum([0, *(len(b.points) for b in bodies)])
    triangles = [b.triangles + o for b, o in zip(bodies, first)]
    return surface(np.concatenate([b.points for b in bodies]), np.concatenate(triangles))


def volume(body) -> float:
    """Signed volume of the welded triangles."""
    return signed_volume(body.points, weld(body.points)[0][body.triangles])


def around(body, vertex: int) -> np.ndarray:
    """Rows of the triangles about a vertex."""
    return np.flatnonzero((body.triangles == vertex).any(1))


def test_a_sound_surface_is_handed_back_as_it_is():
    body = sphere()
    mended, done = repair_surface(body)
    assert mended is body
    assert not done.changed
    assert done.words() == ()
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
    assert f"closed 1 hole with {ring - 2} triangles" in done.words()[0]


def test_the_authored_mesh_stays_as_it_is():
    whole = sphere()
    body = turned(without(whole, around(whole, 20)), np.arange(50))
    mended, _ = repair_surface(body)
    assert len(mended.triangles) > len(body.triangles)
    for name in ("points", "face_counts", "face_indices", "normals", "path", "type_name"):
        assert getattr(mended, name) is getattr(body, name)


def test_a_cap_takes_colour_uv_and_material_from_what_is_beside_it():
    whole = sphere()
    body = without(whole, around(whole, 20))
    corners = body.triangles.reshape(-1)
    body = replace(
        body,
        # Every value is that of the point, so that a cap's can be told by its corners.
        triangle_colours=body.points[corners].reshape(-1, 3, 3),
        triangle_uvs=body.points[corners, :2].reshape(-1, 3, 2),
        triangle_materials=np.full(len(body.triangles), 4),
    )
    mended, done = repair_surface(turned_like(body, np.arange(7)))
    assert done.caps > 0
    assert len(mended.triangle_colours) == len(mended.triangles)
    np.testing.assert_array_equal(mended.triangle_colours, body.points[mended.triangles])
    np.testing.assert_array_equal(mended.triangle_uvs, body.points[mended.triangles][..., :2])
    np.testing.assert_array_equal(mended.triangle_materials, 4)
    np.testing.assert_array_equal(body.face_indices[mended.triangle_corners], mended.triangles)


def turned_like(body, rows):
    """Turned triangles with all that hangs on their corners."""
    made = {}
    for name in ("triangles", "triangle_corners", "triangle_colours", "triangle_uvs"):
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
    assert "left 1 hole open, the largest 17 %" in done.words()[0]


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
    # that has lost all its neighbours is a shell of its own and stays.
    assert build_solid(mended).volume == pytest.approx(volume(whole), rel=0.01)


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
    assert "turned 400 triangles" in done.words()[0]


def test_a_part_that_is_inside_out_is_turned():
    good, bad = sphere(), sphere(radius=0.8, centre=(1.2, 0.0, 0.0))  # neither in the other
    body = joined(good, turned(bad, slice(None)))
    assert [s.winding for s in diagnose(body).shells] == ["outward", "inside out"]
    mended, done = repair_surface(body)
    assert (done.turned, done.turned_parts) == (0, 1)
    assert [s.winding for s in diagnose(mended).shells] == ["outward", "outward"]
    # Unmended, the winding numbers cancel where the balls overlap.
    lens = np.array([[0.6, 0.0, 0.0]])
    assert not build_solid(asset(body)).inside(lens)[0]
    assert build_solid(asset(mended)).inside(lens)[0]


@pytest.mark.parametrize("flipped", [False, True], ids=["outward", "inside out"])
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
    assert "dropped triangles: 3 duplicate" in done.words()[0]


def test_a_body_modelled_with_both_sides_keeps_one():
    whole = sphere()
    body = surface(whole.points, np.concatenate([whole.triangles, whole.triangles[:, ::-1]]))
    with pytest.raises(InputError, match="flat"):
        build_solid(asset(body))
    mended, (done,) = repair_asset(asset(body))
    assert done.duplicates == len(whole.triangles)
    assert build_solid(mended).volume == pytest.approx(volume(whole), rel=1e-12)


def test_a_flap_without_thickness_is_dropped():
    whole = cube()
    points = np.concatenate([whole.points, [[2.0, 2.0, 2.0]]])
    flap = np.array([[1, 3, 8], [3, 1, 8]])
    mended, done = repair_surface(surface(points, np.concatenate([whole.triangles, flap])))
    assert done.duplicates == 2
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


def moebius():
    """A band with half a twist."""
    n = 40
    t = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
    across = np.stack([np.cos(t / 2) * np.cos(t), np.cos(t / 2) * np.sin(t), np.sin(t / 2)], axis=1)
    middle = np.stack([np.cos(t), np.sin(t), 0.0 * t], axis=1)
    points = np.concatenate([middle - 0.2 * across, middle + 0.2 * across])
    faces = []
    for i in range(n):
        j = (i + 1) % n
        low, high = (j, j + n) if j else (n, 0)
        faces += [[i, low, high], [i, high, i + n]]
    return surface(points, faces)


def test_a_one_sided_surface_is_refused_with_or_without_repair():
    body = moebius()
    assert diagnose(body).shells[0].winding == "one-sided"
    mended, done = repair_surface(body)
    assert done.turned == 0
    for candidate in (body, mended):
        with pytest.raises(InputError):
            build_solid(asset(candidate))


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
    assert notes(repairs) == (
        "</B> repaired for the fill: turned 1 triangle to agree with the rest",
    )
