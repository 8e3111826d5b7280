"""Values of a physics material in SI units, from the attributes of several schemas.

Moduli, density and friction are read in this order: UsdPhysics and the AOUSD proposal for
deformables (``physics:``), Newton (``newton:mpm:``), Omniverse (``omniphysics:``).  All are in
stage units: E [Pa] = E * kilogramsPerUnit / metersPerUnit.  Only authored values are used, not the
fallbacks of schemas.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from gf_usd.core.errors import InputError
from gf_usd.core.materials import newton
from gf_usd.core.materials.laws import LAWS, law_parameters
from gf_usd.core.stage import PhysicsMaterialSpec
from gf_usd.core.units import StageUnits

PREFIXES = ("physics:", "newton:mpm:", "omniphysics:")
OURS = "gaussianFlesh:"
POISSON = 0.3  # the fallback of our schema, of Newton's and of the AOUSD proposal
USUAL_DENSITIES = (10.0, 2e4)  # [kg/m^3]: one that was meant so, whatever the units of the stage
INCOMPRESSIBLE = 0.47  # replaces 0.5: the greatest ratio without volumetric locking


Authored = Callable[[str], Any]  # attribute name -> its authored value, None where there is none
Assume = Callable[[str], None]  # called with notes on assumptions


def read_material_spec(
    authored: Authored,
    path: str,
    units: StageUnits,
    *,
    where: str,
    assume: Assume | None = None,
    say: Assume | None = None,
) -> PhysicsMaterialSpec:
    """The values of the Material prim at `path`.

    where : file and prim, for messages.
    assume : called with a note where a value is assumed: a Poisson's ratio that is missing, 0 or
        -inf (not stated) or 0.5 (incompressible).  None: InputError is raised for these.
    say : called with notes on how Newton's plasticity parameters are converted; None: as `assume`.

    Raises InputError for a value that is not a number in its range, and for an unknown law.
    """
    lenient = assume is not None
    young = _number(authored, "youngsModulus", where, unstated=lenient)
    nu = None
    if young is not None:
        young = _within(where, "Young's modulus [Pa]", young * units.pressure, 0.0, 1e13)
        nu = _poissons_ratio(authored, where, assume)
    density, attribute = _authored_number(authored, "density", where, unstated=lenient)
    if density is not None:
        density = _density(where, attribute, density, units)
    law = authored(OURS + "law")
    if law is not None and law not in LAWS:
        raise InputError(f"{where}: {OURS}law is {law!r}", f"choose one of {', '.join(LAWS)}")
    return PhysicsMaterialSpec(
        path=path,
        density=density,
        density_attribute=attribute,
        youngs_modulus=young,
        poissons_ratio=nu,
        static_friction=_up_to(authored, "staticFriction", where, "static friction", 100.0),
        dynamic_friction=_up_to(authored, "dynamicFriction", where, "friction", 100.0),
        restitution=_up_to(authored, "restitution", where, "restitution", 1.0),
        law=law,
        damping_time=_damping_time(authored, where, units, young),
        parameters=_parameters(authored, where, units)
        or _newtons(authored, where, units, law, say or assume),
    )


def _density(where: str, name: str, authored: float, units: StageUnits) -> float:
    """[kg/m^3] of a density in stage units; name : of its attribute."""
    try:
        return _within(where, f"{name} [kg/m^3]", authored * units.density, 0.0, 1e6)
    except InputError as error:
        if units.density == 1.0 or not USUAL_DENSITIES[0] <= authored <= USUAL_DENSITIES[1]:
            raise
        raise InputError(
            f"{error.message}: it is authored as {authored:g} mass units per cubic stage unit, of"
            f" {units.kilograms_per_unit:g} kg and ({units.meters_per_unit:g} m)^3",
            f"{error.hint}; 1000 kg/m^3 is {1000.0 / units.density:g} in this stage",
        ) from None


def states_modulus(authored: Authored) -> bool:
    """Whether a Young's modulus is authored."""
    return any(authored(prefix + "youngsModulus") is not None for prefix in PREFIXES)


def _poissons_ratio(authored: Authored, where: str, assume: Assume | None) -> float | None:
    nu = _number(authored, "poissonsRatio", where)
    if assume is None:
        return None if nu is None else _within(where, "Poisson's ratio", nu, -1.0, 0.5)
    if nu is None:
        assume(f"no Poisson's ratio is stated: {POISSON:g} is assumed")
        return POISSON
    if nu == 0.5:
        assume(f"Poisson's ratio is 0.5 (incompressible): {INCOMPRESSIBLE:g} is used")
        return INCOMPRESSIBLE
    return _within(where, "Poisson's ratio", nu, -1.0, 0.5)


def _parameters(authored: Authored, where: str, units: StageUnits) -> dict[str, float]:
    """The authored parameters of constitutive laws, in SI."""
    out = {}
    for one in law_parameters():
        value = _float(authored(OURS + one.attribute), OURS + one.attribute, where)
        if value is not None:
            out[one.name] = _closed(
                where, one.name, value * units.factor(one.unit), one.high, one.low
            )
    return out


# Attributes without a counterpart in the laws, with the value at which they have no effect.
UNREAD = {
    "": {"internalFriction": 0.0, newton.TENSION: 1.0, "yieldPressure": math.inf},
    newton.CRUSHABLE: {"internalFriction": 0.0, "viscosity": 0.0},
    # Newton bounds the tension of granular materials by a share of the yield pressure, which is
    # infinite by its fallback; here the apex of the yield cone is the bound.
    newton.GRANULAR: {newton.TENSION: 0.0, "yieldPressure": math.inf, "viscosity": 0.0},
}
WHY = {
    "": "its yield stress is the same in tension and under any pressure",
    newton.CRUSHABLE: "crushable materials yield without viscosity, on an ellipse in shear and "
    "pressure",
    newton.GRANULAR: "a granular material bears only the tension that its cohesion gives",
}


