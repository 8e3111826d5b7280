"""What a physics material says, by the names that the field uses, in SI.

Moduli, density and friction are read in this order: UsdPhysics and the AOUSD proposal for
deformables (``physics:``), Newton (``newton:mpm:``), Omniverse (``omniphysics:``).  All are in the
stage's own units: E[Pa] = E * kilogramsPerUnit / metersPerUnit.  Only what is authored counts: a
schema's fallback is nobody's word.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from gf_usd.errors import InputError
from gf_usd.materials import LAW_TOKENS
from gf_usd.model import Material
from gf_usd.units import StageUnits

PREFIXES = ("physics:", "newton:mpm:", "omniphysics:")
OURS = "gaussianFlesh:"
DEFAULT_LAW = "neoHookean"
FRICTION, RESTITUTION = 0.8, 0.85  # where an elastic material says nothing of them
POISSON = 0.3  # the fallback of our schema, of Newton's and of the AOUSD proposal
INCOMPRESSIBLE = 0.47  # what a displacement method carries without locking
WATER = 1000.0  # [kg/m^3] what UsdPhysics assumes where no density is given

Authored = Callable[[str], Any]  # attribute name -> its authored value, None where there is none
Assume = Callable[[str], None]  # told, in words, what had to be assumed


@dataclass(frozen=True, kw_only=True)
class MaterialWords:
    """What one physics material says; None: nothing."""

    path: str = ""  # of the Material prim; empty where none is bound
    density: float | None = None  # [kg/m^3]
    youngs_modulus: float | None = None  # [Pa]
    poissons_ratio: float | None = None  # None also where no Young's modulus is stated
    static_friction: float | None = None  # Coulomb
    dynamic_friction: float | None = None  # Coulomb
    restitution: float | None = None
    law: str | None = None
    damping_time: float | None = None  # Kelvin-Voigt tau [s]

    @property
    def elastic(self) -> bool:
        """Whether it says how stiff it is."""
        return self.youngs_modulus is not None

    @property
    def friction(self) -> float | None:
        """The dynamic friction; where only the static one is stated, that."""
        return self.static_friction if self.dynamic_friction is None else self.dynamic_friction

    def whole(self, density: float = WATER) -> Material | None:
        """The material, None where it is not elastic; density [kg/m^3]: where none is stated."""
        if self.youngs_modulus is None or self.poissons_ratio is None:
            return None
        return Material(
            name=self.path.rpartition("/")[2],
            law=self.law or DEFAULT_LAW,
            density=_or(self.density, density),
            youngs_modulus=self.youngs_modulus,
            poissons_ratio=self.poissons_ratio,
            damping_time=_or(self.damping_time, 0.0),
            friction=_or(self.friction, FRICTION),
            restitution=_or(self.restitution, RESTITUTION),
        )

    def over(self, base: Material) -> Material:
        """`base` with what is stated in its place; the whole material where it is elastic."""
        return self.whole(base.density) or Material(
            name=base.name,
            law=self.law or base.law,
            density=_or(self.density, base.density),
            youngs_modulus=base.youngs_modulus,
            poissons_ratio=base.poissons_ratio,
            damping_time=_or(self.damping_time, base.damping_time),
            friction=_or(self.friction, base.friction),
            restitution=_or(self.restitution, base.restitution),
        )


def read_words(
    authored: Authored,
    path: str,
    units: StageUnits,
    *,
    where: str,
    assume: Assume | None = None,
) -> MaterialWords:
    """What the Material prim at `path` says.

    where : file and prim, for messages.
    assume : without it a Young's modulus needs a Poisson's ratio beside it, and both values that
        the vocabularies give a meaning of their own (0 or -inf: not stated; 0.5: incompressible)
        and missing ones are refused.  With it they are settled, and it is told how.

    Raises InputError for a value that is not a number in its range, or a law that is none.
    """
    lenient = assume is not None
    young = _number(authored, "youngsModulus", where, unstated=lenient)
    nu = None
    if young is not None:
        young = _within(where, "Young's modulus [Pa]", young * units.pressure, 0.0, 1e13)
        nu = _poissons_ratio(authored, where, assume)
    density = _number(authored, "density", where, unstated=lenient)
    if density is not None:
        density = _within(where, "density [kg/m^3]", density * units.density, 0.0, 1e6)
    law = authored(OURS + "law")
    if law is not None and law not in LAW_TOKENS:
        raise InputError(f"{where}: {OURS}law is {law!r}", f"choose one of {', '.join(LAW_TOKENS)}")
    return MaterialWords(
        path=path,
        density=density,
        youngs_modulus=young,
        poissons_ratio=nu,
        static_friction=_up_to(authored, "staticFriction", where, "static friction", 100.0),
        dynamic_friction=_up_to(authored, "dynamicFriction", where, "friction", 100.0),
        restitution=_up_to(authored, "restitution", where, "restitution", 1.0),
        law=law,
        damping_time=_damping_time(authored, where, units, young),
    )


def states_modulus(authored: Authored) -> bool:
    """Whether a Young's modulus is authored, whatever its value."""
    return any(authored(prefix + "youngsModulus") is not None for prefix in PREFIXES)


def _poissons_ratio(authored: Authored, where: str, assume: Assume | None) -> float | None:
    nu = _number(authored, "poissonsRatio", where)
    if assume is None:
        return None if nu is None else _within(where, "Poisson's ratio", nu, -1.0, 0.5)
    if nu is None:
        assume(f"no Poisson's ratio is stated: {POISSON:g} is assumed")
        return POISSON
    if nu == 0.5:
        assume(f"Poisson's ratio is 0.5 (incompressible): {INCOMPRESSIBLE:g} stands for it")
        return INCOMPRESSIBLE
    return _within(where, "Poisson's ratio", nu, -1.0, 0.5)


def _damping_time(
    authored: Authored, where: str, units: StageUnits, young: float | None
) -> float | None:
    """Ours [s], else Newton's viscosity [pressure time] over Young's modulus."""
    tau = _float(authored(OURS + "dampingTime"), OURS + "dampingTime", where)
    viscosity = _float(authored(PREFIXES[1] + "elasticDamping"), "elasticDamping", where)
    if tau is None and viscosity is not None and young is not None:
        tau = viscosity * units.pressure / young
    return None if tau is None else _closed(where, "damping time [s]", tau, 1e6)


def _number(authored: Authored, name: str, where: str, *, unstated: bool = False) -> float | None:
    """The first vocabulary's value; unstated: 0 and -inf leave the word to the next one."""
    for prefix in PREFIXES:
        value = _float(authored(prefix + name), prefix + name, where)
        if value is not None and not (unstated and value in (0.0, float("-inf"))):
            return value
    return None


def _float(value: Any, name: str, where: str) -> float | None:
    if value is None or isinstance(value, float | int):
        return None if value is None else float(value)
    raise InputError(f"{where}: {name} is {value!r}, which is no number", "author it as a float")


def _within(where: str, name: str, value: float, low: float, high: float) -> float:
    if not low < value < high:
        raise InputError(
            f"{where}: {name} is {value:g}", f"give a value between {low:g} and {high:g}"
        )
    return value


def _up_to(authored: Authored, name: str, where: str, shown: str, high: float) -> float | None:
    value = _number(authored, name, where)
    return None if value is None else _closed(where, shown, value, high)


def _closed(where: str, name: str, value: float, high: float) -> float:
    if not 0.0 <= value <= high:
        raise InputError(f"{where}: {name} is {value:g}", f"give a value from 0 to {high:g}")
    return value


def _or(value: float | None, otherwise: float) -> float:
    return otherwise if value is None else value
