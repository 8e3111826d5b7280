"""Presets of real materials, in SI, each with its source."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from gf_usd.core.materials.material import Material, scaled_parameters


@dataclass(frozen=True, kw_only=True)
class PhysicalPreset:
    """An absolute preset: the values of a real material."""

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
            parameters=scaled_parameters(self.parameters, law or self.law),
        )


ASHBY = "Ashby, Materials Selection in Mechanical Design, appendix A: geometric mean of the range"


def _paste(
    name: str, *, density: float, E: float, tau: float, k: float, n: float = 1.0, source: str
) -> PhysicalPreset:
    """What bears tau + k D^n [Pa] sheared at a rate D [1/s]: Herschel and Bulkley 1926."""
    return PhysicalPreset(
        name=name, density=density, youngs_modulus=E, poissons_ratio=0.45, friction=0.9,
        restitution=0.0, damping_time=0.0, law="paste", source=source,
        parameters={
            "yield_stress": 3.0**0.5 * tau, "flow_viscosity": 3.0 ** (0.5 * (1.0 + n)) * k,
            "flow_exponent": n,
        },
    )  # fmt: skip


# Incompressible elastomers are given nu = 0.47, with which a displacement method does not lock.
PHYSICAL: dict[str, PhysicalPreset] = {
    p.name: p
    for p in (
        PhysicalPreset(
            name="gelatin", density=1020.0, youngs_modulus=1e3, poissons_ratio=0.47,
            damping_time=2e-3, restitution=0.5,
            source="a soft dessert gel, to an order of magnitude",
        ),
        PhysicalPreset(
            name="soft-silicone", density=1070.0, youngs_modulus=69e3, poissons_ratio=0.47,
            source="Smooth-On technical bulletin, Ecoflex 00-30: 100 % modulus 10 psi, 1.07 g/cc",
        ),
        PhysicalPreset(
            name="silicone", density=1030.0, youngs_modulus=2.0e6, poissons_ratio=0.47,
            source="PDMS 10:1, E = 20 MPa / ratio: J. Appl. Polym. Sci. 2014, 131, 41050",
        ),
        PhysicalPreset(
            name="neoprene", density=1240.0, youngs_modulus=1.2e6, poissons_ratio=0.47,
            source=f"{ASHBY} 0.7-2 MPa",
        ),
        PhysicalPreset(
            name="natural-rubber", density=925.0, youngs_modulus=1.9e6, poissons_ratio=0.47,
            source=f"{ASHBY} 1.5-2.5 MPa",
        ),
        PhysicalPreset(
            name="hard-rubber", density=1150.0, youngs_modulus=1e7, poissons_ratio=0.47,
            source="a filled, hard elastomer such as a tire's tread, to an order of magnitude",
        ),
        PhysicalPreset(
            name="foam", density=52.0, youngs_modulus=1.7e6, poissons_ratio=0.27,
            damping_time=3e-5, restitution=0.5,
            source=f"{ASHBY} 1-3 MPa (flexible polymer foam, low density)",
        ),
        PhysicalPreset(
            name="polyurethane-foam", density=60.0, youngs_modulus=1.5e7, poissons_ratio=0.3,
            restitution=0.2, damping_time=5e-6, law="crushable",
            parameters={"yield_stress": 4e5, "hardening": 4e5, "cap_shape": 1.5},
            source="a rigid foam of closed cells, R = 60 / 1200 as dense as its solid: Gibson and"
            " Ashby, Cellular Solids, E = E_s (f^2 R^2 + (1 - f) R) and plateau 0.3 sigma_s R^1.5"
            " with E_s = 1.6 GPa, sigma_s = 127 MPa and f = 0.85 of the solid in the edges",
        ),
        PhysicalPreset(
            name="aluminium", density=2700.0, youngs_modulus=68.9e9, poissons_ratio=0.33,
            friction=0.5, restitution=0.6, damping_time=0.0, law="vonMises",
            parameters={"yield_stress": 2.76e8, "hardening": 6e8},
            source="6061-T6, MIL-HDBK-5: yield 276 MPa, ultimate 310 MPa at some 6 % of strain",
        ),
        PhysicalPreset(
            name="mild-steel", density=7850.0, youngs_modulus=2.0e11, poissons_ratio=0.29,
            friction=0.5, restitution=0.6, damping_time=0.0, law="vonMises",
            parameters={"yield_stress": 2.5e8, "hardening": 1.0e9},
            source="ASTM A36: yield 250 MPa; hardening to 400 MPa at 15 % of strain",
        ),
        PhysicalPreset(
            name="copper", density=8930.0, youngs_modulus=1.17e11, poissons_ratio=0.35,
            friction=0.5, restitution=0.5, damping_time=0.0, law="vonMises",
            parameters={"yield_stress": 4e8, "hardening": 1e8},
            source="the copper bar of Taylor tests: Wilkins and Guinan 1973; Kamoulakos 1990",
        ),
        PhysicalPreset(
            name="lead", density=11340.0, youngs_modulus=1.6e10, poissons_ratio=0.44,
            friction=0.6, restitution=0.2, damping_time=0.0, law="vonMises",
            parameters={"yield_stress": 1.2e7, "hardening": 1.2e7},
            source="pure lead: ASM Metals Handbook, tensile strength 12 to 17 MPa, E = 16 GPa",
        ),
        PhysicalPreset(
            name="modelling-clay", density=1850.0, youngs_modulus=3.0e6, poissons_ratio=0.45,
            friction=0.9, restitution=0.1, law="vonMises",
            parameters={
                "yield_stress": 2e4, "hardening": 5e4, "saturation": 1.1e5, "saturation_rate": 5.0,
                "flow_viscosity": 500.0,
            },
            source="Plasticine at 20 C as a model of hot metal: flow stress 0.1 to 0.2 MPa at"
            " strains above 0.2, to an order of magnitude; it begins to flow without a sharp yield"
            " point, and E and the yield stress are fitted, not measured, such that it hardly"
            " bounces",
        ),
        PhysicalPreset(
            name="wet-clay", density=1900.0, youngs_modulus=5.0e6, poissons_ratio=0.45,
            friction=0.9, restitution=0.05, law="vonMises",
            parameters={"yield_stress": 4.3e4, "flow_viscosity": 1e3},
            source="soft saturated clay, undrained: shear strength 25 kPa, E = 200 times it"
            " (Terzaghi, Peck and Mesri 1996), yield stress sqrt(3) times it",
        ),
        PhysicalPreset(
            name="dough", density=1200.0, youngs_modulus=2.5e4, poissons_ratio=0.45,
            friction=0.9, restitution=0.05, damping_time=5e-4, law="vonMises",
            parameters={"yield_stress": 1.5e3, "hardening": 1e3, "flow_viscosity": 1e3},
            source="wheat dough: G' of 5 to 10 kPa, flow from some hundreds of Pa of shear, to an"
            " order of magnitude",
        ),
        PhysicalPreset(
            name="dry-sand", density=1600.0, youngs_modulus=1e6, poissons_ratio=0.3,
            friction=0.6, restitution=0.0, damping_time=0.0, law="druckerPrager",
            parameters={"internal_friction": 0.6},
            source="angle of repose 31 degrees (Lube et al. 2004); softer than sand under load",
        ),
        PhysicalPreset(
            name="wet-sand", density=1900.0, youngs_modulus=1e6, poissons_ratio=0.3,
            friction=0.6, restitution=0.0, damping_time=0.0, law="druckerPrager",
            parameters={"internal_friction": 0.65, "cohesion": 1000.0},
            source="capillary bridges give damp sand 0.5 to 2 kPa (Mitarai and Nori 2006)",
        ),
        PhysicalPreset(
            name="gravel", density=1700.0, youngs_modulus=2e6, poissons_ratio=0.25,
            friction=0.7, restitution=0.0, damping_time=0.0, law="druckerPrager",
            parameters={"internal_friction": 0.84},
            source="crushed rock: angle of repose about 40 degrees; as soft as dry-sand is",
        ),
        PhysicalPreset(
            name="powder-snow", density=120.0, youngs_modulus=4.8e4, poissons_ratio=0.2,
            friction=0.4, restitution=0.0, damping_time=0.0, law="snow",
            parameters={
                "critical_compression": 0.019, "critical_stretch": 0.005,
                "hardening_coefficient": 10.0,
            },
            source="the small critical stretches and E of dry, powdery snow in Stomakhin et al."
            " 2013; new snow has 50 to 200 kg/m^3 (Fierz et al. 2009)",
        ),
        PhysicalPreset(
            name="wet-snow", density=400.0, youngs_modulus=1.4e5, poissons_ratio=0.2,
            friction=0.6, restitution=0.0, damping_time=0.0, law="snow",
            parameters={
                "critical_compression": 0.025, "critical_stretch": 0.0075,
                "hardening_coefficient": 10.0,
            },
            source="the reference values of Stomakhin et al. 2013: snow that packs into balls",
        ),
        _paste(
            "toothpaste", density=1300.0, E=3e5, tau=200.0, k=60.0, n=0.5,
            source="200 Pa and 60 Pa s^0.5 of shear, to an order of magnitude (Ahuja and Potanin"
            " 2018)",
        ),
        _paste(
            "mud", density=1500.0, E=2e5, tau=50.0, k=20.0, n=1.0 / 3.0,
            source="a slurry of clay: the exponent 1/3 of Coussot 1997; 50 Pa and 20 Pa s^(1/3) of"
            " shear, to an order of magnitude",
        ),
        _paste(
            "cream", density=450.0, E=5e4, tau=40.0, k=15.0, n=0.5,
            source="whipped: 40 Pa and 15 Pa s^0.5 of shear, to an order of magnitude (Jakubczyk"
            " and Niranjan 2006)",
        ),
        _paste(
            "honey", density=1420.0, E=2e5, tau=0.06, k=10.0,
            source="at 20 C: 10 Pa s of shear (Yanniotis et al. 2006); it yields so that a heap"
            " can rest",
        ),
        PhysicalPreset(
            name="wax", density=900.0, youngs_modulus=2.0e8, poissons_ratio=0.4,
            friction=0.5, restitution=0.3, damping_time=5e-6, law="vonMises",
            parameters={"yield_stress": 1.5e6, "hardening": 1e6},
            source="paraffin wax at 20 C: E of 0.1 to 0.3 GPa, compressive strength 1 to 2 MPa",
        ),
    )
}  # fmt: skip
