"""Labels and descriptions of the numbers in a report."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from gf_usd.core.errors import listed_paths
from gf_usd.core.materials.laws import law_parameters
from gf_usd.core.units import length_text, volume_text


@dataclass(frozen=True)
class Row:
    """A health value: its key, label and description."""

    key: str
    label: str
    unit: str
    meaning: str


class Line(NamedTuple):
    """A row of the health table with its value."""

    label: str
    value: str
    meaning: str
    marked: bool  # a warning concerns it
    first: bool  # visible at once; other rows are folded


ROWS: tuple[Row, ...] = (
    Row("frames", "Frames", "", "simulated frames"),
    Row("substeps", "Substeps", "", "time steps of all frames"),
    Row("substeps_max_per_frame", "Most substeps in a frame", "", ""),
    Row(
        "frames_without_substeps",
        "Frames without substeps",
        "",
        "every body was in free flight or asleep",
    ),
    Row(
        "flying_body_frames", "Bodies in free flight", "", "summed over the frames without substeps"
    ),
    Row("sleeping_body_frames", "Bodies asleep", "", "summed over the frames without substeps"),
    Row("rollbacks", "Frames recomputed", "", "with half the time step"),
    Row(
        "restitution", "Rebound", "", "speed after the first bounce, divided by the speed before it"
    ),
    Row(
        "loop_cycles",
        "Cycles",
        "",
        "number of times that the animation was played; the last one is written",
    ),
    Row(
        "loop_difference_m",
        "Difference of the last two cycles",
        "m",
        "largest over all particles",
    ),
    Row("loop_difference_share", "Difference of the last two cycles", "", "share of the radius"),
    Row("first_contact_frame", "First contact", "", "frame, counted from 0"),
    Row(
        "fallen_bodies",
        "Bodies past every obstacle",
        "",
        "with nothing below them, in the last frame",
    ),
    Row("fallen_of", "Bodies", "", ""),
    Row("first_fallen_frame", "First body past every obstacle", "", "frame, counted from 0"),
    Row("lost_particles", "Flowing particles lost", "", "below the floor or every obstacle"),
    Row("lost_share", "Flowing particles lost", "", "share of all particles"),
    Row("first_lost_frame", "First flowing particle lost", "", "frame, counted from 0"),
    Row("converted_particles", "Particles converted", "", "from solid to flowing"),
    Row("converted_share", "Particles converted", "", "share of all particles"),
    Row("first_converted_frame", "First particle converted", "", "frame, counted from 0"),
    Row(
        "flow_volume_min",
        "Smallest volume of flowing material",
        "",
        "relative to the volume at rest",
    ),
    Row(
        "flow_volume_max",
        "Largest volume of flowing material",
        "",
        "relative to the volume at rest",
    ),
    Row(
        "flow_per_cell_at_end",
        "Flowing particles in a cell at the end",
        "",
        "mean of the cells that have any; about 6 where the material is deep",
    ),
    Row("flesh", "Flesh", "", "whether the bake has --flesh"),
    Row("falls", "Falls", "", "whether gravity takes the body to a floor or an obstacle"),
    Row("shift_max_m", "Largest displacement", "m", "of the center of mass from its start"),
    Row("kinetic_max_J", "Largest kinetic energy", "J", "of any frame"),
    Row(
        "deepest_penetration_m",
        "Deepest penetration of the floor",
        "m",
        "of all surface points and frames",
    ),
    Row(
        "deepest_penetration_spacings",
        "Deepest penetration of the floor",
        "spacings",
        "in particle spacings",
    ),
    Row("deepest_overlap_m", "Deepest overlap", "m", "with a body or an obstacle"),
    Row("deepest_overlap_spacings", "Deepest overlap", "spacings", "in particle spacings"),
    Row("overlap_pair", "Body with the deepest overlap", "", "and what it overlapped"),
    Row("overlap_frame", "Frame of the deepest overlap", "", "from 0"),
    Row("pierced_max_m", "Deepest edge or corner of an obstacle", "m", "in or through a body"),
    Row(
        "pierced_max_spacings",
        "Deepest edge or corner of an obstacle",
        "spacings",
        "from half a spacing on, in the frames that were measured",
    ),
    Row("pierced_through", "It comes out of the body", "", "on the other side"),
    Row("pierced_pair", "Obstacle with that edge or corner", "", "and the body"),
    Row("pierced_frame", "Frame with that edge or corner", "", "from 0"),
    Row(
        "released_max",
        "Released contact samples",
        "",
        "largest number at a time; samples are released where the surface is folded or inverted,"
        " or an obstacle has too many edges",
    ),
    Row(
        "inside_at_end_share",
        "Surface inside a body at the end",
        "",
        "share of the area that is at least half a spacing deep",
    ),
    Row("inside_at_end_m", "Depth inside a body at the end", "m", "of the deepest point"),
    Row(
        "inside_max_share",
        "Largest part of the surface inside a body",
        "",
        "share of the area, in the frames that were measured",
    ),
    Row("inside_max_m", "Largest depth inside a body", "m", "in the frames that were measured"),
    Row(
        "outside_mesh_max_share",
        "Largest share of the particles outside their mesh",
        "",
        "by a spacing or more; only measured if a mesh has long faces",
    ),
    Row("outside_mesh_max_m", "Largest distance outside the mesh", "m", "of a particle"),
    Row("outside_mesh", "Mesh with the longest faces", "", "relative to the particle spacing"),
    Row("outside_meshes", "Meshes with long faces", "", "of more than four particle spacings"),
    Row(
        "penetration_at_end_spacings",
        "Depth in the floor at the end",
        "spacings",
        "in particle spacings, in the last frame",
    ),
    Row(
        "resting_penetration_m",
        "Depth in the floor at rest",
        "m",
        "in the last frame, if the body is at rest there",
    ),
    Row(
        "resting_penetration_spacings",
        "Depth in the floor at rest",
        "spacings",
        "in particle spacings",
    ),
    Row("min_J", "Smallest volume ratio", "", "J, volume divided by rest volume, of all particles"),
    Row("max_J", "Largest volume ratio", "", "J of all particles"),
    Row("expanded_volume", "Largest volume of a body", "", "over that at rest"),
    Row("expanded_body", "Body of the largest volume", "", "its first mesh"),
    Row("expanded_frame", "Frame of the largest volume", "", "counted from 0"),
    Row("stretched_share", "Stretched share of a body", "", "of its volume, more than 4-fold"),
    Row("stretched_body", "Body of the largest stretched share", "", "its first mesh"),
    Row("stretched_frame", "Frame of the largest stretched share", "", "counted from 0"),
    Row("min_stretch", "Smallest stretch", "", "in any direction; 1 is undeformed"),
    Row("max_stretch", "Largest stretch", "", "in any direction; 1 is undeformed"),
    Row("inverted_particle_frames", "Inverted particles", "", "J of 0 or less, summed over frames"),
    Row("inverted_max", "Most inverted particles", "", "in one frame"),
    Row("inverted_at_end", "Inverted particles at the end", "", "in the last frame"),
    Row("first_inverted_frame", "First inversion", "", "frame, counted from 0"),
    Row(
        "clamped_particle_frames",
        "Clamped particles",
        "",
        "stretch was clamped; summed over frames",
    ),
    Row("clamped_share", "Share of clamped particles", "", "of all particles and frames"),
    Row("stress_capped_particle_frames", "Particles with capped stress", "", "summed over frames"),
    Row("stress_capped_share", "Share with capped stress", "", "of all particles and frames"),
    Row(
        "friction_capped",
        "Capped friction",
        "",
        "number of times in all substeps; only with the friction of the paper",
    ),
    Row(
        "energy_start_J",
        "Energy at the start",
        "J",
        "kinetic, elastic, potential and contact energy",
    ),
    Row("energy_end_J", "Energy at the end", "J", "the same sum in the last frame"),
    Row(
        "energy_max_J",
        "Largest energy",
        "J",
        "of any frame; without pins it is the energy at the start",
    ),
    Row(
        "energy_scale_J",
        "Reference energy",
        "J",
        "largest sum of kinetic and elastic energy, at least m g r",
    ),
    Row(
        "energy_gain_max_J",
        "Largest unexplained energy gain",
        "J",
        "within one frame; ideally only rounding error",
    ),
    Row(
        "energy_gain_max_share",
        "Unexplained energy gain",
        "",
        "largest in a frame, divided by the reference energy",
    ),
    Row("dissipated_J", "Dissipated energy", "J", "by damping, friction, drag and the filter"),
    Row("work_of_pins_J", "Work of pins", "J", "and moving obstacles, done on the bodies"),
    Row(
        "injected_J",
        "Work of corrections",
        "J",
        "by the shape correction and by new contact planes",
    ),
    Row("planes_J", "Work of new contact planes", "J", "net, over the whole bake"),
    Row(
        "planes_gain_share",
        "Energy gain by contact planes",
        "",
        "summed over frames, divided by the reference energy",
    ),
    Row("plastic_dissipation_J", "Plastic dissipation", "J", "energy of permanent deformation"),
    Row("conversion_dissipation_J", "Lost by conversion", "J", "part of the plastic dissipation"),
    Row(
        "settling_dissipation_J",
        "Settling dissipation",
        "J",
        "by rolling resistance and the damping of small bounces and vibrations",
    ),
    Row("momentum_end", "Momentum at the end", "kg m/s", "in the last frame"),
    Row("angular_momentum_end", "Angular momentum at the end", "kg m²/s", "about the origin"),
    Row("free_flight_frames", "Free flight", "", "frames before the first contact"),
    Row("momentum_drift", "Drift of momentum", "", "in free flight, relative"),
    Row("angular_momentum_drift", "Drift of angular momentum", "", "in free flight, relative"),
)

# rows that are visible at once; the others are folded
FIRST = {
    "frames", "substeps", "rollbacks", "restitution", "first_contact_frame",
    "deepest_penetration_m", "deepest_penetration_spacings", "resting_penetration_spacings",
    "min_J", "max_J", "min_stretch", "max_stretch", "inverted_particle_frames",
    "energy_start_J", "energy_end_J", "energy_gain_max_share",
}  # fmt: skip

PATHS = {"outside_meshes"}  # rows of any number of prim paths, of which the page names a few

# rows that a warning concerns, by the rules of gf_usd.pipeline.health.warnings.RULES
MARKS: dict[str, tuple[str, ...]] = {
    "untouched": ("first_contact_frame", "shift_max_m"),
    "still": ("kinetic_max_J",),
    "energy": ("energy_gain_max_J", "energy_gain_max_share"),
    "inside-out": ("inverted_particle_frames", "min_J"),
    "expanded": ("expanded_volume", "expanded_body", "expanded_frame", "max_J"),
    "stretched": ("stretched_share", "stretched_body", "stretched_frame", "max_stretch"),
    "redone": ("rollbacks",),
    "clamp": ("clamped_particle_frames", "clamped_share"),
    "stress-cap": ("stress_capped_particle_frames", "stress_capped_share"),
    "injected": ("injected_J",),
    "planes": ("planes_J", "planes_gain_share"),
    "penetration": ("deepest_penetration_m", "deepest_penetration_spacings"),
    "overlap": ("deepest_overlap_m", "deepest_overlap_spacings", "overlap_pair"),
    "pierced": ("pierced_max_m", "pierced_max_spacings", "pierced_pair"),
    "let-go": ("released_max",),
    "fallen": ("fallen_bodies", "first_fallen_frame"),
    "lost": ("lost_particles", "lost_share", "first_lost_frame"),
    "unconverted": ("converted_particles", "converted_share"),
    "flow-volume": ("flow_volume_min", "flow_volume_max"),
    "thin-flow": ("flow_per_cell_at_end",),
    "inside": ("inside_at_end_share", "inside_at_end_m"),
    "coarse-mesh": ("outside_mesh_max_share", "outside_mesh_max_m", "outside_mesh"),
    "resting-depth": ("resting_penetration_m", "resting_penetration_spacings"),
    "free-flight": ("momentum_drift", "angular_momentum_drift"),
    "loop": ("loop_cycles", "loop_difference_m", "loop_difference_share"),
}

FIELDS = "fields"
SETTINGS: dict[str, tuple[str, str]] = {
    "frames": ("Frames simulated", ""),
    "first": ("First frame written, counted from 0", ""),
    "samples_per_frame": ("Samples per frame", ""),
    "fps": ("Frames per second", "1/s"),
    "time_codes_per_second": ("Time codes per second", "1/s"),
    "start": ("Time code of frame 0", ""),
    "gravity": ("Gravity", "m/s²"),
    "fields": ("Fields besides gravity", ""),
    "up": ("Up axis", ""),
    "floor": ("Floor height", "m"),
    "lift": ("Height lifted at the start", "m"),
    "seed": ("Seed", ""),
    "filter_rate": ("Filter rate", "1/s"),
    "drag": ("Drag", "1/s"),
    "rolling": ("Coefficient of rolling resistance", ""),
    "settling": ("Small motions damped", ""),
    "safety": ("Fraction of the stable time step", ""),
    "device": ("Device", ""),
    "threads": ("Threads", ""),
    "time_scale": ("Time scale", ""),
    "mass_scaling": ("Mass scaling of plastic materials", ""),
    "substeps": ("Substeps per frame", ""),
    "cell": ("Grid cell", "m"),
    "contact_rate": ("Contact stiffness", "1/s²"),
    "sampling": ("Sampling", ""),
    "followers": ("Dependent nodes", ""),
    "mass": ("Mass matrix", ""),
    "deformation_gradients": ("Deformation gradients written", ""),
    "stress": ("Stress written", ""),
    "internal": ("Internal variables written", ""),
    "skin": ("Skin", ""),
    "solver": ("Solver", ""),
    "floor_normal": ("Floor normal", ""),
    "shortcuts": ("Substeps skipped in flight and sleep", ""),
    "wls": ("WLS recomputation of F", ""),
    "procrustes": ("Shape correction", ""),
    "clamp": ("Stretch clamp", ""),
    "stress_cap": ("Stress cap", "Pa"),
}
FACTS: dict[str, tuple[str, str]] = {
    "particles": ("Particles", ""),
    "spacing_m": ("Particle spacing", "m"),
    "volume_m3": ("Volume", "m³"),
    "radius_m": ("Radius of a ball of the same volume", "m"),
    "drop_m": ("Height of free fall", "m"),
    "seconds": ("Bake time", "s"),
}
MATERIAL: dict[str, tuple[str, str]] = {
    "law": ("Law", ""),
    "density": ("Density", "kg/m³"),
    "youngs_modulus": ("Young's modulus", "Pa"),
    "poissons_ratio": ("Poisson's ratio", ""),
    "damping_time": ("Damping time", "s"),
    "friction": ("Friction", ""),
    "restitution": ("Restitution", ""),
}


def material_labels() -> dict[str, tuple[str, str]]:
    """Labels and units of MATERIAL and of the parameters of constitutive laws."""
    return MATERIAL | {p.name: (p.label, p.unit) for p in law_parameters()}


def number(value: Any) -> str:
    """A value as text: four significant digits, grouped thousands, comma-separated lists."""
    if value is None:
        return "not set"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}".replace(",", "\u202f")  # narrow no-break space
    if isinstance(value, float):
        if abs(value) < 1e9 and (value.is_integer() or abs(value) >= 1e3):
            return number(round(value))
        return f"{value:.4g}"
    if isinstance(value, str):
        return value
    if isinstance(value, Sequence):
        return ", ".join(number(v) for v in value) or "none"
    return str(value)


def quantity(value: Any, unit: str) -> str:
    """A value with its unit; lengths and volumes in a unit that suits their size (871 µm)."""
    texts = {"m": length_text, "m³": volume_text}
    if isinstance(value, float) and unit in texts:
        return texts[unit](value).replace(" ", "\u00a0")  # the unit stays on the line
    return f"{number(value)} {unit}" if unit and value is not None else number(value)


def health_rows(health: Mapping[str, Any], warned: Collection[str] = ()) -> list[Line]:
    """The rows of the health table; keys without a label come last.

    warned : names of rules of gf_usd.pipeline.health; rows that they concern are marked.
    """
    marked = {key for rule in warned for key in MARKS.get(rule, ())}
    known = {row.key: row for row in ROWS}
    keys = [key for key in known if key in health] + [key for key in health if key not in known]
    out = []
    for key in keys:
        row = known.get(key) or Row(key, _label_from_key(key), "", "")
        value = listed_paths(health[key]) if key in PATHS and health[key] else health[key]
        text = "none" if value is None else quantity(value, row.unit)
        out.append(Line(row.label, text, row.meaning, key in marked, key in FIRST or key in marked))
    return out


def named_rows(
    values: Mapping[str, Any], names: Mapping[str, tuple[str, str]]
) -> list[tuple[str, str]]:
    """(label, value with its unit), in the order of the names, others last.

    Each force field is a row.
    """
    keys = [k for k in names if k in values] + [k for k in values if k not in names]
    out = []
    for key in keys:
        label, unit = names.get(key, (_label_from_key(key), ""))
        if key == FIELDS and values[key]:
            out += [
                (f"Field: {field.get('kind')}", _describe_field(field)) for field in values[key]
            ]
            continue
        out.append((label, quantity(values[key], unit)))
    return out


def _describe_field(field: Mapping[str, Any]) -> str:
    """A force field of the settings as text; see `gf_usd.core.frames.settings.Field`."""
    if field.get("kind") == "gravity":
        times = field.get("times") or [0.0]
        span = f"time codes {number(times[0])} to {number(times[-1])}"
        return f"{len(times)} keys, {span}: " + "; ".join(
            number(value) for value in field.get("values", [])
        )
    acceleration = field.get("vector") if field.get("kind") == "wind" else field.get("strength")
    parts = [f"{number(acceleration)} m/s²"]
    if field.get("kind") == "noise":
        parts.append(f"length {number(field.get('length'))} m")
        parts.append(f"rate {number(field.get('rate'))} 1/s")
    if field.get("radius") is not None or field.get("kind") == "radial":
        parts.append(f"around {number(field.get('center'))} m")
    if field.get("radius") is not None:
        parts.append(f"radius {number(field['radius'])} m")
    return "; ".join(parts)


def _label_from_key(key: str) -> str:
    return key.replace("_", " ").capitalize()
