"""Cages of Catmull-Clark surfaces: the rules, and cages that a layer over the stage refines."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, Vt

from gf_usd.core.mesh.measures import signed_volume
from gf_usd.core.mesh.triangulation import triangulate
from gf_usd.readers.isolated import read_untrusted
from gf_usd.readers.mesh.divide import layer
from gf_usd.readers.mesh.divide.cages import cage_of, limit_surface, refine_until
from gf_usd.readers.mesh.divide.catmull_clark import INFINITE, Cage, limit, refine, sharp_edges
from gf_usd.readers.mesh.divide.faces import long_faces

CUBE = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], float)
CUBE_FACES = np.array([
    *(0, 2, 3, 1), *(4, 5, 7, 6), *(0, 1, 5, 4), *(2, 6, 7, 3), *(0, 4, 6, 2), *(1, 3, 7, 5),
])  # fmt: skip


def cage(counts, indices, points, sharp=(), corners=()):
    """A cage; sharp : (point, point, sharpness); corners : (point, sharpness)."""
    counts, indices = np.asarray(counts), np.asarray(indices)
    made = Cage(
        counts=counts, indices=indices, points=points,
        edge_sharpness=np.zeros(len(indices)), point_sharpness=np.zeros(points),
    )  # fmt: skip
    for a, b, s in sharp:
        edges = made.edges()
        made.edge_sharpness[(edges.ends == sorted((a, b))).all(1)[edges.of]] = s
    for a, s in corners:
        made.point_sharpness[a] = s
    return made


def cube(sharp=(), corners=()):
    return cage([4] * 6, CUBE_FACES, 8, sharp, corners)


def grid(n):
    """Quads over n x n points of a plane."""
    first = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    quads = first[:, None] + [0, 1, n + 1, n]
    return cage([4] * len(first), quads.ravel(), n * n)


def prism():
    """Over a pentagon with a triangle cut off: valences of 3 to 5, faces of 3 to 5 corners."""
    ring = np.array([(0, 0), (2, 0), (2.4, 1), (1, 1.8), (0, 1)], float)
    points = np.concatenate([np.column_stack([ring, np.full(5, z)]) for z in (0.0, 0.7)])
    faces = [(4, 3, 2, 1, 0), (5, 6, 7, 8, 9), (0, 1, 6, 5), (1, 2, 7, 6), (2, 3, 8, 7),
             (3, 4, 9, 8), (4, 0, 5), (4, 5, 9)]  # fmt: skip
    return points, [len(f) for f in faces], np.concatenate(faces)


def test_a_cube_by_hand():
    level = refine(cube())
    points = level.points(CUBE)
    np.testing.assert_allclose(points[:8], 5.0 / 9.0 * CUBE, atol=1e-15)
    middle = CUBE[level.edges].mean(1)
    np.testing.assert_allclose(points[8:20], 0.75 * middle, atol=1e-15)
    np.testing.assert_allclose(points[20:], CUBE[CUBE_FACES.reshape(-1, 4)].mean(1), atol=1e-15)
    np.testing.assert_allclose(limit(level, points, 8), 0.5 * CUBE, atol=1e-15)
    found = limit_surface(cube(), CUBE)
    assert found is not None
    assert found.shift == pytest.approx(0.5 * np.sqrt(3.0))
    fine = refine_until(cube(), CUBE, lambda p, c, i: not long_faces(p, c, i, 0.03).any(), 10**6)
    assert fine is not None
    deep = fine.values(CUBE, "points")
    volume = signed_volume(deep, triangulate(deep, fine.counts, fine.indices)[0])
    # a cage is of second order: two levels leave a sixteenth of what it was off by
    assert found.volume == pytest.approx(volume, abs=(8.0 - volume) / 16.0)
    # a fine cage has no note
    assert limit_surface(fine.last, deep) is None


def test_a_plane_grid_is_a_bicubic_b_spline():
    """Control points (x, y, x^2 - x y) of unit steps are the surface x^2 - x y + 1/3."""
    n = 7
    x, y = (c.ravel().astype(float) for c in np.meshgrid(np.arange(n), np.arange(n)))
    points = np.stack([x, y, x * x - x * y], 1)
    level = refine(grid(n))
    inner = ((x > 1) & (x < n - 2) & (y > 1) & (y < n - 2)).nonzero()[0]
    expected = points + [0.0, 0.0, 1.0 / 3.0]
    at = limit(level, level.points(points), n * n)
    np.testing.assert_allclose(at[inner], expected[inner], atol=1e-13)
    # a boundary without corners is a cubic B-spline of its own points: x^2 + 1/3 along y = 0
    edge = ((y == 0) & (x > 1) & (x < n - 2)).nonzero()[0]
    np.testing.assert_allclose(at[edge], expected[edge], atol=1e-13)


def boundary_ends(cage):
    """Both points of every edge of one face alone."""
    edges = cage.edges()
    return edges.ends[edges.faces == 1].ravel()


TAGGED = {
    "smooth": ((), ()),
    "crease": ([(0, 1, INFINITE), (1, 2, INFINITE), (2, 3, INFINITE)], ()),
    "corner": ((), [(2, INFINITE), (7, INFINITE)]),
    "many": ([(0, 1, INFINITE), (1, 2, INFINITE), (1, 6, INFINITE)], [(9, INFINITE)]),
}


@pytest.mark.parametrize("tags", TAGGED.values(), ids=TAGGED)
@pytest.mark.parametrize("open_", [False, True])
def test_the_limit_is_that_of_the_refined_cage(tags, open_):
    """The masks of the limit are eigenvectors of those of a level."""
    points, counts, indices = prism()
    if open_:
        counts, indices = counts[1:], indices[counts[0] :]
    made = cage(counts, indices, len(points), *tags)
    first = refine(made)
    once = first.points(points)
    second = refine(first.cage)
    twice = second.points(once)
    # at the end of a crease they are not: no point of it has the rule of its neighbors
    edges, _ = sharp_edges(made)
    sharp = np.bincount(np.concatenate([edges.ravel(), boundary_ends(made)]), minlength=len(points))
    sound = sharp != 1
    assert sound.sum() >= len(points) - 3
    np.testing.assert_allclose(
        limit(first, once, len(points))[sound],
        limit(second, twice, len(once))[: len(points)][sound],
        atol=1e-13,
    )
    # what is affine stays so: the weights of every point sum up to one
    np.testing.assert_allclose(first.points(np.ones((len(points), 1))), 1.0, atol=1e-14)


def test_what_is_not_manifold_stays_in_place():
    """Two cubes with one edge in common, whose ends have five edges and six faces."""
    far = np.array([1000.0, 0.0, 0.0])
    points = np.concatenate([CUBE, CUBE + [2.0, 2.0, 0.0]]) + far
    where = np.unique(points, axis=0, return_inverse=True)
    points, at = where[0], where[1].reshape(-1)
    made = cage([4] * 12, at[np.concatenate([CUBE_FACES, CUBE_FACES + 8])], len(points))
    assert len(points) == 14
    level = refine(made)
    np.testing.assert_allclose(level.points(np.ones((14, 1))), 1.0, atol=1e-14)
    again = refine(level.cage)
    np.testing.assert_allclose(again.points(np.ones((level.cage.points, 1))), 1.0, atol=1e-14)
    ends = made.edges().ends[made.edges().faces == 4].ravel()
    there = limit(level, level.points(points), 14)
    np.testing.assert_array_equal(there[ends], points[ends])
    assert np.linalg.norm(there - points, axis=1).max() < 2.0


@pytest.mark.parametrize("seed", range(5))
def test_weights_of_any_faces_sum_to_one(seed):
    rng = np.random.default_rng(seed)
    faces = [rng.choice(12, n, replace=False) for n in rng.integers(3, 6, 9)]
    made = cage([len(f) for f in faces], np.concatenate(faces), 12)
    level = refine(made)
    np.testing.assert_allclose(level.points(np.ones((12, 1))), 1.0, atol=1e-14)
    ones = np.ones((level.cage.points, 1))
    np.testing.assert_allclose(limit(level, ones, 12), 1.0, atol=1e-14)


def test_a_semi_sharp_crease_is_sharp_for_as_many_levels():
    edges = [(0, 1), (1, 3), (3, 2), (0, 2)]
    now, points = cube([(a, b, 2.0) for a, b in edges]), CUBE
    like, same = cube([(a, b, INFINITE) for a, b in edges]), CUBE
    for _ in range(2):
        one, other = refine(now), refine(like)
        points, same = one.points(points), other.points(same)
        np.testing.assert_allclose(points, same, atol=1e-15)
        now, like = one.cage, other.cage
    assert not now.edge_sharpness.any()
    smooth = replace(like, edge_sharpness=np.zeros(len(like.indices)))
    np.testing.assert_allclose(refine(now).points(points), refine(smooth).points(points))
    # half a level of sharpness is the middle between a crease and none
    half, none, full = (
        refine(cube([(a, b, s) for a, b in edges])).points(CUBE) for s in (0.5, 0.0, 1.0)
    )
    np.testing.assert_allclose(half, 0.5 * (none + full), atol=1e-15)


def test_values_of_corners_keep_their_seams():
    points, counts, indices = prism()
    made = cage(counts, indices, len(points))
    refined = refine_until(made, points, lambda p, c, i: not long_faces(p, c, i, 0.5).any(), 10**6)
    assert refined is not None
    assert len(refined.levels) > 1
    assert not long_faces(
        refined.values(points, "points"), refined.counts, refined.indices, 0.5
    ).any()
    face = np.repeat(np.arange(8), counts)
    uv = np.stack([points[indices, 0], 10.0 * (face == 1)], 1)  # one face is an island
    for linear in ("none", "cornersOnly", "cornersPlus1", "boundaries"):
        out = refined.smooth_corners(uv, linear)
        inner = np.repeat(refined.face, refined.counts) == 1
        np.testing.assert_allclose(out[inner, 1], 10.0, rtol=1e-14)
        assert np.abs(out[~inner, 1]).max() == 0.0
        ends = out[inner, 0].min(), out[inner, 0].max()
        whole = points[indices, 0].min(), points[indices, 0].max()
        # an island of one face has corners unless nothing stays where it is
        assert (np.abs(np.subtract(ends, whole)).max() < 1e-12) == (linear != "none")
    # without seams corners are as smooth as points
    np.testing.assert_allclose(
        refined.smooth_corners(points[indices], "cornersPlus1"),
        refined.values(points, "points")[refined.indices], atol=1e-12,
    )  # fmt: skip
    assert refined.values(np.arange(8), "faces").tolist() == refined.face.tolist()
    assert set(refined.values(face, "corners")) == set(range(8))
    assert set(refined.values(np.arange(10), "points")) == set(range(10))
    one = refined.values(np.column_stack([points, points]), "varying")
    level = made
    expected = points
    for step in refined.levels:
        expected = np.concatenate([
            expected, expected[refine(level).edges].mean(1), step.middle(expected)
        ])  # fmt: skip
        level = step.cage
    np.testing.assert_allclose(one[:, :3], expected, atol=1e-12)


def stage_of(path: Path) -> Usd.Stage:
    """A cube of 2 cm that has a hole, a crease, a corner and what can hang on it; it moves."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    mesh = UsdGeom.Mesh.Define(stage, "/Cube")
    for time in (Usd.TimeCode.Default(), 1, 5):
        up = 0.0 if time == Usd.TimeCode.Default() else float(time)
        points = (CUBE + [0, 3 + up, 0]).astype(np.float32)
        mesh.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(points), time)
    mesh.CreateFaceVertexCountsAttr([4] * 6)
    mesh.CreateFaceVertexIndicesAttr(CUBE_FACES.tolist())
    mesh.CreateHoleIndicesAttr([4])
    mesh.CreateCreaseIndicesAttr().Set([0, 2, 3, 1, 0], 1)
    mesh.CreateCreaseLengthsAttr().Set([5], 1)
    mesh.CreateCreaseSharpnessesAttr().Set([2.5], 1)
    mesh.CreateCornerIndicesAttr([7])
    mesh.CreateCornerSharpnessesAttr([INFINITE])
    api = UsdGeom.PrimvarsAPI(mesh)
    st = api.CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, "faceVarying")
    st.Set([Gf.Vec2f(*c) for c in ((0, 0), (1, 0), (1, 1), (0, 1))])
    st.SetIndices(Vt.IntArray([0, 1, 2, 3] * 6))
    color = api.CreatePrimvar("displayColor", Sdf.ValueTypeNames.Color3fArray, "uniform")
    color.Set([Gf.Vec3f(0.1 * k) for k in range(6)])
    UsdGeom.Subset.CreateGeomSubset(mesh, "Top", "face", [1], "materialBind")
    stage.GetRootLayer().Save()
    return stage


