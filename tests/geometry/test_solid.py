"""Which surfaces bound a solid, how much it holds, and which points lie inside."""

from __future__ import annotations

import pickle

import igl
import numpy as np
import pytest
from solids import CUBE_TRIANGLES, asset, cube, joined, needle, solid, sphere, surface, turned

from gf_usd.core.errors import InputError
from gf_usd.core.mesh.measures import signed_volume
from gf_usd.geometry import solid as module
from gf_usd.geometry.solid import OPEN_FRACTION, PROBES, build_solid, hole_fraction, mean_thickness

# A volume is counted on some 200 000 lattice points; those that cells cut by the surface hold are
# right or wrong at random: the area in cells of edge a, times a^3, to the power of 1/2.  For bodies
# of unit size that is sqrt(3 / a^2) a^3 = 1.7 a^2 = 5e-4, and four times that is allowed.
COUNTED = 2e-3
BVH = igl.FastWindingNumberBVH


def grid_points(low: float, high: float, n: int = 12) -> np.ndarray:
    """(n^3, 3) points off any symmetry plane."""
    axis = low + (high - low) * (np.arange(n) + 0.37) / n
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)


def test_surfaces_inside_others_are_found() -> None:
    core, shell = sphere(0.4, path="/Core"), sphere(1.0, path="/Shell")
    beside = cube((0.8, 0.0, 0.0), 0.3, path="/Beside")  # reaches out of the shell
    # most of its points are inside, but not all of it
    joined = surface(
        np.concatenate([core.points, cube((2.0, 0.0, 0.0)).points]),
        np.concatenate([core.triangles, CUBE_TRIANGLES + len(core.points)]),
        path="/Both",
    )
    assert solid(core, shell, beside, joined).enclosed() == {"/Core"}


def test_a_closed_box_has_its_exact_volume_and_inside():
    body = solid(cube(low=(1.0, 2.0, 3.0), edge=(2.0, 3.0, 0.5)))
    assert body.volume == pytest.approx(3.0, rel=1e-14)
    assert body.embedded == ()
    np.testing.assert_array_equal(body.low, [1, 2, 3])
    np.testing.assert_array_equal(body.high, [3, 5, 3.5])
    X = grid_points(0.5, 6.0)
    inside = ((body.low < X) & (body.high > X)).all(1)
    assert 10 < inside.sum() < len(X)
    np.testing.assert_array_equal(body.inside(X), inside)


@pytest.mark.parametrize(("kept", "built"), [(10**6, 2), (0, 4)])
def test_a_hierarchy_is_built_once_until_it_is_released(
    monkeypatch: pytest.MonkeyPatch, kept: int, built: int
) -> None:
    """Parts of a solid share them; those of small surfaces are not released."""
    monkeypatch.setattr(module, "KEPT", kept)
    made: list[igl.FastWindingNumberBVH] = []

    def counted() -> igl.FastWindingNumberBVH:
        made.append(BVH())
        return made[-1]

    monkeypatch.setattr(igl, "FastWindingNumberBVH", counted)
    body = solid(cube(), cube(low=(2.0, 0.0, 0.0)))
    assert made == [], "the volume of boxes apart is exact"
    X = grid_points(-0.5, 3.5)
    inside = body.inside(X)
    assert inside.sum() > 10
    part = body.part(np.array([1]))
    np.testing.assert_array_equal(part.inside(X), inside & (X[:, 0] > 1.5))
    np.testing.assert_array_equal(body.part(np.array([0])).inside(X), inside & (X[:, 0] < 1.5))
    assert len(made) == 2
    body.release()
    np.testing.assert_array_equal(body.inside(X), inside)
    assert len(made) == built


def test_a_solid_that_was_queried_can_be_pickled():
    """The plan of a bake with pins has one; the native hierarchy cannot be pickled."""
    body, X = solid(cube()), grid_points(-0.5, 1.5)
    inside = body.inside(X)
    again = pickle.loads(pickle.dumps(body))
    np.testing.assert_array_equal(again.inside(X), inside)


