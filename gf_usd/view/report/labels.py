"""Labels and descriptions of the numbers in a report."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from gf_usd.core.materials import law_parameters


@dataclass(frozen=True)
class Row:
    """One line of the health table."""

    key: str
    label: str
    unit: str
    meaning: str


class Line(NamedTuple):
    """A row with its value."""

    label: str
    value: str
    meaning: str
    marked: bool  # a warning is about it
    first: bool


ROWS: tuple[Row, ...] = (
    Row("frames", "Frames", "", "how many were simulated"),
    Row("substeps", "Substeps", "", "time steps, over all frames"),
    Row("substeps_max_per_frame", "Substeps of a frame", "", "at most"),
    Row("frames_without_substeps", "Frames without", "", "frames in which all flew or slept"),
    Row("flying_body_frames", "Flown", "", "bodies, over all frames without substeps"),
    Row("sleeping_body_frames", "Slept", "", "bodies, over all frames without substeps"),
    Row("rollbacks", "Frames redone", "", "times a frame was redone with half the step"),
    Row("restitution", "Rebound", "", "speed after the first bounce over the speed before it"),
    Row(
        "first_contact_frame", "First contact", "", "the first frame, from 0, that touched anything"
    ),
    Row("falls", "Falls", "", "gravity takes it to a floor or an obstacle"),
    Row("shift_max_m", "Farthest from the start", "m", "of the center of mass"),
    Row("kinetic_max_J", "Most kinetic energy", "J", "in a frame"),
    Row("deepest_penetration_m", "Deepest in the floor", "m", "of any point of the surface"),
    Row("deepest_penetration_spacings", "The same", "spacings", "distances between particles"),
    Row("deepest_overlap_m", "Deepest overlap", "m", "with another body or an obstacle"),
    Row("deepest_overlap_spacings", "The same", "spacings", "distances between particles"),
    Row("let_go_max", "Contacts let go", "", "points at once, where a surface is inside out"),
    Row(
        "inside_at_end_share",
        "Inside at the end",
        "",
        "half a spacing and more, part of the surface",
    ),
    Row("inside_at_end_m", "How deep", "m", "the deepest in a body, in the last frame"),
    Row("inside_max_share", "Inside at most", "", "in a frame that was looked at"),
    Row("inside_max_m", "How deep", "m", "in a frame that was looked at"),
    Row("penetration_at_end_spacings", "Deep at the end", "spacings", "in the last frame"),
    Row("resting_penetration_m", "The same", "m", "in the last frame, where it lies still"),
    Row("resting_penetration_spacings", "Deep at rest", "spacings", "where it lies still"),
    Row("min_J", "Smallest volume ratio", "", "J, volume over volume at rest, of any particle"),
    Row("max_J", "Largest volume ratio", "", "the same, the other way"),
    Row("min_stretch", "Most squeezed", "", "smallest stretch in any direction; 1 is at rest"),
    Row("max_stretch", "Most stretched", "", "largest stretch in any direction"),
    Row("inverted_particle_frames", "Inside out", "", "particles with J below 0, over all frames"),
    Row("inverted_max", "Inside out at once", "", "at most"),
    Row("inverted_at_end", "Inside out at the end", "", ""),
    Row("first_inverted_frame", "First inside out", "", "frame, from 0"),
    Row("clamped_particle_frames", "Stretch clamped", "", "particles, over all frames"),
    Row("clamped_share", "The same", "", "as a part of all particles and frames"),
    Row("stress_capped_particle_frames", "Stress cut", "", "particles, over all frames"),
    Row("stress_capped_share", "The same", "", "as a part of all particles and frames"),
    Row("friction_capped", "Friction sticks", "", "over all substeps; the paper's friction only"),
    Row("energy_start_J", "Energy at the start", "J", "kinetic, elastic, potential and contact"),
    Row("energy_end_J", "Energy at the end", "J", "what damping and friction left"),
    Row("energy_max_J", "Most energy", "J", "in any frame; without pins that of the start"),
    Row("energy_scale_J", "Energy that counts", "J", "what the body has to move and strain with"),
    Row("energy_gain_max_J", "Most energy gained", "J", "in a frame, out of nothing; rounding"),
    Row("energy_gain_max_share", "Energy out of nothing", "", "most in a frame, of what counts"),
    Row("dissipated_J", "Energy lost", "J", "to damping, friction, drag and the filter"),
    Row("work_of_pins_J", "Work of pins", "J", "and of moving obstacles, done on the bodies"),
    Row("injected_J", "Work of corrections", "J", "of the shape, and of new contact planes"),
    Row("planes_J", "Work of contact planes", "J", "of new ones, over the whole bake"),
    Row("planes_gain_share", "Energy they gave", "", "frame by frame, of what counts"),
    Row("plastic_dissipation_J", "Energy lost to flow", "J", "permanent deformation"),
    Row("momentum_end", "Momentum at the end", "kg m/s", ""),
    Row("angular_momentum_end", "Angular momentum", "kg m²/s", "at the end, about the origin"),
    Row("free_flight_frames", "Free flight", "", "frames before the first touch"),
    Row("momentum_drift", "Momentum off", "", "in free flight, as a part of the largest"),
    Row("angular_momentum_drift", "Angular momentum off", "", "in free flight, the same way"),
)

# rows that are shown at once; the others unfold
FIRST = {
    "frames", "substeps", "rollbacks", "restitution", "first_contact_frame",
    "deepest_penetration_m", "deepest_penetration_spacings", "resting_penetration_spacings",
    "min_J", "max_J", "min_stretch", "max_stretch", "inverted_particle_frames",
    "energy_start_J", "energy_end_J", "energy_gain_max_share",
}  # fmt: skip

# which rows a warning is about, by the names of gf_usd.pipeline.health.RULES
MARKS: dict[str, tuple[str, ...]] = {
    "untouched": ("first_contact_frame", "shift_max_m"),
    "still": ("kinetic_max_J",),
    "energy": ("energy_gain_max_J", "energy_gain_max_share"),
    "inside-out": ("inverted_particle_frames", "min_J"),
    "redone": ("rollbacks",),
    "clamp": ("clamped_particle_frames", "clamped_share"),
    "stress-cap": ("stress_capped_particle_frames", "stress_capped_share"),
    "injected": ("injected_J",),
    "planes": ("planes_J", "planes_gain_share"),
    "penetration": ("deepest_penetration_m", "deepest_penetration_spacings"),
    "overlap": ("deepest_overlap_m", "deepest_overlap_spacings"),
    "let-go": ("let_go_max",),
    "inside": ("inside_at_end_share", "inside_at_end_m"),
    "resting-depth": ("resting_penetration_m", "resting_penetration_spacings"),
    "free-flight": ("momentum_drift", "angular_momentum_drift"),
}

SETTINGS: dict[str, tuple[str, str]] = {
    "frames": ("Frames simulated", ""),
    "first": ("First frame written, from 0", ""),
    "samples_per_frame": ("Samples per frame", ""),
    "fps": ("Frames per second", "1/s"),
    "time_codes_per_second": ("Time codes per second", "1/s"),
    "start": ("Time code of frame 0", ""),
    "gravity": ("Gravity", "m/s²"),
    "up": ("Up axis", ""),
    "floor": ("Height of the floor", "m"),
    "lift": ("Lifted by", "m"),
    "seed": ("Seed", ""),
    "filter_rate": ("Filter rate", "1/s"),
    "drag": ("Drag", "1/s"),
    "safety": ("Part of the stable step", ""),
    "device": ("Device", ""),
    "threads": ("Threads", ""),
    "time_scale": ("Time scale", ""),
    "mass_scaling": ("Mass scaling of materials that flow", ""),
    "substeps": ("Substeps a frame", ""),
    "cell": ("Grid cell", "m"),
    "contact_rate": ("Contact stiffness", "1/s²"),
    "sampling": ("Sampling", ""),
    "followers": ("Light nodes follow", ""),
    "mass": ("Mass matrix", ""),
    "deformation_gradients": ("F written", ""),
    "stress": ("Stress written", ""),
    "internal": ("Internal variables written", ""),
    "skin": ("Skin", ""),
    "solver": ("Solver", ""),
    "floor_normal": ("Normal of the floor", ""),
    "shortcuts": ("Flight and sleep left out", ""),
    "wls": ("WLS recomputation", ""),
    "procrustes": ("Shape correction", ""),
    "clamp": ("Clamp of stretches", ""),
    "stress_cap": ("Cap of stress", "Pa"),
}
FACTS: dict[str, tuple[str, str]] = {
    "particles": ("Particles", ""),
    "spacing_m": ("Their spacing", "m"),
    "volume_m3": ("Volume", "m³"),
    "radius_m": ("Radius of a ball as large", "m"),
    "drop_m": ("Free fall before the floor", "m"),
    "seconds": ("Time to bake", "s"),
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
    """MATERIAL, and the parameters of the laws."""
    return MATERIAL | {p.name: (p.label, p.unit) for p in law_parameters()}


def number(value: Any) -> str:
    """A value for reading: four digits, thousands apart, lists in brackets."""
    if value is None:
        return "not set"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}".replace(",", "\u202f")  # a narrow space
    if isinstance(value, float):
        if abs(value) < 1e9 and (value.is_integer() or abs(value) >= 1e3):
            return number(round(value))
        return f"{value:.4g}"
    if isinstance(value, str):
        return value
    if isinstance(value, Sequence):
        return ", ".join(number(v) for v in value) or "none"
    return str(value)


def health_rows(health: Mapping[str, Any], warned: Collection[str] = ()) -> list[Line]:
    """What there is, in words; keys that are not known by name come last.

    warned : names of rules of gf_usd.pipeline.health; the rows that they judge are marked.
    """
    marked = {key for about in warned for key in MARKS.get(about, ())}
    known = {row.key: row for row in ROWS}
    keys = [key for key in known if key in health] + [key for key in health if key not in known]
    out = []
    for key in keys:
        row = known.get(key) or Row(key, _plain(key), "", "")
        shown = "none" if health[key] is None else f"{number(health[key])} {row.unit}".strip()
        out.append(
            Line(row.label, shown, row.meaning, key in marked, key in FIRST or key in marked)
        )
    return out


def named_rows(
    values: Mapping[str, Any], names: Mapping[str, tuple[str, str]]
) -> list[tuple[str, str]]:
    """(label, value with its unit), in the order of the names, others last."""
    keys = [k for k in names if k in values] + [k for k in values if k not in names]
    out = []
    for key in keys:
        label, unit = names.get(key, (_plain(key), ""))
        shown = number(values[key])
        out.append((label, f"{shown} {unit}" if unit and values[key] is not None else shown))
    return out


def _plain(key: str) -> str:
    return key.replace("_", " ").capitalize()
