"""Material presets: looks, made absolute for a body's size.

A look is dimensionless (physics.md section 3): moduli in rho g0 r, times in T = sqrt(r / g0), with
r = (3 V / 4 pi)^(1/3) and g0 = 9.81 m/s^2 whatever the scene's gravity, so that a 5 cm and a 5 m
duck squash alike.

Jelly is Neo-Hookean where the paper has it corotated: that law resists collapse to J = 0 with no
more than lam = 3.3 rho g0 r, and a fall of three radii hits with rho v^2 = 6 rho g0 r, so a corotated
jelly turns inside out and falls through its own skin (measured: J = -4, particles 7 spacings under
the floor; Neo-Hookean: J >= 0.05, a third of a spacing, height ratio .33-.35 at 1000-6000 particles).
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass

import numpy as np

from gf_usd.errors import UsageError
from gf_usd.model import Material

G0 = 9.81  # [m/s^2] in the scales of a look; never the scene's gravity
LAW_TOKENS = ("corotated", "neoHookean")
FILTER_RATE = 10.0  # [1/T] of the APIC filter: grid noise dies within a frame or so
SHOT_LENGTH = 13.6  # [T] the paper's 260 frames at 60 fps for r = 1 m


@dataclass(frozen=True, kw_only=True)
class Look:
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

    def material(self, radius: float, law: str | None = None) -> Material:
        """The look on a body of radius r [m]."""
        scale = self.density * G0 * radius
        mu, lam = self.mu * scale, self.lam * scale
        return Material(
            name=self.name,
            law=law or self.law,
            density=self.density,
            youngs_modulus=mu * (3.0 * lam + 2.0 * mu) / (lam + mu),
            poissons_ratio=lam / (2.0 * (lam + mu)),
            damping_time=self.damping * time_scale(radius),
            friction=self.friction,
            restitution=self.restitution,
        )


def time_scale(radius: float) -> float:
    """T = sqrt(r / g0) [s]."""
    return float(np.sqrt(radius / G0))


LOOKS: dict[str, Look] = {
    look.name: look
    for look in (
        Look(
            name="rubber", mu=26.1, lam=13.1, density=1100.0, damping=0.002, friction=0.8,
            restitution=0.85, law="corotated", note="squashes by a third and bounces",
        ),
        Look(
            name="metal", mu=196.0, lam=980.0, density=7800.0, damping=0.0005, friction=0.8,
            restitution=0.85, law="corotated", note="hardly bends, rings and bounces",
        ),
        Look(
            name="jelly", mu=0.653, lam=3.27, density=1000.0, damping=0.02, friction=0.8,
            restitution=0.85, law="neoHookean", note="spreads on the floor and wobbles back",
        ),
    )
}  # fmt: skip


def find_look(name: str) -> Look:
    """The look of that name; UsageError with the nearest names where there is none."""
    if name in LOOKS:
        return LOOKS[name]
    close = difflib.get_close_matches(name, LOOKS, n=1, cutoff=0.5)
    guess = f"did you mean {close[0]}? " if close else ""
    raise UsageError(
        f"there is no material {name!r}",
        f"{guess}choose one of {', '.join(LOOKS)} (gf-usd materials shows them)",
    )


def check_law(law: str) -> str:
    """The law's token; UsageError where there is none of that name."""
    if law in LAW_TOKENS:
        return law
    raise UsageError(f"there is no law {law!r}", f"choose one of {', '.join(LAW_TOKENS)}")
