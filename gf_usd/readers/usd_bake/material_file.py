"""Reading of a material from a USD file: ``--material file.usda``.

Values are read as those of bound physics materials (`usd_physics.materials`), in the file's units.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pxr import Tf, Usd, UsdGeom, UsdShade

from gf_usd.core import USD_SUFFIXES
from gf_usd.core.errors import InputError
from gf_usd.core.materials.laws import LAWS, stated_flow
from gf_usd.core.materials.material import Material
from gf_usd.core.units import StageUnits
from gf_usd.readers.usd_physics.materials import (
    Assume,
    Authored,
    read_material_spec,
    states_modulus,
)
from gf_usd.system import usd_schema  # noqa: F401  (registers the schema before a stage is opened)


def is_material_file(name: str) -> bool:
    """Whether a ``--material`` names a file rather than a preset."""
    return Path(name).suffix.lower() in USD_SUFFIXES


def read_material(path: Path, say: Assume | None = None) -> Material:
    """The material of a file: its default prim, or the only one with a Young's modulus.

    say : called with notes on assumptions.

    Raises InputError where the file cannot be read, has no such material or several, or has values
    out of range.
    """
    stage = _open(path)
    materials = (p for p in stage.Traverse() if p.IsA(UsdShade.Material))
    found = [p for p in materials if states_modulus(_authored(p))]
    default = stage.GetDefaultPrim()
    if default and default in found:
        found = [default]
    if not found:
        raise InputError(
            f"{path} has no material with a Young's modulus",
            "author physics:youngsModulus and physics:poissonsRatio on a Material prim",
        )
    if len(found) > 1:
        raise InputError(
            f"{path} has {len(found)} materials: {', '.join(f'<{p.GetPath()}>' for p in found)}",
            "make one of them the default prim",
        )
    return _material(path, found[0], _units(path, stage), say)


def _open(path: Path) -> Usd.Stage:
    if not path.is_file():
        raise InputError(f"{path} does not exist", "check the spelling of --material")
    try:
        return Usd.Stage.Open(str(path))
    except Tf.ErrorException as error:
        raise InputError(
            f"{path} cannot be read as USD", "check it with usdcat or gf-usd check"
        ) from error


def _units(path: Path, stage: Usd.Stage) -> StageUnits:
    sizes = {"metersPerUnit": UsdGeom.GetStageMetersPerUnit(stage), "kilogramsPerUnit": 1.0}
    if stage.HasAuthoredMetadata("kilogramsPerUnit"):
        sizes["kilogramsPerUnit"] = stage.GetMetadata("kilogramsPerUnit")
    for name, size in sizes.items():
        if not 0.0 < size < float("inf"):
            raise InputError(f"{path}: {name} is {size:g}", f"author a {name} above 0")
    return StageUnits(
        meters_per_unit=float(sizes["metersPerUnit"]),
        kilograms_per_unit=float(sizes["kilogramsPerUnit"]),
    )


def _authored(prim: Usd.Prim) -> Authored:
    """A function that returns the authored value of an attribute of a prim, by name."""

    def authored(name: str) -> Any:
        attribute = prim.GetAttribute(name)
        return attribute.Get() if attribute and attribute.HasAuthoredValue() else None

    return authored


def _material(path: Path, prim: Usd.Prim, units: StageUnits, say: Assume | None) -> Material:
    where = f"{path}: <{prim.GetPath()}>"

    def note(text: str) -> None:
        if say:
            say(f"{where}: {text}")

    spec = read_material_spec(_authored(prim), str(prim.GetPath()), units, where=where, say=note)
    if spec.poissons_ratio is None:
        raise InputError(f"{where} has no Poisson's ratio", "author physics:poissonsRatio")
    if spec.density is None:
        raise InputError(f"{where} has no density", "author physics:density")
    material = spec.whole()
    assert material is not None  # it has both moduli
    if spec.law is None and LAWS[material.law].flows:
        note(f"{stated_flow(material.law)} is stated but no law: {material.law} is used")
    return material
