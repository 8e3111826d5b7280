"""What a region holds: boxes, volumes and patches."""

from __future__ import annotations

import numpy as np
import pytest
from solids import asset, cube, solid, sphere, surface

from gf_usd.core.errors import InputError, UsageError
from gf_usd.core.stage import Region
from gf_usd.geometry.regions import box_region, make_pin, make_rigid, parse_box
from gf_usd.geometry.repair import repair_asset
from gf_usd.geometry.solid import build_solid
from gf_usd.geometry.thin.thicken import thicken_asset

NONE = np.zeros((0, 3))
STILL = np.zeros((1, 0, 3))


def test_a_box_is_read_in_stage_units_whatever_the_order_of_its_corners() -> None:
    low, high = parse_box("box:10,0,-5,-10,20,5", 0.01)
    np.testing.assert_allclose((low, high), [[-0.1, 0.0, -0.05], [0.1, 0.2, 0.05]])


@pytest.mark.parametrize(
    "text", ["box:", "box:1,2,3", "box:1,2,3,4,5,x", "box:0,0,0,1,1,nan", "box:0,0,0,1,0,1"]
)
def test_what_is_no_box_is_refused_with_an_example(text: str) -> None:
    with pytest.raises(UsageError) as caught:
        parse_box(text, 1.0)
    assert text in caught.value.message
    assert "corners" in caught.value.hint


def test_a_box_of_a_still_body_is_itself() -> None:
    region = box_region("box:0,0,0,1,2,3", 1.0, NONE, STILL)
    assert region.path.shape == (1, 8, 3)
    pin = make_pin(region, solid(cube()))
    assert pin.inside(np.array([[0.5, 1.9, 2.9], [0.5, 2.1, 2.9]])).tolist() == [True, False]


def test_a_box_moves_with_the_points_that_lie_in_it() -> None:
    points = np.array([[0.1, 0, 0], [0.2, 0, 0], [0.3, 0.1, 0.1], [5.0, 0, 0]])
    path = np.stack([points, points + np.array([[1.0, 0, 0]] * 3 + [[9.0, 9, 9]])])
    pin = make_pin(box_region("box:-1,-1,-1,1,1,1", 1.0, points, path), solid(cube()))
    np.testing.assert_array_equal(pin.anchors, points[:3])
    np.testing.assert_array_equal(pin.path[1] - pin.path[0], [[1.0, 0, 0]] * 3)


def test_a_box_that_holds_no_point_moves_with_all() -> None:
    points = np.array([[2.0, 0, 0], [3.0, 0, 0], [4.0, 0, 0], [5.0, 0, 0]])
    path = np.stack([points, points + 1.0])
    pin = make_pin(box_region("box:-1,-1,-1,1,1,1", 1.0, points, path), solid(cube()))
    assert len(pin.anchors) == 4


def test_a_volume_is_what_its_triangles_enclose_far_from_the_origin_too() -> None:
    ball = sphere(0.5, center=(1e5, 0.0, 0.0))
    region = Region(
        name="/Ball", kind="volume", points=ball.points, triangles=ball.triangles,
        path=ball.points[None],
    )  # fmt: skip
    pin = make_pin(region, solid(cube()))
    X = np.array([[1e5 + 0.4, 0.0, 0.0], [1e5 + 0.6, 0.0, 0.0]])
    assert pin.inside(X).tolist() == [True, False]
    # chords of the sphere lie inside it by 1.2 % at this fineness
    np.testing.assert_allclose(
        np.linalg.norm(pin.nearest(X) - X, axis=1), [0.1, 0.1], atol=0.012 * 0.5 + 1e-9
    )


def test_a_patch_of_what_is_not_filled_is_refused() -> None:
    body = cube(path="/Body")
    region = Region(
        name="/Other/part", kind="patch", points=body.points, triangles=body.triangles[:2],
        path=body.points[None], body="/Other",
    )  # fmt: skip
    with pytest.raises(InputError, match="not filled"):
        make_pin(region, solid(body))


def test_a_patch_in_a_dent_holds_what_is_nearest_to_it() -> None:
    """Of a step, the upper tread: a point before the riser is nearer to that."""
    points = np.array(
        [[x, y, z] for z in (0.0, 1.0) for x, y in ((0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2))]
    )
    front = [(0, 1, 2), (0, 2, 3), (0, 3, 5), (3, 4, 5)]
    back = [(6 + a, 6 + c, 6 + b) for a, b, c in front]
    ring = [(a, (a + 1) % 6) for a in range(6)]
    sides = [t for a, b in ring for t in ((a, 6 + a, b), (b, 6 + a, 6 + b))]
    # z grows towards the viewer: the front is at z = 0, so turn all of it
    triangles = np.array([(a, c, b) for a, b, c in [*front, *back, *sides]])
    stair = surface(points, triangles, path="/Stair")
    tread = np.array([t for t in triangles if all(points[i][1] == 2.0 for i in t)])
    assert len(tread) == 2
    region = Region(
        name="/Stair/top", kind="patch", points=points, triangles=tread, path=points[None],
        body="/Stair",
    )  # fmt: skip
    pin = make_pin(region, solid(stair))
    X = np.array([[0.5, 2.3, 0.5], [1.2, 1.5, 0.5], [0.5, 1.9, 0.5], [0.5, 2.0, 0.2]])
    assert pin.inside(X).tolist() == [True, False, False, True]


