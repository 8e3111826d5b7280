"""What the default drop moves far, and what that does to the points that are written."""

from __future__ import annotations

from pathlib import Path

import pytest

import gf_usd
from gf_usd.core.errors import UsageError

CUBE = """#usda 1.0
(
    defaultPrim = "Cube"
    metersPerUnit = 1
    upAxis = "Y"
)
def Mesh "Cube"
{
    uniform token subdivisionScheme = "none"
    int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
    int[] faceVertexIndices = [
        0, 2, 3, 1, 4, 5, 7, 6, 0, 1, 5, 4, 2, 6, 7, 3, 0, 4, 6, 2, 1, 3, 7, 5
    ]
    point3f[] points = [%s]
    double3 xformOp:translate = (0, %s, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
"""


def cube(folder: Path, *, translate: float = 0.0, points: float = 0.0) -> Path:
    """A cube of 1 m whose middle is at the height translate + points [m]."""
    corners = [(x, y + points, z) for z in (-0.5, 0.5) for y in (-0.5, 0.5) for x in (-0.5, 0.5)]
    path = folder / "cube.usda"
    path.write_text(CUBE % (", ".join(map(str, corners)), translate))
    return path


def notes(path: Path, **options) -> list[str]:
    plan = gf_usd.inspect(path, particles=300, **options).plan
    assert plan is not None
    return [note for note in plan.notes if "moved" in note]


def test_a_body_high_above_the_floor_is_said_to_be_moved_down(tmp_path: Path) -> None:
    (note,) = notes(cube(tmp_path, points=100.0))
    # radius (3 / 4 pi)^(1/3) = 0.62 m, and a drop of three
    assert note == (
        "the lowest point of the asset is 99.5 m above the floor and is moved down to 1.86 m above"
        " it: drop=99.5 leaves it where it is; floor=97.63895 puts the floor so far under it"
    )


@pytest.mark.parametrize("options", [{"drop": 99.5}, {"floor": 97.63895}])
def test_what_the_note_says_keeps_it_where_it_is(tmp_path: Path, options) -> None:
    path = cube(tmp_path, points=100.0)
    plan = gf_usd.inspect(path, particles=300, **options).plan
    assert plan is not None
    assert plan.settings.lift == pytest.approx((0.0, 0.0, 0.0), abs=1e-3), "seven digits"
    assert notes(path, **options) == []


def test_a_body_wholly_below_the_floor_is_said_to_be_moved_up(tmp_path: Path) -> None:
    (note,) = notes(cube(tmp_path, points=-3.0))
    assert note == (
        "the lowest point of the asset is 3.5 m below the floor and is moved up to 1.86 m above it:"
        " floor=-5.361051 puts the floor so far under it"
    )


@pytest.mark.parametrize("height", [0.0, 0.5, 2.5])
def test_a_body_near_the_floor_has_no_note(tmp_path: Path, height: float) -> None:
    assert notes(cube(tmp_path, points=height)) == []


def test_points_far_from_their_own_origin_are_reported(tmp_path: Path) -> None:
    """The prim's transform stays where it is, so that its points are as far from it."""
    (moved, own) = notes(cube(tmp_path, translate=1e5))
    assert "moved down" in moved
    assert "</Cube> is moved by 100 km" in own
    assert "its points are 100 km from the origin of its own space" in own
    # authored as far from the origin, they have become exact
    assert len(notes(cube(tmp_path, points=1e5))) == 1


def test_points_so_far_that_the_shape_is_lost_are_refused(tmp_path: Path) -> None:
    path = cube(tmp_path, translate=1e7)
    with pytest.raises(UsageError, match=r"its points would be 10000 km from the origin of its"):
        notes(path)
    assert notes(path, floor=1e7 - 2.0) == []
