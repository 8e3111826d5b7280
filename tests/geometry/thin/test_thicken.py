"""Sheets that are given one spacing of flesh, and those that are not."""

from __future__ import annotations

import numpy as np
import pytest
from solids import asset, cube, joined, moebius, sphere, surface

from gf_usd.core.mesh.topology import boundary_edges
from gf_usd.geometry import winding
from gf_usd.geometry.repair import repair_asset
from gf_usd.geometry.sampling.particles import count_particles, sample_solid
from gf_usd.geometry.solid import build_solid
from gf_usd.geometry.thin.thicken import (
    LAYER,
    offsets,
    shells_of,
    thicken_asset,
    thicken_to_count,
)


def sheet(n: int = 1, edge: float = 1.0, wave: float = 0.0, at=(0.0, 0.0, 0.0), path="/Sheet"):
    """A square of n x n quads across y, bent by sin(6 x)."""
    grid = np.array([[i, 0.0, j] for i in range(n + 1) for j in range(n + 1)]) * (edge / n)
    grid[:, 1] = wave * np.sin(6.0 * grid[:, 0])
    corner = np.array([(n + 1) * i + j for i in range(n) for j in range(n)])
    quads = corner[:, None] + [0, 1, n + 2, n + 1]
    return surface(grid + at, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]), path=path)


def thickened(*surfaces, spacing=None, particles=400):
    mended, repairs = repair_asset(asset(*surfaces))
    return thicken_asset(mended, repairs, spacing=spacing, particles=particles)


@pytest.mark.parametrize("n", [1, 8])
def test_a_plane_becomes_a_slab_of_one_layer(n: int) -> None:
    made, (done,) = thickened(sheet(n), particles=400)
    assert (done.thickened, done.thin_left) == (1, 0)
    assert done.thickness == pytest.approx(LAYER / 20.0, rel=1e-9)  # a^2 = 1 / 400 m^2
    assert "made 1 thin part 4.85 cm thick (one spacing) for the simulation" in done.messages()
    solid = build_solid(made)
    assert len(boundary_edges(solid.triangles[0])) == 0
    assert solid.orientation(0) == 1.0
    assert solid.volume == pytest.approx(done.thickness, rel=1e-9)
    filled = sample_solid(solid, particles=400, spacing=None, seed=0)
    # one layer of cells of twice the spacing, 11 along each side, with four or eight particles each
    # but for the corners, a fifth of the next ones
    assert 4 * (11**2 - 4) <= len(filled) <= 8 * 11**2
    assert np.abs(filled.X[:, 1]).max() < 0.5 * done.thickness


def test_a_bent_sheet_has_the_volume_of_its_area() -> None:
    body = sheet(16, wave=0.2)
    made, (done,) = thickened(body, particles=400)
    a, b, c = np.moveaxis(body.points[body.triangles], 1, 0)
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
    # its rim is cut square, and what one side gains in a bend the other side loses
    assert build_solid(made).volume == pytest.approx(area * done.thickness, rel=0.01)


@pytest.mark.parametrize("turned", [(), range(0, 80, 3)])
def test_a_one_sided_strip_has_the_volume_of_its_area(turned) -> None:
    body = moebius(turned)
    made, (done,) = thickened(body, spacing=0.1)
    assert (done.thickened, done.thin_left) == (1, 0)
    solid = build_solid(made)
    assert len(boundary_edges(solid.triangles[0])) == 0
    assert solid.orientation(0) == 1.0
    a, b, c = np.moveaxis(body.points[body.triangles], 1, 0)
    normal = np.cross(b - a, c - a)
    size = np.linalg.norm(normal, axis=1)
    # Its rim is cut square, and what one side gains in a bend the other side loses.
    assert solid.volume == pytest.approx(0.5 * size.sum() * LAYER * 0.1, rel=0.01)
    middle, unit = (a + b + c) / 3.0, normal / size[:, None]
    for way in (-0.045, 0.045):  # of at most 0.0485 m
        assert solid.inside(middle + way * unit).all()
    for way in (-0.055, 0.055):
        assert not solid.inside(middle + way * unit).any()


def test_a_plate_grows_to_one_spacing_and_a_thick_one_stays() -> None:
    plate = cube(edge=(1.0, 0.01, 1.0))
    made, (done,) = thickened(plate, spacing=0.1)
    assert done.thickened == 1
    size = np.ptp(made.surfaces[0].points[np.unique(made.surfaces[0].triangles)], axis=0)
    # 2 V / A of the plate is 0.0098 m: by that much less does it grow, and its rim stays
    grown = 0.01 + LAYER * 0.1 - 0.02 / 2.04
    np.testing.assert_allclose(size, [1.0, grown, 1.0], rtol=1e-9)
    slab = cube(edge=(1.0, 0.3, 1.0))
    same, (left,) = thickened(slab, spacing=0.1)
    assert same.surfaces[0] is slab
    assert left.messages() == ()


