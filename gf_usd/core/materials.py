"""Laws and materials as data: what a law is called, its parameters, and presets.

A law's row says everything about it but its formulas, which stand in the module that it names: the
command line, readers, writers, check rules and the schema read it here, without Taichi.

Material presets: looks, made absolute for a body's size.

A look is dimensionless (docs/physics.md): moduli in rho g0 r, times in T = sqrt(r / g0), with
r = (3 V / 4 pi)^(1/3) and g0 = 9.81 m/s^2 whatever the scene's gravity, so that a 5 cm and a 5 m
duck squash alike.

Looks are Neo-Hookean where the paper has them corotated: the corotated law resists collapse to
J = 0 by a finite pressure, so that its answer to squashing is inversion (eight of eleven assets
baked as rubber; as Neo-Hookean none).  `--preset paper` keeps the paper's law.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from gf_usd.core.errors import UsageError


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A number of a law besides its moduli, constant in time."""

    name: str  # of Material.parameters; the same in every law that has it
    unit: str  # of `StageUnits.factor`, e.g. "Pa"
    attribute: str  # in the namespace gaussianFlesh, on the Material and on particles
    default: float  # [unit] where a material says nothing
    meaning: str  # a sentence, for the schema
    label: str  # for the report
    low: float = 0.0  # [unit] least value
    high: float = float("inf")  # [unit] largest value
    required: bool = False  # a bake is refused where neither material nor paint states it


@dataclass(frozen=True, kw_only=True)
class Internal:
    """A number that a law remembers of each particle."""

    name: str
    rest: float  # before anything has happened
    attribute: str = ""  # in the namespace gaussianFlesh, of particles; "": it is never written
    meaning: str = ""  # a sentence, for the schema
    label: str = ""


@dataclass(frozen=True, kw_only=True)
class LawSpec:
    """A constitutive law as data."""

    token: str  # the value of gaussianFlesh:law
    code: str  # module of its functions, relative to gf_usd.physics.laws: see `registry` there
    source: str
    parameters: tuple[Parameter, ...] = ()  # besides mu and lam
    flows: bool = False  # it has a flow rule, and so a history
    isochoric: bool = False  # its flow keeps the volume, det F_p = 1
    unbounded: bool = False  # it flows without end: for the Updated Lagrangian solver
    over: str = ""  # the law whose energy it has; "": one of its own
    internal: tuple[Internal, ...] = ()


YIELD_STRESS = Parameter(
    name="yield_stress", unit="Pa", attribute="yieldStress", default=1e9,
    meaning="Stress at which the material begins to flow: equivalent, before any hardening.",
    label="Yield stress", required=True,
)  # fmt: skip
HARDENING = Parameter(
    name="hardening", unit="Pa", attribute="hardening", default=0.0,
    meaning="Growth of the yield stress with the equivalent plastic strain, or, of crushable"
    " materials, with the logarithm of the volume that they have lost for good.",
    label="Hardening",
)  # fmt: skip

# Of every law that flows, besides its own: what the solvers work out of F_e.
ELASTIC_STRAIN = Internal(
    name="elastic_strain", rest=0.0, attribute="elasticStrain",
    meaning="Largest |stretch - 1| of the elastic part F_e of each particle's deformation.",
    label="Elastic Strain",
)  # fmt: skip


def _von_mises(token: str, code: str, over: str = "", *, unbounded: bool = False) -> LawSpec:
    """Von Mises plasticity over the elastic energy of a module."""
    return LawSpec(
        token=token,
        code=code,
        source="Simo and Hughes 1998, boxes 3.1 and 9.1; Voce 1955; Perzyna 1966",
        over=over,
        unbounded=unbounded,
        parameters=(
            YIELD_STRESS,
            HARDENING,
            Parameter(
                name="saturation", unit="Pa", attribute="saturation", default=0.0,
                meaning="Hardening that saturates: what the yield stress gains by it at most.",
                label="Saturating hardening",
            ),
            Parameter(
                name="saturation_rate", unit="", attribute="saturationRate", default=0.0,
                meaning="Plastic strains e-fold the rest of the saturating hardening this many"
                " times per unit.",
                label="Saturation rate",
            ),
            Parameter(
                name="flow_viscosity", unit="Pa s", attribute="flowViscosity", default=0.0,
                meaning="Stress above the yield stress per rate of plastic strain; 0: flow at"
                " once.",
                label="Viscosity of flow",
            ),
        ),
        flows=True,
        isochoric=True,
        internal=(
            Internal(
                name="plastic_strain", rest=0.0, attribute="plasticStrain",
                meaning="Equivalent plastic strain of each particle, summed over its past.",
                label="Plastic Strain",
            ),
        ),
    )  # fmt: skip


