"""Unknowns of a fit: values of a material with bounds, a prior and a scale.

A value v between its bounds a and b has the coordinate

    z = (v - a) / (b - a)                  on a linear scale,
    z = log(v / a) / log(b / a)            on a logarithmic scale.

Steps, priors and singular values refer to these coordinates, which lie in 0..1.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.errors import UsageError, did_you_mean
from gf_usd.core.materials.dimensionless import time_scale
from gf_usd.core.materials.laws import law_parameters
from gf_usd.core.materials.material import Material

BOUND_DECADES = 1.5  # of a modulus or a yield stress, on either side of the initial value
POISSON = (0.05, 0.48)  # presets have 0.17 to 0.47; above it the method locks
FRICTION = (0.0, 1.5)
DENSITY_FACTOR = 4.0  # bounds: the initial value divided and multiplied by it
DAMPING = (1e-4, 0.1)  # [T] with T = sqrt(r / g0); presets have 5e-4 to 2e-2 T
MAX_HARDENING_RATIO = 100.0  # bound of initially zero hardening over the yield stress
SHORT_NAMES = {
    "E": "youngs_modulus",
    "nu": "poissons_ratio",
    "tau": "damping_time",
    "rho": "density",
}
ELASTIC = ("youngs_modulus", "poissons_ratio", "damping_time")  # default unknowns
UNITS = {"youngs_modulus": "Pa", "damping_time": "s", "density": "kg/m^3"}


@dataclass(frozen=True, kw_only=True)
class Unknown:
    """An unknown value of a material."""

    name: str  # a field of Material, or one of its parameters
    unit: str
    low: float  # [unit] bounds
    high: float
    start: float  # [unit] initial value, and mean of the prior
    log: bool  # logarithmic scale

    def coordinate(self, value: float) -> float:
        """Coordinate z of a value [unit]."""
        if self.log:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)

    def value(self, z: float) -> float:
        """Value [unit] of a coordinate z."""
        if self.log:
            return self.low * (self.high / self.low) ** z
        return self.low + (self.high - self.low) * z

    @property
    def change(self) -> str:
        """The change that sensitivities refer to, as text."""
        return "10 %" if self.log else f"{RATIO_CHANGE:g}"

    @property
    def change_of_z(self) -> float:
        """The change that sensitivities refer to, as a difference of z."""
        if self.log:
            return math.log(1.1) / math.log(self.high / self.low)
        return RATIO_CHANGE / (self.high - self.low)


RATIO_CHANGE = 0.01  # change of a dimensionless value for sensitivities


def unknowns(
    material: Material,
    radius: float,
    names: Sequence[str] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
) -> tuple[Unknown, ...]:
    """The unknowns of a material on a body of radius r [m].

    names : fields of Material, parameters of its law, or short names (E, nu, tau, rho); empty:
        ELASTIC, and the yield stress of a plastic law.
    bounds : [SI] by name, instead of the default bounds.

    Raises UsageError for a name that the material does not have, and for invalid bounds.
    """
    law_parameter_names = tuple(p.name for p in law_parameters([material.law]))
    plastic = ("yield_stress",) if "yield_stress" in law_parameter_names else ()
    requested = [SHORT_NAMES.get(name, name) for name in names] or [*ELASTIC, *plastic]
    bounds_by_name = {SHORT_NAMES.get(name, name): pair for name, pair in (bounds or {}).items()}
    allowed = [
        *ELASTIC,
        "density",
        "friction",
        "restitution",
        *_searched_parameters(law_parameter_names),
    ]
    for name in (*requested, *bounds_by_name):
        if name not in allowed:
            guess = did_you_mean(name, [*allowed, *SHORT_NAMES])
            raise UsageError(
                f"{name} cannot be fitted for {material.name}, whose law is {material.law}",
                f"{guess}choose one of {', '.join(allowed)}",
            )
    if unused := sorted(bounds_by_name.keys() - set(requested)):
        raise UsageError(
            f"--bounds are given for {unused[0]}, which is not fitted",
            f"add {unused[0]} to --unknowns, or leave out its bounds",
        )
    return tuple(
        _with_bounds(_default_unknown(name, material, radius), bounds_by_name.get(name))
        for name in dict.fromkeys(requested)
    )


def _searched_parameters(parameters: Sequence[str]) -> list[str]:
    return [name for name in ("yield_stress", "hardening") if name in parameters]


def _default_unknown(name: str, material: Material, radius: float) -> Unknown:
    value = value_of(material, name)
    factor = 10.0**BOUND_DECADES
    if name == "poissons_ratio":
        return _make_unknown(name, *POISSON, value, log=False)
    if name == "friction":
        return _make_unknown(name, *FRICTION, value, log=False)
    if name == "restitution":
        return _make_unknown(name, 0.0, 1.0, value, log=False)
    if name == "damping_time":
        low, high = (share * time_scale(radius) for share in DAMPING)
        return _make_unknown(name, low, high, value or math.sqrt(low * high), log=True)
    if name == "density":
        return _make_unknown(name, value / DENSITY_FACTOR, value * DENSITY_FACTOR, value, log=True)
    if name == "hardening" and value <= 0.0:
        stress = value_of(material, "yield_stress")
        return _make_unknown(
            name, stress / MAX_HARDENING_RATIO, stress * MAX_HARDENING_RATIO, stress, log=True
        )
    return _make_unknown(name, value / factor, value * factor, value, log=True)


def _make_unknown(name: str, low: float, high: float, start: float, *, log: bool) -> Unknown:
    unit = next((p.unit for p in law_parameters() if p.name == name), UNITS.get(name, ""))
    return Unknown(
        name=name, unit=unit, low=min(low, start), high=max(high, start), start=start, log=log
    )


def _with_bounds(row: Unknown, bounds: tuple[float, float] | None) -> Unknown:
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
    """The value [SI] of a field of a material, or of a parameter of its law."""
    law_parameter_names = {p.name: p for p in law_parameters([material.law])}
    return (
        material.parameter(law_parameter_names[name])
        if name in law_parameter_names
        else float(getattr(material, name))
    )


def with_values(material: Material, values: Mapping[str, float]) -> Material:
    """The material with new values [SI], by name."""
    law_parameter_names = {p.name for p in law_parameters([material.law])}
    parameters = {name: float(v) for name, v in values.items() if name in law_parameter_names}
    fields = {name: float(v) for name, v in values.items() if name not in law_parameter_names}
    return replace(material, parameters={**material.parameters, **parameters}, **fields)


def values_at(rows: Sequence[Unknown], z: Floats) -> dict[str, float]:
    """Value [unit] of each unknown at coordinates z (n,), by name."""
    return {row.name: row.value(float(one)) for row, one in zip(rows, z, strict=True)}


def starts(rows: Sequence[Unknown]) -> Floats:
    """Coordinates z (n,) of the initial values."""
    return np.array([row.coordinate(row.start) for row in rows])
