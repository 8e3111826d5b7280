"""The bodies with limbs, and the measure of what lies inside a body."""

from __future__ import annotations

import json
from dataclasses import asdict

import numpy as np
import pytest
from limbed import LIMBED, write_limbed
from pxr import Usd, UsdGeom
from solids import CUBE_POINTS, CUBE_TRIANGLES

from gf_usd.core.mesh import boundary_edges, divided, signed_volume, weld
from tools.acceptance.limbs import (
    RESULT,
    Ran,
    main,
    recorded,
    shares_inside,
    triangles_at,
    which_inside,
)


@pytest.mark.parametrize("name", LIMBED)
def test_what_is_made_is_watertight_and_right_side_out(name) -> None:
    for points, triangles in LIMBED[name]():
        assert len(boundary_edges(weld(points)[0][triangles])) == 0
        assert signed_volume(points, triangles) > 0.0
        assert points[:, 1].min() > -0.1


def test_a_written_one_is_a_stage_in_meters(tmp_path) -> None:
    stage = Usd.Stage.Open(str(write_limbed("rings", tmp_path / "rings.usda")))
    meshes = [p for p in stage.Traverse() if p.IsA(UsdGeom.Mesh)]
    assert len(meshes) == 5
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0


def found(points, triangles, mesh, area=np.inf):
    """Of `which_inside`, with pieces of at most an area."""
    pieces = divided(points, triangles, area)
    return pieces, *which_inside(points, triangles, mesh, pieces)


def test_of_a_cube_in_a_cube_all_of_the_inner_one_is_inside() -> None:
    inner = 0.25 + 0.5 * CUBE_POINTS
    points = np.concatenate([CUBE_POINTS, inner])
    triangles = np.concatenate([CUBE_TRIANGLES, CUBE_TRIANGLES + 8])
    mesh = np.repeat([0, 1], 12)
    _, inside, area = found(points, triangles, mesh)
    assert inside.tolist() == [False] * 12 + [True] * 12
    np.testing.assert_allclose(area, np.repeat([0.5, 0.125], 12))
    assert not found(CUBE_POINTS, CUBE_TRIANGLES, mesh[:12])[1].any()
    _, both, _ = found(points, triangles, np.zeros(24, int))
    assert both.tolist() == inside.tolist(), "the same of one mesh"


@pytest.mark.parametrize("mesh", [(0, 1), (0, 0)], ids=["two meshes", "one mesh"])
@pytest.mark.parametrize(("gap", "inside"), [(1e-4, False), (-1e-4, True)])
def test_what_touches_is_not_inside(gap, inside, mesh) -> None:
    """Two cubes next to each other, with a gap and an overlap of 5e-5 of the box around them."""
    points = np.concatenate([CUBE_POINTS, CUBE_POINTS + [1.0 + gap, 0.0, 0.0]])
    triangles = np.concatenate([CUBE_TRIANGLES, CUBE_TRIANGLES + 8])
    _, seen, area = found(points, triangles, np.repeat(mesh, 12))
    faces = np.isclose(points[triangles][:, :, 0], 1.0, atol=2e-4).all(1)
    assert seen.tolist() == (faces & inside).tolist()
    assert area[faces].sum() == pytest.approx(2.0)


