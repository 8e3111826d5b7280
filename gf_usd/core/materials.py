"""Material presets: looks, made absolute for a body's size.

A look is dimensionless (docs/physics.md): moduli in rho g0 r, times in T = sqrt(r / g0), with
r = (3 V / 4 pi)^(1/3) and g0 = 9.81 m/s^2 whatever the scene's gravity, so that a 5 cm and a 5 m
duck squash alike.

Jelly is Neo-Hookean where the paper has it corotated: that law resists collapse to J = 0 with no
more than lam = 3.3 rho g0 r, and a fall of three radii hits with rho v^2 = 6 rho g0 r, so a
corotated jelly turns inside out and falls through its own skin (measured: J = -4, particles 7
spacings under the floor; Neo-Hookean: J >= 0.05, a third of a spacing, height ratio .33-.35 at
1000-6000 particles).
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass, replace

import numpy as np

from gf_usd.core.errors import UsageError

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


@dataclass(frozen=True, kw_only=True)
class Physical:
    """An absolute preset: the numbers of a real material."""

    name: str
    density: float  # [kg/m^3]
    youngs_modulus: float  # [Pa]
    poissons_ratio: float
    source: str
    damping_time: float = 1e-4  # Kelvin-Voigt tau [s]
    friction: float = 0.8
    restitution: float = 0.85
    law: str = "neoHookean"

    def material(self, radius: float, law: str | None = None) -> Material:
        """The material, the same on a body of any radius [m]."""
        del radius
        return Material(
            name=self.name,
            law=law or self.law,
            density=self.density,
            youngs_modulus=self.youngs_modulus,
            poissons_ratio=self.poissons_ratio,
            damping_time=self.damping_time,
            friction=self.friction,
            restitution=self.restitution,
        )


ASHBY = "Ashby, Materials Selection in Mechanical Design, appendix A: geometric mean of the range"

# Incompressible elastomers are given nu = 0.47: what a displacement method carries without locking.
PHYSICAL: dict[str, Physical] = {
    p.name: p
    for p in (
        Physical(
            name="gelatin", density=1020.0, youngs_modulus=1e3, poissons_ratio=0.47,
            damping_time=2e-3, restitution=0.5,
            source="a soft dessert gel, to an order of magnitude",
        ),
        Physical(
            name="soft-silicone", density=1070.0, youngs_modulus=69e3, poissons_ratio=0.47,
            source="Smooth-On technical bulletin, Ecoflex 00-30: 100 % modulus 10 psi, 1.07 g/cc",
        ),
        Physical(
            name="silicone", density=1030.0, youngs_modulus=2.0e6, poissons_ratio=0.47,
            source="PDMS 10:1, E = 20 MPa / ratio: J. Appl. Polym. Sci. 2014, 131, 41050",
        ),
        Physical(
            name="neoprene", density=1240.0, youngs_modulus=1.2e6, poissons_ratio=0.47,
            source=f"{ASHBY} 0.7-2 MPa",
        ),
        Physical(
            name="natural-rubber", density=925.0, youngs_modulus=1.9e6, poissons_ratio=0.47,
            source=f"{ASHBY} 1.5-2.5 MPa",
        ),
        Physical(
            name="hard-rubber", density=1150.0, youngs_modulus=1e7, poissons_ratio=0.47,
            source="a filled, hard elastomer such as a tyre's tread, to an order of magnitude",
        ),
        Physical(
            name="foam", density=52.0, youngs_modulus=1.7e6, poissons_ratio=0.27,
            damping_time=2e-3, restitution=0.5,
            source=f"{ASHBY} 1-3 MPa (flexible polymer foam, low density)",
        ),
    )
}  # fmt: skip

Preset = Look | Physical


@dataclass(frozen=True)
class Fixed:
    """A material that is given whole, for example by a file."""

    given: Material

    @property
    def name(self) -> str:
        return self.given.name

    def material(self, radius: float, law: str | None = None) -> Material:
        """The material as given; radius [m] changes nothing."""
        del radius
        return replace(self.given, law=law or self.given.law)


def presets() -> dict[str, Preset]:
    """Every preset by name, looks first."""
    return {**LOOKS, **PHYSICAL}


def find_preset(name: str) -> Preset:
    """The preset of that name; UsageError with the nearest names where there is none."""
    known = presets()
    if name in known:
        return known[name]
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    guess = f"did you mean {close[0]}? " if close else ""
    raise UsageError(
        f"there is no material {name!r}",
        f"{guess}choose one of {', '.join(known)} (gf-usd materials shows them),"
        " or a USD file with a material",
    )


def check_law(law: str) -> str:
    """The law's token; UsageError where there is none of that name."""
    if law in LAW_TOKENS:
        return law
    raise UsageError(f"there is no law {law!r}", f"choose one of {', '.join(LAW_TOKENS)}")


@dataclass(frozen=True, kw_only=True)
class Material:
    """A constitutive law with its numbers, absolute (SI)."""

    name: str
    law: str  # a row of gf_usd.physics.laws.LAWS
    density: float  # [kg/m^3]
    youngs_modulus: float  # [Pa]
    poissons_ratio: float
    damping_time: float = 0.0  # Kelvin-Voigt tau [s]
    friction: float = 0.8  # Coulomb
    restitution: float = 0.85  # enters the contact damping ratio

    @property
    def mu(self) -> float:
        """Shear modulus E / (2 (1 + nu)) [Pa]."""
        return self.youngs_modulus / (2.0 * (1.0 + self.poissons_ratio))

    @property
    def lam(self) -> float:
        """Lame's first parameter E nu / ((1 + nu) (1 - 2 nu)) [Pa]."""
        nu = self.poissons_ratio
        return self.youngs_modulus * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))

    @property
    def wave_speed(self) -> float:
        """c = sqrt((lam + 2 mu) / rho) [m/s] of pressure waves at rest."""
        return float(np.sqrt((self.lam + 2.0 * self.mu) / self.density))
