"""Inspection of an asset: plain data, and the JSON that ``gf-usd inspect --json`` prints.

Keys of the JSON; lengths in meters unless a name says otherwise, None where it does not apply:

file, bakeable, refusal {message, hint}, warnings [], notes [], skipped [{path, reason}]
units       meters_per_unit, kilograms_per_unit, up_axis, and for the first and the last whether
            the file says so: meters_per_unit_from, up_axis_from (file | assumed | option)
time        codes_per_second, frames_per_second, start, end: as authored
size        widths of the box around everything, along x, y, z
meshes      of each: path, type, points, faces, triangles, quads, ngons, largest_face, fill
            (filled | rides along | stays | refused), reason, watertight, boundary_edges, holes,
            hole_share, volume_m3, area_m2, collapsed, slivers, duplicates, non_manifold_edges,
            repairs {}; shells: index, triangles, low, size, volume_m3, area_m2, winding, against,
            and holes: edges, size, center, share
body        particles, spacing, volume_m3, radius, frames, fps, start, drop, first_contact_frame
            (of a fall on the floor; None also where it is not estimated, as with obstacles),
            thickness_5_percent (of the surface is no thicker), thickness_median, and the
            particles_across the former
parts       poorly filled: path, shell, kind (empty | few | thin | bare region | thin region),
            center, size, thickness (median: of a rod, its diameter), particles,
            suggested_particles, speck (small and apart from all others); none where faults of
            a mesh cost much of the fill
suggested_particles     a total that fills all parts that a sensible number fills, without specks
materials   of each: name, substeps_per_frame, substeps_per_sample (between two samples of a frame),
            substeps (expected in all), most_substeps (what they may become by contact or by
            strain), strain_profile (substeps over those at rest, at equal intervals, of a
            body that hangs from a pin; else empty),
            damping_ratio (of the grid's stiffest vibration),
            critical_damping_time ([s] of all materials, with which that ratio is 1;
            0: of a fluid),
            contact_factor (substeps with contact over those without), seconds (of all frames),
            usual_seconds (of a bake that ends at rest), most_seconds, usual_most_seconds (with
            most_substeps), flying_samples (without
            substeps), sample_seconds, moving_seconds (of a sample without and with substeps),
            end_seconds (once all are written), disk_bytes, memory_bytes
advice      of --material auto, for each mesh: path, material, confidence, reason, by
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from gf_usd.core.arrays import Floats
from gf_usd.core.asset import Asset
from gf_usd.core.errors import InputError
from gf_usd.core.materials.material import Material
from gf_usd.core.units import check_unit
from gf_usd.geometry.diagnosis import Diagnosis, diagnose, lost_volume_warning
from gf_usd.geometry.repair import Repairs
from gf_usd.geometry.solid import Solid
from gf_usd.geometry.thin.parts import Part, suggestion
from gf_usd.geometry.thin.thickness import Thickness, thickness
from gf_usd.pipeline.cost.budget import Cost
from gf_usd.pipeline.cost.forecast import FILLING, INSPECTING, READING, Stages, Watch
from gf_usd.pipeline.prepared import Prepared, draw, with_shot_length
from gf_usd.prepare.asset_size import implausible_size, size
from gf_usd.prepare.fill.inputs import repair_asset_for_fill
from gf_usd.prepare.fill.neighbors import would_fill
from gf_usd.prepare.options.parse import parse_request
from gf_usd.prepare.outputs.outputs import outputs
from gf_usd.prepare.plan import Plan
from gf_usd.prepare.prepare import AssetFile, fill_found, poor_parts_of
from gf_usd.readers.usd.stage import layers_kept
from gf_usd.system.sandbox import Limits
from gf_usd.system.taichi_runtime import watching


@dataclass(frozen=True, kw_only=True)
class Inspection:
    """What `inspect` found about an asset."""

    asset: Asset  # as it was read
    diagnoses: tuple[Diagnosis, ...]  # one per surface, before any repair
    repairs: tuple[Repairs, ...] = ()  # one per surface that moves; empty without repair=True
    plan: Plan | None = None  # None: refused
    cost: Cost | None = None  # estimated_seconds, estimated_bytes and more; None: refused
    shortcuts: tuple[str, ...] = ()  # hints at a faster bake, as text
    parts: tuple[Part, ...] = ()  # that are filled poorly
    warnings: tuple[str, ...] = ()  # problems of the asset, as text
    refusal: InputError | None = None  # why `bake` would refuse the asset; None: it would not
    thickness: Thickness | None = None  # of the filled bodies

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes of the plan, or of the reader if there is no plan."""
        return self.plan.notes if self.plan else self.asset.facts.notes

    def fill_of(self, path: str) -> tuple[str, str]:
        """(filled | rides along | stays | refused, reason) of a mesh.

        A mesh that rides along encloses no volume and follows a solid near it; one that stays is
        not moved.
        """
        if self.plan is None:
            return "refused", ""
        return self._not_filled.get(path, ("filled", ""))

    @cached_property
    def _not_filled(self) -> dict[str, tuple[str, str]]:
        """What `fill_of` returns of the meshes of a plan that are not filled."""
        assert self.plan is not None
        return {path: ("rides along", reason) for path, reason in self.plan.embedded} | {
            path: ("stays", reason) for path, reason in self.plan.asset.skipped
        }

    @cached_property
    def _repairs(self) -> dict[str, Repairs]:
        return {one.path: one for one in self.repairs}

    def as_json(self) -> dict[str, Any]:
        """Plain values; the keys are documented at the top of gf_usd/pipeline/inspect.py."""
        facts = self.asset.facts
        return {
            "file": str(facts.path),
            "bakeable": self.refusal is None,
            "refusal": refusal_json(self.refusal),
            "warnings": list(self.warnings),
            "notes": list(self.notes),
            "skipped": [{"path": p, "reason": why} for p, why in self.asset.skipped],
            "units": {
                "meters_per_unit": facts.units.meters_per_unit,
                "meters_per_unit_from": facts.unit_from,
                "kilograms_per_unit": facts.units.kilograms_per_unit,
                "up_axis": facts.up_axis,
                "up_axis_from": facts.axis_from,
            },
            "time": {
                "codes_per_second": facts.time_codes_per_second,
                "frames_per_second": facts.frames_per_second,
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
        repairs = self._repairs.get(seen.path)
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
            "non_manifold_edges": seen.non_manifold_edges,
            "repairs": repairs.as_dict() if repairs else None,
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
                        {"edges": h.edges, "size": h.size, "center": _plain(h.center),
                         "centre": _plain(h.center),  # until 1.0
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
            **self._thickness(p.spacing),
            "volume_m3": p.volume,
            "radius": p.radius,
            "frames": s.frames,
            "fps": s.fps,
            "start": s.start,
            "drop": self.plan.drop,
            "first_contact_frame": self.cost["first_contact_frame"],
        }

    def _thickness(self, spacing: float) -> dict[str, float | None]:
        if self.thickness is None:
            return dict.fromkeys(("thickness_5_percent", "thickness_median", "particles_across"))
        return {
            "thickness_5_percent": self.thickness.thin,
            "thickness_median": self.thickness.median,
            "particles_across": self.thickness.across(spacing),
        }


def examine(asset: Asset, repairs: Sequence[Repairs] = ()) -> Inspection:
    """The part of an inspection that does not need a plan."""
    return Inspection(
        asset=asset,
        diagnoses=tuple(diagnose(surface) for surface in asset.surfaces),
        repairs=tuple(repairs),
    )


def refusal_json(error: InputError | None) -> dict[str, str] | None:
    """An error as plain values."""
    return None if error is None else {"message": error.message, "hint": error.hint}


def lost_volume(seen: Inspection, solid: Solid) -> str:
    """A warning where defects of the meshes remove much of the enclosed volume; else ""."""
    if seen.plan is None or seen.repairs:
        return ""
    joined = {*solid.walls.values(), *(group[0] for group in solid.joined)}
    whole = {s.path: diagnose(s) for s in solid.surfaces if s.path in joined}
    parts = {path for group in solid.joined for path in group[1:]}
    filled = [
        whole.get(d.path, d)
        for d in seen.diagnoses
        if seen.fill_of(d.path)[0] == "filled" and d.path not in parts
    ]
    return lost_volume_warning(filled, seen.plan.particles.volume, solid.adding_nothing)


def _part(part: Part) -> dict[str, Any]:
    return {
        "path": part.path,
        "shell": part.shell,
        "kind": part.kind,
        "center": _plain(part.center),
        "centre": _plain(part.center),  # until 1.0
        "size": part.size,
        "thickness": part.thickness,
        "particles": part.particles,
        "suggested_particles": part.suggested,
        "speck": part.speck,
    }


def _plain(values: Floats) -> list[float]:
    return [float(v) for v in values]


@layers_kept()
def inspect(
    path: str | Path,
    *,
    material: str | tuple[str | Material, ...] | None = None,
    law: str | None = None,
    prims: Sequence[str] = (),
    meters_per_unit: float | None = None,
    up_axis: str | None = None,
    repair: bool = False,
    limits: Limits | None = None,
    watch: Watch | None = None,
    **options: Any,
) -> Inspection:
    """The result of `bake` with the same parameters without simulating, and defects of the asset.

    watch : called with the current stage.

    A refusal is part of the result (`Inspection.refusal`), provided that the file can be read.

    Raises
    ------
    UsageError : for invalid options.
    InputError : the file cannot be read, is the result of a bake, or contains nothing to bake.
    """
    check_unit(meters_per_unit)
    request, presets = parse_request(material, law, options)
    source, stages = Path(path), Stages(watch)
    stages.begin(READING, source.name)
    given = AssetFile(
        path=source, limits=limits, request=request, presets=presets, prims=prims,
        meters_per_unit=meters_per_unit, up_axis=up_axis,
    )  # fmt: skip
    with given.reading() as read:
        found = given.asset(read.result(), draw)
    asset, spec = found.asset, found.spec
    stages.begin(INSPECTING, "(meshes)")
    seen = examine(asset)
    files = outputs(source, [preset.name for preset in found.presets], None)
    others = given.around(found)
    try:
        plan, solid = fill_found(
            found, request, law, files, others, repair=repair, known=seen.diagnoses,
            progress=partial(stages.begin, FILLING),
        )  # fmt: skip
    except InputError as refusal:
        warnings = [implausible_size(asset)]
        mendable = not repair and not would_fill(asset)
        if mendable and would_fill(repair_asset_for_fill(asset, request, spec)[1]):
            warnings.append("it can be baked with --repair")
        return replace(
            seen, refusal=refusal, warnings=tuple(w for w in warnings if w),
            repairs=repair_asset_for_fill(asset, request, spec)[2] if repair else (),
        )  # fmt: skip
    stages.begin(INSPECTING, "(time and memory)")
    with watching(stages.compile):
        prepared = with_shot_length(Prepared(plan=plan))
        cost, hints = prepared.cost, prepared.shortcuts
    stages.begin(INSPECTING, "(thin parts)")
    seen = replace(
        seen, plan=prepared.plan, repairs=prepared.plan.repairs, cost=cost, shortcuts=hints,
        thickness=thickness(solid, plan.bodies.of_surface if plan.bodies else None),
    )  # fmt: skip
    lost = lost_volume(seen, solid)
    # where defects remove much of the volume, they also cause the thin parts
    parts = () if lost else poor_parts_of(plan, solid)
    warnings = (implausible_size(prepared.plan.asset), prepared.plan.heavy, lost)
    return replace(seen, parts=parts, warnings=tuple(w for w in warnings if w))