def test_a_layer_refines_a_cage(tmp_path: Path):
    path = tmp_path / "cube.usda"
    source = stage_of(path)
    before = UsdGeom.Mesh(source.GetPrimAtPath("/Cube"))
    cage = cage_of(before, np.full(6, 4), CUBE_FACES, 8)
    assert cage is not None
    read = read_untrusted(path, max_edge_length=0.8)
    assert read.converted is not None
    stage = Usd.Stage.Open(str(read.converted.layer))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Cube"))
    assert mesh.GetSubdivisionSchemeAttr().Get() == "catmullClark"
    counts = np.array(mesh.GetFaceVertexCountsAttr().Get())
    indices = np.array(mesh.GetFaceVertexIndicesAttr().Get())
    assert len(counts) == 6 * 4**2
    for time in (1, 5):
        points = np.array(mesh.GetPointsAttr().Get(time), float)
        assert not long_faces(points, counts, indices, 0.8).any()
        finer = cage_of(mesh, counts, indices, len(points))
        assert finer is not None
        old, new = refine(cage), refine(finer)
        was = np.array(before.GetPointsAttr().Get(time), float)
        np.testing.assert_allclose(
            limit(new, new.points(points), len(points))[:8],
            _limit_after(cage, was, 3),
            atol=1e-6,
        )
        assert old.cage.points < len(points)
    faces = np.repeat(np.arange(6), 16)
    assert list(mesh.GetHoleIndicesAttr().Get()) == np.flatnonzero(faces == 4).tolist()
    assert list(mesh.GetCornerIndicesAttr().Get()) == [7]
    assert set(mesh.GetCreaseSharpnessesAttr().Get()) == {0.5}
    assert set(mesh.GetCreaseLengthsAttr().Get()) == {2}
    api = UsdGeom.PrimvarsAPI(mesh)
    assert len(api.GetPrimvar("st").ComputeFlattened()) == len(indices)
    assert len(api.GetPrimvar("displayColor").ComputeFlattened()) == len(counts)
    top = UsdGeom.Subset(stage.GetPrimAtPath("/Cube/Top"))
    assert len(top.GetIndicesAttr().Get()) == 16
    assert any("the subdivision cage" in note for note in read.asset.facts.notes)


