"""The sample assets: sound as meshes, valid as USD, and made by tools/make_samples.py."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Kind, Usd, UsdGeom, UsdShade, UsdValidation

REPO = Path(__file__).resolve().parents[2]
NAMES = ("duck", "sphere", "deformed_sphere")
ROUNDING = 1e-5  # of points in the files: five decimals


@pytest.fixture(scope="module", params=NAMES)
def stage(request: pytest.FixtureRequest) -> Usd.Stage:
    return Usd.Stage.Open(str(REPO / "samples" / f"{request.param}.usda"))


def the_mesh(stage: Usd.Stage) -> UsdGeom.Mesh:
    [prim] = [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)]
    return UsdGeom.Mesh(prim)


def arrays(stage: Usd.Stage) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """points (V, 3), quads (F, 4), vertex normals (V, 3)."""
    mesh = the_mesh(stage)
    assert set(mesh.GetFaceVertexCountsAttr().Get()) == {4}
    return (
        np.array(mesh.GetPointsAttr().Get(), dtype=float),
        np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 4),
        np.array(mesh.GetNormalsAttr().Get(), dtype=float),
    )


def volume(points: np.ndarray, faces: np.ndarray) -> float:
    a, b, c, d = points[faces].transpose(1, 0, 2)
    return float(np.einsum("ij,ij->", a, np.cross(b, c) + np.cross(c, d)) / 6.0)


def corner_sines(points: np.ndarray, faces: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(F, 4) sine of each corner's angle, signed by the surface normal: < 0 where folded."""
    corners = points[faces]
    ahead = np.roll(corners, -1, axis=1) - corners
    behind = np.roll(corners, 1, axis=1) - corners
    lengths = np.linalg.norm(ahead, axis=2) * np.linalg.norm(behind, axis=2)
    return np.einsum("fki,fki->fk", np.cross(ahead, behind), normals[faces]) / lengths


def texture_areas(stage: Usd.Stage) -> np.ndarray:
    """(F,) signed area of each quad in the texture."""
    st = UsdGeom.PrimvarsAPI(the_mesh(stage)).GetPrimvar("st")
    uv = np.array(st.ComputeFlattened(), dtype=float).reshape(-1, 4, 2)
    one, two = uv[:, 2] - uv[:, 0], uv[:, 3] - uv[:, 1]
    return 0.5 * (one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0])


def test_every_edge_joins_two_faces_in_opposite_directions(stage: Usd.Stage) -> None:
    points, faces, _ = arrays(stage)
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    directed = {(int(a), int(b)) for a, b in edges}
    assert len(directed) == len(edges), "an edge is used twice in one direction"
    assert {(b, a) for a, b in directed} == directed, "an edge is open"
    # one closed shell without handles
    assert len(points) - len(edges) // 2 + len(faces) == 2
    assert set(faces.ravel()) == set(range(len(points)))


def test_points_are_distinct(stage: Usd.Stage) -> None:
    points, _, _ = arrays(stage)
    assert len(np.unique(points, axis=0)) == len(points)


def test_faces_look_outward_and_none_is_degenerate(stage: Usd.Stage) -> None:
    points, faces, normals = arrays(stage)
    assert volume(points, faces) > 0.0
    # corners of a good quad lie within 25 and 155 degrees; a folded one is negative
    assert corner_sines(points, faces, normals).min() > np.sin(np.radians(25.0))
    edges = np.linalg.norm(points[faces] - points[np.roll(faces, -1, axis=1)], axis=2)
    assert (edges.max(axis=1) / edges.min(axis=1)).max() < 3.0


def test_a_folded_quad_is_noticed(stage: Usd.Stage) -> None:
    points, faces, normals = arrays(stage)
    broken = points.copy()
    broken[faces[0, 0]] += 2.0 * (points[faces[0, 2]] - points[faces[0, 0]])
    assert corner_sines(broken, faces, normals).min() < 0.0


def test_normals_are_unit_and_one_per_vertex(stage: Usd.Stage) -> None:
    mesh = the_mesh(stage)
    points, _, normals = arrays(stage)
    assert mesh.GetNormalsInterpolation() == UsdGeom.Tokens.vertex
    assert mesh.GetSubdivisionSchemeAttr().Get() == UsdGeom.Tokens.none
    assert normals.shape == points.shape
    # four decimals a component: at most sqrt(3) * 0.5e-4 off
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-4)


