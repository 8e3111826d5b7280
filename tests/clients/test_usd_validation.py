"""NVIDIA's usd-validation finds no error in what we wrote, and does in what is damaged."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from client_assets import Baked
from client_runs import findings, needs
from pxr import Gf, Sdf, Usd, UsdGeom

pytestmark = [pytest.mark.clients, needs("validation")]

# A cache is a payload: its prims are overs, which have a type only where the source is below them
NOT_ALONE = {"TypeChecker", "DefaultPrimChecker"}


@pytest.mark.parametrize("asset", ["duck", "blocks", "obj", "apart"])
def test_root_layers_have_no_error_and_no_failure_of_ours(
    asset: str,
    request: pytest.FixtureRequest,
    tmp_path: Path,
) -> None:
    baked: Baked = request.getfixturevalue(asset)
    found = findings(baked.root, tmp_path)
    assert {severity for severity, _, _ in found} <= {"FAILURE"}
    # such as the normals that an OBJ without any leaves out
    assert found <= findings(baked.source, tmp_path)


@pytest.mark.parametrize("asset", ["duck", "blocks", "obj", "apart"])
def test_caches_alone_have_no_error(
    asset: str,
    request: pytest.FixtureRequest,
    tmp_path: Path,
) -> None:
    baked: Baked = request.getfixturevalue(asset)
    for cache in baked.caches:
        found = findings(cache, tmp_path)
        assert {severity for severity, _, _ in found} <= {"FAILURE"}
        assert {rule for _, rule, _ in found} <= NOT_ALONE


def _cut(mesh: UsdGeom.Mesh) -> None:
    """Topology that leads to points that are not there."""
    points = mesh.GetPointsAttr()
    for time in points.GetTimeSamples():
        points.Set(points.Get(time)[:-5], time)


def _shrink(mesh: UsdGeom.Mesh) -> None:
    """An extent that holds less than its points."""
    for time in mesh.GetExtentAttr().GetTimeSamples():
        mesh.GetExtentAttr().Set([(-0.1, -0.1, -0.1), (0.1, 0.1, 0.1)], time)


def _retype(mesh: UsdGeom.Mesh) -> None:
    """Points of another type than the schema's."""
    mesh.GetPrim().RemoveProperty("points")
    wrong = mesh.GetPrim().CreateAttribute("points", Sdf.ValueTypeNames.Double3Array, False)
    wrong.Set([Gf.Vec3d(0.0)] * 98, 101)


@pytest.mark.parametrize(
    ("damage", "rule"),
    [
        (_cut, "ValidateTopologyChecker"),
        (_shrink, "ExtentsChecker"),
        (_retype, "UsdValidationAttributeTypeMismatchChecker"),
    ],
)
def test_damage_is_found(
    damage: Callable[[UsdGeom.Mesh], None],
    rule: str,
    blocks: Baked,
    tmp_path: Path,
) -> None:
    damaged = blocks.with_output_folder(tmp_path / "damaged")
    cache = Usd.Stage.Open(str(damaged.caches[0]))
    damage(UsdGeom.Mesh(cache.GetPrimAtPath("/Blocks/left/Mesh")))
    cache.Save()
    assert rule in {name for _, name, _ in findings(damaged.root, tmp_path)}
