"""Long faces of meshes are divided in a layer over the stage: and so is what depends on them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, Vt

from gf_usd.core.errors import InputError
from gf_usd.core.mesh.measures import areas, signed_volume
from gf_usd.core.mesh.triangulation import triangulate
from gf_usd.readers.isolated import read_untrusted
from gf_usd.readers.mesh.divide import layer as divide
from gf_usd.readers.mesh.divide.faces import divide_faces
from gf_usd.readers.mesh.divide.layer import fine_edge

LONGEST = 0.35
# A prism over a pentagon, with a small square on its side: long and short faces, 3 to 5 corners.
RING = np.array([(0, 0), (2, 0), (2.4, 1), (1, 1.8), (0, 1)], float)
POINTS = np.concatenate([np.column_stack([RING, np.full(5, z)]) for z in (0.0, 0.1)])
COUNTS = np.array([5, 5, 4, 4, 4, 4, 3, 3])
INDICES = np.array([
    *(4, 3, 2, 1, 0), *(5, 6, 7, 8, 9),
    *(0, 1, 6, 5), *(1, 2, 7, 6), *(2, 3, 8, 7), *(3, 4, 9, 8), *(4, 0, 5), *(4, 5, 9),
])  # fmt: skip
CORNER_FACE = np.repeat(np.arange(8), COUNTS)
SLOPE = np.array([[0.3, -0.2], [0.1, 0.7], [0.5, 0.4]])
UV = POINTS[INDICES] @ SLOPE + 10.0 * CORNER_FACE[:, None]  # affine on each face, seams between


def edges_of(counts, indices):
    """(C, 2) directed edges of polygons."""
    ends, first = [], 0
    for n in counts:
        ring = indices[first : first + n]
        ends += list(zip(ring, np.roll(ring, -1)))
        first += n
    return np.array(ends)


def test_no_edge_is_longer_and_the_surface_stays():
    made = divide_faces(POINTS, COUNTS, INDICES, LONGEST)
    points = made.division.extended(POINTS)
    np.testing.assert_array_equal(points[: len(POINTS)], POINTS)
    edges = edges_of(made.counts, made.indices)
    assert np.linalg.norm(points[edges[:, 1]] - points[edges[:, 0]], axis=1).max() <= LONGEST
    # closed: every edge is there once in each direction
    assert {tuple(e) for e in edges.tolist()} == {tuple(e) for e in edges[:, ::-1].tolist()}
    assert len({tuple(e) for e in edges.tolist()}) == len(edges)
    before = triangulate(POINTS, COUNTS, INDICES)[0]
    after = triangulate(points, made.counts, made.indices)[0]
    assert areas(points, after).sum() == pytest.approx(areas(POINTS, before).sum(), rel=1e-12)
    assert signed_volume(points, after) == pytest.approx(signed_volume(POINTS, before), rel=1e-12)
    assert made.divided == 8
    assert made.face.tolist() == sorted(made.face.tolist()), "faces stay in their order"


def test_short_faces_stay_as_they_are():
    small = np.array([[3, 0, 0], [3.1, 0, 0], [3.1, 0.1, 0], [3, 0.1, 0]], float)
    points = np.concatenate([POINTS, small])
    counts, indices = np.append(COUNTS, 4), np.concatenate([INDICES, 10 + np.arange(4)])
    made = divide_faces(points, counts, indices, LONGEST)
    assert (made.divided, made.counts[-1], made.indices[-4:].tolist()) == (8, 4, [10, 11, 12, 13])
    whole = divide_faces(points, counts, indices, 10.0)
    assert whole.divided == 0
    assert whole.counts.tolist() == counts.tolist()
    assert whole.indices.tolist() == indices.tolist()


def test_values_of_points_faces_and_corners():
    made = divide_faces(POINTS, COUNTS, INDICES, LONGEST)
    points = made.division.extended(POINTS)
    np.testing.assert_allclose(made.values(POINTS @ SLOPE, "points"), points @ SLOPE, atol=1e-14)
    face = np.repeat(made.face, made.counts)
    expected = points[made.indices] @ SLOPE + 10.0 * face[:, None]
    np.testing.assert_allclose(made.values(UV, "corners"), expected, atol=1e-12)
    assert made.values(np.arange(8), "faces").tolist() == made.face.tolist()
    # what has no fraction is one of the values there were, of the same face or of a point's end
    assert set(made.values(CORNER_FACE, "corners")) == set(range(8))
    assert (made.values(CORNER_FACE, "corners") == face).all()
    nearest = made.values(np.arange(10), "points")
    assert nearest[:10].tolist() == list(range(10))
    assert set(nearest) <= set(range(10))
    # two values of each point, one after the other
    pairs = made.values(np.repeat(POINTS[:, 0], 2), "points", 2)
    np.testing.assert_allclose(pairs, np.repeat(points[:, 0], 2), atol=1e-14)


def stage_of(path: Path, scheme: str = "none") -> Usd.Stage:
    """The prism in half its size under a transform that doubles it, with what can hang on it."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    stage.SetTimeCodesPerSecond(48)
    stage.SetStartTimeCode(1)
    root = UsdGeom.Xform.Define(stage, "/A")
    root.AddScaleOp().Set(Gf.Vec3f(2))
    stage.SetDefaultPrim(root.GetPrim())
    mesh = UsdGeom.Mesh.Define(stage, "/A/Prism")
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy((0.5 * POINTS).astype(np.float32)))
    mesh.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy((0.5 * POINTS).astype(np.float32)), 1)
    moved = (0.5 * POINTS + [0, 0, 1]).astype(np.float32)
    mesh.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(moved), 9)
    mesh.CreateFaceVertexCountsAttr(COUNTS.tolist())
    mesh.CreateFaceVertexIndicesAttr(INDICES.tolist())
    mesh.CreateSubdivisionSchemeAttr(scheme)
    api = UsdGeom.PrimvarsAPI(mesh)
    values, back = np.unique(UV.astype(np.float32), axis=0, return_inverse=True)
    st = api.CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, "faceVarying")
    st.Set(Vt.Vec2fArray.FromNumpy(values))
    st.SetIndices(Vt.IntArray(back.reshape(-1).tolist()))
    color = api.CreatePrimvar("displayColor", Sdf.ValueTypeNames.Color3fArray, "vertex")
    color.Set(Vt.Vec3fArray.FromNumpy((0.1 * POINTS).astype(np.float32)))
    name = api.CreatePrimvar("part", Sdf.ValueTypeNames.StringArray, "uniform")
    name.Set([f"face{k}" for k in range(8)])
    mesh.CreateNormalsAttr([(0, 0, -1)] * 5 + [(0, 0, 1)] * 5 + [(1, 0, 0)] * 22)
    mesh.SetNormalsInterpolation("faceVarying")
    UsdGeom.Subset.CreateGeomSubset(mesh, "Caps", "face", [0, 1], "materialBind")
    stage.Save()
    return stage


