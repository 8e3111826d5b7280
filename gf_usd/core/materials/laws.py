"""The laws as data: a row of `LAWS` contains everything about a law except its formulas.

The command line, readers, writers, check rules and the schema read it here, without Taichi; the
formulas are in the module of gf_usd.physics.laws that the row names.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from gf_usd.core.errors import UsageError, did_you_mean


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A parameter of a law in addition to its moduli, constant in time."""

    name: str  # of Material.parameters; the same in every law that has it
    unit: str  # of `StageUnits.factor`, e.g. "Pa"
    attribute: str  # in the namespace gaussianFlesh, on the Material and on particles
    default: float  # [unit] of a material that does not state it
    meaning: str  # a sentence, for the schema
    label: str  # for the report
    low: float = 0.0  # [unit] least value
    high: float = float("inf")  # [unit] largest value
    required: bool = False  # a bake is refused where neither material nor paint states it


@dataclass(frozen=True, kw_only=True)
class Internal:
    """An internal variable that a law stores for each particle."""

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
    associated: bool = True  # its flow only ever takes energy
    unbounded: bool = False  # it flows without limit: for the Updated Lagrangian solver
    over: str = ""  # the law whose energy it has; "": its own
    internal: tuple[Internal, ...] = ()


YIELD_STRESS = Parameter(
    name="yield_stress", unit="Pa", attribute="yieldStress", default=1e9,
    meaning="Equivalent stress at which the material begins to flow, before any hardening.",
    label="Yield stress", required=True,
)  # fmt: skip
HARDENING = Parameter(
    name="hardening", unit="Pa", attribute="hardening", default=0.0,
    meaning="Increase of the yield stress with the equivalent plastic strain or, for crushable"
    " materials, with the logarithm of the permanently lost volume.",
    label="Hardening",
)  # fmt: skip
FLOW_VISCOSITY = Parameter(
    name="flow_viscosity", unit="Pa s", attribute="flowViscosity", default=0.0,
    meaning="Stress above the yield stress at a plastic strain rate of 1/s; 0: flow without"
    " viscosity.",
    label="Viscosity of flow",
)  # fmt: skip
PLASTIC_STRAIN = Internal(
    name="plastic_strain", rest=0.0, attribute="plasticStrain",
    meaning="Accumulated equivalent plastic strain of each particle.",
    label="Plastic Strain",
)  # fmt: skip

# Of every law that flows, in addition to its own: computed from F_e by the solvers.
ELASTIC_STRAIN = Internal(
    name="elastic_strain", rest=0.0, attribute="elasticStrain",
    meaning="Largest |stretch - 1| of the elastic part F_e of each particle's deformation.",
    label="Elastic Strain",
)  # fmt: skip

LOOSENING = Internal(
    name="loosening", rest=0.0, attribute="loosening",
    meaning="Logarithm of the volume that each particle gained when it came apart; this gap"
    " closes before the particle bears pressure again.",
    label="Loosening",
)  # fmt: skip