def test_a_rigid_patch_is_what_lies_nearest_to_it() -> None:
    body = solid(cube())
    surface = body.surfaces[0]
    top = np.flatnonzero((surface.points[surface.triangles][:, :, 1] == 1.0).all(1))
    region = Region(
        name="/Body/top", kind="patch", points=surface.points, triangles=surface.triangles[top],
        path=surface.points[None], body="/Body",
    )  # fmt: skip
    pin = make_rigid(region, body)
    assert pin.rigid
    X = np.array([[0.5, 0.9, 0.5], [0.5, 0.4, 0.5], [0.1, 0.8, 0.5], [0.5, 1.2, 0.5]])
    assert np.asarray(pin.inside(X)).tolist() == [True, False, False, True]


def thick_sheet(*others, plate: float = 0.0, spacing: float = 0.1):
    """A sheet of two squares across y, x from 0 to 2, its solid, and the region that is the one of
    lower x; plate : [m] of thickness of its own."""
    if plate:
        parts = [cube((k, -0.5 * plate, 0.0), (1.0, plate, 1.0)) for k in (0.0, 1.0)]
        # without the wall that they share
        faces = [np.delete(part.triangles, rows, axis=0) for part, rows in
                 zip(parts, ([10, 11], [8, 9]), strict=True)]  # fmt: skip
        points = np.concatenate([part.points for part in parts])
        body = surface(points, np.concatenate([faces[0], 8 + faces[1]]))
        top = np.isclose(points[body.triangles, 1], 0.5 * plate).all(1)
    else:
        points = np.array([[x, 0.0, z] for x in (0.0, 1.0, 2.0) for z in (0.0, 1.0)])
        body = surface(points, np.array([[0, 1, 2], [2, 1, 3], [2, 3, 4], [4, 3, 5]]))
        top = np.ones(4, bool)
    chosen = body.triangles[top & (points[body.triangles, 0].max(1) <= 1.0)]
    mended, repairs = repair_asset(asset(body, *others))
    filled, (done, *_) = thicken_asset(mended, repairs, spacing=spacing, particles=0)
    assert done.thickened == 1
    region = Region(name="/Body/half", kind="patch", points=points, triangles=chosen,
                    path=points[None], body="/Body")  # fmt: skip
    return mended.surfaces, build_solid(filled), region


@pytest.mark.parametrize("plate", [0.0, 0.02])
def test_a_part_of_a_sheet_holds_its_flesh_and_what_is_around(plate: float) -> None:
    drawn, body, region = thick_sheet(plate=plate)
    flesh = np.array([[x, y, 0.5] for x in (0.5, 0.99, 1.01, 1.5) for y in (-0.04, 0.0, 0.04)])
    around = np.array([[0.5, -0.2, 0.5], [-0.2, 0.1, 0.5], [0.9, 0.2, 1.3], [1.1, 0.2, 0.5]])
    X = np.concatenate([flesh, around])
    held = [True] * 6 + [False] * 6 + [True] * 3 + [False]
    pin = make_pin(region, body, drawn)
    assert pin.inside(X).tolist() == held
    # the rest begins at x = 1, on either side and in the middle, and not at the rim
    there = X * [0.0, 1.0, 1.0] + [1.0, 0.0, 0.0]
    there[:, 2] = np.minimum(there[:, 2], 1.0)
    np.testing.assert_allclose(pin.nearest(X), there, atol=1e-9)
    assert make_rigid(region, body, drawn).inside(X).tolist() == held


def test_a_whole_sheet_has_no_boundary_near() -> None:
    drawn, body, region = thick_sheet()
    whole = Region(name="/Body", kind="patch", points=region.points, body="/Body",
                   triangles=drawn[0].triangles, path=region.path)  # fmt: skip
    pin = make_pin(whole, body, drawn)
    X = np.array([[0.5, 0.0, 0.5], [2.5, 0.3, 0.5]])
    assert pin.inside(X).all()
    assert np.linalg.norm(pin.nearest(X) - X, axis=1).min() > 2.0


def test_a_part_of_a_surface_holds_nothing_of_what_is_next_to_it() -> None:
    # a pole that the sheet hangs on, and the air around that
    pole = cube((-0.4, -0.2, -1.0), (0.35, 0.4, 3.0), path="/Pole")
    X = np.array([[-0.2, 0.0, 0.5], [-0.2, 0.3, 0.5], [-0.01, 0.0, 0.5], [0.2, 0.0, 0.5]])
    drawn, body, region = thick_sheet(pole)
    assert make_pin(region, body, drawn).inside(X).tolist() == [False, False, True, True]
    above = cube((0.0, 1.3, 0.0), path="/Above")
    lid = cube()
    region = Region(name="/Body/top", kind="patch", points=lid.points, path=lid.points[None],
                    triangles=lid.triangles[[6, 7]], body="/Body")  # fmt: skip
    X = np.array([[0.5, 1.1, 0.5], [0.5, 1.2, 0.5], [0.5, 2.5, 0.5]])
    pin = make_pin(region, solid(lid, above))
    assert pin.inside(X).tolist() == [True, False, False]