LAWS: dict[str, LawSpec] = {
    row.token: row
    for row in (
        LawSpec(
            token="corotated",
            code=".corotated",
            source="GaussianFlesh eq. 5; Stomakhin et al. 2012 (fixed corotated)",
        ),
        LawSpec(token="neoHookean", code=".neo_hookean", source="Bonet and Wood 2008, eq. 6.28"),
        _von_mises("vonMises", ".von_mises"),
        LawSpec(
            token="crushable",
            code=".crushable",
            source="Deshpande and Fleck 2000 (isotropic crushable foam)",
            parameters=(
                YIELD_STRESS,
                HARDENING,
                Parameter(
                    name="cap_shape", unit="", attribute="capShape", default=2.12,
                    meaning="Shape alpha of the yield surface, an ellipse of pressure and shear:"
                    " 3 / sqrt(2) keeps the width of what is pressed along one axis.",
                    label="Shape of the cap", low=0.1, high=2.9,
                ),
            ),
            flows=True,
            internal=(
                Internal(
                    name="lost_volume", rest=0.0, attribute="lostVolume",
                    meaning="Logarithm of the volume that each particle has lost for good: rest"
                    " volume over what is left of it.",
                    label="Lost Volume",
                ),
            ),
        ),
        LawSpec(
            token="druckerPrager",
            code=".drucker_prager",
            source="Drucker and Prager 1952; Klar et al. 2016; Tampubolon et al. 2017",
            parameters=(
                Parameter(
                    name="internal_friction", unit="", attribute="internalFriction", default=0.6,
                    meaning="Shear stress that a granular material bears over its pressure: the"
                    " tangent of the steepest slope at which it stays.",
                    label="Internal friction", low=0.01, high=5.0, required=True,
                ),
                Parameter(
                    name="cohesion", unit="Pa", attribute="cohesion", default=0.0,
                    meaning="Shear stress that a granular material bears without pressure.",
                    label="Cohesion",
                ),
            ),
            flows=True,
            unbounded=True,
            internal=(
                Internal(
                    name="loosening", rest=0.0, attribute="loosening",
                    meaning="Logarithm of the volume that each particle gained as it came apart,"
                    " which closes before it bears pressure again.",
                    label="Loosening",
                ),
            ),
        ),
        _von_mises("paste", ".von_mises", unbounded=True),
        _von_mises("vonMisesNeoHookean", ".von_mises_neo_hookean", over="neoHookean"),
        _von_mises("vonMisesCorotated", ".von_mises_corotated", over="corotated"),
    )
}  # fmt: skip


def law_parameters(tokens: Iterable[str] | None = None) -> tuple[Parameter, ...]:
    """The parameters of laws, one of each name; None: of all laws."""
    wanted = set(LAWS if tokens is None else tokens)
    rows = [row for token, row in LAWS.items() if token in wanted]
    return tuple({p.name: p for row in rows for p in row.parameters}.values())


def law_internals(tokens: Iterable[str] | None = None) -> tuple[Internal, ...]:
    """What is written of the state of laws that flow, one of each name; None: of all laws."""
    wanted = set(LAWS if tokens is None else tokens)
    rows = [row for token, row in LAWS.items() if token in wanted and row.flows]
    own = [v for row in rows for v in row.internal if v.attribute]
    return tuple({v.name: v for v in (own + [ELASTIC_STRAIN] if rows else own)}.values())


