"""Newton's importer reads the materials we wrote: moduli, density and damping.

Newton simulates what a stage specifies.  A bake specifies nothing, it is the result; so a layer
over it adds a tetrahedron and makes the Points a body, both with the material that we wrote.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from client_assets import Baked
from client_runs import PROBES, needs, programs, run
from pxr import Gf, Usd, UsdGeom, UsdPhysics, UsdShade

from gf_usd.core.materials.material import Material

pytestmark = [pytest.mark.clients, needs("newton")]

SINGLE = 2.0**-22  # two roundings to single precision: of our file and of Newton's arrays


@dataclass(frozen=True)
class Reading:
    """A material of ours, and what Newton understood of it."""

    material: Material
    unit: float  # [m]
    moduli: list[float]  # [stage units] of each particle, by its index into our materials
    report: dict[str, Any]

    def lame(self) -> tuple[float, float]:
        """mu and lambda [stage units] of the moduli as single precision holds them in the file."""
        young = float(np.float32(self.material.youngs_modulus * self.unit))
        nu = float(np.float32(self.material.poissons_ratio))
        return young / (2 * (1 + nu)), young * nu / ((1 + nu) * (1 - 2 * nu))


@pytest.fixture(scope="module")
def readings(
    duck: Baked,
    blocks: Baked,
    obj: Baked,
    apart: Baked,
    tmp_path_factory: pytest.TempPathFactory,
) -> dict[str, Reading]:
    """All that Newton reads, in one process: it takes seconds to start."""
    folder = tmp_path_factory.mktemp("newton")
    cases = {
        "rubber": (duck, 0),
        "metal": (duck, 1),
        "jelly": (duck, 2),
        "blocks": (blocks, 0),
        "obj": (obj, 0),
        "apart": (apart, 0),
        "without the proposal": (_damaged(duck, folder / "a", _forget_the_proposal), 0),
        "in pascals": (_damaged(duck, folder / "b", _say_pascals), 0),
    }
    stages = {
        name: _proof(baked, number, folder / f"{name.replace(' ', '_')}.usda")
        for name, (baked, number) in cases.items()
    }
    files = {name: Path(stage.GetRootLayer().realPath) for name, stage in stages.items()}
    run([programs("newton") / "python", PROBES / "newton_import.py", *files.values()])
    return {
        name: Reading(
            material=baked.materials[number],
            unit=UsdGeom.GetStageMetersPerUnit(stages[name]),
            moduli=_moduli(_points(stages[name])),
            report=json.loads(files[name].with_suffix(".json").read_text()),
        )
        for name, (baked, number) in cases.items()
    }


@pytest.mark.parametrize("name", ["rubber", "metal", "jelly", "blocks", "obj"])
def test_newton_reads_exact_mu_lambda_and_density(name: str, readings: dict[str, Reading]) -> None:
    r = readings[name]
    mu, lam = r.lame()
    density = r.material.density * r.unit**3
    # by the words of the proposal, in stage units
    assert r.report["tetmesh"] == [
        [pytest.approx(value, rel=SINGLE)] for value in (mu, lam, density)
    ]
    assert r.report["soft"][0][:2] == pytest.approx([mu, lam], rel=SINGLE)
    # and what these are about: pascals
    assert mu / r.unit == pytest.approx(r.material.mu, rel=SINGLE)
    # in lambda, the rounding of nu counts 2 / (1 - 2 nu) times
    much = 1 + 2 / (1 - 2 * r.material.poissons_ratio)
    assert lam / r.unit == pytest.approx(r.material.lam, rel=SINGLE * much)


@pytest.mark.parametrize("name", ["rubber", "metal", "jelly", "blocks", "obj"])
def test_newton_makes_an_elastic_body_of_the_points(
    name: str, readings: dict[str, Reading]
) -> None:
    r = readings[name]
    for key, value in (
        ("young_modulus", r.material.youngs_modulus),
        ("poisson_ratio", r.material.poissons_ratio),
        ("damping", r.material.damping_time),
        # at Newton's own 0 any tension tears it
        ("tensile_yield_ratio", 1.0),
        ("density", r.material.density),
    ):
        # a density is a mass over the cube of a width: four roundings more
        wanted = pytest.approx([value] * len(r.moduli), rel=4 * SINGLE)
        assert r.report["particles"][key] == wanted, key


def test_newton_gives_each_particle_the_material_of_its_subset(
    readings: dict[str, Reading],
) -> None:
    r = readings["apart"]
    assert len(set(r.moduli)) == 2
    wanted = [modulus / r.unit for modulus in r.moduli]
    assert r.report["particles"]["young_modulus"] == pytest.approx(wanted, rel=4 * SINGLE)


@pytest.mark.parametrize("name", ["without the proposal", "in pascals"])
def test_a_damaged_material_is_seen(name: str, readings: dict[str, Reading]) -> None:
    r = readings[name]
    found = r.report["tetmesh"][0]
    assert found is None or abs(found[0] / r.lame()[0] - 1) > 0.5


def _damaged(baked: Baked, folder: Path, damage: Callable[[Usd.Prim], None]) -> Baked:
    copy = baked.with_output_folder(folder)
    cache = Usd.Stage.Open(str(copy.caches[0]))
    damage(cache.GetPrimAtPath("/Duck/GaussianFlesh/Materials/rubber"))
    cache.Save()
    return copy


def _forget_the_proposal(material: Usd.Prim) -> None:
    material.RemoveAppliedSchema("PhysicsVolumeDeformableMaterialAPI")


def _say_pascals(material: Usd.Prim) -> None:
    for name in ("physics:youngsModulus", "newton:mpm:youngsModulus"):
        attribute = material.GetAttribute(name)
        attribute.Set(attribute.Get() * 100.0)


def _points(stage: Usd.Stage) -> Usd.Prim:
    return next(prim for prim in stage.Traverse() if prim.GetTypeName() == "Points")


def _moduli(points: Usd.Prim) -> list[float]:
    targets = points.GetRelationship("gaussianFlesh:materials").GetTargets()
    materials = [points.GetStage().GetPrimAtPath(path) for path in targets]
    table = [material.GetAttribute("physics:youngsModulus").Get() for material in materials]
    return [table[number] for number in points.GetAttribute("gaussianFlesh:materialIndices").Get()]


def _proof(baked: Baked, number: int, path: Path) -> Usd.Stage:
    """A shot of one variant with things for Newton to simulate out of its material."""
    stage = Usd.Stage.CreateNew(str(path))
    made = Usd.Stage.Open(str(baked.root))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.GetStageUpAxis(made))
    UsdGeom.SetStageMetersPerUnit(stage, UsdGeom.GetStageMetersPerUnit(made))
    look: Any = baked.materials[number]
    root = stage.DefinePrim(made.GetDefaultPrim().GetPath())
    root.GetReferences().AddReference(str(baked.root))
    root.GetVariantSets().SetSelection("gaussianFlesh", look.name)
    UsdGeom.Scope.Define(stage, "/Proof")
    UsdPhysics.Scene.Define(stage, "/Proof/Scene").GetPrim().AddAppliedSchema("NewtonMPMSceneAPI")
    tet = UsdGeom.TetMesh.Define(stage, "/Proof/Tet")
    tet.CreatePointsAttr([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)])
    tet.CreateTetVertexIndicesAttr([Gf.Vec4i(0, 1, 2, 3)])
    points = _points(stage)
    # Newton reads where they are at no time at all; points of several materials have that already
    if UsdGeom.Points(points).GetPointsAttr().Get() is None:
        rest = points.GetAttribute("gaussianFlesh:restPositions").Get()
        UsdGeom.Points(points).GetPointsAttr().Set(rest)
    for prim, api in (
        (tet.GetPrim(), "PhysicsVolumeDeformableSimAPI"),
        (points, "NewtonPointsDeformableSimAPI"),
    ):
        prim.AddAppliedSchema("PhysicsDeformableBodyAPI")
        prim.AddAppliedSchema(api)
    subsets = UsdShade.MaterialBindingAPI(points).GetMaterialBindSubsets()
    bound = subsets[0].GetPrim() if subsets else points
    material, _ = UsdShade.MaterialBindingAPI(bound).ComputeBoundMaterial("physics")
    UsdShade.MaterialBindingAPI.Apply(tet.GetPrim()).Bind(
        material, UsdShade.Tokens.weakerThanDescendants, "physics"
    )
    stage.Save()
    return stage
