"""Strain and stress of a bake as pictures show them."""

from __future__ import annotations

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdVol, Vt

from gf_usd.core.errors import InputError, UsageError
from gf_usd.readers.pictures.recording import BakedMotion
from gf_usd.readers.pictures.scene import PictureStage
from gf_usd.readers.pictures.values import NeighborFit, largest_stretch

SIDE = 4
LIFT = 5.0
STRETCH = np.diag([1.5, 0.9, 1.0])
TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
Types = Sdf.ValueTypeNames


def lattice() -> np.ndarray:
    grid = np.stack(np.meshgrid(*[np.arange(SIDE)] * 3, indexing="ij"), -1).reshape(-1, 3)
    return grid + np.random.default_rng(0).uniform(-0.2, 0.2, grid.shape)


def vectors(values: np.ndarray) -> Vt.Vec3fArray:
    return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(values, dtype=np.float32))


def moved(points: np.ndarray, time: float) -> np.ndarray:
    """Lifted at time 1; turned and stretched at time 2."""
    return points + (0, LIFT, 0) if time == 1.0 else points @ (TURN @ STRETCH).T


def bake(path, *, gradients: bool = True, stress: bool = True, meshes: bool = True):
    """A cube of particles and a mesh embedded in it, with a mesh that is not."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    stage.SetStartTimeCode(1)
    stage.SetEndTimeCode(2)
    rest = lattice()
    prim = UsdVol.ParticleField3DGaussianSplat.Define(stage, "/Box/Gaussians").GetPrim()
    positions = prim.CreateAttribute("positions", Types.Point3fArray, False)
    prim.CreateAttribute("gaussianFlesh:restPositions", Types.Point3fArray, False).Set(
        vectors(rest)
    )
    prim.CreateAttribute("orientations", Types.QuatfArray, False).Set(
        Vt.QuatfArray([Gf.Quatf(1)] * len(rest))
    )
    prim.CreateAttribute("scales", Types.Float3Array, False).Set(vectors(np.ones_like(rest)))
    points = UsdGeom.Points.Define(stage, "/Box/Points").GetPrim()
    points.CreateAttribute("gaussianFlesh:restPositions", Types.Point3fArray, False).Set(
        vectors(rest)
    )
    cubes = [UsdGeom.Mesh.Define(stage, name) for name in ("/Box/Skin", "/Box/Prop")]
    for time in (1.0, 2.0):
        positions.Set(vectors(moved(rest, time)), time)
        UsdGeom.Points(points).GetPointsAttr().Set(vectors(moved(rest, time)), time)
        for cube in cubes:
            corners = (SIDE - 1) * np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0)])
            cube.GetPointsAttr().Set(vectors(moved(corners, time)), time)
        if gradients:
            f = np.eye(3) if time == 1.0 else TURN @ STRETCH
            stored = np.ascontiguousarray(np.tile(f, (len(rest), 1, 1)))
            prim.CreateAttribute(
                "gaussianFlesh:deformationGradients", Types.Matrix3dArray, False
            ).Set(Vt.Matrix3dArray.FromNumpy(stored), time)
        if stress:
            prim.CreateAttribute("gaussianFlesh:vonMisesStress", Types.FloatArray, False).Set(
                Vt.FloatArray([time * (i + 1) for i in range(len(rest))]), time
            )
    for cube in cubes:
        cube.GetFaceVertexCountsAttr().Set([3])
        cube.GetFaceVertexIndicesAttr().Set([0, 1, 2])
    if meshes:
        prim.CreateRelationship("gaussianFlesh:sourceMeshes", False).SetTargets(["/Box/Skin"])
    stage.Save()
    return path


def test_the_largest_stretch_does_not_see_rotation():
    f = np.stack([np.eye(3), TURN, TURN @ np.diag([0.4, 1.2, 1.0]), np.full((3, 3), np.nan)])
    assert largest_stretch(f)[:3] == pytest.approx([0.0, 0.0, 0.6])
    assert np.isnan(largest_stretch(f)[3])


def test_a_fit_to_neighbors_is_exact_for_affine_motion():
    rest = lattice()
    f = np.array([[1.2, 0.3, 0.0], [-0.1, 0.8, 0.2], [0.0, 0.1, 1.1]])
    assert np.allclose(NeighborFit(rest)(rest @ f.T + 3.0), f, atol=1e-9)


def test_a_sheet_of_particles_is_fitted_within_its_plane():
    flat = lattice()[: SIDE * SIDE] * (0, 1, 1)
    f = NeighborFit(flat)(flat * (1.0, 1.5, 1.0))
    assert largest_stretch(f) == pytest.approx(0.5)


@pytest.mark.parametrize("gradients", [True, False])
def test_strain_of_particles_and_of_the_mesh_embedded_in_them(tmp_path, gradients):
    path = bake(tmp_path / "box.usda", gradients=gradients)
    for show in ("gaussians", "ellipsoids", "points"):
        source = PictureStage(path, show, color="strain")
        for time, expected in ((1.0, 0.0), (2.0, 0.5)):
            scene = source.scene(time)
            (cloud,) = scene.splats or scene.ellipsoids
            # positions are stored in single precision
            assert cloud.values == pytest.approx(expected, abs=1e-5)
    source = PictureStage(path, "mesh", color="strain")
    skin, prop = source.scene(2.0).meshes
    assert skin.name == "/Box/Skin"
    assert skin.values == pytest.approx(0.5, abs=1e-5)
    assert prop.values is None
    assert any("fitted" in note for note in source.scene(2.0).notes) != gradients


def test_stress_is_in_pascals_and_each_vertex_has_that_of_its_neighbors(tmp_path):
    path = bake(tmp_path / "box.usda")
    source = PictureStage(path, "mesh", color="stress")
    values = source.scene(2.0).meshes[0].values
    # a pressure of 1 in a stage of centimeters and kilograms is 100 Pa
    own = 200.0 * np.arange(1, SIDE**3 + 1)
    corners = (SIDE - 1) * np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0)])
    for corner, value in zip(corners, values):
        near = own[np.argsort(np.linalg.norm(lattice() - corner, axis=1))[:8]]
        assert near.min() < value < near.max()


def test_elastic_and_plastic_strain_are_read_where_they_were_written(tmp_path):
    path = bake(tmp_path / "box.usda")
    with pytest.raises(InputError, match="</Box/Gaussians> holds no plastic") as caught:
        PictureStage(path, "gaussians", color="plastic")
    assert "--internal" in caught.value.hint
    stage = Usd.Stage.Open(str(path))
    prim = stage.GetPrimAtPath("/Box/Gaussians")
    ramp = np.arange(SIDE**3, dtype=np.float32)
    of_each = {"elasticStrain": 0.01 * ramp, "plasticStrain": ramp, "lostVolume": ramp[::-1]}
    for name, values in of_each.items():
        attribute = prim.CreateAttribute(f"gaussianFlesh:{name}", Types.FloatArray, False)
        for time in (1.0, 2.0):
            attribute.Set(Vt.FloatArray.FromNumpy(np.ascontiguousarray(time * values)), time)
    stage.Save()
    for what, expected in (
        ("elastic", 0.02 * ramp),
        ("plastic", 2.0 * np.maximum(ramp, ramp[::-1])),
    ):
        (cloud,) = PictureStage(path, "gaussians", color=what).scene(2.0).splats
        assert cloud.values == pytest.approx(expected)
    (*_, frame) = BakedMotion(path).frames()
    assert sorted(frame.measured) == ["elastic", "plastic", "stress"]
    assert frame.measured["elastic"] == pytest.approx(0.02 * ramp)


def test_the_range_holds_nearly_all_in_every_frame(tmp_path):
    source = PictureStage(bake(tmp_path / "box.usda"), "mesh", color="stress")
    quantity = source.values.quantity(source.motion.time_codes)
    count = SIDE**3
    assert quantity.largest == pytest.approx(200.0 * count)
    assert quantity.high == pytest.approx(200.0 * (1 + 0.99 * (count - 1)))
    assert (quantity.low, quantity.unit, quantity.chosen) == (0.0, "Pa", False)


def test_what_a_bake_does_not_hold_is_refused(tmp_path):
    path = bake(tmp_path / "box.usda", stress=False)
    with pytest.raises(InputError, match="</Box/Gaussians> holds no stress") as caught:
        PictureStage(path, "mesh", color="stress")
    assert "--stress" in caught.value.hint
    with pytest.raises(UsageError, match="unknown --color heat"):
        PictureStage(path, "mesh", color="heat")
    plain = tmp_path / "plain.usda"
    plain.write_text('#usda 1.0\ndef Cube "box" {\n}\n', encoding="utf-8")
    with pytest.raises(
        InputError, match="needs the particles of a bake, and the file contains none"
    ):
        PictureStage(plain, "mesh", color="strain")