def flowing_law(stated: Iterable[str], otherwise: str) -> str:
    """The law of a material that states these parameters by name, and no law.

    One that states what only laws that flow ask for (a yield stress) flows: by `otherwise` where
    that asks for it, else by the first law that has all that is stated.
    """
    wanted = set(stated)
    asked = {p.name for p in law_parameters() if p.required} & wanted
    if not asked or asked <= {p.name for p in LAWS[otherwise].parameters}:
        return otherwise
    having = [t for t, row in LAWS.items() if asked <= {p.name for p in row.parameters}]
    whole = [t for t in having if wanted <= {p.name for p in LAWS[t].parameters}]
    return (whole or having)[0]


def check_law(law: str) -> str:
    """The law's token; UsageError where there is none of that name."""
    if law in LAWS:
        return law
    raise UsageError(f"there is no law {law!r}", f"choose one of {', '.join(LAWS)}")


def lame(E: Any, nu: Any) -> tuple[Any, Any]:
    """mu = E / (2 (1 + nu)) and lam = E nu / ((1 + nu) (1 - 2 nu)), of numbers or arrays."""
    return E / (2.0 * (1.0 + nu)), E * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))


def young_poisson(mu: Any, lam: Any) -> tuple[Any, Any]:
    """E = mu (3 lam + 2 mu) / (lam + mu) and nu = lam / (2 (lam + mu)), of numbers or arrays."""
    return mu * (3.0 * lam + 2.0 * mu) / (lam + mu), lam / (2.0 * (lam + mu))


G0 = 9.81  # [m/s^2] in the scales of a look; never the scene's gravity
FILTER_RATE = 10.0  # [1/T] of the APIC filter: grid noise dies within a frame or so
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
    # The law's own, by name: what is a pressure in rho g0 r, what is a viscosity in rho g0 r T.
    parameters: Mapping[str, float] = field(default_factory=dict, hash=False)

    def material(self, radius: float, law: str | None = None) -> Material:
        """The look on a body of radius r [m]."""
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
            parameters=_own(
                self.parameters,
                law or self.law,
                {"Pa": scale, "Pa s": scale * time_scale(radius)},
            ),
        )


def _own(
    parameters: Mapping[str, float], law: str, scales: Mapping[str, float] | None = None
) -> dict[str, float]:
    """Those of a preset's parameters that a law has, times the scale of their unit."""
    return {
        p.name: parameters[p.name] * (scales or {}).get(p.unit, 1.0)
        for p in law_parameters([law])
        if p.name in parameters
    }


def time_scale(radius: float) -> float:
    """T = sqrt(r / g0) [s]."""
    return float(np.sqrt(radius / G0))