def test_texture_coordinates(stage: Usd.Stage) -> None:
    _, faces, _ = arrays(stage)
    st = UsdGeom.PrimvarsAPI(the_mesh(stage)).GetPrimvar("st")
    assert st.GetInterpolation() == UsdGeom.Tokens.faceVarying
    uv = np.array(st.ComputeFlattened())
    assert uv.shape == (faces.size, 2)
    assert uv.min() >= 0.0
    assert uv.max() <= 1.0
    assert set(st.GetIndices()) == set(range(len(st.Get()))), "a value that no corner uses"


def test_texture_is_neither_flipped_nor_starved(stage: Usd.Stage) -> None:
    points, faces, _ = arrays(stage)
    a, b, c, d = points[faces].transpose(1, 0, 2)
    density = texture_areas(stage) / (0.5 * np.linalg.norm(np.cross(c - a, d - b), axis=1))
    assert density.min() > 0.0
    # the deformed sphere keeps the sphere's layout, so it stretches by its radius squared
    assert density.max() / density.min() < 5.0


def test_charts_do_not_overlap(stage: Usd.Stage) -> None:
    st = UsdGeom.PrimvarsAPI(the_mesh(stage)).GetPrimvar("st")
    uv = np.array(st.ComputeFlattened(), dtype=float).reshape(-1, 4, 2)
    size = 1024
    pixels = (np.stack(np.meshgrid(*[np.arange(size) + 0.5] * 2), axis=-1)) / size
    hits = np.zeros((size, size), dtype=int)
    for quad in uv:
        lo = np.floor(quad.min(axis=0) * size).astype(int)
        hi = np.ceil(quad.max(axis=0) * size).astype(int)
        window = (slice(lo[1], hi[1]), slice(lo[0], hi[0]))
        side = np.roll(quad, -1, axis=0) - quad
        offset = pixels[window][..., None, :] - quad
        hits[window] += (side[:, 0] * offset[..., 1] - side[:, 1] * offset[..., 0] > 0).all(axis=-1)
    assert hits.max() == 1
    # quads are convex in the texture, so what they cover is their area
    assert hits.mean() == pytest.approx(texture_areas(stage).sum(), rel=0.01)


def test_extent_is_the_bounds(stage: Usd.Stage) -> None:
    points, _, _ = arrays(stage)
    extent = np.array(the_mesh(stage).GetExtentAttr().Get())
    np.testing.assert_array_equal(extent, [points.min(axis=0), points.max(axis=0)])


def test_stage_says_what_it_is(stage: Usd.Stage) -> None:
    root = stage.GetDefaultPrim()
    assert root.IsA(UsdGeom.Xform)
    model = Usd.ModelAPI(root)
    assert model.GetKind() == Kind.Tokens.component
    assert model.GetAssetName() == root.GetName()
    assert model.GetAssetVersion()
    assert model.GetAssetIdentifier().resolvedPath == stage.GetRootLayer().realPath
    assert UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y
    assert stage.HasAuthoredMetadata(UsdGeom.Tokens.metersPerUnit)


def test_every_face_has_one_material(stage: Usd.Stage) -> None:
    mesh = the_mesh(stage)
    _, faces, _ = arrays(stage)
    subsets = UsdShade.MaterialBindingAPI(mesh).GetMaterialBindSubsets()
    if subsets:
        covered = np.concatenate([subset.GetIndicesAttr().Get() for subset in subsets])
        assert sorted(covered) == list(range(len(faces)))
        family = UsdShade.Tokens.materialBind
        assert UsdGeom.Subset.GetFamilyType(mesh, family) == UsdGeom.Tokens.partition
    for bound in [subset.GetPrim() for subset in subsets] or [mesh.GetPrim()]:
        assert bound.HasAPI(UsdShade.MaterialBindingAPI)
        material, _ = UsdShade.MaterialBindingAPI(bound).ComputeBoundMaterial()
        shader = material.ComputeSurfaceSource()[0]
        assert shader.GetIdAttr().Get() == "UsdPreviewSurface"
        color = shader.GetInput("diffuseColor").Get()
        assert color in list(mesh.GetDisplayColorAttr().Get())


def test_usd_validation_finds_nothing(stage: Usd.Stage) -> None:
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    errors = UsdValidation.ValidationContext(validators).Validate(stage)
    assert [f"{error.GetName()}: {error.GetMessage()}" for error in errors] == []