def test_a_layer_over_the_stage(tmp_path: Path):
    path = tmp_path / "prism.usda"
    stage_of(path)
    before = path.read_bytes()
    # half a unit of the stage is 0.005 m; the mesh has twice the size of its points
    read = read_untrusted(path, max_edge_length=LONGEST)
    assert path.read_bytes() == before
    made = read.converted
    assert made is not None
    stage = Usd.Stage.Open(str(made.layer))
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 0.01
    assert stage.GetTimeCodesPerSecond() == 48
    assert stage.GetDefaultPrim().GetPath() == "/A"
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/A/Prism"))
    faces = divide_faces(POINTS, COUNTS, INDICES, LONGEST)
    points = faces.division.extended(0.5 * POINTS)
    np.testing.assert_allclose(np.array(mesh.GetPointsAttr().Get(1)), points, atol=1e-6)
    later = np.array(mesh.GetPointsAttr().Get(9))
    np.testing.assert_allclose(later, points + [0, 0, 1], atol=1e-6)
    assert list(mesh.GetFaceVertexCountsAttr().Get()) == faces.counts.tolist()
    assert len(mesh.GetNormalsAttr().Get()) == len(faces.indices)
    api = UsdGeom.PrimvarsAPI(mesh)
    st = api.GetPrimvar("st")
    face = np.repeat(faces.face, faces.counts)
    expected = 2.0 * points[faces.indices] @ SLOPE + 10.0 * face[:, None]
    np.testing.assert_allclose(np.array(st.ComputeFlattened()), expected, atol=2e-5)
    color = np.array(api.GetPrimvar("displayColor").Get())
    np.testing.assert_allclose(color, 0.2 * points, atol=1e-6)
    assert list(api.GetPrimvar("part").Get()) == [f"face{k}" for k in faces.face]
    caps = UsdGeom.Subset(stage.GetPrimAtPath("/A/Prism/Caps"))
    assert list(caps.GetIndicesAttr().Get()) == np.flatnonzero(faces.face < 2).tolist()
    (surface,) = read.asset.surfaces
    assert len(surface.points) == len(points)
    assert read.asset.facts.path == path
    assert any("8 of 8 faces are divided" in note for note in read.asset.facts.notes)