DIMENSIONLESS: dict[str, DimensionlessPreset] = {
    look.name: look
    for look in (
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
            restitution=0.5, law="vonMises", note="a soft metal: keeps every dent, hardly bounces",
            parameters={"yield_stress": 8.0, "hardening": 20.0},
        ),
        DimensionlessPreset(
            name="clay", mu=65.0, lam=325.0, density=1800.0, damping=0.002, friction=0.9,
            restitution=0.1, law="vonMises", note="stays as it was pressed",
            parameters={"yield_stress": 3.0, "hardening": 3.0, "flow_viscosity": 0.3},
        ),
        DimensionlessPreset(
            name="styrofoam", mu=26.0, lam=13.0, density=60.0, damping=0.005, friction=0.9,
            restitution=0.1, law="crushable", note="is crushed where it is hit, and stays smaller",
            parameters={"yield_stress": 4.0, "hardening": 15.0, "cap_shape": 2.12},
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
    parameters: Mapping[str, float] = field(default_factory=dict, hash=False)  # in SI, by name

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
            parameters=_own(self.parameters, law or self.law),
        )


ASHBY = "Ashby, Materials Selection in Mechanical Design, appendix A: geometric mean of the range"


# Incompressible elastomers are given nu = 0.47: what a displacement method carries without locking.
def _bingham(name: str, density: float, E: float, Y: float, eta: float, source: str) -> Physical:
    """A paste or thick liquid; Y [Pa] and eta [Pa s] of tension."""
    return Physical(
        name=name, density=density, youngs_modulus=E, poissons_ratio=0.45, friction=0.9,
        restitution=0.0, damping_time=0.0, law="paste", source=source,
        parameters={"yield_stress": Y, "flow_viscosity": eta},
    )  # fmt: skip


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
            damping_time=3e-5, restitution=0.5,
            source=f"{ASHBY} 1-3 MPa (flexible polymer foam, low density)",
        ),
        Physical(
            name="polyurethane-foam", density=60.0, youngs_modulus=1.5e7, poissons_ratio=0.3,
            restitution=0.2, damping_time=5e-6, law="crushable",
            parameters={"yield_stress": 4e5, "hardening": 4e5, "cap_shape": 1.5},
            source="a rigid foam of closed cells, R = 60 / 1200 as dense as its solid: Gibson and"
            " Ashby, Cellular Solids, E = E_s (f^2 R^2 + (1 - f) R) and plateau 0.3 sigma_s R^1.5"
            " with E_s = 1.6 GPa, sigma_s = 127 MPa and f = 0.85 of the solid in the edges",
        ),
        Physical(
            name="aluminium", density=2700.0, youngs_modulus=68.9e9, poissons_ratio=0.33,
            friction=0.5, restitution=0.6, damping_time=0.0, law="vonMises",
            parameters={"yield_stress": 2.76e8, "hardening": 6e8},
            source="6061-T6, MIL-HDBK-5: yield 276 MPa, ultimate 310 MPa at some 6 % of strain",
        ),
        Physical(
            name="mild-steel", density=7850.0, youngs_modulus=2.0e11, poissons_ratio=0.29,
            friction=0.5, restitution=0.6, damping_time=0.0, law="vonMises",
            parameters={"yield_stress": 2.5e8, "hardening": 1.0e9},
            source="ASTM A36: yield 250 MPa; hardening to 400 MPa at 15 % of strain",
        ),
        Physical(
            name="copper", density=8930.0, youngs_modulus=1.17e11, poissons_ratio=0.35,
            friction=0.5, restitution=0.5, damping_time=0.0, law="vonMises",
            parameters={"yield_stress": 4e8, "hardening": 1e8},
            source="the copper bar of Taylor tests: Wilkins and Guinan 1973; Kamoulakos 1990",
        ),
        Physical(
            name="lead", density=11340.0, youngs_modulus=1.6e10, poissons_ratio=0.44,
            friction=0.6, restitution=0.2, damping_time=0.0, law="vonMises",
            parameters={"yield_stress": 1.2e7, "hardening": 1.2e7},
            source="pure lead: ASM Metals Handbook, tensile strength 12 to 17 MPa, E = 16 GPa",
        ),
        Physical(
            name="modelling-clay", density=1850.0, youngs_modulus=3.0e6, poissons_ratio=0.45,
            friction=0.9, restitution=0.1, law="vonMises",
            parameters={
                "yield_stress": 2e4, "hardening": 5e4, "saturation": 1.1e5, "saturation_rate": 5.0,
                "flow_viscosity": 500.0,
            },
            source="Plasticine at 20 C as a model of hot metal: flow stress 0.1 to 0.2 MPa at"
            " strains above 0.2, to an order of magnitude; it begins to flow without a sharp yield"
            " point, and the yield stress is fitted such that it hardly bounces",
        ),
        Physical(
            name="wet-clay", density=1900.0, youngs_modulus=5.0e6, poissons_ratio=0.45,
            friction=0.9, restitution=0.05, law="vonMises",
            parameters={"yield_stress": 4.3e4, "flow_viscosity": 1e3},
            source="soft saturated clay, undrained: shear strength 25 kPa, E = 200 times it"
            " (Terzaghi, Peck and Mesri 1996), yield stress sqrt(3) times it",
        ),
        Physical(
            name="dough", density=1200.0, youngs_modulus=2.5e4, poissons_ratio=0.45,
            friction=0.9, restitution=0.05, damping_time=5e-4, law="vonMises",
            parameters={"yield_stress": 1.5e3, "hardening": 1e3, "flow_viscosity": 1e3},
            source="wheat dough: G' of 5 to 10 kPa, flow from some hundreds of Pa of shear, to an"
            " order of magnitude",
        ),
        Physical(
            name="dry-sand", density=1600.0, youngs_modulus=1e6, poissons_ratio=0.3,
            friction=0.6, restitution=0.0, damping_time=0.0, law="druckerPrager",
            parameters={"internal_friction": 0.6},
            source="angle of repose 31 degrees (Lube et al. 2004); softer than sand under load",
        ),
        Physical(
            name="wet-sand", density=1900.0, youngs_modulus=1e6, poissons_ratio=0.3,
            friction=0.6, restitution=0.0, damping_time=0.0, law="druckerPrager",
            parameters={"internal_friction": 0.65, "cohesion": 1000.0},
            source="capillary bridges give damp sand 0.5 to 2 kPa (Mitarai and Nori 2006)",
        ),
        Physical(
            name="gravel", density=1700.0, youngs_modulus=2e6, poissons_ratio=0.25,
            friction=0.7, restitution=0.0, damping_time=0.0, law="druckerPrager",
            parameters={"internal_friction": 0.84},
            source="crushed rock: angle of repose about 40 degrees; as soft as dry-sand is",
        ),
        _bingham(
            "toothpaste", 1300.0, 3e5, 350.0, 90.0,
            "200 Pa of shear and 30 Pa s, to an order of magnitude (Ahuja and Potanin 2018)",
        ),
        _bingham(
            "mud", 1500.0, 2e5, 90.0, 15.0,
            "a slurry of clay: 50 Pa of shear and 5 Pa s, to an order of magnitude (Coussot 1997)",
        ),
        _bingham(
            "cream", 450.0, 5e4, 70.0, 15.0,
            "whipped: 40 Pa of shear, 5 Pa s, to an order of magnitude (Jakubczyk et al. 2006)",
        ),
        _bingham(
            "honey", 1420.0, 2e5, 0.1, 30.0,
            "at 20 C: 10 Pa s of shear (Yanniotis et al. 2006); it yields so that a heap can rest",
        ),
        Physical(
            name="wax", density=900.0, youngs_modulus=2.0e8, poissons_ratio=0.4,
            friction=0.5, restitution=0.3, damping_time=5e-6, law="vonMises",
            parameters={"yield_stress": 1.5e6, "hardening": 1e6},
            source="paraffin wax at 20 C: E of 0.1 to 0.3 GPa, compressive strength 1 to 2 MPa",
        ),
    )
}  # fmt: skip