def _newtons(
    authored: Authored, where: str, units: StageUnits, law: str | None, say: Assume | None
) -> dict[str, float]:
    """Newton's plasticity attributes as law parameters, in SI; empty where there is no plasticity.

    Internal friction makes a material granular, and a yield pressure crushable.
    """

    def stated(name: str) -> float | None:
        value = _float(authored(PREFIXES[1] + name), PREFIXES[1] + name, where)
        return None if value is None or value == -math.inf else value

    def positive(name: str, value: float, high: float = math.inf, low: float = 0.0) -> float:
        return _closed(where, PREFIXES[1] + name, value, high, low)

    kind = newton.GRANULAR if stated("internalFriction") and law in (None, newton.GRANULAR) else ""
    out = {}
    for one in law_parameters([kind] if kind else None):
        name, factor = (newton.GRAINS if kind else newton.FLOW).get(one.name, ("", 0.0))
        value = stated(name) if name else None
        if value:
            SI = value * factor * units.factor(one.unit)
            out[one.name] = positive(name, SI, one.high, one.low)
    if not kind and "yield_stress" not in out:
        return {}
    crushed = {}
    if not kind and law in (None, newton.CRUSHABLE):
        crushed = _crushable(stated, positive, units)
        if crushed or law:
            kind = newton.CRUSHABLE
            out.pop("flow_viscosity", None)
            out |= crushed
    left = [name for name, nothing in UNREAD[kind].items() if stated(name) not in (None, nothing)]
    if kind == newton.CRUSHABLE:
        tension, ratio = LAWS[kind].parameters[3], stated(newton.TENSION)
        if ratio is not None and tension.low <= ratio <= tension.high:
            out[tension.name] = ratio
        elif ratio is not None:
            left.append(newton.TENSION)
        if not crushed and stated("yieldPressure") not in (None, math.inf):
            left.append("yieldPressure")
    if hardening := stated("hardening"):
        if kind == newton.CRUSHABLE:
            # yield stress times exp(h (1 - J)), to first order in the volumetric compression
            out["hardening"] = positive("hardening", hardening * out["yield_stress"])
        else:
            left.append("hardening")
    if say and left:
        what = "internal friction" if kind == newton.GRANULAR else "yield stress"
        say(
            f"the {what} is read from the attributes of Newton, except for "
            + ", ".join(PREFIXES[1] + name for name in left)
            + f": {WHY[kind]}"
        )
    return out


def _crushable(
    stated: Callable[[str], float | None], positive: Callable[..., float], units: StageUnits
) -> dict[str, float]:
    """Parameters of the law `crushable` from the yield pressure; empty where it is out of range."""
    pressure, shape = stated("yieldPressure"), LAWS[newton.CRUSHABLE].parameters[2]
    if not pressure or math.isinf(pressure):
        return {}
    shear = positive("yieldStress", (stated("yieldStress") or 0.0) * units.pressure)
    pressure = positive("yieldPressure", pressure * units.pressure)
    yields, alpha = newton.cap(shear, pressure)
    if not shape.low <= alpha <= shape.high:
        return {}
    return {"yield_stress": yields, shape.name: alpha}


def _damping_time(
    authored: Authored, where: str, units: StageUnits, young: float | None
) -> float | None:
    """[s] damping time of gaussianFlesh, else Newton's viscosity over Young's modulus."""
    tau = _float(authored(OURS + "dampingTime"), OURS + "dampingTime", where)
    viscosity = _float(authored(PREFIXES[1] + "elasticDamping"), "elasticDamping", where)
    if tau is None and viscosity is not None and young is not None:
        tau = viscosity * units.pressure / young
    return None if tau is None else _closed(where, "damping time [s]", tau, 1e6)


def _number(authored: Authored, name: str, where: str, *, unstated: bool = False) -> float | None:
    return _authored_number(authored, name, where, unstated=unstated)[0]


def _authored_number(
    authored: Authored, name: str, where: str, *, unstated: bool = False
) -> tuple[float | None, str]:
    """The value of the first prefix with one, and the attribute that has it; unstated: 0 and -inf
    count as not authored.
    """
    for prefix in PREFIXES:
        value = _float(authored(prefix + name), prefix + name, where)
        if value is not None and not (unstated and value in (0.0, float("-inf"))):
            return value, prefix + name
    return None, ""


def _float(value: Any, name: str, where: str) -> float | None:
    if value is None or isinstance(value, float | int):
        return None if value is None else float(value)
    raise InputError(f"{where}: {name} is {value!r}, which is not a number", "author it as a float")


def _within(where: str, name: str, value: float, low: float, high: float) -> float:
    if not low < value < high:
        raise InputError(
            f"{where}: {name} is {value:g}", f"give a value between {low:g} and {high:g}"
        )
    return value


def _up_to(authored: Authored, name: str, where: str, shown: str, high: float) -> float | None:
    value = _number(authored, name, where)
    return None if value is None else _closed(where, shown, value, high)


def _closed(where: str, name: str, value: float, high: float, low: float = 0.0) -> float:
    if not low <= value <= high:
        raise InputError(f"{where}: {name} is {value:g}", f"give a value from {low:g} to {high:g}")
    return value