def value(name: str, interpolation: str, values: list[float], indices=None):
    def author(mesh: UsdGeom.Mesh) -> str:
        kind = Sdf.ValueTypeNames.FloatArray
        primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(name, kind, interpolation)
        primvar.Set(values)
        if indices is not None:
            primvar.SetIndices(Vt.IntArray(indices))
        return f"primvars:{name}"

    return author


def normals(mesh: UsdGeom.Mesh) -> str:
    mesh.CreateNormalsAttr([(0, 0, 1)] * 3)
    return "normals"


@pytest.mark.parametrize("scheme", ["none", "catmullClark"])
@pytest.mark.parametrize(
    "misfit",
    [
        value("few", "vertex", [0.0] * 5), value("many", "vertex", [0.0] * 9),
        value("few", "uniform", [0.0] * 3), value("few", "faceVarying", [0.0] * 7),
        value("out", "vertex", [1.0, 2.0], [0, 1, 0, 1, 0, 1, 0, 5]),
        value("unset", "faceVarying", [1.0], [0, -1] * 12), normals,
    ],
)  # fmt: skip
def test_what_does_not_fit_a_mesh_is_left_out_and_reported(tmp_path: Path, misfit, scheme):
    path = tmp_path / "cube.usda"
    stage = stage_of(path)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Cube"))
    mesh.CreateSubdivisionSchemeAttr(scheme)
    name = misfit(mesh)
    stage.GetRootLayer().Save()
    read = read_untrusted(path, max_edge_length=1.5)
    assert read.converted is not None
    made = Usd.Stage.Open(str(read.converted.layer))
    assert not made.GetAttributeAtPath(f"/Cube.{name}").HasAuthoredValue()
    assert any(f"{name} does not fit the faces" in note for note in read.asset.facts.notes)


