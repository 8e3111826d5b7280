"""A material: a constitutive law with its parameters, in SI."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gf_usd.core.materials.laws import LAWS, YIELD_STRESS, Parameter, law_parameters


def lame(E: Any, nu: Any) -> tuple[Any, Any]:
    """mu = E / (2 (1 + nu)) and lam = E nu / ((1 + nu) (1 - 2 nu)), of numbers or arrays."""
    return E / (2.0 * (1.0 + nu)), E * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))


def young_poisson(mu: Any, lam: Any) -> tuple[Any, Any]:
    """E = mu (3 lam + 2 mu) / (lam + mu) and nu = lam / (2 (lam + mu)), of numbers or arrays."""
    return mu * (3.0 * lam + 2.0 * mu) / (lam + mu), lam / (2.0 * (lam + mu))


@dataclass(frozen=True, kw_only=True)
class Material:
    """A constitutive law with its parameters, in SI.

    Its values are checked where it is first used, as by `bake` or `Scene.add_body`: a UsageError
    then names the field and the number.
    """

    name: str
    law: str  # a row of LAWS
    density: float  # [kg/m^3]
    youngs_modulus: float  # [Pa]
    poissons_ratio: float
    damping_time: float = 0.0  # Kelvin-Voigt tau [s]
    friction: float = 0.8  # Coulomb
    restitution: float = 0.85  # enters the contact damping ratio
    # By name, in SI: the parameters of the law that are not at their default.
    parameters: Mapping[str, float] = field(default_factory=dict, hash=False)

    @property
    def mu(self) -> float:
        """Shear modulus [Pa]."""
        return lame(self.youngs_modulus, self.poissons_ratio)[0]

    @property
    def lam(self) -> float:
        """Lame's first parameter [Pa]."""
        return lame(self.youngs_modulus, self.poissons_ratio)[1]

    def parameter(self, one: Parameter) -> float:
        """The value [one.unit] of a law's parameter."""
        return self.parameters.get(one.name, one.default)

    @property
    def yield_strain(self) -> float | None:
        """Y / E, the elastic strain at which it yields; None if it never yields."""
        stress = self.parameters.get(YIELD_STRESS.name) if LAWS[self.law].flows else None
        return None if stress is None else stress / self.youngs_modulus

    @property
    def values(self) -> dict[str, Any]:
        """All fields, including the parameters of the law, as in reports."""
        fields = {name: value for name, value in vars(self).items() if name != "parameters"}
        return fields | {p.name: self.parameter(p) for p in law_parameters([self.law])}

    @property
    def wave_speed(self) -> float:
        """c = sqrt((lam + 2 mu) / rho) [m/s] of pressure waves at rest."""
        return float(np.sqrt((self.lam + 2.0 * self.mu) / self.density))


def scaled_parameters(
    parameters: Mapping[str, float], law: str, scales: Mapping[str, float] | None = None
) -> dict[str, float]:
    """Those of a preset's parameters that a law has, times the scale of their unit."""
    return {
        p.name: parameters[p.name] * (scales or {}).get(p.unit, 1.0)
        for p in law_parameters([law])
        if p.name in parameters
    }
