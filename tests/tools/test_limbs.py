"""Faces of an asset divided for a measurement: the same shape in shorter edges."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom

from gf_usd.core.mesh.measures import signed_volume
from gf_usd.core.mesh.triangulation import triangulate
from tools.acceptance.limbs import divide, edges

BOX = """#usda 1.0
( defaultPrim = "Box" )
def Mesh "Box"
{
    int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
    int[] faceVertexIndices = [0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4,
        1, 5, 7, 3]
    point3f[] points = [(0, 0, 0), (0, 0, 1), (0, 1, 0), (0, 1, 1),
        (4, 0, 0), (4, 0, 1), (4, 1, 0), (4, 1, 1)]
    normal3f[] primvars:normals = [(1, 0, 0)]
}
"""


def read(path: Path):
    stage = Usd.Stage.Open(str(path))
    mesh = UsdGeom.Mesh(stage.GetDefaultPrim())
    points = np.asarray(mesh.GetPointsAttr().Get(), float)
    counts = np.asarray(mesh.GetFaceVertexCountsAttr().Get())
    return points, counts, np.asarray(mesh.GetFaceVertexIndicesAttr().Get())


def test_a_divided_box_is_the_same_box(tmp_path: Path) -> None:
    whole, divided = tmp_path / "box.usda", tmp_path / "divided.usda"
    whole.write_text(BOX, encoding="utf-8")
    divide(whole, divided, 0.3)
    points, counts, indices = read(divided)
    # 4 m in two halvings, which leave edges of 1 m, 1.2 m being allowed
    assert len(counts) == 6 * 4**2
    assert edges(points, np.split(indices, np.cumsum(counts)[:-1])).max() <= 1.2
    triangles, _, _ = triangulate(points, counts, indices)
    assert abs(signed_volume(points, triangles)) == 4.0