Preset = DimensionlessPreset | Physical


@dataclass(frozen=True)
class Fixed:
    """A material that is given whole, for example by a file."""

    given: Material
    notes: tuple[str, ...] = ()  # what was chosen for it

    @property
    def name(self) -> str:
        return self.given.name

    def material(self, radius: float, law: str | None = None) -> Material:
        """The material as given; radius [m] changes nothing."""
        del radius
        return replace(self.given, law=law or self.given.law)


def presets() -> dict[str, Preset]:
    """Every preset by name, looks first."""
    return {**DIMENSIONLESS, **PHYSICAL}


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


@dataclass(frozen=True, kw_only=True)
class Material:
    """A constitutive law with its numbers, absolute (SI)."""

    name: str
    law: str  # a row of LAWS
    density: float  # [kg/m^3]
    youngs_modulus: float  # [Pa]
    poissons_ratio: float
    damping_time: float = 0.0  # Kelvin-Voigt tau [s]
    friction: float = 0.8  # Coulomb
    restitution: float = 0.85  # enters the contact damping ratio
    # By name, in SI: those of the law's own that are not at their default.
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
        """Y / E, the elastic strain at which it yields; None where it never does."""
        stress = self.parameters.get(YIELD_STRESS.name) if LAWS[self.law].flows else None
        return None if stress is None else stress / self.youngs_modulus

    @property
    def values(self) -> dict[str, Any]:
        """Every field, with the parameters of the law among them, as reports hold it."""
        fields = {name: value for name, value in vars(self).items() if name != "parameters"}
        return fields | {p.name: self.parameter(p) for p in law_parameters([self.law])}

    @property
    def wave_speed(self) -> float:
        """c = sqrt((lam + 2 mu) / rho) [m/s] of pressure waves at rest."""
        return float(np.sqrt((self.lam + 2.0 * self.mu) / self.density))
