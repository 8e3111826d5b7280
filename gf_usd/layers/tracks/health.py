"""Health of a bake as attributes of its layers (GaussianFleshHealthAPI).

Values of single frames are time samples in the cache.  The totals are in the root layer, inside the
bake's variant, so that they are available without the payload and disappear when another variant is
selected.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pxr import Gf, Sdf, Usd, Vt

from gf_usd.core.asset import Asset
from gf_usd.core.frames.frame import Health
from gf_usd.core.units import StageUnits
from gf_usd.layers.stage import Home, roots_of
from gf_usd.system import usd_schema

Types = Sdf.ValueTypeNames
PREFIX = "gaussianFlesh:health:"

# attribute -> (type, field of `Health`, unit)
FRAME: dict[str, tuple[Any, str, str]] = {
    "kineticEnergy": (Types.Double, "kinetic", "energy"),
    "elasticEnergy": (Types.Double, "elastic", "energy"),
    "potentialEnergy": (Types.Double, "potential", "energy"),
    "contactEnergy": (Types.Double, "contact", "energy"),
    "pinWork": (Types.Double, "work", "energy"),
    "injectedEnergy": (Types.Double, "injected", "energy"),
    "centerOfMass": (Types.Double3, "center", "length"),
    "momentum": (Types.Double3, "momentum", "momentum"),
    "angularMomentum": (Types.Double3, "angular_momentum", "action"),
    "minVolumeRatio": (Types.Float, "min_J", ""),
    "maxVolumeRatio": (Types.Float, "max_J", ""),
    "minStretch": (Types.Float, "min_stretch", ""),
    "maxStretch": (Types.Float, "max_stretch", ""),
    "invertedParticles": (Types.Int, "inverted", ""),
    "clampedParticles": (Types.Int, "clamped", ""),
    "stressCappedParticles": (Types.Int, "stress_capped", ""),
    "penetration": (Types.Float, "penetration", "length"),
    "overlap": (Types.Float, "overlap", "length"),
    "contactsLetGo": (Types.Int, "let_go", ""),
    "frictionCaps": (Types.Int64, "friction_capped", ""),
    "substeps": (Types.Int, "substeps", ""),
    "rollbacks": (Types.Int, "rollbacks", ""),
    "flyingBodies": (Types.Int, "flying", ""),
    "sleepingBodies": (Types.Int, "sleeping", ""),
}
FLOW = {"plasticDissipation": (Types.Double, "plastic_dissipation", "energy")}  # where a law flows
# where rolling resistance and settling act
SETTLING = {"settlingDissipation": (Types.Double, "settling_dissipation", "energy")}

# attribute -> (type, key of `HealthLog.summary`, unit)
TOTAL: dict[str, tuple[Any, str, str]] = {
    "frames": (Types.Int, "frames", ""),
    "substeps": (Types.Int64, "substeps", ""),
    "rollbacks": (Types.Int, "rollbacks", ""),
    "framesWithoutSubsteps": (Types.Int, "frames_without_substeps", ""),
    "energyStart": (Types.Double, "energy_start_J", "energy"),
    "energyEnd": (Types.Double, "energy_end_J", "energy"),
    "energyGain": (Types.Double, "energy_gain_max_J", "energy"),
    "dissipatedEnergy": (Types.Double, "dissipated_J", "energy"),
    "pinWork": (Types.Double, "work_of_pins_J", "energy"),
    "injectedEnergy": (Types.Double, "injected_J", "energy"),
    "plasticDissipation": (Types.Double, "plastic_dissipation_J", "energy"),
    "settlingDissipation": (Types.Double, "settling_dissipation_J", "energy"),
    "momentumDrift": (Types.Float, "momentum_drift", ""),
    "angularMomentumDrift": (Types.Float, "angular_momentum_drift", ""),
    "minVolumeRatio": (Types.Float, "min_J", ""),
    "maxVolumeRatio": (Types.Float, "max_J", ""),
    "minStretch": (Types.Float, "min_stretch", ""),
    "maxStretch": (Types.Float, "max_stretch", ""),
    "invertedParticles": (Types.Int64, "inverted_particle_frames", ""),
    "clampedParticles": (Types.Int64, "clamped_particle_frames", ""),
    "stressCappedParticles": (Types.Int64, "stress_capped_particle_frames", ""),
    "penetration": (Types.Float, "deepest_penetration_m", "length"),
    "overlap": (Types.Float, "deepest_overlap_m", "length"),
    "contactsLetGo": (Types.Int, "released_max", ""),
    "restingPenetration": (Types.Float, "resting_penetration_m", "length"),
    "insideShare": (Types.Float, "inside_at_end_share", ""),
    "insideDepth": (Types.Float, "inside_at_end_m", "length"),
    "frictionCaps": (Types.Int64, "friction_capped", ""),
    "restitution": (Types.Float, "restitution", ""),
}


# attribute -> type, of the figures that have intervals
CERTIFIED: dict[str, Any] = {
    "figures": Types.TokenArray,
    "values": Types.DoubleArray,
    "halfWidths": Types.DoubleArray,
    "unknown": Types.StringArray,
    "frames": Types.Int,
}


def bake_root(asset: Asset, home: Home) -> Sdf.Path:
    """The prim with the health: the home's root, or the scope where that has no variant set."""
    return home.root if home.root in roots_of(asset, home) else home.scope