def edge(mesh: UsdGeom.Mesh) -> None:
    mesh.CreateFaceVertexCountsAttr([*[4] * 6, 2])
    mesh.CreateFaceVertexIndicesAttr([*CUBE_FACES.tolist(), 0, 1])


def unbounded(mesh: UsdGeom.Mesh) -> None:
    mesh.CreateInterpolateBoundaryAttr(UsdGeom.Tokens.none)


def other(mesh: UsdGeom.Mesh) -> None:
    mesh.GetPointsAttr().Set([(0, 0, 0)] * 9, 5)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (edge, "faces of fewer than three corners"),
        (unbounded, "interpolateBoundary = none"),
        (other, "another number of points at some time"),
    ],
)
def test_a_cage_that_cannot_be_refined_stays_and_is_reported(tmp_path: Path, change, why):
    path = tmp_path / "cube.usda"
    stage = stage_of(path)
    change(UsdGeom.Mesh(stage.GetPrimAtPath("/Cube")))
    stage.GetRootLayer().Save()
    read = read_untrusted(path, max_edge_length=0.8)
    assert len(read.asset.surfaces[0].points) == 8
    assert any(why in note and "faces longer" in note for note in read.asset.facts.notes)


def test_a_length_that_nobody_asked_for_does_not_refuse(tmp_path: Path, monkeypatch):
    path = tmp_path / "cube.usda"
    stage_of(path)
    monkeypatch.setattr(layer, "MOST", 200)
    read = read_untrusted(path, edges_for=10_000)
    assert len(read.asset.surfaces[0].points) == 8
    assert any("would have more than 200 triangles" in note for note in read.asset.facts.notes)


def _limit_after(cage, points, levels):
    """The limit of a cage, by the masks of a deeper level."""
    count = len(points)
    for _ in range(levels):
        level = refine(cage)
        points, cage = level.points(points), level.cage
    last = refine(cage)
    return limit(last, last.points(points), len(points))[:count]