def test_an_asset_far_from_the_origin_loses_no_digits():
    # At 1e6 m a float64 has 1e-10 left; volumes are taken about the asset's own center.
    body = solid(cube(low=(1e6, -2e6, 5e5), edge=0.01))
    assert body.volume == pytest.approx(1e-6, rel=1e-6)
    X = np.array([[1e6, -2e6, 5e5]]) + 0.01 * np.array([[0.5, 0.5, 0.5], [1.5, 0.5, 0.5]])
    assert body.inside(X).tolist() == [True, False]


def test_a_surface_that_is_inside_out_has_the_same_inside():
    shape = sphere()
    turned = surface(shape.points, shape.triangles[:, ::-1])
    X = grid_points(-1.2, 1.2)
    assert solid(turned).volume == pytest.approx(solid(shape).volume, rel=1e-14)
    np.testing.assert_array_equal(solid(turned).inside(X), solid(shape).inside(X))


def test_points_are_inside_where_they_are_inside_any_surface() -> None:
    """Each surface is asked only for the points between its ends along an axis."""
    rng = np.random.default_rng(0)
    centers = rng.uniform(0.0, 3.0, (30, 3))
    balls = solid(*(sphere(0.4, c, 1, path=f"/Ball{k}") for k, c in enumerate(centers)))
    X = np.concatenate([rng.uniform(-0.5, 3.5, (5000, 3)), *(b.points for b in balls.surfaces)])
    each = np.array([one.inside(X) for one in balls.bounds])
    np.testing.assert_array_equal(balls.inside(X), each.any(0))
    assert 400 < balls.inside(X).sum() < len(X) - 400
    assert not balls.inside(X[:0]).size


@pytest.mark.slow
def test_spheres_that_overlap_are_counted_once():
    # Two unit spheres 1 m apart share a lens of 5 pi / 12; geodesic ones are smaller by the same
    # share as their volume.
    a, b = sphere(path="/A"), sphere(center=(1.0, 0.0, 0.0), path="/B")
    one = solid(a).volume
    shrunk = one / (4.0 / 3.0 * np.pi)
    body = solid(a, b)
    assert body.volume == pytest.approx(2.0 * one - shrunk * 5.0 * np.pi / 12.0, rel=COUNTED)
    X = grid_points(-1.0, 2.0)
    union = solid(a).inside(X) | solid(b).inside(X)
    np.testing.assert_array_equal(body.inside(X), union)


@pytest.mark.slow
def test_one_mesh_of_two_overlapping_shells_is_counted_once_too():
    a, b = sphere(), sphere(center=(1.0, 0.0, 0.0))
    both = surface(
        np.concatenate([a.points, b.points]),
        np.concatenate([a.triangles, b.triangles + len(a.points)]),
    )
    assert solid(both).volume == pytest.approx(solid(a, b).volume, rel=2.0 * COUNTED)


@pytest.mark.slow
def test_opposite_orientations_of_overlapping_surfaces_do_not_cancel():
    a, b = sphere(path="/A"), sphere(center=(1.0, 0.0, 0.0), path="/B")
    turned = surface(b.points, b.triangles[:, ::-1], path="/B")
    X = grid_points(-1.0, 2.0)
    np.testing.assert_array_equal(solid(a, turned).inside(X), solid(a, b).inside(X))


@pytest.mark.slow
def test_a_few_missing_faces_change_little():
    shape = sphere(subdivisions=3)
    keep = np.ones(len(shape.triangles), bool)
    keep[::50] = False
    holed = surface(shape.points, shape.triangles[keep])
    body = solid(holed)
    assert hole_fraction(holed.points, holed.triangles) == pytest.approx(0.02, abs=0.005)
    # A missing face of area A moves the surface of winding number 1/2 by about sqrt(A) there:
    # 2 % of the area times sqrt(.01) of the radius.
    assert body.volume == pytest.approx(solid(shape).volume, rel=0.02 * 0.1 + COUNTED)
    X = grid_points(-1.2, 1.2)
    r = np.linalg.norm(X, axis=1)
    clear = np.abs(r - 1.0) > 0.15
    np.testing.assert_array_equal(body.inside(X)[clear], (r < 1.0)[clear])