def _von_mises(token: str, code: str, over: str = "") -> LawSpec:
    """Von Mises plasticity over the elastic energy of a module."""
    return LawSpec(
        token=token,
        code=code,
        source="Simo and Hughes 1998, boxes 3.1 and 9.1; Voce 1955; Perzyna 1966",
        over=over,
        parameters=(
            YIELD_STRESS,
            HARDENING,
            Parameter(
                name="saturation", unit="Pa", attribute="saturation", default=0.0,
                meaning="Saturating hardening: the largest amount that it adds to the yield"
                " stress.",
                label="Saturating hardening",
            ),
            Parameter(
                name="saturation_rate", unit="", attribute="saturationRate", default=0.0,
                meaning="Rate of the saturating hardening: the part that remains is exp(-rate *"
                " equivalent plastic strain).",
                label="Saturation rate",
            ),
            FLOW_VISCOSITY,
        ),
        flows=True,
        isochoric=True,
        internal=(PLASTIC_STRAIN,),
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
                    meaning="Shape alpha of the yield surface, an ellipse of pressure and"
                    " shear: with 3 / sqrt(2) a body keeps its width when it is"
                    " compressed along one axis.",
                    label="Shape of the cap", low=0.1, high=2.9,
                ),
                Parameter(
                    name="tensile_yield_ratio", unit="", attribute="tensileYieldRatio",
                    default=1.0,
                    meaning="Ratio of the hydrostatic tension to the hydrostatic pressure at"
                    " which a crushable material yields.",
                    label="Tensile yield ratio", low=0.05, high=5.0,
                ),
            ),
            flows=True,
            internal=(
                Internal(
                    name="lost_volume", rest=0.0, attribute="lostVolume",
                    meaning="Logarithm of the permanent volume loss of each particle: rest"
                    " volume divided by remaining volume.",
                    label="Lost Volume",
                ),
            ),
        ),
        LawSpec(
            token="druckerPrager",
            code=".flowing.drucker_prager",
            source="Drucker and Prager 1952; Klar et al. 2016; Tampubolon et al. 2017",
            parameters=(
                Parameter(
                    name="internal_friction", unit="", attribute="internalFriction", default=0.6,
                    meaning="Ratio of the shear stress that a granular material bears to its"
                    " pressure: the tangent of its steepest stable slope.",
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
            internal=(LOOSENING,),
        ),
        LawSpec(
            token="snow",
            code=".flowing.snow",
            source="Stomakhin, Schroeder, Chai, Teran and Selle 2013",
            over="corotated",
            parameters=(
                Parameter(
                    name="critical_compression", unit="", attribute="criticalCompression",
                    default=0.025,
                    meaning="Elastic compression 1 - stretch of snow beyond which it is compacted.",
                    label="Critical compression", low=1e-5, high=0.5, required=True,
                ),
                Parameter(
                    name="critical_stretch", unit="", attribute="criticalStretch", default=0.0075,
                    meaning="Elastic stretch - 1 of snow beyond which it comes apart.",
                    label="Critical stretch", low=1e-5, high=0.5,
                ),
                Parameter(
                    name="hardening_coefficient", unit="", attribute="hardeningCoefficient",
                    default=10.0,
                    meaning="Logarithm of the stiffening of snow per unit of lost volume.",
                    label="Hardening coefficient", high=20.0,
                ),
            ),
            flows=True,
            associated=False,
            unbounded=True,
            internal=(
                Internal(
                    name="plastic_volume", rest=1.0, attribute="plasticVolume",
                    meaning="Determinant of the plastic part F_p of each particle's"
                    " deformation: below 1 if snow was compacted, above 1 if it came"
                    " apart.",
                    label="Plastic Volume",
                ),
            ),
        ),
        LawSpec(
            token="fluid",
            code=".flowing.fluid",
            source="Tait's equation of state: Batchelor 1967; Monaghan 1994",
            parameters=(
                Parameter(
                    name="viscosity", unit="Pa s", attribute="viscosity", default=0.0,
                    meaning="Shear viscosity of a fluid.", label="Viscosity", required=True,
                ),
                Parameter(
                    name="cavitation", unit="Pa", attribute="cavitation", default=0.0,
                    meaning="Tension that a fluid bears before it comes apart.",
                    label="Cavitation tension",
                ),
            ),
            flows=True,
            unbounded=True,
            internal=(LOOSENING,),
        ),
        LawSpec(
            token="paste",
            code=".flowing.paste",
            source="Herschel and Bulkley 1926; Perzyna 1966; Simo and Hughes 1998, box 9.1",
            parameters=(
                YIELD_STRESS,
                HARDENING,
                FLOW_VISCOSITY,
                Parameter(
                    name="flow_exponent", unit="", attribute="flowExponent", default=1.0,
                    meaning="Exponent of the plastic strain rate in the stress above the yield"
                    " stress: 1 for a Bingham fluid, less for shear-thinning flow.",
                    label="Exponent of flow", low=0.1, high=1.0,
                ),
            ),
            flows=True,
            isochoric=True,
            unbounded=True,
            internal=(PLASTIC_STRAIN,),
        ),
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
    """Internal variables of flowing laws that are written, one of each name; None: all laws."""
    wanted = set(LAWS if tokens is None else tokens)
    rows = [row for token, row in LAWS.items() if token in wanted and row.flows]
    own = [v for row in rows for v in row.internal if v.attribute]
    return tuple({v.name: v for v in (own + [ELASTIC_STRAIN] if rows else own)}.values())


def flowing_law(stated: Iterable[str], otherwise: str) -> str:
    """The law of a material that states these parameters by name, and no law.

    A material that states a required parameter of flowing laws (a yield stress) flows: by
    `otherwise` if that law has the parameter, else by the first law with all stated parameters.
    """
    wanted = set(stated)
    needed = {p.name for p in law_parameters() if p.required} & wanted
    if not needed or needed <= {p.name for p in LAWS[otherwise].parameters}:
        return otherwise
    having = [t for t, row in LAWS.items() if needed <= {p.name for p in row.parameters}]
    whole = [t for t in having if wanted <= {p.name for p in LAWS[t].parameters}]
    return (whole or having)[0]


def stated_flow(law: str) -> str:
    """The name of the parameter that makes a material flow, as text: "a yield stress"."""
    label = next(p.label for p in LAWS[law].parameters if p.required).lower()
    return f"{'an' if label[0] in 'aeiou' else 'a'} {label}"


def check_law(law: str) -> str:
    """The law's token; UsageError where there is none of that name."""
    if law in LAWS:
        return law
    guess = did_you_mean(law, LAWS)
    raise UsageError(f"there is no law {law!r}", f"{guess}choose one of {', '.join(LAWS)}")
