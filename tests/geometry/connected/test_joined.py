"""Meshes that bound a volume only together are one surface, as a bottle split by its materials."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from solids import asset, cube, sphere, surface

from gf_usd import inspect
from gf_usd.core.asset import Surface, SurfaceMaterial
from gf_usd.core.mesh.measures import signed_volume
from gf_usd.geometry.connected.joined import joined_surfaces
from gf_usd.geometry.solid import build_solid
from gf_usd.geometry.surface import Nearest, colors
from gf_usd.pipeline.inspect import Inspection


def part(whole: Surface, rows: np.ndarray, path: str, **more) -> Surface:
    """A mesh of some triangles of another, with points of its own."""
    used, renumbered = np.unique(whole.triangles[rows], return_inverse=True)
    return surface(whole.points[used], renumbered.reshape(-1, 3), path=path, **more)


def slices(whole: Surface, *heights: float) -> list[Surface]:
    """The mesh, cut along the edges nearest to these heights."""
    middle = whole.points[whole.triangles].mean(1)[:, 1]
    band = np.searchsorted(heights, middle)
    return [part(whole, np.flatnonzero(band == k), f"/Part{k}") for k in range(len(heights) + 1)]


BALL = sphere(1.0)


def test_the_parts_of_a_ball_are_the_ball() -> None:
    parts = slices(BALL, -0.3, 0.3)
    joined = joined_surfaces(asset(*parts))
    (one,) = joined.asset.surfaces
    assert signed_volume(one.points, one.triangles) == pytest.approx(
        signed_volume(BALL.points, BALL.triangles), rel=1e-12
    )
    assert len(build_solid(joined.asset).surfaces) == 1
    assert sorted(joined.groups[0]) == ["/Part0", "/Part1", "/Part2"]
    assert joined.groups[0][0] == one.path
    assert joined.notes[0].startswith("3 meshes share borders and enclose a volume only together")


def test_a_part_that_faces_the_other_way_is_reversed() -> None:
    low, middle, high = slices(BALL, -0.3, 0.3)
    turned = replace(
        middle,
        triangles=middle.triangles[:, ::-1],
        triangle_corners=middle.triangle_corners[:, ::-1],
    )
    (one,) = joined_surfaces(asset(low, turned, high)).asset.surfaces
    assert abs(signed_volume(one.points, one.triangles)) == pytest.approx(
        signed_volume(BALL.points, BALL.triangles), rel=1e-12
    )
    assert np.array_equal(one.face_indices[one.triangle_corners], one.triangles)


def test_each_part_keeps_its_color_and_material() -> None:
    low, high = slices(BALL, 0.0)
    red = np.tile((1.0, 0.0, 0.0), (len(low.triangles), 3, 1))
    blue = SurfaceMaterial(path="/Blue", color=(0.0, 0.0, 1.0))
    low = replace(low, triangle_colors=red)
    bound = np.zeros(len(high.triangles), np.int64)
    high = replace(high, materials=(blue,), triangle_materials=bound)
    solid = build_solid(joined_surfaces(asset(low, high)).asset)
    (one,) = solid.surfaces
    up = one.points[one.triangles].mean(1)[:, 1] > 0.0
    count = len(one.triangles)
    at = Nearest(
        surface=np.zeros(count, np.int64),
        triangle=np.arange(count),
        barycentric=np.full((count, 3), 1.0 / 3.0),
        normal=np.zeros((count, 3)),
        distance=np.zeros(count),
    )
    found = colors(solid, at)
    assert np.allclose(found[~up], (1.0, 0.0, 0.0))
    assert np.allclose(found[up], (0.0, 0.0, 1.0))


def lid(height: float, path: str = "/Lid") -> Surface:
    return surface([[0, height, 0], [0, height, 1], [1, height, 1], [1, height, 0]],
                   [[0, 1, 2], [0, 2, 3]], path=path)  # fmt: skip


def open_box() -> Surface:
    """A cube without its top: open by a sixth of its closed area, and filled by itself."""
    whole = cube()
    top = (whole.points[whole.triangles][:, :, 1] == 1.0).all(1)
    return part(whole, np.flatnonzero(~top), "/Box")


def test_a_box_and_its_lid() -> None:
    assert len(joined_surfaces(asset(open_box(), lid(1.0))).asset.surfaces) == 1


@pytest.mark.parametrize(
    "surfaces",
    [
        (open_box(), lid(1.1)),  # above it: no common border
        (cube(path="/Box"), lid(1.0)),  # the box is closed
        (lid(0.0, "/A"), surface([[1, 0, 0], [1, 0, 1], [2, 0, 1]], [[0, 1, 2]], path="/B")),
        (open_box(), replace(lid(1.0), component="/Other")),
    ],
    ids=["apart", "closed", "no volume", "components"],
)
def test_others_are_not_joined(surfaces: tuple[Surface, ...]) -> None:
    before = asset(*surfaces)
    joined = joined_surfaces(before)
    assert joined.asset.surfaces == before.surfaces
    assert joined.groups == ()


def test_a_mesh_that_must_stay_apart_is_not_joined() -> None:
    assert joined_surfaces(asset(*slices(BALL, 0.0)), apart={"/Part1"}).groups == ()


def write_parts(path: Path, parts: list[Surface], more: str = "") -> Path:
    meshes = "".join(
        f"""    def Mesh "{one.path[1:]}" {{
        uniform token subdivisionScheme = "none"
        int[] faceVertexCounts = {[3] * len(one.triangles)}
        int[] faceVertexIndices = {one.triangles.ravel().tolist()}
        point3f[] points = [{", ".join(str(tuple(p)) for p in one.points.tolist())}]
{more}    }}
"""
        for one in parts
    )
    text = f"""#usda 1.0
