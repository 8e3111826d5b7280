"""The check on files that are not ours, odd, damaged or no USD at all."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from checked_stages import CUBE, MESH, MIDDLE, RATE, box, good_stage, put, vec3, with_nan
from pxr import Sdf, Usd, UsdGeom, UsdPhysics

from gf_usd.core.errors import InputError
from gf_usd.layers.check.base import RULES
from gf_usd.layers.check.run import CheckResult, check_file, check_stage


def rules_of(result: CheckResult) -> set[str]:
    return {finding.rule for finding in result.findings}


@pytest.mark.slow
@pytest.mark.parametrize("value", ["0", "nan", "inf"])
def test_time_codes_that_hang_usd_are_refused_in_time(tmp_path: Path, value: str) -> None:
    """Zero over a sublayer: USD's own GetTimeSamples never returns, so nothing may read them."""
    good_stage(tmp_path / "below.usda").Save()
    path = tmp_path / "above.usda"
    header = (
        f"#usda 1.0\n(\n    timeCodesPerSecond = {value}\n    subLayers = [@./below.usda@]\n)\n"
    )
    path.write_text(header, "utf-8")
    code = (
        "import sys\n"
        "from gf_usd.layers.check.run import check_file\n"
        "result = check_file(sys.argv[1])\n"
        "print(result.ok, *[f.rule for f in result.findings], *[s.rule for s in result.skipped])\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(path)],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
        env={"PYTHONPATH": str(Path(__file__).resolve().parents[3])},
    )
    ok, rule, *skipped = done.stdout.split()
    assert (ok, rule) == ("False", "time-codes-per-second")
    asleep = {name for name, rule in RULES.items() if rule.reads_samples}
    assert set(skipped) == asleep - {"time-codes-per-second"} | {"usd"}


def test_a_cache_of_overs_is_judged_by_itself(tmp_path: Path) -> None:
    """Prims without a type, as in a payload opened alone, still have points that can be wrong."""
    stage = Usd.Stage.CreateNew(str(tmp_path / "cache.usda"))
    over = stage.OverridePrim("/Body/Mesh")
    points = over.CreateAttribute("points", Sdf.ValueTypeNames.Point3fArray)
    extent = over.CreateAttribute("extent", Sdf.ValueTypeNames.Float3Array)
    points.Set(vec3(CUBE))
    extent.Set(box(CUBE * 0.5))
    found = {f.rule: f for f in check_stage(stage).findings}
    assert found["extent"].message == "extent leaves points up to 0.5 outside"
    points.Set(vec3(with_nan(CUBE)))
    assert "finite" in rules_of(check_stage(stage))


def test_attributes_of_the_wrong_type_are_no_crash(tmp_path: Path) -> None:
    """USD's own validator names the type; the rules of ours must get past it."""
    path = tmp_path / "odd.usda"
    path.write_text(
        '#usda 1.0\n(\n    defaultPrim = "A"\n    upAxis = "Y"\n    metersPerUnit = 1\n)\n'
        'def Mesh "A"\n{\n    string points = "many"\n    float3 extent = (1, 2, 3)\n'
        '    token[] faceVertexCounts = ["x"]\n    float[] faceVertexIndices = [0.5]\n'
        "    string[] velocities.timeSamples = {\n        1: ['a'],\n        2: ['b'],\n    }\n}\n"
        'def ParticleField3DGaussianSplat "B"\n{\n    point3f[] positions = [(0, 0, 0)]\n'
        '    string scales = "big"\n    int[] orientations = [1]\n}\n',
        "utf-8",
    )
    result = check_file(path)
    assert any("AttributeTypeMismatch" in rule for rule in rules_of(result))


def test_the_validators_of_usd_are_run(tmp_path: Path) -> None:
    stage = good_stage(tmp_path / "no_default.usda")
    stage.ClearDefaultPrim()
    (finding,) = check_stage(stage).findings
    assert finding.rule == "usd:usdValidation:StageMetadataChecker.MissingDefaultPrim"
    assert (finding.severity, finding.prim_path) == ("error", "/")
    assert "invalid or missing defaultPrim" in finding.message
    assert (
        finding.fix
        == "author defaultPrim in the root layer: the name of the root prim to be referenced"
    )


