"""The materials of a bake as prims: UsdShade Materials with physics attributes in stage units.

Each has the attributes of three schemas, so that other simulators can read it: UsdPhysics with the
moduli of the AOUSD proposal for deformables (``physics:``), Newton (``newton:mpm:``), and gf-usd
for values that neither of them defines.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdPhysics, UsdShade, Vt

from gf_usd.core.arrays import Ints
from gf_usd.core.asset import free_name, prim_name
from gf_usd.core.materials import newton
from gf_usd.core.materials.laws import LAWS, law_parameters
from gf_usd.core.materials.material import Material
from gf_usd.core.units import StageUnits
from gf_usd.layers.stage import new_layer, refresh, save, to_metadata
from gf_usd.system import usd_schema  # noqa: F401  (registers the schema before its APIs are applied)
from gf_usd.system.atomic_files import dropped_on_failure, publish

Types = Sdf.ValueTypeNames

# API schemas of others, known by name only: usd-core has no definition of them
VOLUME_MATERIAL_API = "PhysicsVolumeDeformableMaterialAPI"  # AOUSD proposal
NEWTON_MATERIAL_API = "NewtonMPMMaterialAPI"
# the laws whose flow Newton has words for
VOLUME_KEEPING = ("vonMises", "vonMisesNeoHookean", "vonMisesCorotated")


def write_materials(
    stage: Usd.Stage,
    parent: Sdf.Path,
    materials: Sequence[Material],
    variant: str,
    units: StageUnits,
) -> list[Sdf.Path]:
    """Define one Material prim for each material under the Scope ``parent``.

    The prim is called after the material; a name that occurs again gets a number.

    Returns
    -------
    Paths in the order of ``materials``, to which GaussianFleshParticlesAPI's indices refer.
    """
    UsdGeom.Scope.Define(stage, parent)
    paths: list[Sdf.Path] = []
    for material in materials:
        taken = {path.name for path in paths}
        path = parent.AppendChild(
            free_name(prim_name(material.name or variant), taken.__contains__)
        )
        _write(stage, path, material, variant, units)
        paths.append(path)
    return paths


def write_material_file(
    path: Path, material: Material, about: Mapping[str, Any], *, source: Path
) -> Path:
    """Write a layer with one material, in SI, that ``--material FILE`` takes; returns path.

    source : the asset that it was found for, which is never written to.
    about : metadata of the material prim, under the key gaussianFlesh of its customData.

    Raises UsageError where path is the asset, and BakeError where a file cannot be written.
    """
    layer = new_layer(path, source)
    with dropped_on_failure(path):
        stage = Usd.Stage.Open(layer)
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
        (written,) = write_materials(
            stage, Sdf.Path("/Materials"), [material], material.name, StageUnits()
        )
        stage.SetDefaultPrim(stage.GetPrimAtPath("/Materials"))
        stage.GetPrimAtPath(written).SetCustomDataByKey("gaussianFlesh", to_metadata(about))
        save(layer)
        del stage, layer
        publish(path)
        refresh(path)
    return path


def bind(prim: Usd.Prim, material: Sdf.Path) -> None:
    """Bind a material to a prim for the purpose ``physics``."""
    target = UsdShade.Material(prim.GetStage().GetPrimAtPath(material))
    UsdShade.MaterialBindingAPI.Apply(prim).Bind(
        target, UsdShade.Tokens.weakerThanDescendants, "physics"
    )


def bind_points(
    points: Usd.Prim, materials: Sequence[Sdf.Path], indices: Ints, time_code: float | None
) -> None:
    """Bind materials to the points of a Points prim, each by its own GeomSubset.

    The subsets are a partition of the family ``materialBind`` with the names of the materials; a
    material without points has none.

    indices : (N,) into ``materials``.
    time_code : None: the subsets and the points have default values, the points their rest
    positions, for readers without a time. With value clips, that of the first sample of the points:
    a default value would hide the clips, and without one USD requires the subsets to vary as well.
    """
    api = UsdShade.MaterialBindingAPI.Apply(points)
    code = Usd.TimeCode.Default() if time_code is None else Usd.TimeCode(time_code)
    if time_code is None:
        rest = points.GetAttribute("gaussianFlesh:restPositions").Get()
        UsdGeom.Points(points).GetPointsAttr().Set(rest)
    for number, material in enumerate(materials):
        own = np.flatnonzero(np.asarray(indices) == number)
        if len(own):
            subset = api.CreateMaterialBindSubset(
                material.name, Vt.IntArray(), UsdGeom.Tokens.point
            )
            subset.GetIndicesAttr().Clear()
            subset.GetIndicesAttr().Set(Vt.IntArray.FromNumpy(own.astype(np.int32)), code)
            bind(subset.GetPrim(), material)
    api.SetMaterialBindSubsetsFamilyType(UsdGeom.Tokens.partition)


def _write(
    stage: Usd.Stage, path: Sdf.Path, material: Material, variant: str, units: StageUnits
) -> None:
    prim = UsdShade.Material.Define(stage, path).GetPrim()
    # the API of gf-usd applies it too, but only where its schema is registered
    physics = UsdPhysics.MaterialAPI.Apply(prim)
    physics.CreateDensityAttr(material.density / units.density)
    physics.CreateStaticFrictionAttr(material.friction)
    physics.CreateDynamicFrictionAttr(material.friction)
    physics.CreateRestitutionAttr(material.restitution)
    prim.ApplyAPI("GaussianFleshMaterialAPI")
    own = (
        (f"gaussianFlesh:{p.attribute}", Types.Float, material.parameter(p) / units.factor(p.unit))
        for p in law_parameters([material.law])
    )
    for name, kind, value in (
        ("gaussianFlesh:law", Types.Token, material.law),
        ("gaussianFlesh:dampingTime", Types.Float, material.damping_time),
        ("gaussianFlesh:look", Types.Token, variant),
        *own,
    ):
        prim.CreateAttribute(name, kind, False, Sdf.VariabilityUniform).Set(value)
    for api in (VOLUME_MATERIAL_API, NEWTON_MATERIAL_API):
        prim.AddAppliedSchema(api)
    young = material.youngs_modulus / units.pressure
    for name, value in (
        ("physics:youngsModulus", young),
        ("physics:poissonsRatio", material.poissons_ratio),
        ("newton:mpm:youngsModulus", young),
        ("newton:mpm:poissonsRatio", material.poissons_ratio),
        ("newton:mpm:elasticDamping", young * material.damping_time),
        *_newtons_flow(material, units),
    ):
        prim.CreateAttribute(name, Types.Float, False).Set(value)


def _newtons_flow(material: Material, units: StageUnits) -> list[tuple[str, float]]:
    """Newton's terms for a material with flow; see `core.materials.newton`.

    Its fallback of tensileYieldRatio, 0, is a material that falls apart under tension, like sand,
    and that of internalFriction would make the strength of a metal grow with pressure.
    """
    known, values = newton.FLOW, {newton.TENSION: 1.0}
    if material.law == newton.GRANULAR:
        known, values = newton.GRAINS, {newton.TENSION: 0.0}
    elif material.law in (*VOLUME_KEEPING, newton.CRUSHABLE):
        values["internalFriction"] = 0.0
    else:
        known = {}
    for one in law_parameters([material.law]):
        if one.name in known:
            name, factor = known[one.name]
            values[name] = material.parameter(one) / units.factor(one.unit) / factor
    if material.law == newton.CRUSHABLE:
        y, hardening, alpha, tension = map(material.parameter, LAWS[material.law].parameters)
        shear, pressure = newton.bounds(y, alpha)
        values |= {
            "yieldStress": shear / units.pressure, "yieldPressure": pressure / units.pressure,
            "hardening": hardening / y, newton.TENSION: tension,
        }  # fmt: skip
    return [(f"newton:mpm:{name}", value) for name, value in values.items()]
