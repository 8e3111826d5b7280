"""Material values with time samples: where Young's modulus changes, and what changes besides."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pxr import Usd, UsdGeom, UsdShade

from gf_usd.core.asset import Asset, StageFacts
from gf_usd.core.materials.laws import law_parameters
from gf_usd.core.stage import StageSpec
from gf_usd.readers.usd.select import named_prim
from gf_usd.readers.usd.stage import open_stage, reading
from gf_usd.readers.usd_bake.settings import KNOWN, read_painted
from gf_usd.readers.usd_bake.spec import read_motion
from gf_usd.readers.usd_physics.bodies import PURPOSE
from gf_usd.readers.usd_physics.materials import OURS, PREFIXES

KEYED = "youngsModulus"


@dataclass(frozen=True, kw_only=True)
class MaterialKeys:
    """When the materials of a stage change."""

    codes: tuple[float, ...] = ()  # time codes of the samples of Young's modulus, ascending
    by: tuple[str, ...] = ()  # the attributes that have them, e.g. "/M.physics:youngsModulus"
    others: tuple[str, ...] = ()  # attributes of materials that change and are not followed


def material_keys(file: Path, facts: StageFacts, paths: Sequence[str]) -> MaterialKeys:
    """The time samples of the physics materials bound to prims, and of what is painted on them.

    file : the USD file; facts.path is what messages call it; paths : of the surfaces.
    """
    codes: set[float] = set()
    by: dict[str, None] = {}
    others: dict[str, None] = {}
    with reading(file):
        stage = open_stage(file)
        for path in paths:
            for attribute in _attributes(named_prim(stage, facts.path, path)):
                samples = attribute.GetTimeSamples()
                if len(samples) < 2:
                    continue
                name = str(attribute.GetPath())
                if attribute.GetBaseName() == KEYED:
                    codes.update(samples)
                    by[name] = None
                else:
                    others[name] = None
    return MaterialKeys(codes=tuple(sorted(codes)), by=tuple(by), others=tuple(others))


def _attributes(prim: Usd.Prim) -> Iterator[Usd.Attribute]:
    """Those of its materials for physics and of their subsets, and what is painted on it."""
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
    """What a stage says, with the materials that its bodies have at a time code.

    Raises InputError as `read_stage_spec`.
    """
    there = read_motion(asset, file, rest=code, times=(), elastic=True)
    return replace(
        spec,
        physics=replace(spec.physics, bodies=there.bodies),
        painted=read_painted(file, asset.facts, asset.surfaces, rest=code),
    )
