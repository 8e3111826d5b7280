"""Moments of cut cells next to closed forms: of whole bodies, and of single cells."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from mesh_moments import BODIES, of_mesh
from solids import cube, joined, needle, solid, sphere, turned, without

from gf_usd.core.mesh.measures import signed_volume
from gf_usd.geometry.sampling.content import FULL, Grid, find_content
from gf_usd.geometry.sampling.pieces import cut


def grid_over(body, h, shift=(0.0, 0.0, 0.0)):
    low = body.low - h * (1.0 + np.asarray(shift))
    return Grid(
        corner=low, h=h, count=np.ceil((body.high + h - low) / h).astype(int), turn=np.eye(3)
    )


def totals(content, grid):
    """Volume, first moments (3,) and second moments (3, 3) about the origin of all cells."""
    f, m, second = content.moments[:, 0], content.moments[:, 1:4], content.moments[:, 4:]
    C = second[:, [[0, 3, 4], [3, 1, 5], [4, 5, 2]]]
    x = grid.corner / grid.h + content.ijk + 0.5
    C = C + x[:, :, None] * m[:, None] + m[:, :, None] * x[:, None]
    C = C + f[:, None, None] * x[:, :, None] * x[:, None]
    h = grid.h
    return h**3 * f.sum(), h**4 * (m + f[:, None] * x).sum(0), h**5 * C.sum(0)


@pytest.mark.parametrize("h", [0.11, 0.3, 5.0])
@pytest.mark.parametrize("name", BODIES)
def test_cells_add_up_to_the_moments_of_the_mesh(name, h):
    body = solid(BODIES[name])
    grid = grid_over(body, h, (0.1, 0.37, 0.71))
    found = find_content(body, grid)
    assert found.counted == 0
    for mine, exact in zip(totals(found, grid), of_mesh(*body.outward(0))):
        np.testing.assert_allclose(mine, exact, rtol=1e-10, atol=1e-12)


def test_a_cell_cut_by_a_plane_and_one_that_has_a_corner():
    # x < 1.25 of the unit cells 1 .. 2: a quarter of them; and the corner of three such planes.
    body = solid(cube(edge=(1.25, 1.25, 1.25)))
    grid = Grid(corner=np.zeros(3), h=1.0, count=np.array([2, 2, 2]), turn=np.eye(3))
    found = find_content(body, grid)
    cells = {tuple(c): m for c, m in zip(found.ijk.tolist(), found.moments)}
    np.testing.assert_allclose(cells[0, 0, 0], FULL, atol=1e-15)
    f, x = 0.25, -0.375
    xx = f**3 / 12.0 + f * x**2
    exact = [f, f * x, 0.0, 0.0, xx, f / 12.0, f / 12.0, 0.0, 0.0, 0.0]
    np.testing.assert_allclose(cells[1, 0, 0], exact, atol=1e-15)
    exact = [f**3, *3 * [f**3 * x], *3 * [f * f * xx], *3 * [f**3 * x * x]]
    np.testing.assert_allclose(cells[1, 1, 1], exact, atol=1e-15)


def test_faces_on_the_planes_of_the_grid():
    body = solid(cube(edge=2.0))
    grid = Grid(corner=-np.ones(3), h=1.0, count=np.array([4, 4, 4]), turn=np.eye(3))
    found = find_content(body, grid)
    assert sorted(found.ijk.tolist()) == [[i, j, k] for i in (1, 2) for j in (1, 2) for k in (1, 2)]
    np.testing.assert_allclose(found.moments, np.tile(FULL, (8, 1)), atol=1e-12)


def test_the_faces_of_a_cut_cell_have_the_area_of_the_solid_in_them():
    body = solid(cube(edge=(2.0, 2.0, 0.3)))
    grid = Grid(corner=np.zeros(3), h=1.0, count=np.array([2, 2, 1]), turn=np.eye(3))
    found = find_content(body, grid)
    faces = {tuple(c): a for c, a in zip(found.ijk.tolist(), found.faces)}
    # The bottom lies in the lower faces across z: there is nothing below it.
    np.testing.assert_allclose(faces[0, 0, 0], [[0.0, 0.0, 0.0], [0.3, 0.3, 0.0]], atol=1e-15)
    np.testing.assert_allclose(faces[1, 0, 0], [[0.3, 0.0, 0.0], [0.0, 0.3, 0.0]], atol=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("body", "exact"),
    [
        # cavity, inside-out shell, shell within a shell: one surface, told apart by shells
        (joined(sphere(), turned(sphere(0.5), slice(None))), lambda r: r(1.0) - r(0.5)),
        (turned(sphere(), slice(None)), lambda r: r(1.0)),
        (joined(sphere(), sphere(0.5)), lambda r: r(1.0)),
        (
            joined(sphere(), turned(sphere(0.5, center=(3.0, 0.0, 0.0)), slice(None))),
            lambda r: r(1.0) + r(0.5),
        ),
    ],
    ids=["cavity", "inside-out", "nested", "one inside-out"],
)
def test_shells_of_one_surface(body, exact):
    made = solid(body)
    found = find_content(made, grid_over(made, 0.17))
    one = sphere()
    volume = signed_volume(one.points, one.triangles)
    assert 0.17**3 * found.moments[:, 0].sum() == pytest.approx(
        exact(lambda r: volume * r**3), rel=1e-9
    )


def test_surfaces_that_overlap_count_once():
    # Cubes of edge 1 that share a quarter of each.
    body = solid(cube(path="/A"), cube(low=(0.5, 0.5, 0.0), path="/B"))
    found = find_content(body, grid_over(body, 0.13, (0.3, 0.1, 0.2)))
    # Only where the surfaces of both are in one cell probes are counted: some 40 cells along the
    # two edges where they cross, each with 512 probes of which half are inside.
    assert 0 < found.counted < 150
    scatter = np.sqrt(found.counted) * 0.5 / np.sqrt(512.0)
    off = found.moments[:, 0].sum() - 1.75 / 0.13**3
    assert abs(off) < 3.0 * scatter


def test_surfaces_that_touch_add_up_exactly():
    body = solid(cube(path="/A"), cube(low=(1.0, 0.2, 0.1), path="/B"))
    found = find_content(body, grid_over(body, 0.3, (0.3, 0.1, 0.2)))
    assert found.counted == 0
    assert 0.3**3 * found.moments[:, 0].sum() == pytest.approx(2.0, rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("spoil", [without, turned])
def test_a_surface_with_a_hole_or_a_turned_face_is_counted(spoil):
    whole = sphere()
    body = solid(spoil(whole, [3]))
    found = find_content(body, grid_over(body, 0.2))
    assert found.counted > 0
    volume = signed_volume(whole.points, whole.triangles)
    # The face is a thousandth of the surface; cells on it are right to 1/sqrt(64 probes) at least.
    scatter = 0.2**3 * np.sqrt(found.counted) / np.sqrt(12.0 * 64.0)
    assert abs(0.2**3 * found.moments[:, 0].sum() - volume) < 3.0 * scatter + 2e-3 * volume


def test_a_tube_open_at_both_ends_is_filled_from_its_wall():
    # No piece of surface lies in the columns of the bore, whose cells are full by winding number.
    h, edge, height = 0.11, 1.0, 4.0
    box = cube(edge=(edge, edge, height))
    z = box.points[box.triangles][:, :, 2]
    body = solid(without(box, np.flatnonzero(np.ptp(z, axis=1) == 0.0)))
    found = find_content(body, grid_over(body, h))
    inner = {(i, j, k) for i, j, k in found.ijk.tolist() if 2 < k < 34 and 2 < i < 8 and 2 < j < 8}
    assert len(inner) == 31 * 5 * 5
    assert found.counted > 0
    # Where w = 1/2 bulges out of the mouths: less than a half ball of the edge at each.
    assert abs(h**3 * found.moments[:, 0].sum() - edge**2 * height) < 2.0 * 0.26 * edge**3


def test_a_needle_is_cut_into_pieces_in_the_number_of_the_planes_it_crosses():
    long = needle(2000.0, 0.3)
    corners = long.points[long.triangles] + 0.123
    pieces = cut(corners)
    # Three triangles cross 2,000 planes of each axis in turn, and slabs leave three pieces at most.
    assert len(pieces.source) < 3 * 3 * 3 * 3 * 2003
    whole = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    sums = np.stack([np.bincount(pieces.source, v) for v in pieces.area_vectors.T], 1)
    np.testing.assert_allclose(sums, whole, rtol=1e-9, atol=1e-6)
    low, high = np.floor(pieces.corners.min(1) + 1e-9), np.ceil(pieces.corners.max(1) - 1e-9)
    assert (high - low <= 1.0).all()


@pytest.mark.slow
def test_a_needle_takes_memory_by_its_cells_and_not_by_those_of_its_box():
    body = solid(needle(1.0, 1e-4))
    h = 1.0 / 3000.0
    tracemalloc.start()
    found = find_content(body, grid_over(body, h))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert h**3 * found.moments[:, 0].sum() == pytest.approx(body.volume, rel=1e-9)
    # The ten moments of each cell in one layer of the box alone would take more.
    assert peak < 10 * 8 / h**2
