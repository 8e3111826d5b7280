"""What is counted and measured of a mesh, on shapes where it is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from solids import CUBE_POINTS, CUBE_TRIANGLES, cube, sphere, surface

from gf_usd.geometry.diagnosis import diagnose, faults, tolerated_defects


def test_a_box_is_watertight_with_its_volume_and_area():
    seen = diagnose(cube(edge=(2.0, 3.0, 4.0)))
    assert seen.watertight
    assert (seen.points, seen.faces, len(seen.shells)) == (8, 12, 1)
    assert (seen.volume, seen.area) == (pytest.approx(24.0), pytest.approx(52.0))
    assert seen.shells[0].winding == "outward"
    np.testing.assert_allclose(seen.shells[0].size, [2.0, 3.0, 4.0])
    assert faults(seen) == []
    assert tolerated_defects([seen]) == []


def test_faces_are_counted_as_authored():
    body = replace(cube(), face_counts=np.array([3, 4, 4, 5, 7]))
    seen = diagnose(body)
    assert seen.face_sizes == {"triangles": 1, "quads": 2, "ngons": 2}
    assert seen.largest_face == 7


def test_a_box_without_a_lid_has_one_hole_of_a_sixth():
    seen = diagnose(surface(CUBE_POINTS, CUBE_TRIANGLES[2:]))
    (hole,) = seen.holes
    assert hole.edges == 4
    assert hole.share == pytest.approx(1 / 6)
    assert hole.size == pytest.approx(np.sqrt(2.0))
    np.testing.assert_allclose(hole.center, [0.5, 0.5, 0.0])
    assert seen.hole_share == pytest.approx(1 / 6)
    # All that is wrong is a hole that repair would leave: it is not recommended.
    assert tolerated_defects([seen]) == [
        "</Body> is filled despite 1 hole (17 % of the closed area)"
    ]


def test_the_hole_is_found_whatever_way_the_triangles_face():
    triangles = CUBE_TRIANGLES[2:].copy()
    triangles[::3] = triangles[::3, ::-1]
    seen = diagnose(surface(CUBE_POINTS, triangles))
    assert [hole.edges for hole in seen.holes] == [4]
    assert seen.loose_edges == 0


def test_holes_belong_to_their_shells():
    lidless = CUBE_TRIANGLES[2:]
    far = CUBE_POINTS + [5.0, 0.0, 0.0]
    both = surface(
        np.concatenate([CUBE_POINTS, far]), np.concatenate([CUBE_TRIANGLES, lidless + 8])
    )
    seen = diagnose(both)
    assert [len(shell.holes) for shell in seen.shells] == [0, 1]
    # Half of the closed area is a sixth open.
    assert seen.hole_share == pytest.approx(1 / 12)


@pytest.mark.parametrize(
    ("triangles", "winding"),
    [
        (CUBE_TRIANGLES, "outward"),
        (CUBE_TRIANGLES[:, ::-1], "inside out"),
        (np.concatenate([CUBE_TRIANGLES[:11], CUBE_TRIANGLES[11:, ::-1]]), "mixed"),
        (CUBE_TRIANGLES[:4], "open"),
        (np.array([[0, 1, 2], [0, 2, 1]]), "flat"),
    ],
)
def test_the_orientation_of_a_shell(triangles, winding):
    assert diagnose(surface(CUBE_POINTS, triangles)).shells[0].winding == winding


def test_a_cavity_is_taken_off_the_volume():
    outer, inner = sphere(), sphere(radius=0.5)
    hollow = surface(
        np.concatenate([outer.points, inner.points]),
        np.concatenate([outer.triangles, inner.triangles[:, ::-1] + len(outer.points)]),
    )
    seen = diagnose(hollow)
    assert [shell.winding for shell in seen.shells] == ["outward", "cavity"]
    assert seen.volume == pytest.approx(diagnose(outer).volume * (1.0 - 0.5**3))
    assert tolerated_defects([seen]) == []


def test_faults_are_reported_in_words():
    triangles = np.concatenate([CUBE_TRIANGLES[2:11], CUBE_TRIANGLES[11:, ::-1]])
    seen = diagnose(surface(CUBE_POINTS, np.concatenate([triangles, triangles[:2]])))
    assert "2 duplicate triangles" in faults(seen)
    (note,) = tolerated_defects([seen])
    assert note.endswith("--repair fixes this")


def test_many_meshes_with_faults_have_one_note():
    open_ = [surface(CUBE_POINTS, CUBE_TRIANGLES[2:], path=f"/Open{k}") for k in range(2)]
    slit = surface(CUBE_POINTS, CUBE_TRIANGLES[1:], path="/Slit")
    doubled = surface(CUBE_POINTS, np.concatenate([CUBE_TRIANGLES, CUBE_TRIANGLES[:2]]))
    seen = [diagnose(s) for s in (*open_, cube(), slit, doubled)]
    assert len(tolerated_defects(seen[:4])) == 3
    assert tolerated_defects(seen) == [
        "4 meshes are filled despite 3 holes (at most 17 % of the closed area, of </Open0>), "
        "2 duplicate triangles; --repair fixes this"
    ]


def test_an_edge_of_four_triangles_is_not_manifold():
    second = CUBE_TRIANGLES + 8
    points = np.concatenate([CUBE_POINTS, CUBE_POINTS + [1.0, 1.0, 0.0]])
    seen = diagnose(surface(points, np.concatenate([CUBE_TRIANGLES, second])))
    # Two boxes that touch along one edge: one shell, closed.
    assert (seen.non_manifold_edges, len(seen.shells), seen.watertight) == (1, 1, True)
    assert seen.volume == pytest.approx(2.0)


def test_a_mesh_of_collapsed_faces_only():
    seen = diagnose(surface(CUBE_POINTS, [[0, 0, 1], [2, 2, 2]]))
    assert (seen.collapsed, seen.shells, seen.watertight, seen.volume) == (2, (), False, 0)