def test_vertices_that_coincide_are_welded_before_holes_are_judged():
    shape = cube()
    loose = surface(shape.points[shape.triangles].reshape(-1, 3), np.arange(36).reshape(-1, 3))
    body = solid(loose)
    assert body.volume == pytest.approx(1.0, rel=1e-14)
    assert body.triangles[0].max() < 36
    assert body.sources[0].tolist() == list(range(12))


def test_collapsed_triangles_are_dropped_and_the_rest_keep_their_rows():
    triangles = np.insert(CUBE_TRIANGLES, 3, [1, 1, 5], axis=0)
    body = solid(surface(cube().points, triangles))
    assert body.sources[0].tolist() == [0, 1, 2, *range(4, 13)]
    assert body.volume == pytest.approx(1.0, rel=1e-14)


@pytest.mark.parametrize(("missing", "share"), [(0, 0.0), (1, 0.5 / 6.0), (2, 1.0 / 6.0)])
def test_hole_fraction_is_the_share_of_the_closed_area(missing, share):
    # Triangles 0 and 1 are one face of the cube; flat fans close what is missing exactly.
    assert hole_fraction(cube().points, CUBE_TRIANGLES[missing:]) == pytest.approx(share)


def test_a_box_without_a_lid_is_a_solid_and_a_sheet_is_not():
    lid = surface(cube().points, CUBE_TRIANGLES[2:], path="/Box")
    assert hole_fraction(lid.points, lid.triangles) < OPEN_FRACTION
    assert solid(lid).embedded == ()
    open_box = surface(cube().points, CUBE_TRIANGLES[4:], path="/Tube")
    assert hole_fraction(open_box.points, open_box.triangles) > OPEN_FRACTION
    body = solid(cube(path="/Solid"), open_box)
    assert [path for path, _ in body.embedded] == ["/Tube"]
    assert [s.path for s in body.surfaces] == ["/Solid"]
    reason = body.embedded[0][1]
    # Two loops of four edges; fans of 2 m^2 next to walls of 4.
    assert "8 boundary edges" in reason
    assert "33 % of the closed area (at most 25 %)" in reason


def cloth(path: str = "/Cloth"):
    points = np.array([[x, 0.0, z] for x in range(4) for z in range(4)], float)
    corner = np.array([4 * i + j for i in range(3) for j in range(3)])
    quads = corner[:, None] + [0, 1, 5, 4]
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return surface(points, triangles, path=path)


def test_cloth_alone_is_refused_in_words():
    with pytest.raises(InputError, match="no mesh encloses a volume") as caught:
        build_solid(asset(cloth()))
    assert "</Cloth>: the surface is open: 12 boundary edges" in caught.value.message
    assert "asset.usda" in caught.value.message
    assert "give the mesh thickness" in caught.value.hint


def test_a_sheet_of_two_sides_in_one_place_is_flat():
    one = cloth()
    there_and_back = surface(
        np.concatenate([one.points, one.points]),
        np.concatenate([one.triangles, one.triangles[:, ::-1] + len(one.points)]),
        path="/Paper",
    )
    with pytest.raises(InputError, match="no mesh encloses") as caught:
        build_solid(asset(there_and_back))
    assert "</Paper>: it is flat: volume 0 m^3 for an area of 18 m^2" in caught.value.message


def test_a_mesh_of_collapsed_faces_is_refused_in_words():
    with pytest.raises(InputError) as caught:
        build_solid(asset(surface(cube().points, np.array([[0, 0, 1], [2, 2, 2]]))))
    assert "</Body>: every face is collapsed" in caught.value.message


def test_every_surface_is_named_where_none_can_be_filled():
    with pytest.raises(InputError) as caught:
        build_solid(asset(cloth("/One"), cloth("/Two")))
    assert "/One" in caught.value.message
    assert "/Two" in caught.value.message


