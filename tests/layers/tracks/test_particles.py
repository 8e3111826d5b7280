"""The Gaussians, their twin of points and their materials."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, UsdShade
from small_sources import MOVING, PLAIN
from small_stages import (
    RUBBER,
    bake,
    write_cache,
)

from gf_usd.core.frames.choices import Choices


def test_the_splats_extent_is_that_of_their_three_sigma_ellipsoids(tmp_path: Path) -> None:
    asset = PLAIN.asset(tmp_path)
    root, _, _ = bake(asset, tmp_path)
    stage = Usd.Stage.Open(str(root.path))
    splats = stage.GetPrimAtPath("/duck/GaussianFlesh/Gaussians")
    directions = np.random.default_rng(0).normal(size=(4000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    surface = []
    for center, turn, scale in zip(
        splats.GetAttribute("positions").Get(12),
        splats.GetAttribute("orientations").Get(12),
        splats.GetAttribute("scales").Get(12),
    ):
        matrix = np.array(Gf.Matrix3d(Gf.Quatd(turn)))  # for row vectors
        surface.append(np.array(center) + 3.0 * (directions * np.array(scale)) @ matrix)
    cloud = np.concatenate(surface)
    low, high = np.array(splats.GetAttribute("extent").Get(12))
    size = high - low
    assert np.all(cloud >= low - 1e-5 * size)
    assert np.all(cloud <= high + 1e-5 * size)
    # 4000 directions come within 2 % of every extreme
    np.testing.assert_allclose(cloud.min(axis=0), low, atol=0.02 * size.max())
    np.testing.assert_allclose(cloud.max(axis=0), high, atol=0.02 * size.max())


def test_gaussians_carry_color_opacity_and_rest_state(tmp_path: Path) -> None:
    asset = PLAIN.asset(tmp_path)
    root, particles, _ = bake(asset, tmp_path)
    stage = Usd.Stage.Open(str(root.path))
    splats = stage.GetPrimAtPath("/duck/GaussianFlesh/Gaussians")
    assert splats.GetTypeName() == "ParticleField3DGaussianSplat"
    assert splats.GetAttribute("radiance:sphericalHarmonicsDegree").Get() == 0
    flat = np.array(splats.GetAttribute("radiance:sphericalHarmonicsCoefficients").Get())
    # a renderer shows 1/2 + Y_00 f
    np.testing.assert_allclose(0.5 + flat / (2 * np.sqrt(np.pi)), particles.color, atol=1e-6)
    np.testing.assert_allclose(splats.GetAttribute("opacities").Get(), particles.opacity, rtol=1e-6)
    for name in ("orientations", "gaussianFlesh:restOrientations"):
        turns = splats.GetAttribute(name).Get(11)
        wxyz = [[q.real, *q.imaginary] for q in turns]
        np.testing.assert_allclose(wxyz, particles.orientation, atol=1e-7)
    np.testing.assert_allclose(
        splats.GetAttribute("scales").Get(12), 1.2 * particles.scale, rtol=1e-6
    )
    for prim in (splats, stage.GetPrimAtPath("/duck/GaussianFlesh/Points")):
        assert "GaussianFleshParticlesAPI" in prim.GetAppliedSchemas()
        rest = prim.GetAttribute("gaussianFlesh:restPositions")
        assert rest.GetVariability() == Sdf.VariabilityUniform
        np.testing.assert_allclose(rest.Get(), particles.X, rtol=1e-6)
        # the stage counts mass in half kilograms
        masses = particles.V0 * 1100.0 / 0.5
        np.testing.assert_allclose(
            prim.GetAttribute("gaussianFlesh:masses").Get(), masses, rtol=1e-6
        )
        meshes = prim.GetRelationship("gaussianFlesh:sourceMeshes").GetTargets()
        assert meshes == [Sdf.Path("/duck/geo/body")]


def test_each_body_has_its_own_material(tmp_path: Path) -> None:
    asset = MOVING.asset(tmp_path)
    write_cache(tmp_path / "c.usdc", asset, bodies=2)
    stage = Usd.Stage.Open(str(tmp_path / "c.usdc"))
    splats = stage.GetPrimAtPath("/root/GaussianFlesh/Gaussians")
    materials = splats.GetRelationship("gaussianFlesh:materials").GetTargets()
    scope = Sdf.Path("/root/GaussianFlesh/Materials")
    assert materials == [scope.AppendChild("rubber"), scope.AppendChild("rubber_2")]
    assert set(splats.GetAttribute("gaussianFlesh:materialIndices").Get()) == {0, 1}
    assert not splats.HasAPI(UsdShade.MaterialBindingAPI)


@pytest.mark.parametrize("clips", [0, 2])
def test_points_of_several_materials_are_bound_in_subsets(tmp_path: Path, clips: int) -> None:
    asset = MOVING.asset(tmp_path)
    write_cache(tmp_path / "c.usdc", asset, bodies=2, choices=Choices(clip_frames=clips))
    stage = Usd.Stage.Open(str(tmp_path / "c.usdc"))
    points = UsdGeom.Points(stage.GetPrimAtPath("/root/GaussianFlesh/Points"))
    prim = points.GetPrim()
    which = np.array(prim.GetAttribute("gaussianFlesh:materialIndices").Get())
    subsets = UsdShade.MaterialBindingAPI(prim).GetMaterialBindSubsets()
    assert [s.GetPrim().GetName() for s in subsets] == ["rubber", "rubber_2"]
    # without clips what reads no time finds points and subsets
    code = Usd.TimeCode(stage.GetStartTimeCode()) if clips else Usd.TimeCode.Default()
    rest = np.array(prim.GetAttribute("gaussianFlesh:restPositions").Get())
    assert len(points.GetPointsAttr().Get(code)) == len(rest)
    for number, subset in enumerate(subsets):
        found = np.array(subset.GetIndicesAttr().Get(code))
        np.testing.assert_array_equal(found, np.flatnonzero(which == number))
        bound, _ = UsdShade.MaterialBindingAPI(subset).ComputeBoundMaterial("physics")
        assert bound.GetPath() == f"/root/GaussianFlesh/Materials/{subset.GetPrim().GetName()}"
        shown, _ = UsdShade.MaterialBindingAPI(subset).ComputeBoundMaterial()
        assert not shown, "they are no look"
    if not clips:
        np.testing.assert_array_equal(np.array(points.GetPointsAttr().Get()), rest)
    assert UsdGeom.Subset.ValidateFamily(points, "point", "materialBind") == (True, "")
    # and the motion is that of the samples, at their times
    moved = np.array(points.GetPointsAttr().Get(stage.GetEndTimeCode()))
    assert not np.allclose(moved, rest)
    subsets[0].GetIndicesAttr().Set([0], code)
    assert not UsdGeom.Subset.ValidateFamily(points, "point", "materialBind")[0]


def test_a_material_is_bound_for_physics_in_stage_units(tmp_path: Path) -> None:
    asset = MOVING.asset(tmp_path)
    root, _, _ = bake(asset, tmp_path)
    stage = Usd.Stage.Open(str(root.path))
    splats = stage.GetPrimAtPath("/root/GaussianFlesh/Gaussians")
    material, _ = UsdShade.MaterialBindingAPI(splats).ComputeBoundMaterial("physics")
    prim = material.GetPrim()
    assert prim.GetPath() == "/root/GaussianFlesh/Materials/rubber"
    physics = UsdPhysics.MaterialAPI(prim)
    # centimeters and kilograms: kg/m^3 * 1e-6, kg/(m s^2) * 1e-2
    assert physics.GetDensityAttr().Get() == pytest.approx(RUBBER.density * 1e-6)
    assert prim.GetAttribute("physics:youngsModulus").Get() == pytest.approx(2e5 * 1e-2)
    assert prim.GetAttribute("physics:poissonsRatio").Get() == pytest.approx(0.45)
    assert physics.GetDynamicFrictionAttr().Get() == pytest.approx(0.7)
    assert physics.GetStaticFrictionAttr().Get() == pytest.approx(0.7)
    assert physics.GetRestitutionAttr().Get() == pytest.approx(0.6)
    assert prim.GetAttribute("gaussianFlesh:law").Get() == "neoHookean"
    assert prim.GetAttribute("gaussianFlesh:look").Get() == "rubber"
    assert prim.GetAttribute("gaussianFlesh:dampingTime").Get() == pytest.approx(0.002)