@pytest.mark.slow
def test_only_the_sheet_of_a_mesh_changes() -> None:
    both = joined(cube(), sheet(2, at=(0.0, 2.0, 0.0)))
    made, (done,) = thickened(both, spacing=0.1)
    assert done.thickened == 1
    solid = build_solid(made)
    X = np.array([[0.5, 0.5, 0.5], [0.5, 2.04, 0.5], [0.5, 1.96, 0.5], [0.5, 2.06, 0.5]])
    assert solid.inside(X).tolist() == [True, True, True, False]


def test_spacing_and_sheets_agree_on_the_number_of_particles() -> None:
    """V + S a = N a^3 of a ball and a sheet."""
    made, _ = thickened(sphere(0.3), sheet(2, at=(0.0, 1.0, 0.0)), particles=1000)
    solid = build_solid(made)
    a = np.cbrt(solid.volume / 1000)
    # the volume is counted on a lattice of 200,000 places: to a few per cent of a thin slab
    assert np.ptp(made.surfaces[1].points[:, 1]) == pytest.approx(LAYER * a, rel=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("wave", [0.0, 0.05])
@pytest.mark.parametrize("wanted", [500, pytest.param(3000, marks=pytest.mark.slow)])
def test_a_sheet_has_as_many_particles_as_asked_for(wave: float, wanted: int) -> None:
    """Of any resolution: with volume / a^3 of them a flat one has twice, a bent one up to four."""
    mended, repairs = repair_asset(asset(sheet(16, wave=wave)))
    made, (done,), spacing = thicken_to_count(mended, repairs, wanted)
    assert spacing is not None
    assert done.thickness == pytest.approx(LAYER * spacing)
    # A flat sheet has a whole number n of cells along each edge: from n to n + 1, 2 / n more.  Of a
    # bent one, parts come to lie in one more layer: what is off by more than .25 has a note.
    off = 0.25 if wave else 2.0 / np.sqrt(wanted / 8)
    assert count_particles(build_solid(made), spacing) == pytest.approx(wanted, rel=off)


@pytest.mark.slow
def test_of_many_particles_a_share_is_counted() -> None:
    mended, repairs = repair_asset(asset(sheet(2)))
    *_, few = thicken_to_count(mended, repairs, 20_000)
    *_, many = thicken_to_count(mended, repairs, 20_000 * 16)
    assert few is not None
    assert many == pytest.approx(few / 4.0, rel=1e-4)  # a^2 = S / N, of whole numbers N
    *_, none = thicken_to_count(*repair_asset(asset(cube())), 500)
    assert none is None


def test_what_is_too_small_or_in_flesh_stays_as_it_is() -> None:
    small = sheet(edge=0.3, at=(0.0, 3.0, 0.0), path="/Leaf")  # 9 particles at 0.1 m, of 16
    made, (_, leaf) = thickened(cube(), small, spacing=0.1)
    assert made.surfaces[1] is small
    assert (leaf.thickened, leaf.thin_left) == (0, 1)
    assert "left 1 sheet unfilled" in leaf.messages()[-1]
    within = joined(cube(), sheet(edge=0.5, at=(0.25, 0.5, 0.25)))
    same, (done,) = thickened(within, spacing=0.1)
    assert same.surfaces[0] is within
    assert (done.thickened, done.thin_left) == (0, 0)


def test_sheets_near_a_solid_share_one_hierarchy_of_winding_numbers(monkeypatch) -> None:
    sheets = [sheet(n=2, edge=0.3, at=(2.0 + i, 0.0, 0.0)) for i in range(5)]
    within = sheet(n=2, edge=0.3)
    made = []
    build = winding.winding_hierarchy
    monkeypatch.setattr(winding, "winding_hierarchy", lambda *a: made.append(a) or build(*a))
    seen = shells_of(joined(sphere(), within, *sheets))
    assert seen.enclosed.tolist() == [0, 1, 0, 0, 0, 0, 0]
    assert len(made) == 1


@pytest.mark.slow
def test_three_sheets_that_meet_are_all_thick() -> None:
    """Along one edge: each is a slab, and they overlap."""
    points = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0], [1, 0, 1], [-1, 0, 0], [-1, 0, 1],
                       [0, 1, 0], [0, 1, 1]], float)  # fmt: skip
    faces = [[0, 1, k + 1] for k in (2, 4, 6)] + [[0, k + 1, k] for k in (2, 4, 6)]
    made, (done,) = thickened(surface(points, np.array(faces)), spacing=0.1)
    assert done.thickened == 1
    X = np.array([[0.5, 0.04, 0.5], [-0.5, -0.04, 0.5], [0.04, 0.5, 0.5], [0.5, 0.06, 0.5]])
    assert build_solid(made).inside(X).tolist() == [True, True, True, False]


def test_offsets_move_every_face_of_a_box_by_one() -> None:
    box = cube()
    np.testing.assert_allclose(offsets(box.points, box.triangles), 2.0 * box.points - 1.0)
