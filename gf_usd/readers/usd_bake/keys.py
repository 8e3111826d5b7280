"""Material values with time samples: those that a bake applies over time, and those it ignores."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from pxr import Usd, UsdGeom, UsdShade

from gf_usd.core.asset import Asset, StageFacts
from gf_usd.core.materials.laws import law_parameters
from gf_usd.core.stage import StageSpec
from gf_usd.readers.usd.select import named_prim
from gf_usd.readers.usd.stage import open_stage, reading
from gf_usd.readers.usd_bake.settings import KNOWN, read_painted
from gf_usd.readers.usd_bake.spec import read_motion
from gf_usd.readers.usd_physics.attributes import require_constant
from gf_usd.readers.usd_physics.bodies import PURPOSE
from gf_usd.readers.usd_physics.materials import OURS, PREFIXES

# attribute -> value that its time samples animate: see `core.materials.keys`
FOLLOWED = {
    "youngsModulus": "youngs_modulus",
    "poissonsRatio": "poissons_ratio",
    "dampingTime": "damping_time",
    "elasticDamping": "damping_time",
    "dynamicFriction": "friction",
}
STATIC, CONSERVED = "staticFriction", "density"


@dataclass(frozen=True, kw_only=True)
class MaterialKeys:
    """The time samples of the materials of a stage."""

    codes: tuple[float, ...] = ()  # time codes of the samples that are applied, ascending
    # their attributes, e.g. "/M.physics:youngsModulus", by the values of FOLLOWED
    by: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    others: tuple[str, ...] = ()  # attributes of materials whose time samples are ignored


def material_keys(file: Path, facts: StageFacts, paths: Sequence[str]) -> MaterialKeys:
    """The time samples of the physics materials bound to prims, and of painted primvars.

    file : the USD file; facts.path is its name in messages; paths : of the surfaces.

    Raises InputError for a density that varies over time.
    """
    codes: set[float] = set()
    by: dict[str, dict[str, None]] = {}
    others: dict[str, None] = {}
    with reading(file):
        stage = open_stage(file)
        for path in paths:
            for attribute in _attributes(named_prim(stage, facts.path, path)):
                samples = attribute.GetTimeSamples()
                if len(samples) < 2:
                    continue
                name = str(attribute.GetPath())
                followed = _followed(attribute)
                if followed:
                    codes.update(samples)
                    by.setdefault(followed, {})[name] = None
                elif attribute.GetBaseName() == CONSERVED:
                    require_constant(facts.path, attribute)
                else:
                    others[name] = None
    return MaterialKeys(
        codes=tuple(sorted(codes)),
        by={what: tuple(names) for what, names in by.items()},
        others=tuple(others),
    )


def _followed(attribute: Usd.Attribute) -> str | None:
    """The value that an attribute animates; None where it is not in FOLLOWED."""
    name = attribute.GetName()
    if name.endswith(STATIC):  # what counts where there is no other
        dynamic = attribute.GetPrim().GetAttribute(name.replace(STATIC, "dynamicFriction"))
        return None if dynamic and dynamic.HasAuthoredValue() else "friction"
    return FOLLOWED.get(attribute.GetBaseName())


def _attributes(prim: Usd.Prim) -> Iterator[Usd.Attribute]:
    """The attributes of the prim's physics materials, of its subsets', and its painted primvars."""
    painted = {*KNOWN, *(OURS + p.attribute for p in law_parameters())}
    bindings = UsdShade.MaterialBindingAPI(prim)
    subsets = bindings.GetMaterialBindSubsets() if prim.IsA(UsdGeom.Imageable) else []
    for bound in (prim, *(subset.GetPrim() for subset in subsets)):
        material, _ = UsdShade.MaterialBindingAPI(bound).ComputeBoundMaterial(PURPOSE)
        for attribute in material.GetPrim().GetAuthoredAttributes() if material else ():
            if attribute.GetName().startswith((*PREFIXES, OURS)):
                yield attribute
    for primvar in UsdGeom.PrimvarsAPI(prim).FindPrimvarsWithInheritance():
        if primvar.GetPrimvarName() in painted:
            yield primvar.GetAttr()


def spec_at(asset: Asset, file: Path, spec: StageSpec, code: float) -> StageSpec:
    """The spec of a stage, with the materials of its bodies at a time code.

    Raises InputError as `read_stage_spec`.
    """
    there = read_motion(asset, file, rest=code, times=(), elastic=True)
    return replace(
        spec,
        physics=replace(spec.physics, bodies=there.bodies),
        painted=read_painted(file, asset.facts, asset.surfaces, rest=code),
    )
