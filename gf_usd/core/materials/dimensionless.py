"""Dimensionless presets, and their values for a body of a given size.

Moduli are in rho g0 r and times in T = sqrt(r / g0), with r = (3 V / 4 pi)^(1/3) and
g0 = 9.81 m/s^2 whatever the scene's gravity, so that a 5 cm and a 5 m duck deform alike
(docs/physics.md).  The presets are Neo-Hookean, while those of the paper are corotated: the
corotated law resists collapse to J = 0 only with a finite pressure, so that squashed bodies invert
(eight of eleven assets baked as rubber; none as Neo-Hookean).  `--preset paper` keeps the paper's
law.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from gf_usd.core.errors import UsageError
from gf_usd.core.materials.material import Material, scaled_parameters, young_poisson

G0 = 9.81  # [m/s^2] in the scales of a preset; never the scene's gravity
FILTER_RATE = 10.0  # [1/T] of the APIC filter: grid noise decays within about a frame
SHOT_LENGTH = 13.6  # [T] the paper's 260 frames at 60 fps for r = 1 m


@dataclass(frozen=True, kw_only=True)
class DimensionlessPreset:
    """A dimensionless preset."""

    name: str
    mu: float  # [rho g0 r]
    lam: float  # [rho g0 r]
    density: float  # [kg/m^3]
    damping: float  # Kelvin-Voigt tau [T]
    friction: float
    restitution: float
    law: str
    note: str
    # Parameters of the law, by name: pressures in rho g0 r, viscosities in rho g0 r T.
    parameters: Mapping[str, float] = field(default_factory=dict, hash=False)

    def material(self, radius: float, law: str | None = None) -> Material:
        """The preset on a body of radius r [m].

        Raises UsageError unless the radius is finite and above 0.
        """
        if not 0.0 < radius < np.inf:
            raise UsageError(
                f"preset {self.name}: the radius is {radius:g}",
                "give the radius [m] of a ball of the body's volume, above 0",
            )
        scale = self.density * G0 * radius
        young, poisson = young_poisson(self.mu * scale, self.lam * scale)
        return Material(
            name=self.name,
            law=law or self.law,
            density=self.density,
            youngs_modulus=young,
            poissons_ratio=poisson,
            damping_time=self.damping * time_scale(radius),
            friction=self.friction,
            restitution=self.restitution,
            parameters=scaled_parameters(
                self.parameters,
                law or self.law,
                {"Pa": scale, "Pa s": scale * time_scale(radius)},
            ),
        )


def time_scale(radius: float) -> float:
    """T = sqrt(r / g0) [s]."""
    return float(np.sqrt(radius / G0))


DIMENSIONLESS: dict[str, DimensionlessPreset] = {
    p.name: p
    for p in (
        DimensionlessPreset(
            name="rubber", mu=26.1, lam=13.1, density=1100.0, damping=0.002, friction=0.8,
            restitution=0.85, law="neoHookean", note="squashes by a third and bounces",
        ),
        DimensionlessPreset(
            name="metal", mu=196.0, lam=980.0, density=7800.0, damping=0.0005, friction=0.8,
            restitution=0.85, law="neoHookean", note="hardly bends, rings and bounces",
        ),
        DimensionlessPreset(
            name="jelly", mu=0.653, lam=3.27, density=1000.0, damping=0.02, friction=0.8,
            restitution=0.85, law="neoHookean", note="spreads on the floor and wobbles back",
        ),
        DimensionlessPreset(
            name="dented", mu=196.0, lam=980.0, density=7800.0, damping=0.0005, friction=0.8,
            restitution=0.5, law="vonMises", note="a soft metal: dents permanently, hardly bounces",
            parameters={"yield_stress": 8.0, "hardening": 20.0},
        ),
        DimensionlessPreset(
            name="clay", mu=65.0, lam=325.0, density=1800.0, damping=0.002, friction=0.9,
            restitution=0.1, law="vonMises", note="keeps the shape it is pressed into",
            parameters={"yield_stress": 3.0, "hardening": 3.0, "flow_viscosity": 0.3},
        ),
        DimensionlessPreset(
            name="styrofoam", mu=26.0, lam=13.0, density=60.0, damping=0.005, friction=0.9,
            restitution=0.1, law="crushable",
            note="crushes where it is hit, and does not expand again",
            parameters={"yield_stress": 4.0, "hardening": 15.0, "cap_shape": 2.12},
        ),
        DimensionlessPreset(
            name="water", mu=6.0, lam=596.0, density=1000.0, damping=0.0, friction=0.0,
            restitution=0.0, law="fluid",
            note="splashes; a fall of three radii compresses it by 1 %",
            parameters={"viscosity": 3e-5},
        ),
    )
}  # fmt: skip
