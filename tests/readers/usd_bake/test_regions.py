"""Regions that prims name: subsets, meshes, what lies under a prim; and how they move."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gf_usd.core.errors import InputError
from gf_usd.core.stage import Region
from gf_usd.readers import read_asset
from gf_usd.readers.usd_bake.regions import read_regions

STAGE = """#usda 1.0
( metersPerUnit = 0.5
  upAxis = "Y"
  startTimeCode = 1
  endTimeCode = 3 )
def Xform "Moving" {
    double3 xformOp:translate.timeSamples = { 1: (0, 0, 0), 3: (4, 0, 0) }
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def Mesh "Box" {
        int[] faceVertexCounts = [4, 4, 4, 4, 3, 3, 4]
        int[] faceVertexIndices = [0,2,3,1, 4,5,7,6, 0,1,5,4, 2,6,7,3, 0,4,6, 0,6,2, 1,3,7,5]
        point3f[] points = [(0,0,0),(2,0,0),(0,2,0),(2,2,0),(0,0,2),(2,0,2),(0,2,2),(2,2,2)]
        def GeomSubset "end" {
            uniform token elementType = "face"
            int[] indices = [4, 5]
        }
        def GeomSubset "dots" {
            uniform token elementType = "point"
            int[] indices = [0, 4, 6]
        }
        def GeomSubset "empty" {
            uniform token elementType = "face"
            int[] indices = []
        }
    }
}
def Xform "Still" {
    def Sphere "Ball" {
        double radius = 1
    }
    def Cube "Block" {
        double size = 1
    }
}
def Scope "Nothing" {}
"""

Regions = Callable[..., tuple[Region, ...]]


@pytest.fixture
def regions(write: Callable[..., Path]) -> Regions:
    """Read regions of the stage above at three frames."""

    def regions(*names: str, rest: float | None = None) -> tuple[Region, ...]:
        path = write(STAGE)
        return read_regions(path, names, read_asset(path).facts, rest=rest, times=[1.0, 2.0, 3.0])

    return regions


def test_a_subset_of_faces_is_a_patch_that_moves_with_its_mesh(regions: Regions) -> None:
    (end,) = regions("/Moving/Box/end")
    assert (end.kind, end.body) == ("patch", "/Moving/Box")
    assert len(end.points) == 4
    assert len(end.triangles) == 2
    np.testing.assert_array_equal(end.points[:, 0], 0.0)
    # 4 units of half a meter
    np.testing.assert_allclose(end.path[:, 0] - end.points[0], [[0, 0, 0], [1, 0, 0], [2, 0, 0]])


def test_a_subset_of_points_has_the_faces_between_them(regions: Regions) -> None:
    (dots,) = regions("/Moving/Box/dots")
    assert len(dots.triangles) == 1
    np.testing.assert_array_equal(np.sort(dots.points[:, 2]), [0.0, 1.0, 1.0])


def test_a_mesh_is_a_volume_and_a_prim_above_is_all_its_meshes(regions: Regions) -> None:
    box, still = regions("/Moving/Box", "/Still")
    assert (box.kind, len(box.points), len(box.triangles)) == ("volume", 8, 12)
    assert box.path.shape == (3, 8, 3)
    assert still.kind == "volume"
    assert still.path.shape == (1, *still.points.shape)  # nothing moves
    assert still.points.max() == pytest.approx(0.5)  # the ball's radius


def test_the_rest_pose_is_the_one_asked_for(regions: Regions) -> None:
    (box,) = regions("/Moving/Box", rest=3.0)
    assert box.points[:, 0].min() == 2.0
    np.testing.assert_array_equal(box.path[0], box.points)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("/Nothing", "without a mesh under it"),
        ("/Moving/Box/empty", "0 indices but contains no face"),
        ("/Moving/Bocks", "there is no prim"),
    ],
)
def test_what_bounds_nothing_is_refused(regions: Regions, name: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        regions(name)
    assert name in caught.value.message
    assert message in caught.value.message
    assert caught.value.hint
