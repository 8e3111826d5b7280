"""Caps over the holes of filled meshes, and contact samples on them."""

from __future__ import annotations

import numpy as np
import pytest
from solids import cube, fill, joined, solid, sphere, surface

from gf_usd.core.asset import Surface
from gf_usd.core.mesh.measures import areas, signed_volume
from gf_usd.geometry.sampling.contact_samples import sample_surface
from gf_usd.geometry.sampling.holes import SMALLEST, capped
from gf_usd.geometry.solid import Solid

SPACING = 0.1


def bottomless(low=(0.0, 0.0, 0.0), edge=1.0, path: str = "/Open") -> Surface:
    """A cube without its lower face."""
    whole = cube(low, edge)
    lower = (whole.points[whole.triangles][:, :, 1] == low[1]).all(1)
    assert lower.sum() == 2
    return surface(whole.points, whole.triangles[~lower], path=path)


def caps(body: Solid, index: int = 0, spacing: float = SPACING) -> tuple[np.ndarray, np.ndarray]:
    """The points of a surface, and the triangles that close its holes."""
    own = body.outward(index)[1]
    points, triangles = capped(body, index, np.arange(len(body.surfaces)), spacing)
    np.testing.assert_array_equal(triangles[: len(own)], own)
    return points, triangles[len(own) :]


@pytest.mark.parametrize("inside_out", [False, True])
def test_a_hole_is_capped_in_its_plane_facing_outward(inside_out: bool) -> None:
    mesh = bottomless()
    if inside_out:
        mesh = surface(mesh.points, mesh.triangles[:, ::-1], path="/Open")
    body = solid(mesh)
    points, made = caps(body)
    assert len(made) == 2
    assert areas(points, made).sum() == pytest.approx(1.0)
    # closed and outward: the volume of the cube
    whole = capped(body, 0, np.arange(1), SPACING)
    assert signed_volume(*whole) == pytest.approx(1.0)


def test_closed_surfaces_and_holes_smaller_than_samples_have_none() -> None:
    assert len(caps(solid(cube()))[1]) == 0
    body = solid(bottomless())
    assert len(caps(body, spacing=0.99 / np.sqrt(SMALLEST))[1]) == 2
    assert len(caps(body, spacing=1.01 / np.sqrt(SMALLEST))[1]) == 0


def test_a_hole_inside_another_surface_of_the_body_has_none() -> None:
    # as the neck of a head that ends in a torso
    body = solid(bottomless(low=(0.0, 0.5, 0.0)), cube((-0.5, -0.8, -0.5), 2.0, path="/Torso"))
    assert len(caps(body)[1]) == 0
    # of a body of its own it is capped
    own = body.outward(0)[1]
    assert len(capped(body, 0, np.array([0]), SPACING)[1]) == len(own) + 2


def test_a_cap_far_from_the_filling_is_omitted() -> None:
    """A ball with a wedge cut out: its rim is bent, and a cap over it is in the filling."""
    ball = sphere(1.0, path="/Ball")
    middle = ball.points[ball.triangles].mean(1)
    wedge = (middle[:, 1] > 0.0) & (np.abs(np.arctan2(middle[:, 0], middle[:, 1])) < 0.45)
    body = solid(surface(ball.points, ball.triangles[~wedge], path="/Ball"))
    assert len(caps(body, spacing=1.0)[1])
    assert len(caps(body, spacing=0.05)[1]) == 0


def test_samples_cover_a_hole_as_the_face_that_is_missing() -> None:
    made, whole = (sample_surface(solid(one), SPACING) for one in (bottomless(), cube()))
    assert made.area.sum() == pytest.approx(6.0, rel=1e-12)
    below = [samples.X[:, 1] < 1e-9 for samples in (made, whole)]
    assert below[0].sum() == pytest.approx(below[1].sum(), rel=0.1)
    assert made.area[below[0]].sum() == pytest.approx(whole.area[below[1]].sum(), rel=0.05)
    # a candidate is within 0.4 spacings, and a sample within 0.7 of that
    axis = np.linspace(0.0, 1.0, 21)
    places = np.stack(np.meshgrid(axis, [0.0], axis, indexing="ij"), -1).reshape(-1, 3)
    apart = np.linalg.norm(places[:, None] - made.X[below[0]], axis=2).min(1)
    assert apart.max() < 1.1 * SPACING


def test_samples_of_a_surface_of_two_shells_cover_the_holes_of_both() -> None:
    both = joined(bottomless(), bottomless(low=(3.0, 0.0, 0.0)))
    made = sample_surface(solid(both), SPACING)
    assert made.area.sum() == pytest.approx(12.0, rel=1e-12)


def test_cells_at_a_hole_are_filled_up_to_its_plane() -> None:
    """They were filled by their centers, up to half a cell beyond it."""
    made, whole = (fill(solid(one), 1000)[0] for one in (bottomless(), cube()))
    assert made.X[:, 1].min() > 0.0
    assert made.V0.sum() == pytest.approx(1.0, rel=0.01)
    assert made.X[:, 1].min() == pytest.approx(whole.X[:, 1].min(), abs=0.1 * made.spacing)
