"""What may be unknown of a material: bounds, prior, and the scale on which it is searched.

A value v between its bounds a and b has the coordinate

    z = (v - a) / (b - a)                  where the value itself is searched,
    z = log(v / a) / log(b / a)            where its logarithm is,

so that all coordinates lie in 0..1.  Steps, priors and singular values are compared in them.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.errors import UsageError
from gf_usd.core.materials.dimensionless import time_scale
from gf_usd.core.materials.laws import law_parameters
from gf_usd.core.materials.material import Material

DECADES = 1.5  # of a modulus or a yield stress, to either side of the material that is started from
POISSON = (0.05, 0.48)  # presets have 0.17 to 0.47; above it a displacement method locks
FRICTION = (0.0, 1.5)
DENSITY = 4.0  # times and divided by
DAMPING = (1e-4, 0.1)  # [T] with T = sqrt(r / g0); presets have 5e-4 to 2e-2 T
HARDENING = 100.0  # of a material without any: up to so many times its yield stress
SHORT = {"E": "youngs_modulus", "nu": "poissons_ratio", "tau": "damping_time", "rho": "density"}
ELASTIC = ("youngs_modulus", "poissons_ratio", "damping_time")  # unless others are asked for
UNITS = {"youngs_modulus": "Pa", "damping_time": "s", "density": "kg/m^3"}


@dataclass(frozen=True, kw_only=True)
class Unknown:
    """A value of a material that is to be found."""

    name: str  # a field of Material, or one of its parameters
    unit: str
    low: float  # [unit] bounds
    high: float
    start: float  # [unit] where the search begins, and the mean of the prior
    log: bool  # its logarithm is searched

    def coordinate(self, value: float) -> float:
        """z of a value [unit]."""
        if self.log:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)

    def value(self, z: float) -> float:
        """[unit] of a coordinate."""
        if self.log:
            return self.low * (self.high / self.low) ** z
        return self.low + (self.high - self.low) * z

    @property
    def change(self) -> str:
        """The change that sensitivities are given for, in words."""
        return "10 %" if self.log else f"{LITTLE:g}"

    @property
    def change_of_z(self) -> float:
        """The same as a difference of coordinates."""
        if self.log:
            return math.log(1.1) / math.log(self.high / self.low)
        return LITTLE / (self.high - self.low)


LITTLE = 0.01  # of a ratio, for sensitivities


def unknowns(
    material: Material,
    radius: float,
    names: Sequence[str] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
) -> tuple[Unknown, ...]:
    """The unknowns of a material on a body of radius r [m].

    names : fields of Material, parameters of its law, or short ones (E, nu, tau, rho); none: the
        elastic ones, and the yield stress where the law flows.
    bounds : [SI] instead of the usual ones, by name.

    Raises UsageError for a name that the material has not, and for bounds that make no sense.
    """
    own = tuple(p.name for p in law_parameters([material.law]))
    flow = ("yield_stress",) if "yield_stress" in own else ()
    wanted = [SHORT.get(name, name) for name in names] or [*ELASTIC, *flow]
    given = {SHORT.get(name, name): pair for name, pair in (bounds or {}).items()}
    known = [*ELASTIC, "density", "friction", "restitution", *_searched(own)]
    for name in (*wanted, *given):
        if name not in known:
            close = difflib.get_close_matches(name, [*known, *SHORT], n=1)
            guess = f"did you mean {close[0]}? " if close else ""
            raise UsageError(
                f"{name} cannot be fitted for {material.name}, whose law is {material.law}",
                f"{guess}choose one of {', '.join(known)}",
            )
    if idle := sorted(given.keys() - set(wanted)):
        raise UsageError(
            f"--bounds are given for {idle[0]}, which is not fitted",
            f"add {idle[0]} to --unknowns, or leave out its bounds",
        )
    return tuple(
        _bounded(_unknown(name, material, radius), given.get(name))
        for name in dict.fromkeys(wanted)
    )


def _searched(parameters: Sequence[str]) -> list[str]:
    return [name for name in ("yield_stress", "hardening") if name in parameters]


def _unknown(name: str, material: Material, radius: float) -> Unknown:
    now = value_of(material, name)
    spread = 10.0**DECADES
    if name == "poissons_ratio":
        return _row(name, *POISSON, now, log=False)
    if name == "friction":
        return _row(name, *FRICTION, now, log=False)
    if name == "restitution":
        return _row(name, 0.0, 1.0, now, log=False)
    if name == "damping_time":
        low, high = (share * time_scale(radius) for share in DAMPING)
        return _row(name, low, high, now or math.sqrt(low * high), log=True)
    if name == "density":
        return _row(name, now / DENSITY, now * DENSITY, now, log=True)
    if name == "hardening" and now <= 0.0:
        stress = value_of(material, "yield_stress")
        return _row(name, stress / HARDENING, stress * HARDENING, stress, log=True)
    return _row(name, now / spread, now * spread, now, log=True)


def _row(name: str, low: float, high: float, start: float, *, log: bool) -> Unknown:
    unit = next((p.unit for p in law_parameters() if p.name == name), UNITS.get(name, ""))
    return Unknown(
        name=name, unit=unit, low=min(low, start), high=max(high, start), start=start, log=log
    )


def _bounded(row: Unknown, bounds: tuple[float, float] | None) -> Unknown:
    if bounds is None:
        return row
    low, high = bounds
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise UsageError(
            f"--bounds {row.name}={low:g}:{high:g}", "give LOW:HIGH, with the lower bound first"
        )
    if row.log and low <= 0.0:
        raise UsageError(
            f"--bounds {row.name}={low:g}:{high:g}: the search uses its logarithm",
            "give a lower bound above 0",
        )
    if row.name == "poissons_ratio" and not (low > -1.0 and high < 0.5):
        raise UsageError(f"--bounds {row.name}={low:g}:{high:g}", "give numbers from -0.99 to 0.49")
    middle = math.sqrt(low * high) if row.log else 0.5 * (low + high)
    start = row.start if low <= row.start <= high else middle
    return replace(row, low=low, high=high, start=start)


def value_of(material: Material, name: str) -> float:
    """[SI] a field of a material, or a parameter of its law."""
    own = {p.name: p for p in law_parameters([material.law])}
    return material.parameter(own[name]) if name in own else float(getattr(material, name))


def with_values(material: Material, values: Mapping[str, float]) -> Material:
    """The material with other values [SI], by name."""
    own = {p.name for p in law_parameters([material.law])}
    parameters = {name: float(v) for name, v in values.items() if name in own}
    fields = {name: float(v) for name, v in values.items() if name not in own}
    return replace(material, parameters={**material.parameters, **parameters}, **fields)


def values_at(rows: Sequence[Unknown], z: Floats) -> dict[str, float]:
    """[unit] of each unknown at coordinates (n,)."""
    return {row.name: row.value(float(one)) for row, one in zip(rows, z, strict=True)}


def starts(rows: Sequence[Unknown]) -> Floats:
    """(n,) coordinates at which the search begins."""
    return np.array([row.coordinate(row.start) for row in rows])
