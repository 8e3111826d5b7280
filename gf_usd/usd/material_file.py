"""Materials out of a USD file: ``--material file.usda``.

Moduli, density and friction are read by the names that the field uses, in this order: UsdPhysics
and the AOUSD proposal (``physics:``), Newton (``newton:mpm:``), Omniverse (``omniphysics:``).
All are in the file's own units: E[Pa] = E * kilogramsPerUnit / metersPerUnit.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pxr import Tf, Usd, UsdGeom, UsdShade

from gf_usd.errors import InputError
from gf_usd.materials import LAW_TOKENS
from gf_usd.model import Material
from gf_usd.units import StageUnits
from gf_usd.usd import schema  # noqa: F401  (registers the schema before a stage is opened)

PREFIXES = ("physics:", "newton:mpm:", "omniphysics:")
OURS = ("gaussianFlesh:",)
DEFAULT_LAW = "neoHookean"
SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")


def is_material_file(name: str) -> bool:
    """Whether a ``--material`` names a file rather than a preset."""
    return Path(name).suffix.lower() in SUFFIXES


def read_material(path: Path) -> Material:
    """The one material with a Young's modulus in a file, or the one its default prim is.

    Raises InputError where the file cannot be read, has none, has several, or has values out of
    range.
    """
    stage = _open(path)
    found = [p for p in stage.Traverse() if p.IsA(UsdShade.Material) and _modulus(p) is not None]
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
    return _material(path, found[0], _units(path, stage))


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


def _value(prim: Usd.Prim, name: str, prefixes: tuple[str, ...] = PREFIXES) -> Any:
    for prefix in prefixes:
        attribute = prim.GetAttribute(prefix + name)
        if attribute and attribute.HasAuthoredValue():
            return attribute.Get()
    return None


def _number(
    prim: Usd.Prim, name: str, otherwise: float, prefixes: tuple[str, ...] = PREFIXES
) -> float:
    value = _value(prim, name, prefixes)
    return otherwise if value is None else float(value)


def _modulus(prim: Usd.Prim) -> float | None:
    return _value(prim, "youngsModulus")


def _material(path: Path, prim: Usd.Prim, units: StageUnits) -> Material:
    young = float(_modulus(prim) or 0.0) * units.pressure
    nu = _value(prim, "poissonsRatio")
    density = _value(prim, "density")
    where = f"{path}: <{prim.GetPath()}>"
    if nu is None:
        raise InputError(f"{where} has no Poisson's ratio", "author physics:poissonsRatio")
    if density is None:
        raise InputError(f"{where} has no density", "author physics:density")
    density = float(density) * units.density
    for name, value, low, high in (
        ("Young's modulus [Pa]", young, 0.0, 1e13),
        ("Poisson's ratio", float(nu), -1.0, 0.5),
        ("density [kg/m^3]", density, 0.0, 1e6),
    ):
        if not low < value < high:
            raise InputError(
                f"{where}: {name} is {value:g}", f"give a value between {low:g} and {high:g}"
            )
    friction = _number(prim, "dynamicFriction", 0.8)
    restitution = _number(prim, "restitution", 0.85)
    damping = _number(prim, "dampingTime", 0.0, OURS)
    for name, value, high in (
        ("friction", friction, 100.0),
        ("restitution", restitution, 1.0),
        ("damping time [s]", damping, 1e6),
    ):
        if not 0.0 <= value <= high:
            raise InputError(f"{where}: {name} is {value:g}", f"give a value from 0 to {high:g}")
    law = _value(prim, "law", OURS) or DEFAULT_LAW
    if law not in LAW_TOKENS:
        raise InputError(
            f"{where}: gaussianFlesh:law is {law!r}", f"choose one of {', '.join(LAW_TOKENS)}"
        )
    return Material(
        name=prim.GetName(),
        law=law,
        density=density,
        youngs_modulus=young,
        poissons_ratio=float(nu),
        damping_time=damping,
        friction=friction,
        restitution=restitution,
    )
