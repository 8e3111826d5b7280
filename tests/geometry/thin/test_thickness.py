"""The thickness of solids that is known: plates, rods, balls, and what overlaps."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from solids import cube, solid, sphere, surface, without

from gf_usd.geometry.thin.thickness import Thickness, inward_rays, thickness


def test_a_plate_is_as_thick_as_across_it() -> None:
    # its two faces are 2 of 2.4 of its area; rays from the rim run along it
    seen = thickness(solid(cube(edge=(1.0, 1.0, 0.1))))
    assert seen is not None
    assert seen.thin == pytest.approx(0.1, rel=1e-6)
    assert seen.median == pytest.approx(0.1, rel=1e-6)
    length, _, _ = inward_rays(solid(cube(edge=(1.0, 1.0, 0.1))), np.arange(1), 1200)
    assert (length > 0.5).mean() == pytest.approx(0.4 / 2.4, abs=1 / 1200 * 8)


def test_a_rod_is_as_thick_as_its_diameter() -> None:
    rod = trimesh.creation.cylinder(radius=0.1, height=2.0, sections=64)
    seen = thickness(solid(surface(rod.vertices, rod.faces)))
    # flat sides of 64 lie between the inner and the outer circle
    assert seen is not None
    assert 0.2 * np.cos(np.pi / 64) - 1e-6 <= seen.thin <= 0.2
    assert seen.median <= 0.2


def test_a_ball_is_as_thick_as_its_diameter() -> None:
    seen = thickness(solid(sphere(0.5)))
    assert seen is not None
    # of facets: from an inner to an outer radius, and no quantile is far
    assert 0.97 <= seen.thin <= seen.median <= 1.0


def test_a_thin_part_counts_by_its_area() -> None:
    # a cube with a fin next to it whose faces are 2 * 0.2 of 6.4, then of 6.2 of the area
    big = cube(path="/Cube")
    for height, thin in ((0.2, 0.01), (0.1, 1.0)):
        fin = cube(low=(2.0, 0.0, 0.0), edge=(0.01, height, 1.0), path="/Fin")
        seen = thickness(solid(big, fin))
        assert seen is not None
        assert seen.thin == pytest.approx(thin, rel=0.01)


def test_surfaces_that_overlap_are_one() -> None:
    one = cube(path="/One")
    two = cube(low=(0.5, 0.0, 0.0), path="/Two")
    length, _, _ = inward_rays(solid(one, two), np.zeros(2, int), 1000)
    np.testing.assert_allclose(np.unique(length.round(6)), [1.0, 1.5])


def test_a_body_is_as_thick_as_without_those_it_touches() -> None:
    """A plate on a box as one body; as a body of its own it is to be filled by itself."""
    both = solid(cube(path="/Box"), cube(low=(0.0, 0.0, 1.0), edge=(1.0, 1.0, 0.1), path="/Plate"))
    one, two = thickness(both), thickness(both, np.arange(2))
    assert one is not None
    assert two is not None
    assert one.thin == pytest.approx(1.0, rel=1e-6)
    assert two.thin == pytest.approx(0.1, rel=1e-6)
    # 2 of 8.4 of the area are the faces of the plate, and 6 those of the box
    length, _, _ = inward_rays(both, np.arange(2), 1000)
    assert (length < 0.5).mean() == pytest.approx(2.0 / 8.4, abs=8 / 1000)


def test_which_way_faces_look_does_not_matter() -> None:
    plate = cube(edge=(1.0, 1.0, 0.1))
    turned = surface(plate.points, plate.triangles[:, ::-1])
    assert thickness(solid(turned)) == thickness(solid(plate))


def test_it_scales_and_repeats() -> None:
    small, large = (thickness(solid(sphere(r))) for r in (0.01, 10.0))
    assert small is not None
    assert large is not None
    assert large.thin == pytest.approx(1000.0 * small.thin, rel=1e-6)  # igl counts in f32
    assert thickness(solid(sphere(0.01))) == small


def test_rays_through_a_hole_are_left_out() -> None:
    whole = cube()
    open_above = without(whole, [2])  # a triangle of the top
    length, _, _ = inward_rays(solid(open_above), np.arange(1), 1000)
    assert len(length) < 1000
    np.testing.assert_allclose(length, 1.0, rtol=1e-6)


def test_a_sharp_edge_is_not_a_thin_part() -> None:
    """Rays get short towards the edges of a tetrahedron, and no resolution fills these: its thin
    5 % were a fifteenth of its median, for which a bake took its largest number of particles."""
    tetra = surface(
        np.vstack([np.zeros(3), np.eye(3)]), [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    )
    seen = thickness(solid(tetra))
    assert seen is not None
    assert seen.thin > 0.5 * seen.median


def test_a_triangular_rod_is_thin() -> None:
    """Its sides meet at 60 degrees, and it is thin all the same; a pyramid next to it is not."""
    rod = trimesh.creation.cylinder(radius=0.1, height=4.0, sections=3)
    pyramid = trimesh.creation.cone(radius=2.0, height=2.0, sections=4)
    pyramid.apply_translation((5.0, 0.0, 0.0))
    for meshes in ([rod], [rod, pyramid]):
        both = trimesh.util.concatenate(meshes)
        seen = thickness(solid(surface(both.vertices, both.faces)))
        assert seen is not None
        assert 0.04 < seen.thin < 0.15 if len(meshes) == 1 else seen.thin < 0.15


def test_particles_across() -> None:
    assert Thickness(thin=0.12, median=1.0).across(0.04) == pytest.approx(3.0)


@pytest.mark.parametrize("size", [1e-6, 0.01, 1e6])
def test_thickness_scales_with_the_body(size: float) -> None:
    """The ray test of libigl misses triangles whose doubled area is below 1e-6 of its unit: a
    ball 2 cm wide had no thickness."""
    fine = sphere(subdivisions=4)
    whole = thickness(solid(fine))
    seen = thickness(solid(surface(size * fine.points, fine.triangles)))
    assert whole is not None
    assert seen is not None
    assert seen.thin == pytest.approx(size * whole.thin, rel=1e-5)
    assert seen.median == pytest.approx(size * whole.median, rel=1e-5)
    length, _, _ = inward_rays(
        solid(surface(size * fine.points, fine.triangles)), np.arange(1), 200
    )
    assert len(length) == 200


def test_a_thickness_is_measured_once(monkeypatch: pytest.MonkeyPatch) -> None:
    body = solid(cube())
    found = thickness(body)
    monkeypatch.setattr(
        "gf_usd.geometry.thin.thickness.inward_rays",
        lambda *_: (np.ones(3), np.zeros(3, bool), np.zeros(3, np.int64)),
    )
    assert thickness(body, np.zeros(1, np.int64)) is found
    assert thickness(body, rays=100) != found
