"""Faces that are there twice, walls back to back, and parts that reach into each other."""

from __future__ import annotations

import numpy as np
import pytest
from solids import CUBE_POINTS, asset, cube, joined, surface, turned, volume

from gf_usd.core.asset import Surface
from gf_usd.core.mesh.triangulation import triangulate
from gf_usd.geometry.diagnosis import diagnose
from gf_usd.geometry.repair import repair_surface
from gf_usd.geometry.solid import build_solid

QUADS = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]


def of_faces(points: np.ndarray, faces: list[list[int]]) -> Surface:
    """A mesh of polygons, as a reader would cut it."""
    counts, indices = np.array([len(f) for f in faces]), np.concatenate(faces)
    triangles, corners, _ = triangulate(points, counts, indices)
    return Surface(
        path="/Body", type_name="Mesh", points=points, face_counts=counts, face_indices=indices,
        triangles=triangles, triangle_corners=corners,
    )  # fmt: skip


def back(faces: list[list[int]], shift: int = 0) -> list[list[int]]:
    """The faces from behind, each from another corner on: a square may be cut the other way."""
    return [[*f[::-1][shift:], *f[::-1][:shift]] for f in faces]


@pytest.mark.parametrize("shift", [0, 1, 2])
def test_a_body_of_quads_with_both_sides_keeps_one_that_faces_outward(shift: int) -> None:
    mended, done = repair_surface(of_faces(CUBE_POINTS, [*back(QUADS, shift), *QUADS]))
    assert (done.other_sides, done.walls, done.duplicates) == (12, 0, 0)
    assert volume(mended) == pytest.approx(1.0, rel=1e-12)
    assert "12 on the second side" in done.messages()[0]


def test_a_copy_with_points_of_its_own_is_the_second_side_too() -> None:
    whole = cube()
    mended, done = repair_surface(joined(whole, turned(whole, slice(None))))
    assert done.other_sides == 12
    assert volume(mended) == pytest.approx(1.0, rel=1e-12)


def test_a_second_side_that_lacks_a_few_faces_is_one_still() -> None:
    mended, done = repair_surface(of_faces(CUBE_POINTS, [*QUADS, *back(QUADS)[:4]]))
    assert (done.other_sides, done.walls) == (8, 0)
    assert volume(mended) == pytest.approx(1.0, rel=1e-12)


def test_a_hollow_body_with_a_second_side_outside_stays_hollow() -> None:
    inner = 0.5 + 0.5 * (CUBE_POINTS - 0.5)
    faces = [*QUADS, *back(QUADS, 1), *[[8 + i for i in f] for f in back(QUADS)]]
    mended, done = repair_surface(of_faces(np.concatenate([CUBE_POINTS, inner]), faces))
    assert (done.other_sides, done.cavities) == (12, 1)
    assert volume(mended) == pytest.approx(1.0 - 0.125, rel=1e-12)


def test_a_wall_between_two_rooms_is_dropped() -> None:
    """Two boxes, face to face: what is between them has no thickness."""
    points = np.concatenate([CUBE_POINTS, CUBE_POINTS + (1.0, 0.0, 0.0)])
    faces = [*QUADS, *[[8 + i for i in f[1:] + f[:1]] for f in QUADS]]
    body = of_faces(points, faces)
    assert diagnose(body).duplicates == 4
    mended, done = repair_surface(body)
    assert (done.walls, done.other_sides) == (4, 0)
    seen = diagnose(mended)
    assert seen.watertight
    assert len(seen.shells) == 1
    assert volume(mended) == pytest.approx(2.0, rel=1e-12)


def test_a_wall_across_a_body_is_dropped() -> None:
    """Through opposite edges of a box, both ways."""
    wall = [[0, 1, 7, 6]]
    mended, done = repair_surface(of_faces(CUBE_POINTS, [*QUADS, *wall, *back(wall, 1)]))
    assert (done.walls, done.other_sides) == (4, 0)
    assert volume(mended) == pytest.approx(1.0, rel=1e-12)


def test_parts_that_overlap_stay_and_share_their_flesh() -> None:
    crossed = joined(
        cube((-2.0, 0.0, 0.0), (5.0, 1.0, 1.0)), cube((0.0, -2.0, 0.0), (1.0, 5.0, 1.0))
    )
    mended, done = repair_surface(crossed)
    assert mended is crossed
    assert (done.overlapping, done.changed) == (2, False)
    assert "2 parts that overlap others" in done.messages()[0]
    # counted on a lattice of 200,000 places along the box: to their rounding
    assert build_solid(asset(mended)).volume == pytest.approx(9.0, rel=0.02)


def test_parts_that_touch_do_not_overlap() -> None:
    apart = surface(
        np.concatenate([CUBE_POINTS, CUBE_POINTS * (1.0, 0.5, 0.5) + (1.0, 0.2, 0.2)]),
        np.concatenate([cube().triangles, 8 + cube().triangles]),
    )
    assert repair_surface(apart)[1].overlapping == 0
