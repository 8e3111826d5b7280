"""What an inspection found: plain data, and the JSON that ``gf-usd inspect --json`` prints.

Keys of the JSON; lengths in metres unless a name says otherwise, None where it does not apply:

file, bakeable, refusal {message, hint}, warnings [], notes [], skipped [{path, reason}]
units       meters_per_unit, kilograms_per_unit, up_axis, and for the first and the last whether
            the file says so: meters_per_unit_from, up_axis_from (file | assumed | option)
time        codes_per_second, start, end: as authored
size        widths of the box around everything, along x, y, z
meshes      of each: path, type, points, faces, triangles, quads, ngons, largest_face, fill
            (filled | rides along | refused), reason, watertight, boundary_edges, holes, hole_share,
            volume_m3, area_m2, collapsed, slivers, duplicates, non_manifold_edges, repairs {};
            shells: index, triangles, low, size, volume_m3, area_m2, winding, against, and holes:
            edges, size, centre, share
body        particles, spacing, volume_m3, radius, frames, fps, start, drop, first_contact_frame
parts       poorly filled: path, shell, kind (empty | few | thin | bare region | thin region),
            centre, size, thickness, particles, suggested_particles; none where faults of a mesh
            cost much of the fill
suggested_particles     a total that fills all parts that a sensible number fills
materials   of each: name, substeps_per_frame, seconds, disk_bytes, memory_bytes
advice      of --material auto, for each mesh: path, material, confidence, reason, by
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from gf_usd.errors import InputError
from gf_usd.geometry.diagnosis import Diagnosis, diagnose, faults
from gf_usd.geometry.parts import Part, suggestion
from gf_usd.geometry.repair import Repairs
from gf_usd.model import Asset, Floats, StageFacts

if TYPE_CHECKING:
    from gf_usd.plan import Plan

PLAUSIBLE = (0.02, 20.0)  # [m] width of the things people make soft: a grape to a lorry
HUGE, TINY = 30.0, 0.005  # [m] beyond these the unit is more likely wrong than the asset odd
KEPT = 0.9  # of the volume that meshes enclose: less is worth a warning; overlaps count twice in it
UNIT, AXIS = "--meters-per-unit", "--up-axis"
ATTRIBUTES = {UNIT: "metersPerUnit", AXIS: "upAxis"}
COMMON_UNITS = (0.01, 1.0, 0.001)  # [m]


@dataclass(frozen=True, kw_only=True)
class Inspection:
    """One asset, looked at; made by `preflight.inspect`."""

    asset: Asset  # as it was read
    diagnoses: tuple[Diagnosis, ...]  # one a surface, before any repair
    repairs: tuple[Repairs, ...] = ()
    plan: Plan | None = None  # None: refused
    cost: dict[str, Any] | None = None  # of `estimate`
    parts: tuple[Part, ...] = ()
    warnings: tuple[str, ...] = ()
    refusal: InputError | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """Of the plan, else of the reader."""
        return self.plan.notes if self.plan else self.asset.facts.notes

    def fill_of(self, path: str) -> tuple[str, str]:
        """(filled | rides along | refused, reason) of a mesh."""
        if self.plan is None:
            return "refused", ""
        reason = dict(self.plan.riders).get(path)
        return ("filled", "") if reason is None else ("rides along", reason)

    def as_json(self) -> dict[str, Any]:
        """Plain values; see the top of this file."""
        facts = self.asset.facts
        unit_from, axis_from = origin(facts, UNIT), origin(facts, AXIS)
        return {
            "file": str(facts.path),
            "bakeable": self.refusal is None,
            "refusal": refusal_json(self.refusal),
            "warnings": list(self.warnings),
            "notes": list(self.notes),
            "skipped": [{"path": p, "reason": why} for p, why in self.asset.skipped],
            "units": {
                "meters_per_unit": facts.units.meters_per_unit,
                "meters_per_unit_from": unit_from,
                "kilograms_per_unit": facts.units.kilograms_per_unit,
                "up_axis": facts.up_axis,
                "up_axis_from": axis_from,
            },
            "time": {
                "codes_per_second": facts.time_codes_per_second,
                "start": facts.start_time_code,
                "end": facts.end_time_code,
            },
            "size": _plain(size(self.asset)),
            "meshes": [self._mesh(seen) for seen in self.diagnoses],
            "body": self._body(),
            "parts": [_part(part) for part in self.parts],
            "suggested_particles": suggestion(self.parts),
            "materials": self.cost["per_material"] if self.cost else [],
            "advice": [asdict(one) for one in self.plan.advice] if self.plan else [],
        }

    def _mesh(self, seen: Diagnosis) -> dict[str, Any]:
        fill, reason = self.fill_of(seen.path)
        repairs = {r.path: r.as_dict() for r in self.repairs}.get(seen.path)
        return {
            "path": seen.path,
            "type": seen.type_name,
            "points": seen.points,
            "faces": seen.faces,
            **seen.face_sizes,
            "largest_face": seen.largest_face,
            "fill": fill,
            "reason": reason,
            "watertight": seen.watertight,
            "boundary_edges": seen.boundary_edges,
            "holes": len(seen.holes),
            "hole_share": seen.hole_share,
            "volume_m3": seen.volume,
            "area_m2": seen.area,
            "collapsed": seen.collapsed,
            "slivers": seen.slivers,
            "duplicates": seen.duplicates,
            "non_manifold_edges": seen.crowded_edges,
            "repairs": repairs,
            "shells": [
                {
                    "index": s.index,
                    "triangles": s.triangles,
                    "low": _plain(s.low),
                    "size": _plain(s.size),
                    "volume_m3": s.volume,
                    "area_m2": s.area,
                    "winding": s.winding,
                    "against": s.against,
                    "holes": [
                        {"edges": h.edges, "size": h.size, "centre": _plain(h.centre),
                         "share": h.share}
                        for h in s.holes
                    ],
                }
                for s in seen.shells
            ],
        }  # fmt: skip

    def _body(self) -> dict[str, Any] | None:
        if self.plan is None or self.cost is None:
            return None
        p, s = self.plan.particles, self.plan.settings
        return {
            "particles": len(p),
            "spacing": p.spacing,
            "volume_m3": p.volume,
            "radius": p.radius,
            "frames": s.frames,
            "fps": s.fps,
            "start": s.start,
            "drop": self.plan.drop,
            "first_contact_frame": self.cost["first_contact_frame"],
        }


def look_at(asset: Asset, repairs: Sequence[Repairs] = ()) -> Inspection:
    """The part of an inspection that needs no plan."""
    return Inspection(
        asset=asset,
        diagnoses=tuple(diagnose(surface) for surface in asset.surfaces),
        repairs=tuple(repairs),
    )


def refusal_json(error: InputError | None) -> dict[str, str] | None:
    """An error as plain values."""
    return None if error is None else {"message": error.message, "hint": error.hint}


def origin(facts: StageFacts, option: str) -> str:
    """Where the answer to --meters-per-unit or --up-axis comes from: file, assumed or option.

    Readers say in a note what the file does not say itself.
    """
    said = [note for note in facts.notes if option in note or ATTRIBUTES[option] in note]
    if any("asked for" in note for note in said):
        return "option"
    return "assumed" if any("assumed" in note for note in said) else "file"


def size(asset: Asset) -> Floats:
    """(3,) [m] of the box around all surfaces."""
    low = np.min([s.points.min(0) for s in asset.surfaces], axis=0)
    high = np.max([s.points.max(0) for s in asset.surfaces], axis=0)
    return high - low


def implausible_size(asset: Asset) -> str:
    """A warning where the asset is so large or small that its unit is likely wrong; else ""."""
    unit = asset.facts.units.meters_per_unit
    width = float(size(asset).max())
    units = width / unit
    # An assumed unit deserves less trust than one that somebody wrote down.
    least = PLAUSIBLE[0] if origin(asset.facts, UNIT) == "assumed" else TINY
    if least <= width <= HUGE:
        return ""
    likely = [u for u in COMMON_UNITS if u != unit and PLAUSIBLE[0] <= units * u <= PLAUSIBLE[1]]
    # Of the units that fit, a tiny asset wants the largest and a huge one the first named.
    fitting = max(likely, default=None) if width < least else next(iter(likely), None)
    said = f"the asset is {width:.3g} m wide: {units:.4g} units of {unit:g} m"
    if fitting is None:
        return f"{said}; check its unit ({UNIT})"
    return f"{said}; with {UNIT} {fitting:g} it would be {units * fitting:.3g} m"


def lost_volume(seen: Inspection) -> str:
    """A warning where faults of the meshes cost the fill much of what they enclose; else ""."""
    if seen.plan is None or seen.repairs:
        return ""
    filled = [d for d in seen.diagnoses if seen.fill_of(d.path)[0] == "filled"]
    whole, fill = sum(d.volume for d in filled), seen.plan.particles.volume
    if fill >= KEPT * whole or not any(faults(d) for d in filled):
        return ""
    return (
        f"only {fill:.3g} of the {whole:.3g} m^3 that the meshes enclose are filled: try --repair"
    )


def _part(part: Part) -> dict[str, Any]:
    return {
        "path": part.path,
        "shell": part.shell,
        "kind": part.kind,
        "centre": _plain(part.centre),
        "size": part.size,
        "thickness": part.thickness,
        "particles": part.particles,
        "suggested_particles": part.suggested,
    }


def _plain(values: Floats) -> list[float]:
    return [float(v) for v in values]