def open_sample(name: str) -> Usd.Stage:
    return Usd.Stage.Open(str(REPO / "samples" / f"{name}.usda"))


def test_duck_is_ten_centimeters_long_and_sits_on_the_floor() -> None:
    stage = open_sample("duck")
    assert UsdGeom.GetStageMetersPerUnit(stage) == 0.01
    points, faces, _ = arrays(stage)
    assert 2500 <= len(faces) <= 5000
    assert np.ptp(points[:, 2]) == pytest.approx(10.0, abs=0.2)
    assert points[:, 1].min() == 0.0
    # a base wide enough to stand on: a disc of 1 cm radius at least
    assert np.ptp(points[points[:, 1] < ROUNDING, 0]) > 2.0


def test_duck_is_symmetric() -> None:
    points, _, _ = arrays(open_sample("duck"))
    mirrored = points * [-1.0, 1.0, 1.0] + 0.0
    assert {tuple(p) for p in mirrored} == {tuple(p) for p in points}


def test_duck_has_two_eyes_and_a_beak_in_front() -> None:
    stage = open_sample("duck")
    points, faces, _ = arrays(stage)
    subsets = UsdShade.MaterialBindingAPI(the_mesh(stage)).GetMaterialBindSubsets()
    center = points[faces].mean(axis=1)
    parts = {
        subset.GetPrim().GetName(): center[subset.GetIndicesAttr().Get()] for subset in subsets
    }
    assert set(parts) == {"body", "beak", "eyes"}
    sides = np.sign(parts["eyes"][:, 0])
    assert (sides > 0).sum() == (sides < 0).sum() == len(sides) / 2
    assert parts["beak"][:, 2].max() > parts["eyes"][:, 2].max() > 0.0
    assert parts["eyes"][:, 1].min() > parts["beak"][:, 1].mean()


def test_border_of_an_eye_is_a_circle() -> None:
    stage = open_sample("duck")
    points, faces, _ = arrays(stage)
    eyes = UsdGeom.Subset(the_mesh(stage).GetPrim().GetChild("eyes")).GetIndicesAttr().Get()
    rest = np.setdiff1d(np.arange(len(faces)), eyes)
    ring = points[np.intersect1d(faces[eyes], faces[rest])]
    ring = ring[ring[:, 0] > 0.0]
    _, _, axes = np.linalg.svd(ring - ring.mean(axis=0))
    flat = (ring - ring.mean(axis=0)) @ axes[:2].T
    radius = np.linalg.norm(flat, axis=1)
    # a staircase of quads 0.17 wide would spread by a third; sphere cuts head in a circle
    assert np.ptp(radius) < 0.06 * radius.mean()


@pytest.mark.parametrize("name", ["sphere", "deformed_sphere"])
def test_spheres_are_in_meters_about_the_origin(name: str) -> None:
    stage = open_sample(name)
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    points, faces, _ = arrays(stage)
    # a chord mesh of 4 * 16 cells round the equator loses about (pi / 64)^2 of the volume
    assert volume(points, faces) == pytest.approx(4.0 / 3.0 * np.pi, rel=2 * (np.pi / 64) ** 2)


def test_sphere_is_round_and_its_sibling_is_not() -> None:
    points, faces, normals = arrays(open_sample("sphere"))
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 1.0, atol=2 * ROUNDING)
    np.testing.assert_allclose(normals, points, atol=1e-4)
    lumpy, same, _ = arrays(open_sample("deformed_sphere"))
    np.testing.assert_array_equal(same, faces)
    radius = np.linalg.norm(lumpy, axis=1)
    assert radius.max() / radius.min() > 1.5
    assert Gf.Vec3d(*lumpy.mean(axis=0)).GetLength() < 0.2


@pytest.mark.slow
@pytest.mark.acceptance
def test_generator_reproduces_the_files(tmp_path: Path) -> None:
    script = REPO / "tools" / "make_samples.py"
    subprocess.run([sys.executable, str(script), "--out", str(tmp_path)], check=True)
    for name in (*NAMES, "creature", "shot", "ten_ducks"):
        made, kept = (folder / f"{name}.usda" for folder in (tmp_path, REPO / "samples"))
        assert made.read_bytes() == kept.read_bytes(), f"{name}.usda: run tools/make_samples.py"
        assert kept.stat().st_size < 1.2e6
    capture = "duck_capture.spz"
    assert (tmp_path / capture).read_bytes() == (REPO / "samples" / capture).read_bytes()
