"""Implicit shapes: closed, outward, even, and as large as the shape they stand for."""

import numpy as np
import pytest

from gf_usd.core.mesh.measures import signed_volume
from gf_usd.core.mesh.topology import boundary_edges, shells, weld

PI = np.pi
SHAPES = {
    'def Sphere "S" {\ndouble radius = 2\n}': (4 / 3 * PI * 8, [2, 2, 2]),
    'def Cube "S" {\ndouble size = 3\n}': (27, [1.5] * 3),
    'def Capsule "S" {\ndouble radius = 0.5\ndouble height = 3\nuniform token axis = "X"\n}': (
        PI * 0.25 * 3 + 4 / 3 * PI / 8,
        [2, 0.5, 0.5],
    ),
    'def Capsule "S" {\ndouble radius = 0.5\ndouble height = 0\n}': (PI / 6, [0.5] * 3),
    'def Cylinder "S" {\ndouble radius = 1\ndouble height = 1\nuniform token axis = "Y"\n}': (
        PI,
        [1, 0.5, 1],
    ),
    'def Cone "S" {\ndouble radius = 1\ndouble height = 2\nuniform token axis = "Z"\n}': (
        PI * 2 / 3,
        [1, 1, 1],
    ),
    'def Cylinder_1 "S" {\ndouble radiusTop = 1\ndouble radiusBottom = 2\ndouble height = 2\n}': (
        PI * 2 / 3 * (1 + 2 + 4),
        [2, 2, 1],
    ),
    'def Capsule_1 "S" {\ndouble radiusTop = 1\ndouble radiusBottom = 2\ndouble height = 2\n}': (
        PI * 2 / 3 * (1 + 2 + 4) + 2 / 3 * PI * (1 + 8),
        [2, 2, 2.5],
    ),
}


@pytest.mark.parametrize("body", SHAPES)
def test_closed_outward_and_of_the_right_size(read, body):
    volume, half = SHAPES[body]
    (surface,) = read(body).surfaces
    assert surface.type_name in body
    assert weld(surface.points)[1] == len(surface.points)  # every point is shared
    assert len(np.unique(surface.face_indices)) == len(surface.points)
    assert surface.face_counts.sum() == len(surface.face_indices)
    assert len(boundary_edges(surface.triangles)) == 0
    assert shells(surface.triangles).max() == 0
    # Chords of 72 around and 12 from pole to rim lie inside the round shape: at most 0.8 % less.
    assert 0.992 * volume < signed_volume(surface.points, surface.triangles) <= volume * 1.000001
    np.testing.assert_allclose(np.ptp(surface.points, axis=0) / 2, half, rtol=1e-12)


@pytest.mark.parametrize("body", [b for b in SHAPES if "Cone" not in b])
def test_triangles_are_well_shaped(read, body):
    (surface,) = read(body).surfaces
    a, b, c = np.moveaxis(surface.points[surface.triangles], 1, 0)
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    edges = sum(np.einsum("ij,ij->i", e, e) for e in (b - a, c - b, a - c))
    # 1 for an equilateral triangle, 0.87 for half a square, 0.6 for half a 1:2 rectangle.
    assert np.min(4 * np.sqrt(3) * area / edges) > 0.6


def test_the_cone_points_along_its_axis(read):
    (surface,) = read('def Cone "S" {\nuniform token axis = "Y"\n}').surfaces
    tip = surface.points[np.argmax(surface.points[:, 1])]
    np.testing.assert_allclose(tip, [0, 1, 0], atol=1e-12)
    assert np.sum(surface.points[:, 1] > 0.999) == 1


def test_animated_radius_is_read_at_the_pose_time(read):
    body = 'def Sphere "S" {\ndouble radius.timeSamples = { 1: 1, 11: 3 }\n}'
    for time, radius in ((None, 1.0), (6, 2.0), (11, 3.0)):
        assert read(body, time_code=time).surfaces[0].points.max() == pytest.approx(radius)


@pytest.mark.parametrize(("kind", "size"), [("Cube", "size"), ("Capsule", "height")])
def test_a_shape_that_grows_starts_from_its_first_size_and_this_is_said(read, kind, size):
    still = f'def {kind} "S" {{\n double {size} = 2\n}}'
    assert "is animated" not in str(read(still).facts.notes)
    grows = still.replace(" = 2", ".timeSamples = { 1: 2, 9: 4 }")
    note = "</S> is animated: the simulation starts from its pose at the first frame"
    assert note in read(grows).facts.notes


def test_negative_radius_is_left_alone(read):
    asset = read('def Cube "A" {}\ndef Sphere "S" {\ndouble radius = -1\n}')
    assert asset.skipped == (("/S", "its radius is -1"),)


@pytest.mark.parametrize("shape", ["Capsule", "Cylinder", "Cone", "Capsule_1", "Cylinder_1"])
def test_an_axis_that_is_none_is_left_alone(read, shape):
    asset = read(f'def Cube "A" {{}}\ndef {shape} "S" {{\nuniform token axis = "up"\n}}')
    assert asset.skipped == (("/S", "its axis is 'up', which is not X, Y or Z"),)
