"""Points prims that are bodies: the surface around their balls, and which of them are none."""

from __future__ import annotations

import numpy as np
import pytest

from gf_usd.core.mesh.measures import signed_volume
from gf_usd.core.mesh.topology import boundary_edges
from gf_usd.readers.usd.solids import points as module
from gf_usd.readers.usd.solids.points import cover
from gf_usd.readers.usd.stage import SkippedPrim

W = 0.25
LATTICE = [
    (W * (i + 0.5), W * (j + 0.5), W * (k + 0.5))
    for i in range(4)
    for j in range(4)
    for k in range(4)
]
WIDTHS = f'float[] widths = [{W}] (interpolation = "constant")'


def points(inner: str = WIDTHS, where=LATTICE, apis: str = "") -> str:
    schemas = f"(prepend apiSchemas = [{apis}])" if apis else ""
    return f'def Points "P" {schemas}\n{{\npoint3f[] points = {where}\n{inner}\n}}'


def test_one_ball_is_a_ball() -> None:
    # Marching cubes cut chords of cells h of at most a quarter radius: a sagitta of h^2 / 8 r, and
    # the distance that is linear in a cell errs by as much again: 2 % of the radius at most,
    # which count three times in the volume.
    vertices, triangles = cover(np.zeros((1, 3)), np.array([2.0]))
    assert signed_volume(vertices, triangles) == pytest.approx(4 / 3 * np.pi, rel=0.06)
    assert not len(boundary_edges(triangles))


def test_balls_that_lie_apart_stay_apart() -> None:
    from scipy.sparse import coo_matrix

    from gf_usd.core.neighbors import components

    vertices, triangles = cover(np.array([(0.0, 0, 0), (8, 0, 0)]), np.array([2.0, 2.0]))
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]]])
    graph = coo_matrix((np.ones(len(edges)), edges.T), shape=(len(vertices),) * 2)
    assert components(graph)[0] == 2


@pytest.mark.slow
def test_touching_balls_of_a_lattice_are_one_closed_block() -> None:
    where = np.array(LATTICE)
    vertices, triangles = cover(where, np.full(len(where), W))
    assert not len(boundary_edges(triangles))
    # Within the box around all balls, which is the unit cube, and around the block of the centers'
    # lattice cells taken in by a dimple of closing: with c = W a ball of radius c rests on four of
    # radius W/2 at sqrt(2.25 - .5) - 1 = .32 W above the plane of their centers.
    assert vertices.min() > -1e-9
    assert vertices.max() < 1 + 1e-9
    core = 4 * W - 2 * (0.5 - 0.32) * W
    assert core**3 < signed_volume(vertices, triangles) < 1.0


def test_balls_of_different_size_are_each_within(monkeypatch) -> None:
    monkeypatch.setattr(module, "CELLS", module.FEWEST)
    # A large ball is seen although eight small ones are nearer to every place around it.
    rng = np.random.default_rng(3)
    small = rng.normal(size=(60, 3))
    small *= 1.05 / np.linalg.norm(small, axis=1)[:, None]
    where = np.concatenate([np.zeros((1, 3)), small])
    vertices, _ = cover(where, np.concatenate([[2.0], np.full(60, 0.05)]))
    # h is at most a 24th of the longest side, 2.15; the surface is within h of the large ball's.
    assert np.linalg.norm(vertices, axis=1).min() > 1.0 - 2.15 / 24


def test_points_come_first_and_the_surface_around_them_after(read) -> None:
    asset = read(points())
    (surface,) = asset.surfaces
    assert (surface.type_name, surface.own_points) == ("Points", len(LATTICE))
    np.testing.assert_allclose(surface.points[: len(LATTICE)], LATTICE, atol=1e-7)
    assert surface.triangles.min() == len(LATTICE)
    assert signed_volume(surface.points, surface.triangles) > 0.0
    assert "</P>: a surface was constructed around its 64 points" in asset.facts.notes


def test_the_surface_has_the_color_of_the_nearest_point(read) -> None:
    colors = ", ".join("(1, 0, 0)" if x < 0.5 else "(0, 0, 1)" for x, _, _ in LATTICE)
    asset = read(
        points(f'{WIDTHS}\ncolor3f[] primvars:displayColor = [{colors}] (interpolation = "vertex")')
    )
    (surface,) = asset.surfaces
    corner = surface.points[surface.triangles]
    red = surface.triangle_colors[..., 0] > 0.5
    assert (corner[..., 0][red] <= 0.5 + 1e-9).all()
    assert red.any()
    assert not red.all()


@pytest.mark.slow
@pytest.mark.parametrize("api", ["NewtonPointsDeformableSimAPI", "PhysxParticleSetAPI"])
def test_points_of_a_simulation_need_no_widths(read, api: str) -> None:
    asset = read(points("", apis=f'"{api}"'))
    assert "</P>: no widths are authored: the distance between neighbors, 0.25, is used" in (
        asset.facts.notes
    )
    assert 0.8 < signed_volume(asset.surfaces[0].points, asset.surfaces[0].triangles) < 1.0


@pytest.mark.slow
def test_points_below_a_deformable_body_are_one(read) -> None:
    body = 'def Xform "B" (prepend apiSchemas = ["PhysicsDeformableBodyAPI"])'
    asset = read(f"{body}\n{{\n{points('')}\n}}")
    assert [surface.path for surface in asset.surfaces] == ["/B/P"]


MESH = 'def Cube "C" {}\n'


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        (points(""), "Points without widths and without physics are not a body"),
        (
            points("float[] widths = [1, 2]"),
            "its 2 widths are not valid: it needs one, or one for each of 64",
        ),
        (points("float[] widths = [0]"), "its 1 widths are not valid: it needs one"),
        (points(WIDTHS, where="[]"), "has no points"),
        (
            points("point3f[] gaussianFlesh:restPositions = []\n" + WIDTHS),
            "these points are the particles of a bake",
        ),
    ],
)
def test_other_points_are_left_alone(read, body: str, reason: str) -> None:
    asset = read(MESH + body)
    assert [surface.path for surface in asset.surfaces] == ["/C"]
    assert reason in dict(asset.skipped)["/P"]


def test_points_in_one_place_have_no_size(read) -> None:
    asset = read(MESH + points("", where="[(1, 1, 1), (1, 1, 1)]", apis='"PhysxParticleSetAPI"'))
    assert "2 points in one place" in dict(asset.skipped)["/P"]


def test_nothing_to_cover_is_said() -> None:
    with pytest.raises(SkippedPrim, match="no surface"):
        # Numbers in which single balls vanish between the nodes of the grid.
        cover(np.array([(0.0, 0, 0), (1e6, 0, 0)]), np.array([1e-3, 1e-3]))
