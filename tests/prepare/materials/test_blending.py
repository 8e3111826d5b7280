"""Materials that blend and values that are painted: stage, particles and cache."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, UsdShade

from gf_usd.api.bake import bake
from gf_usd.core.errors import InputError, UsageError
from gf_usd.core.materials.per_particle import spread
from gf_usd.geometry.connected.bodies import smoothstep
from gf_usd.pipeline.prepared import prepare
from gf_usd.prepare.plan import Plan

UNIT = 0.01  # [m]: centimeters; the bar is 40 x 10 x 10 of them
RINGS, LENGTH = 8, 40.0
FEW: dict[str, Any] = {"particles": 400, "frames": 2}
SOFT, STIFF = 1e5, 1e6  # [Pa]
EPS = float(np.finfo(np.float32).eps)


def bar(stage: Usd.Stage) -> UsdGeom.Mesh:
    """A bar along x of eight rings of four faces and two caps, which come last."""
    mesh = UsdGeom.Mesh.Define(stage, "/Bar/Mesh")
    square = [(-5, -5), (5, -5), (5, 5), (-5, 5)]
    points = [(x, *yz) for x in np.linspace(0.0, LENGTH, RINGS + 1) for yz in square]
    faces = []
    for ring in range(RINGS):
        for k in range(4):
            a, b = 4 * ring + k, 4 * ring + (k + 1) % 4
            faces.append((a, b, b + 4, a + 4))
    last = 4 * RINGS
    faces += [(3, 2, 1, 0), (last, last + 1, last + 2, last + 3)]
    mesh.CreatePointsAttr([Gf.Vec3f(*map(float, p)) for p in points])
    mesh.CreateFaceVertexCountsAttr([4] * len(faces))
    mesh.CreateFaceVertexIndicesAttr([i for face in faces for i in face])
    mesh.CreateSubdivisionSchemeAttr("none")
    return mesh


@pytest.fixture
def stage(tmp_path) -> Usd.Stage:
    stage = Usd.Stage.CreateNew(str(tmp_path / "bar.usda"))
    UsdGeom.SetStageMetersPerUnit(stage, UNIT)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/Bar").GetPrim())
    bar(stage)
    return stage


def halves(stage: Usd.Stage, densities=(1000.0, 2000.0)) -> None:
    """A soft and a stiff half, bound by subsets."""
    middle = 4 * (RINGS // 2)
    faces = [[*range(middle), 4 * RINGS], [*range(middle, 4 * RINGS), 4 * RINGS + 1]]
    for name, rows, young, density in zip(("soft", "stiff"), faces, (SOFT, STIFF), densities):
        material = UsdShade.Material.Define(stage, f"/Bar/{name}")
        prim = material.GetPrim()
        UsdPhysics.MaterialAPI.Apply(prim).CreateDensityAttr(density * UNIT**3)
        for key, value in (("youngsModulus", young * UNIT), ("poissonsRatio", 0.25)):
            prim.CreateAttribute(f"physics:{key}", Sdf.ValueTypeNames.Float).Set(value)
        subset = UsdGeom.Subset.Define(stage, f"/Bar/Mesh/{name}")
        subset.CreateIndicesAttr(rows)
        subset.CreateFamilyNameAttr("materialBind")
        api = UsdShade.MaterialBindingAPI.Apply(subset.GetPrim())
        api.Bind(material, materialPurpose="physics")


def paint(stage: Usd.Stage, values, interpolation: str, name="youngsModulus") -> None:
    api = UsdGeom.PrimvarsAPI(stage.GetPrimAtPath("/Bar/Mesh"))
    kind = Sdf.ValueTypeNames.FloatArray
    made = api.CreatePrimvar(f"gaussianFlesh:{name}", kind, interpolation)
    made.Set([float(v) for v in values])


def prepared(stage: Usd.Stage, tmp_path: Path, **options) -> Plan:
    stage.Save()
    source = Path(stage.GetRootLayer().realPath)
    return prepare(source, output=tmp_path / "out.usda", **{**FEW, **options}).plan


def moduli(plan: Plan) -> np.ndarray:
    """(N,) [Pa] of each particle."""
    return spread(plan.particles, plan.variants[0].table)["youngs_modulus"]


def test_halves_blend_over_the_width_that_is_asked(stage, tmp_path):
    halves(stage)
    sharp = prepared(stage, tmp_path)
    assert sharp.particles.own is None
    blend = prepared(stage, tmp_path, blend_width=10.0)
    own = blend.particles.own
    assert own is not None
    share = smoothstep(0.5 + (blend.particles.X[:, 0] - 0.5 * LENGTH * UNIT) / (10.0 * UNIT))
    # Poisson's ratio is one, so that E goes as mu does; near the ends of the bar the caps are
    # nearest, where the other half is out of reach.  The file holds float32.
    np.testing.assert_allclose(moduli(blend), SOFT + (STIFF - SOFT) * share, rtol=1e-6)
    np.testing.assert_allclose(own["density"], 1000.0 + 1000.0 * share, rtol=1e-6)
    mixed = int(((share > 0.0) & (share < 1.0)).sum())
    assert 0 < mixed < len(share)
    assert any(note.startswith(f"{mixed} of {len(share)} particles") for note in blend.notes)


def test_a_width_without_two_materials_is_said_to_change_nothing(stage, tmp_path):
    plan = prepared(stage, tmp_path, blend_width=5.0)
    assert plan.particles.own is None
    assert "--blend-width changes nothing: no body has two materials" in plan.notes


@pytest.mark.parametrize("width", [-1.0, float("nan")])
def test_a_width_that_makes_no_sense_is_refused(stage, tmp_path, width):
    with pytest.raises(UsageError, match="--blend-width"):
        prepared(stage, tmp_path, blend_width=width)


def test_a_stated_mass_stays_when_densities_blend(stage, tmp_path):
    halves(stage)
    UsdPhysics.RigidBodyAPI.Apply(stage.GetPrimAtPath("/Bar"))
    UsdPhysics.MassAPI.Apply(stage.GetPrimAtPath("/Bar")).CreateMassAttr(7.0)
    plan = prepared(stage, tmp_path, blend_width=10.0)
    per = spread(plan.particles, plan.variants[0].table)
    assert per["density"] @ plan.particles.V0 == pytest.approx(7.0, rel=1e-12)
    assert per["density"].min() < 0.6 * per["density"].max()


# A value for each element that is a line in x where it can be: E = 1000 + 100 x [stage units]
RAMP = 1000.0 + 100.0 * np.repeat(np.linspace(0.0, LENGTH, RINGS + 1), 4)


@pytest.mark.parametrize("interpolation", ["vertex", "varying", "faceVarying"])
def test_what_is_painted_on_vertices_is_a_line_between_them(stage, tmp_path, interpolation):
    corners = stage.GetPrimAtPath("/Bar/Mesh").GetAttribute("faceVertexIndices").Get()
    paint(stage, RAMP[list(corners)] if interpolation == "faceVarying" else RAMP, interpolation)
    plan = prepared(stage, tmp_path)
    X = plan.particles.X / UNIT
    # the nearest point of the walls has the particle's own x; that of the caps the cap's
    side = 5.0 - np.abs(X[:, 1:]).max(1)
    end = np.minimum(X[:, 0], LENGTH - X[:, 0])
    x = np.where(end < side, np.where(X[:, 0] < 20.0, 0.0, LENGTH), X[:, 0])
    # float32 points, over an edge of an eighth of the bar
    expected = (1000.0 + 100.0 * x) / UNIT
    np.testing.assert_allclose(moduli(plan), expected, rtol=100.0 * EPS)
    assert plan.materials[0].name == "authored"


def test_what_is_painted_on_faces_is_one_value_a_face(stage, tmp_path):
    values = [1e4 if ring < RINGS // 2 else 2e4 for ring in range(RINGS) for _ in range(4)]
    paint(stage, [*values, 1e4, 2e4], "uniform")
    plan = prepared(stage, tmp_path)
    left = plan.particles.X[:, 0] < 0.5 * LENGTH * UNIT
    np.testing.assert_allclose(moduli(plan), np.where(left, 1e4, 2e4) / UNIT, rtol=10.0 * EPS)


def test_a_constant_one_holds_for_all_and_is_inherited(stage, tmp_path):
    api = UsdGeom.PrimvarsAPI(stage.GetPrimAtPath("/Bar"))
    api.CreatePrimvar(
        "gaussianFlesh:youngsModulus", Sdf.ValueTypeNames.Float, UsdGeom.Tokens.constant
    ).Set(3e4)
    plan = prepared(stage, tmp_path)
    np.testing.assert_allclose(moduli(plan), 3e4 / UNIT, rtol=10.0 * EPS)


def test_density_and_poissons_ratio_are_painted_alike(stage, tmp_path):
    paint(stage, [0.002], "constant", "density")
    paint(stage, [0.3], "constant", "poissonsRatio")
    plan = prepared(stage, tmp_path)
    per = spread(plan.particles, plan.variants[0].table)
    np.testing.assert_allclose(per["density"], 2000.0, rtol=10.0 * EPS)
    np.testing.assert_allclose(per["poissons_ratio"], 0.3, rtol=10.0 * EPS)
    rubber = plan.variants[0].table[0]
    np.testing.assert_allclose(per["youngs_modulus"], rubber.youngs_modulus, rtol=10.0 * EPS)


def test_a_material_of_the_command_goes_before_what_is_painted(stage, tmp_path):
    paint(stage, [-1.0], "constant")  # not even looked at
    plan = prepared(stage, tmp_path, material="jelly")
    assert plan.particles.own is None


@pytest.mark.parametrize(
    ("values", "interpolation", "name", "message"),
    [
        ([1e4, -2.0, 0.0, *[1e4] * 33], "vertex", "youngsModulus", "2 of 36 values .* is -2"),
        ([1e4, np.nan, *[1e4] * 34], "vertex", "youngsModulus", "1 of 36 values .* is nan"),
        ([np.inf], "constant", "youngsModulus", "1 of 1 values .* is inf"),
        ([0.5], "constant", "poissonsRatio", "1 of 1 values .* is 0.5"),
        ([0.0], "constant", "density", "1 of 1 values .* is 0"),
        (
            [1e4] * 7,
            "uniform",
            "youngsModulus",
            "has 7 values, but 'uniform' interpolation needs 34",
        ),
    ],
)
def test_values_that_make_no_sense_are_refused(
    stage, tmp_path, values, interpolation, name, message
):
    paint(stage, values, interpolation, name)
    with pytest.raises(InputError, match=f"</Bar/Mesh>: primvars:gaussianFlesh:{name} .*{message}"):
        prepared(stage, tmp_path)


def test_a_primvar_of_another_type_is_refused(stage, tmp_path):
    api = UsdGeom.PrimvarsAPI(stage.GetPrimAtPath("/Bar/Mesh"))
    api.CreatePrimvar("gaussianFlesh:density", Sdf.ValueTypeNames.Color3fArray, "constant").Set(
        [Gf.Vec3f(1.0)]
    )
    with pytest.raises(InputError, match="is of type color3f"):
        prepared(stage, tmp_path)


@pytest.mark.slow
def test_the_cache_and_the_report_hold_the_values_of_particles(stage, tmp_path):
    halves(stage)
    stage.Save()
    source = Path(stage.GetRootLayer().realPath)
    result = bake(source, output=tmp_path / "out.usda", blend_width=10.0, **FEW)
    assert result.findings == ()
    baked = Usd.Stage.Open(str(result.root))
    prims = [p for p in baked.Traverse() if p.HasAPI("GaussianFleshParticlesAPI")]
    assert len(prims) == 2
    own = json.loads(result.report.read_text())["own_values"]
    for prim in prims:

        def of(name, prim=prim):
            return np.array(prim.GetAttribute(f"gaussianFlesh:{name}").Get(), float)

        young, density = of("youngsModulus") / UNIT, of("densities") / UNIT**3
        assert len(young) == len(density) == result.particles
        np.testing.assert_allclose([young.min(), young.max()], own["youngs_modulus"], rtol=EPS * 4)
        np.testing.assert_allclose([density.min(), density.max()], own["density"], rtol=EPS * 4)
        np.testing.assert_allclose(of("poissonsRatio"), 0.25, rtol=EPS * 4)
        np.testing.assert_allclose(of("masses"), of("densities") * of("restVolumes"), rtol=EPS * 4)
    mass = json.loads(result.report.read_text())["bakes"][0]["per_frame"][0]["mass"]
    assert float(of("masses").sum()) == pytest.approx(mass, rel=1e-5)


def test_a_bake_of_one_material_writes_no_values_of_particles(stage, tmp_path):
    stage.Save()
    source = Path(stage.GetRootLayer().realPath)
    result = bake(source, output=tmp_path / "out.usda", **FEW)
    baked = Usd.Stage.Open(str(result.root))
    prims = [p for p in baked.Traverse() if p.HasAPI("GaussianFleshParticlesAPI")]
    assert not any(p.GetAttribute("gaussianFlesh:youngsModulus").HasAuthoredValue() for p in prims)
    assert json.loads(result.report.read_text())["own_values"] == {}
