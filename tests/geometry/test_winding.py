"""Which parts of a mesh are inside others."""

from __future__ import annotations

import numpy as np
import pytest

from gf_usd.core.mesh.topology import used_points
from gf_usd.geometry import winding

CUBE = np.array(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), float).reshape(3, -1).T - 0.5
FACES = np.array(
    [
        (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
        (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
    ]
)  # fmt: skip


def cubes(*placed: tuple[float, tuple[float, float, float]]):
    """Points, triangles and labels of cubes, each of an edge and a center."""
    points = np.concatenate([edge * CUBE + center for edge, center in placed])
    triangles = np.concatenate([FACES + 8 * k for k in range(len(placed))])
    return points, triangles, np.repeat(np.arange(len(placed)), len(FACES))


def test_the_parent_of_a_part_is_the_smallest_one_around_it():
    whole = cubes(
        (0.5, (0.1, 0.0, 0.0)), (4.0, (0.0, 0.0, 0.0)), (2.0, (0.0, 0.0, 0.0)),
        (1.0, (9.0, 0.0, 0.0)), (0.2, (1.5, 0.0, 0.0)),
    )  # fmt: skip
    volume = np.abs(winding.volumes(*whole))
    assert winding.enclosing_parts(*whole, volume).tolist() == [2, -1, 1, -1, 1]


def test_of_two_equal_parts_around_a_part_the_first_is_its_parent():
    whole = cubes((2.0, (0.0, 0.0, 0.0)), (2.0, (0.0, 0.0, 0.0)), (1.0, (0.1, 0.0, 0.0)))
    volume = np.abs(winding.volumes(*whole))
    assert winding.enclosing_parts(*whole, volume).tolist() == [-1, -1, 0]


def test_a_part_is_searched_once_for_all_specks_in_its_box(monkeypatch: pytest.MonkeyPatch):
    """A hierarchy for each of the specks took nine tenths of the time of a scan (measured)."""
    asked = []
    true = winding.winding_inside

    def counted(points, triangles, X):
        asked.append(len(triangles))
        return true(points, triangles, X)

    monkeypatch.setattr(winding, "winding_inside", counted)
    specks = [(0.01, (0.3 * np.cos(k), 0.3 * np.sin(k), 0.01 * k)) for k in range(30)]
    whole = cubes((2.0, (0.0, 0.0, 0.0)), *specks)
    parent = winding.enclosing_parts(*whole, np.abs(winding.volumes(*whole)))
    assert parent.tolist() == [-1, *[0] * 30]
    assert asked == [len(FACES)]


@pytest.mark.parametrize("last", [11, 10_000], ids=["most points used", "few points used"])
def test_used_points_are_those_that_numpy_finds(last: int):
    triangles = np.array([(3, 1, last), (last, 1, 7), (7, 3, 1)])
    used, local = used_points(triangles)
    expected, back = np.unique(triangles, return_inverse=True)
    assert used.tolist() == expected.tolist() == [1, 3, 7, last]
    assert local.tolist() == back.reshape(-1, 3).tolist()
    assert [len(found) for found in used_points(np.zeros((0, 3), np.int64))] == [0, 0]