def test_nested_gprims_are_gone_once_the_fix_is_followed(tmp_path: Path) -> None:
    stage = Usd.Stage.CreateNew(str(tmp_path / "nested.usda"))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
    UsdGeom.Cube.Define(stage, "/World/Body")
    UsdGeom.Scope.Define(stage, "/World/Body/Parts")
    UsdGeom.Sphere.Define(stage, "/World/Body/Parts/Knob")
    (finding,) = check_stage(stage).findings
    assert finding.rule.endswith(".InvalidNestedGprims")
    assert finding.prim_path == "/World/Body/Parts/Knob"
    assert finding.fix == (
        "move </World/Body/Parts/Knob> out of </World/Body>, for example to </World/Knob>: a prim"
        " that is drawn has no others below it; an Xform above both can hold their transform"
    )
    editor = Usd.NamespaceEditor(stage)
    assert editor.MovePrimAtPath("/World/Body/Parts/Knob", "/World/Knob")
    assert editor.ApplyEdits()
    assert check_stage(stage).findings == ()


def test_what_a_validator_says_of_itself_is_no_fix(tmp_path: Path) -> None:
    """Documentation such as "Validates all of the ..." tells what it does, not what to do."""
    stage = Usd.Stage.CreateNew(str(tmp_path / "collider.usda"))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    root = UsdGeom.Xform.Define(stage, "/World").GetPrim()
    stage.SetDefaultPrim(root)
    points = UsdGeom.Points.Define(stage, "/World/Dust")
    points.CreatePointsAttr([(0, 0, 0)])
    points.CreateExtentAttr([(0, 0, 0), (0, 0, 0)])
    UsdPhysics.CollisionAPI.Apply(points.GetPrim())
    found = check_stage(stage).findings
    assert found
    assert all("ColliderChecker" in one.rule for one in found)
    assert {one.fix for one in found} == {"correct </World/Dust> as the message says"}


def test_a_damaged_sublayer_is_a_finding(tmp_path: Path) -> None:
    good_stage(tmp_path / "good.usda").Save()
    (tmp_path / "bad.usda").write_text('#usda 1.0\ndef "A" {', "utf-8")
    path = tmp_path / "over.usda"
    path.write_text("#usda 1.0\n(\n    subLayers = [@./bad.usda@, @./gone.usda@]\n)\n", "utf-8")
    result = check_file(path)
    text = " ".join(f.message for f in result.findings)
    assert "bad.usda" in text
    assert "gone.usda" in text
    assert not result.ok


def test_instances_are_judged_once_under_a_path_of_the_stage(tmp_path: Path) -> None:
    shared = good_stage(tmp_path / "shared.usda")
    put(MESH, "points", vec3(with_nan(CUBE)), MIDDLE)(shared)
    shared.Save()
    stage = Usd.Stage.CreateNew(str(tmp_path / "shot.usda"))
    stage.SetTimeCodesPerSecond(RATE)
    for name in ("A", "B"):
        prim = stage.DefinePrim(f"/{name}", "Xform")
        prim.GetReferences().AddReference("./shared.usda")
        prim.SetInstanceable(True)
    paths = [f.prim_path for f in check_stage(stage).findings if f.rule == "finite"]
    assert paths == ["/A/Mesh"]


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("gone.usda", None, "gone.usda does not exist"),
        (".", None, " is a folder"),
        ("text.usda", "hello\n", "text.usda cannot be opened as USD"),
        ("duck.obj", "v 0 0 0\n", "duck.obj does not have the suffix of a USD file"),
        ("open.usda", '#usda 1.0\ndef Mesh "a', "open.usda:2:12: syntax error at ''"),
        ("cut.usdc", "PXR-USDC", "cut.usdc cannot be opened as USD"),
    ],
)
def test_what_is_no_usd_file_is_refused(
    tmp_path: Path, name: str, content: str | None, message: str
) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_text(content, "utf-8")
    with pytest.raises(InputError) as error:
        check_file(path)
    assert message in error.value.message
    assert "pxrInternal" not in error.value.message
    assert error.value.hint