(
    defaultPrim = "Ball"
    metersPerUnit = 1
    upAxis = "Y"
)
def Xform "Ball" {{
{meshes}}}
"""
    path.write_text(text, encoding="utf-8")
    return path


COARSE = slices(sphere(1.0, subdivisions=2), -0.3, 0.3)


def test_a_ball_of_three_open_meshes_is_baked_as_one_body(tmp_path: Path) -> None:
    """Its ends were two bodies that collided, and the band between them moved with one of them."""
    seen = inspect(write_parts(tmp_path / "a.usda", COARSE), particles=300)
    assert seen.plan is not None
    assert [seen.fill_of(s.path) for s in seen.asset.surfaces] == [("filled", "")] * 3
    assert seen.plan.bodies is not None
    assert seen.plan.bodies.count == 1
    whole = sphere(1.0, subdivisions=2)
    assert seen.plan.particles.volume == pytest.approx(
        signed_volume(whole.points, whole.triangles), rel=1e-6
    )
    assert not seen.warnings
    assert [note for note in seen.notes if "Part" in note] == [
        "3 meshes share borders and enclose a volume only together: they are filled as one body:"
        " </Ball/Part0>, </Ball/Part1>, </Ball/Part2>"
    ]


def test_half_balls_are_not_refused(tmp_path: Path) -> None:
    halves = slices(sphere(1.0, subdivisions=2), 0.0)
    assert inspect(write_parts(tmp_path / "a.usda", halves), particles=300).refusal is None


def test_a_part_can_be_pinned(tmp_path: Path) -> None:
    subset = """        def GeomSubset "spot" {
            uniform token elementType = "face"
            int[] indices = [0, 1, 2, 3, 4, 5, 6, 7]
        }
"""
    path = write_parts(tmp_path / "a.usda", COARSE, subset)
    seen = inspect(path, particles=300, pins=["/Ball/Part1/spot"])
    assert seen.refusal is None
    assert seen.plan is not None
    assert len(seen.plan.pins) == 1


def test_a_mesh_and_its_copy_are_not_joined_with_a_third_one() -> None:
    """Their faces canceled: only the third one was filled."""
    large, small = slices(BALL, 0.6)
    copy = replace(large, path="/Copy")
    assert joined_surfaces(asset(large, copy, small)).groups == ()


def can_on_water(path: Path) -> Inspection:
    """A box in three meshes (bottom, sides, top), on a box of water."""
    box = cube((0.0, 1.0, 0.0), 1.0)
    middle = box.points[box.triangles].mean(1)[:, 1]
    rows = [np.flatnonzero(m) for m in (middle < 1.01, abs(middle - 1.5) < 0.45, middle > 1.99)]
    names = ("/Bottom", "/Sides", "/Top")
    parts = [part(box, some, name) for some, name in zip(rows, names, strict=True)]
    write_parts(path, [*parts, cube((0.0, 0.0, 0.0), 1.0, path="/Under")])
    water = 'def Mesh "Under" {\n        custom token gaussianFlesh:material = "water"'
    text = path.read_text("utf-8").replace('def Mesh "Under" {', water)
    path.write_text(text, encoding="utf-8")
    return inspect(path, particles=400)


def test_every_part_moves_with_the_body_that_it_bounds(tmp_path: Path) -> None:
    """The bottom of a can followed the water that it stood on, and was hidden with it."""
    seen = can_on_water(tmp_path / "can.usda")
    assert seen.plan is not None
    of = seen.plan.bodies.embedded
    assert [of[f"/Ball/{name}"] for name in ("Bottom", "Sides", "Top", "Under")] == [0, 0, 0, 1]


def test_a_part_is_no_ground(tmp_path: Path) -> None:
    box = cube((0.0, 1.0, 0.0), 1.0)
    low = box.points[box.triangles].mean(1)[:, 1] < 1.01
    parts = [part(box, np.flatnonzero(low), "/Bottom"), part(box, np.flatnonzero(~low), "/Rest")]
    seen = inspect(write_parts(tmp_path / "box.usda", parts), particles=400)
    assert [note for note in seen.notes if "as a ground does" in note] == []