def test_walls_thinner_than_any_probe_are_refused_in_words():
    # Two needles of a tenth of a millimeter along the diagonals of a box of a meter: of 200 000
    # points spread evenly over it about .005 lie in them.
    needles = [needle(1.0, 1e-4, path="/A"), needle(1.0, 1e-4, mirrored=True, path="/B")]
    volume = sum(abs(signed_volume(n.points, n.triangles)) for n in needles)
    assert PROBES * volume < 0.05
    with pytest.raises(InputError, match="tested points is inside") as caught:
        build_solid(asset(*needles))
    assert "2 surfaces" in caught.value.message
    assert "thinner than a hundredth" in caught.value.hint


def test_bodies_apart_have_the_exact_volume_of_their_sum():
    # Of a box of a kilometer around them probes would not meet one.
    balls = [sphere(0.1, center=(1e3 * k, 0.0, 0.0), path=f"/B{k}") for k in range(3)]
    exact = sum(signed_volume(b.points, b.triangles) for b in balls)
    assert build_solid(asset(*balls)).volume == pytest.approx(exact, rel=1e-9)


@pytest.mark.parametrize("gap", [0.0, -1e-7])
def test_bodies_that_touch_have_the_exact_volume_of_their_sum(gap: float):
    """Their boxes have no volume in common but by rounding: it was counted on probes, slowly."""
    boxes = [cube(low=(k * (1.0 + gap), 0.3 * k, 0.0), path=f"/B{k}") for k in range(3)]
    body = solid(*boxes)
    assert body.volume == pytest.approx(3.0, rel=1e-12)


@pytest.mark.parametrize("far", [1e3, 1e4, 1e5])
def test_bodies_that_touch_far_from_the_origin_have_the_exact_volume_of_their_sum(far: float):
    """Points in float32 next to a transform in float64: rounded up, a box reaches into the next."""
    low = far + 0.2  # which is rounded up
    box, other = cube(low=(low, 0.0, 0.0), path="/A"), cube(low=(low + 1.0, 0.0, 0.0), path="/B")
    rounded = surface(box.points.astype(np.float32), box.triangles, path="/A")
    shared = rounded.points[:, 0].max() - other.points[:, 0].min()
    assert 0.0 < shared < 0.01
    assert solid(rounded, other).volume == pytest.approx(2.0, rel=1e-12)


@pytest.mark.parametrize("shift", [0.0, 0.05])
def test_bodies_that_overlap_far_from_the_origin_are_counted_once(shift: float):
    """Also boxes that are no larger than the rounding of float32 there."""
    boxes = [
        cube(low=(1e5 + 0.01 * k * shift, 0.0, 0.0), edge=0.01, path=f"/{k}") for k in range(2)
    ]
    assert solid(*boxes).volume == pytest.approx(1e-6 * (1.0 + shift), rel=COUNTED)


def test_mean_thickness_of_shells_does_not_depend_on_their_winding() -> None:
    plate = cube(edge=(1.0, 1.0, 0.01))
    assert mean_thickness(plate) == pytest.approx(0.02 / 2.04)
    mirrored = surface(plate.points * (-1.0, 1.0, 1.0) - (1.0, 0.0, 0.0), plate.triangles)
    both = joined(plate, mirrored)
    assert both.signed_volume == pytest.approx(0.0, abs=1e-12)
    assert mean_thickness(both) == pytest.approx(0.02 / 2.04)


@pytest.mark.parametrize("inside_out", [False, True])
def test_a_cavity_is_no_part_of_the_thickness(inside_out: bool) -> None:
    outer, inner = cube(edge=1.0), cube((0.1, 0.1, 0.1), 0.8)
    wall = joined(outer, turned(inner, range(12)))
    wall = turned(wall, range(24)) if inside_out else wall
    assert mean_thickness(wall) == pytest.approx(2.0 * (1.0 - 0.8**3) / (6.0 + 6.0 * 0.64))
    # beside another one that is mirrored
    beside = joined(wall, turned(cube((3.0, 0.0, 0.0), 1.0), range(12)))
    expected = 2.0 * (2.0 - 0.8**3) / (12.0 + 6.0 * 0.64)
    assert mean_thickness(beside) == pytest.approx(expected)