def test_of_a_large_triangle_only_what_is_inside_counts() -> None:
    """A cube that stands in the corner of one of twice its size, whose faces have two triangles."""
    points = np.concatenate([2.0 * CUBE_POINTS, [1.5, 1.5, 1.5] + CUBE_POINTS])
    triangles = np.concatenate([CUBE_TRIANGLES, CUBE_TRIANGLES + 8])
    pieces, inside, area = found(points, triangles, np.repeat([0, 1], 12), 0.5 * 0.05**2)
    assert area.sum() == pytest.approx(30.0)
    # A square of 0.5 x 0.5 on three faces of each.  A piece counts whole: those at the rim of a
    # square, of two sides 0.5 long, are 0.05 wide.
    for cube in (0, 1):
        mine = inside & (pieces.of // 12 == cube)
        assert area[mine].sum() == pytest.approx(3 * 0.5**2, abs=3 * 2 * 0.5 * 0.05)


def test_what_is_inside_at_rest_is_told_apart_from_what_comes_there() -> None:
    """Of three cubes one lies in the large one at rest, one comes into it."""
    stage = Usd.Stage.CreateInMemory()
    within, beside = 0.2 + 0.25 * CUBE_POINTS, [2.0, 0.0, 0.0] + 0.25 * CUBE_POINTS
    for name, places in (
        ("Large", (CUBE_POINTS, CUBE_POINTS)),
        ("Shell", (within, within)),
        ("Comes", (beside, within + [0.0, 0.0, 0.4])),
    ):
        mesh = UsdGeom.Mesh.Define(stage, f"/{name}")
        for time, points in enumerate(places):
            mesh.GetPointsAttr().Set([tuple(map(float, p)) for p in points], float(time))
        mesh.GetFaceVertexCountsAttr().Set([3] * 12)
        mesh.GetFaceVertexIndicesAttr().Set(CUBE_TRIANGLES.ravel().tolist())
    small = 0.25**2 / (1.0 + 2.0 * 0.25**2)
    assert shares_inside(stage) == pytest.approx((small, small))


def test_a_frame_in_the_world_is_read_in_triangles() -> None:
    stage = Usd.Stage.CreateInMemory()
    mesh = UsdGeom.Mesh.Define(stage, "/Square")
    mesh.AddTranslateOp().Set((0.0, 5.0, 0.0))
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0]], float)
    for time in (1.0, 2.0):
        mesh.GetPointsAttr().Set([tuple(time * p) for p in square], time)
    mesh.GetFaceVertexCountsAttr().Set([4, 3])
    mesh.GetFaceVertexIndicesAttr().Set([0, 1, 2, 3, 1, 4, 2])
    UsdGeom.Mesh.Define(stage, "/Still")
    np.testing.assert_allclose(triangles_at(stage, 0)[0], square + [0.0, 5.0, 0.0])
    points, triangles, whose = triangles_at(stage, -1)
    assert whose.tolist() == [0, 0, 0]
    np.testing.assert_allclose(points, 2.0 * square + [0.0, 5.0, 0.0])
    assert triangles.tolist() == [[0, 1, 2], [0, 2, 3], [1, 4, 2]]
    mesh.GetOrientationAttr().Set(UsdGeom.Tokens.leftHanded)
    assert triangles_at(stage, -1)[1].tolist() == [[2, 1, 0], [3, 2, 0], [2, 4, 1]]


def test_rows_of_an_earlier_record_say_of_what_they_are(tmp_path) -> None:
    row = {"asset": "hand", "look": "jelly", "seconds": 1.0}
    later = {**row, "look": "metal", "date": "2001-02-04", "commit": "fed"}
    tree = {"date": "2001-02-03", "commit": "abc", "outcome": {"data": {"runs": [row, later]}}}
    file = tmp_path / "record.json"
    file.write_text(json.dumps(tree))
    rows = recorded(file)
    assert rows["hand", "jelly"] == Ran(**row, date="2001-02-03", commit="abc")
    assert rows["hand", "metal"] == Ran(**later)


def test_what_is_kept_or_recorded_is_not_baked(tmp_path, capsys) -> None:
    """Of the folder the newer row is taken, before that of the record; nothing else is printed."""
    rows = [Ran(asset="hand", look=look, seconds=1.0) for look in ("rubber", "jelly")]
    tree = {"outcome": {"data": {"runs": [asdict(row) for row in rows]}}, "date": "", "commit": ""}
    file, keep = tmp_path / "record.json", tmp_path / "kept"
    file.write_text(json.dumps(tree))
    (keep / "hand" / "jelly").mkdir(parents=True)
    (keep / "hand" / "jelly" / RESULT).write_text(json.dumps({**asdict(rows[1]), "seconds": 2.0}))
    words = [str(tmp_path), "--keep", str(keep), "--recorded", str(file), "--kept", "--json"]
    assert main([*words, "--only", "hand"]) == 0
    seen = json.loads(capsys.readouterr().out)["runs"]
    assert [(one["look"], one["seconds"]) for one in seen] == [("rubber", 1.0), ("jelly", 2.0)]