def varying(stage: Usd.Stage) -> None:
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/A/Prism"))
    for code in (1, 2):
        mesh.GetFaceVertexIndicesAttr().Set(INDICES.tolist(), code)


def loop(stage: Usd.Stage) -> None:
    UsdGeom.Mesh(stage.GetPrimAtPath("/A/Prism")).GetSubdivisionSchemeAttr().Set("loop")


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (loop, "the cage of a Loop subdivision surface"),
        (varying, "its topology changes"),
    ],
)
def test_a_mesh_that_cannot_be_divided_stays_and_is_reported(tmp_path: Path, change, why):
    path = tmp_path / "prism.usda"
    stage = stage_of(path)
    change(stage)
    stage.Save()
    read = read_untrusted(path, max_edge_length=LONGEST)
    (surface,) = read.asset.surfaces
    assert len(surface.points) == 10
    assert any(why in note and "8 faces" in note for note in read.asset.facts.notes)


def test_too_many_triangles_are_refused(tmp_path: Path, monkeypatch):
    path = tmp_path / "prism.usda"
    stage_of(path)
    monkeypatch.setattr(divide, "MOST", 500)
    with pytest.raises(InputError, match="more than 500 triangles") as error:
        read_untrusted(path, max_edge_length=0.01)
    assert "/A/Prism" in str(error.value)
    assert "--max-edge-length" in error.value.hint


def test_an_edge_of_two_spacings(tmp_path: Path):
    path = tmp_path / "prism.usda"
    stage_of(path)
    (whole,) = read_untrusted(path).asset.surfaces
    volume = signed_volume(POINTS * 0.01, triangulate(POINTS, COUNTS, INDICES)[0])
    edge = fine_edge([whole], 700)
    assert edge == pytest.approx(2.0 * np.cbrt(volume / 700), rel=1e-6)
    (fine,) = read_untrusted(path, edges_for=700).asset.surfaces
    ends = np.stack([fine.triangles, np.roll(fine.triangles, -1, axis=1)], -1).reshape(-1, 2)
    longest = np.linalg.norm(fine.points[ends[:, 0]] - fine.points[ends[:, 1]], axis=1).max()
    assert 0.4 * edge < longest <= edge * (1.0 + 1e-6)
    assert fine_edge([], 700) == np.inf


def test_a_mesh_that_stays_may_have_any_edges(tmp_path: Path, monkeypatch):
    """It is not divided only to be counted."""
    path = tmp_path / "prism.usda"
    stage = stage_of(path)
    loop(stage)
    stage.Save()
    monkeypatch.setattr(divide, "MOST", 500)
    (surface,) = read_untrusted(path, max_edge_length=0.01).asset.surfaces
    assert len(surface.points) == 10