class HealthTrack:
    """Writes the health of frames onto the bake's root prim in the cache.

    A field that is zero in all frames (clamps, pins) is written too: zero means that it was
    measured.

    flows : a law among the materials flows; settles : rolling resistance or settling is active.
    """

    def __init__(
        self,
        cache: Usd.Stage,
        path: Sdf.Path,
        units: StageUnits,
        *,
        flows: bool = False,
        settles: bool = False,
    ) -> None:
        self._cache, self._layer = cache, None
        prim = cache.OverridePrim(path)
        prim.ApplyAPI(usd_schema.HEALTH_API)
        si = si_factors(units)
        watched = FRAME | (FLOW if flows else {}) | (SETTLING if settles else {})
        self._rows = [
            (prim.CreateAttribute(PREFIX + name, kind, False), field, si[unit])
            for name, (kind, field, unit) in watched.items()
        ]
        self._paths = [attribute.GetPath() for attribute, _, _ in self._rows]

    def write(self, health: Health, time_code: float) -> None:
        """Author one frame."""
        layer = self._cache.GetEditTarget().GetLayer()
        if layer != self._layer:
            # creates the specs of the attributes, if this layer has none
            for attribute, field, size in self._rows:
                attribute.Set(_value(getattr(health, field), size), time_code)
            self._layer = layer
            return
        # writing two dozen numbers through a stage takes several times as long
        with Sdf.ChangeBlock():
            for path, (_, field, size) in zip(self._paths, self._rows):
                layer.SetTimeSample(path, time_code, _value(getattr(health, field), size))


def author_totals(
    spec: Sdf.PrimSpec,
    health: Mapping[str, Any],
    units: StageUnits,
    warnings: Sequence[str] = (),
    failure: str = "",
) -> None:
    """Apply the API and author the totals of a bake on a prim spec.

    health : `HealthLog.summary`; unknown values are not authored. warnings : texts. failure : why
        the bake ended early; "" where it did not.
    """
    names = Sdf.TokenListOp()
    names.prependedItems = [usd_schema.HEALTH_API]
    spec.SetInfo("apiSchemas", names)
    si = si_factors(units)
    for name, (kind, key, unit) in TOTAL.items():
        if health.get(key) is not None:
            _author(spec, f"total:{name}", kind, _value(health[key], si[unit]))
    if warnings:
        _author(spec, "warnings", Types.StringArray, Vt.StringArray(list(warnings)))
    if failure:
        _author(spec, "failure", Types.String, failure)


def author_certificate(
    spec: Sdf.PrimSpec, certificate: Mapping[str, Any], units: StageUnits
) -> None:
    """Author the intervals of the figures of a bake, in stage units.

    certificate : as in reports: docs/guide/report.md.
    """
    length = {"m": units.length}
    names, values, halves, unknown = [], [], [], []
    for name, one in certificate["figures"].items():
        if one["value"] is None:
            unknown.append(f"{_camel(name)}: {one['reason']}")
            continue
        size = length.get(one["unit"], 1.0)
        several = len(one["value"]) > 1
        for axis, value in zip("XYZ", one["value"]):
            names.append(_camel(name) + (axis if several else ""))
            values.append(value / size)
            halves.append(one["half_width"] / size)
    found = {
        "figures": Vt.TokenArray(names),
        "values": Vt.DoubleArray(values),
        "halfWidths": Vt.DoubleArray(halves),
        "unknown": Vt.StringArray(unknown),
        "frames": certificate.get("center", {}).get("frames", 0),
    }
    for name, kind in CERTIFIED.items():
        _author(spec, f"certified:{name}", kind, found[name])


def _camel(name: str) -> str:
    """peak_strain -> peakStrain."""
    first, *rest = name.split("_")
    return first + "".join(word.capitalize() for word in rest)


def _author(spec: Sdf.PrimSpec, name: str, kind: Any, value: Any) -> None:
    uniform = Sdf.VariabilityUniform
    Sdf.AttributeSpec(spec, PREFIX + name, kind, uniform).default = value


def _value(value: Any, size: float) -> Any:
    if isinstance(value, int):
        return value
    if isinstance(value, float):
        return value / size
    return Gf.Vec3d(*(float(part) / size for part in value))


def si_factors(units: StageUnits) -> dict[str, float]:
    """One unit of the stage in SI; seconds are seconds."""
    return {
        "": 1.0,
        "length": units.length,
        "momentum": units.mass * units.length,
        "action": units.mass * units.length**2,
        "energy": units.mass * units.length**2,
    }
