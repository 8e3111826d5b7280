"""Two meshes that are the sides of a wall are filled only in between."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from solids import asset, cube, sphere, surface

from gf_usd.core.asset import Surface, SurfaceMaterial, Texture
from gf_usd.core.mesh.measures import signed_volume
from gf_usd.core.mesh.topology import boundary_edges, shells
from gf_usd.geometry.connected.joined import joined_surfaces
from gf_usd.geometry.connected.walls import Walls, find_walls, with_walls
from gf_usd.geometry.solid import build_solid, closed_triangles
from gf_usd.geometry.surface import colors, nearest

SIDES = 24
OUTER, INNER = sphere(1.0, path="/Outer"), sphere(0.8, path="/Inner")


def turned(one: Surface) -> Surface:
    return replace(one, triangles=one.triangles[:, ::-1])


def cup(radius: float, low: float, top: float, sides: int = SIDES, path: str = "/Outer") -> Surface:
    """A cylinder about the y axis that is open at the top and faces outward."""
    angle = 2.0 * np.pi * np.arange(sides) / sides
    ring = radius * np.stack([np.cos(angle), np.zeros(sides), -np.sin(angle)], 1)
    points = np.concatenate([[(0.0, low, 0.0)], *(ring + (0.0, y, 0.0) for y in (low, top))])
    k, after = np.arange(sides), (np.arange(sides) + 1) % sides
    faces = [
        np.stack([np.zeros(sides, int), 1 + after, 1 + k], 1),
        np.stack([1 + k, 1 + after, 1 + sides + after], 1),
        np.stack([1 + k, 1 + sides + after, 1 + sides + k], 1),
    ]
    return surface(points, np.concatenate(faces), path=path)


def walls(*surfaces: Surface, one_thing: bool = True) -> Walls:
    return find_walls(asset(*surfaces), lambda one, two: one_thing)


@pytest.mark.slow
def test_only_the_wall_of_an_egg_is_filled() -> None:
    found = walls(turned(INNER), OUTER)
    assert dict(found.outer) == {"/Inner": "/Outer"}
    assert found.unclear == ()
    whole = with_walls(asset(turned(INNER), OUTER), found)
    assert [s.path for s in whole.surfaces] == ["/Outer"]
    solid = build_solid(whole)
    expected = sum(s * signed_volume(b.points, b.triangles) for s, b in ((1, OUTER), (-1, INNER)))
    assert solid.volume == pytest.approx(expected, rel=5e-3)  # 20 000 points are tested
    at = np.array([[0.0, r, 0.0] for r in (0.0, 0.75, 0.85, 0.95, 1.05)])
    assert solid.inside(at).tolist() == [False, False, True, True, False]
    assert len(whole.surfaces[0].points[: whole.surfaces[0].own_points]) == len(OUTER.points)


@pytest.mark.parametrize("sides", [SIDES, 17])
def test_the_rim_of_a_mug_is_closed(sides: int) -> None:
    """Both sides are open at the top, where the winding number of each is uncertain."""
    outer, inner = cup(1.0, 0.0, 2.4), turned(cup(0.8, 0.2, 2.4, sides, "/Inner"))
    (mug,) = with_walls(asset(outer, inner), walls(outer, inner)).surfaces
    triangles = closed_triangles(mug)[0]
    assert len(boundary_edges(triangles)) == 0
    assert shells(triangles).max() == 0
    assert len(triangles) == len(outer.triangles) + len(inner.triangles) + SIDES + sides
    area = [0.5 * n * np.sin(2.0 * np.pi / n) for n in (SIDES, sides)]
    volume = area[0] * 2.4 - 0.8**2 * area[1] * 2.2
    assert signed_volume(mug.points, triangles) == pytest.approx(volume, rel=1e-12)


def test_holes_on_opposite_ends_are_not_joined_by_a_rim() -> None:
    outer, inner = cup(1.0, 0.0, 2.4), cup(0.8, 0.2, 2.3, path="/Inner")
    inner = replace(inner, points=inner.points * (1.0, -1.0, 1.0) + (0.0, 2.4, 0.0))
    found = walls(outer, inner)  # the mirror image faces inward
    (mug,) = with_walls(asset(outer, inner), found).surfaces
    assert len(mug.triangles) == len(outer.triangles) + len(inner.triangles)


def test_a_common_rim_needs_none() -> None:
    outer, inner = cup(1.0, 0.0, 2.4), turned(cup(0.8, 0.2, 2.4, path="/Inner"))
    points = inner.points.copy()
    points[1 + SIDES :] = outer.points[1 + SIDES :]
    inner = replace(inner, points=points)
    (mug,) = with_walls(asset(outer, inner), walls(outer, inner)).surfaces
    assert len(boundary_edges(closed_triangles(mug)[0])) == 0
    assert len(mug.triangles) == len(outer.triangles) + len(inner.triangles)


def test_walls_in_walls_and_two_cavities() -> None:
    """The inner flask of a thermos is in the cavity of the outer one."""
    radii = {"/A": 1.0, "/B": -0.9, "/C": 0.8, "/D": -0.7}
    flask = [sphere(abs(r), path=path) for path, r in radii.items()]
    flask = [turned(s) if radii[s.path] < 0.0 else s for s in flask]
    assert dict(walls(*flask).outer) == {"/B": "/A", "/D": "/C"}
    holes = [turned(sphere(0.3, (x, 0.0, 0.0), path=f"/{x:g}")) for x in (-0.5, 0.5)]
    found = walls(OUTER, *holes)
    assert dict(found.outer) == {"/-0.5": "/Outer", "/0.5": "/Outer"}
    (whole,) = with_walls(asset(OUTER, *holes), found).surfaces
    assert shells(closed_triangles(whole)[0]).max() == 2


@pytest.mark.parametrize(
    ("surfaces", "unclear"),
    [
        ((OUTER, INNER), True),
        ((turned(OUTER), INNER), True),
        ((turned(OUTER), turned(INNER)), True),
        ((OUTER, sphere(0.7, path="/Inner")), False),  # a yolk
        ((OUTER, sphere(0.8, (0.5, 0.0, 0.0), path="/Inner")), False),  # reaches out
        ((OUTER, turned(sphere(0.8, (0.5, 0.0, 0.0), path="/Inner"))), False),
    ],
    ids=["outward", "both turned", "inward", "small", "overlap", "overlap inward"],
)
def test_other_meshes_are_filled_as_they_are(surfaces: tuple, unclear: bool) -> None:
    found = walls(*surfaces)
    assert found.outer == {}
    assert found.unclear == ((("/Inner", "/Outer"),) if unclear else ())
    assert len(found.notes) == unclear


def test_meshes_that_are_not_one_thing_are_no_wall() -> None:
    assert walls(OUTER, turned(INNER), one_thing=False) == Walls()
    assert walls(OUTER, INNER, one_thing=False) == Walls()


def test_skinned_meshes_are_no_wall() -> None:
    assert walls(OUTER, replace(turned(INNER), skinned=True)) == Walls()


def test_an_inner_mesh_directly_in_another_inner_one_is_filled() -> None:
    found = walls(OUTER, turned(INNER), turned(sphere(0.3, path="/Core")))
    assert dict(found.outer) == {"/Inner": "/Outer"}


def test_notes_on_many_pairs_are_few() -> None:
    pairs = [("/B", "/A"), ("/D", "/C"), ("/F", "/E"), ("/H", "/G"), ("/J", "/I")]
    notes = Walls(unclear=tuple(pairs)).notes
    assert len(notes) == 3
    assert notes[0].startswith("</B> is inside </A> (and 2 more pairs are alike), and")


@pytest.mark.slow
def test_each_side_keeps_its_look() -> None:
    """A texture of a side without coordinates is not read at those of the other one."""
    red, blue = ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    image = Texture(pixels=np.full((1, 1, 3), 255, np.uint8), srgb=True)
    outer = replace(
        OUTER,
        materials=(SurfaceMaterial(path="/Red", color=red, texture=image),),
        triangle_materials=np.zeros(len(OUTER.triangles), int),
    )
    inner = replace(
        turned(INNER),
        materials=(SurfaceMaterial(path="/Blue", color=blue),),
        triangle_materials=np.zeros(len(INNER.triangles), int),
        triangle_uvs=np.zeros((len(INNER.triangles), 3, 2)),
    )
    solid = build_solid(with_walls(asset(outer, inner), walls(outer, inner)))
    X = np.array([[0.0, 0.81, 0.0], [0.0, 0.99, 0.0]])
    np.testing.assert_array_equal(colors(solid, nearest(solid, X)), [blue, red])
    one = replace(OUTER, triangle_colors=np.tile(red, (len(OUTER.triangles), 3, 1)))
    solid = build_solid(with_walls(asset(one, turned(INNER)), walls(one, turned(INNER))))
    np.testing.assert_array_equal(colors(solid, nearest(solid, X)), [(0.5, 0.5, 0.5), red])


def test_a_cube_in_a_sphere_beside_others() -> None:
    core = turned(cube((-0.3, -0.3, -0.3), 0.6, path="/Core"))
    beside = sphere(0.2, (3.0, 0.0, 0.0), path="/Beside")
    whole = with_walls(asset(core, beside, OUTER), walls(core, beside, OUTER))
    assert [s.path for s in whole.surfaces] == ["/Beside", "/Outer"]


def test_holes_count_to_the_size_of_a_mesh() -> None:
    """A cup that is open at the top was taken for smaller than the closed mesh in it."""
    outer, inner = cup(1.0, 0.0, 2.0), sphere(0.8, path="/Inner")
    tall = replace(inner, points=inner.points * (1.15, 1.15, 1.15) + (0.0, 1.0, 0.0))
    assert dict(walls(turned(tall), outer).outer) == {"/Inner": "/Outer"}


def test_what_fills_a_cavity_is_no_side_of_the_wall() -> None:
    content = sphere(0.75, path="/Content")
    found = walls(OUTER, turned(INNER), content)
    assert dict(found.outer) == {"/Inner": "/Outer"}
    assert found.unclear == ()


def test_every_mesh_of_an_inner_side_is_part_of_the_wall() -> None:
    inner = turned(INNER)
    high = inner.points[inner.triangles].mean(1)[:, 1] > 0.0
    halves = [
        replace(inner, path=path, triangles=inner.triangles[rows],
                triangle_corners=inner.triangle_corners[rows])
        for path, rows in (("/High", high), ("/Low", ~high))
    ]  # fmt: skip
    joined = joined_surfaces(asset(OUTER, *halves))
    found, left = find_walls(joined.asset, lambda one, two: True).with_parts(joined)
    assert dict(found.outer) == {"/High": "/Outer", "/Low": "/Outer"}
    assert left.groups == ()


@pytest.mark.parametrize("inner", [INNER, turned(INNER)])
def test_a_collider_is_no_side_of_a_wall_of_what_it_stands_in_for(inner: Surface) -> None:
    found = find_walls(asset(OUTER, inner), lambda one, two: True, lambda one, two: OUTER.path)
    assert found == Walls(colliders=((OUTER.path, inner.path),))
    (note,) = found.notes
    assert note.startswith(f"<{OUTER.path}> is a collider of the body of <{inner.path}>")
