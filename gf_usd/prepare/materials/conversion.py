"""Which particles can be converted: `--conversion [WHERE=]PRESET@LIMIT`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Ints
from gf_usd.core.asset import Asset, Surface
from gf_usd.core.errors import InputError, UsageError
from gf_usd.core.frames.particles import Particles
from gf_usd.core.materials.conversion import KINDS, TIME, Conversion, Limit
from gf_usd.core.materials.laws import LAWS
from gf_usd.core.materials.material import Material
from gf_usd.core.materials.per_particle import unbounded
from gf_usd.core.materials.presets import find_preset
from gf_usd.core.stage import PhysicsMaterialSpec, StageSpec, SubsetMaterial
from gf_usd.prepare.bodies.plan import BodyPlan
from gf_usd.prepare.materials.assign import Assigned
from gf_usd.prepare.materials.parts import MaterialPart, material_parts, part_of_particles
from gf_usd.prepare.materials.regions import MaterialBox, parse_corners

if TYPE_CHECKING:
    from gf_usd.geometry.solid import Solid

OPTION = "--conversion"


@dataclass(frozen=True, kw_only=True)
class ConversionRule:
    """One rule of the option."""

    text: str  # as given
    path: str  # of a prim, all below it included; "": everything, or what is in the box
    box: MaterialBox | None
    material: str  # name of a preset that flows without limit
    limit: Limit

    def becomes(self, stated: Mapping[str, float]) -> Material:
        """The new material of particles, with the values of the options.  It does not depend on a
        body's size.
        """
        return replace(find_preset(self.material).material(1.0, None), **stated)

    def may_hold(
        self, surface: Surface, spec: StageSpec, unit: float, parts: Sequence[str] = ()
    ) -> bool:
        """Whether a rule may match particles of a filled surface.

        unit : [m] of the stage; parts : paths of the meshes that were joined to the surface.
        """
        if self.box is not None:
            low, high = self.box.low * unit, self.box.high * unit
            points = np.asarray(surface.points)
            return bool((points.max(0) >= low).all() and (points.min(0) <= high).all())
        body = spec.bodies.get(surface.path)
        subsets = body.subsets if body else ()
        paths = (surface.path, *parts, *(one.path for one in subsets))
        return any(_is_at_or_below(path, self.path) for path in paths)


def parse_conversions(texts: Sequence[str]) -> tuple[ConversionRule, ...]:
    """The rules of "[WHERE=]PRESET@LIMIT".

    WHERE is the path of a prim or GeomSubset, or a box x0,y0,z0,x1,y1,z1 in stage units, and LIMIT
    is time:CODE, strain:VALUE or stress:PASCAL.  Raises UsageError for anything else, for an
    unknown preset, and for one that does not flow without limit.
    """
    return tuple(_parse(text) for text in texts)


def _parse(text: str) -> ConversionRule:
    where, _, what = text.rpartition("=")
    name, _, beyond = what.rpartition("@")
    kind, _, number = beyond.partition(":")
    try:
        value = float(number)
    except ValueError:
        value = np.nan
    sound = np.isfinite(value) and (kind == TIME or value > 0.0)
    if not name or kind not in KINDS or not sound:
        raise UsageError(
            f"{OPTION} {text} is not a material and a limit",
            f"give a preset that flows and a limit above zero: {OPTION} honey@time:48,"
            f" powder-snow@strain:0.1 or wet-sand@stress:2000, and before it, if not all bodies are"
            f" meant, the path of a prim or a box: {OPTION} /World/Bar=honey@time:48",
        )
    preset = find_preset(name.strip())
    made = preset.material(1.0, None)
    if not LAWS[made.law].unbounded:
        raise UsageError(
            f"{OPTION} {text}: {preset.name} does not flow without limit, and only such presets"
            " can be given",
            "name one of the flowing presets: gf-usd materials lists them",
        )
    where, box = where.strip(), None
    if where and not where.startswith("/"):
        low, high = parse_corners(OPTION, text, where)
        box = MaterialBox(text=text, material=preset.name, low=low, high=high)
        where = ""
    return ConversionRule(
        text=text, path=where, box=box, material=preset.name, limit=Limit(kind=kind, value=value)
    )


def with_conversions(
    asset: Asset,
    assigned: Assigned,
    rules: Sequence[ConversionRule],
    solid: Solid,
    bodies: BodyPlan,
    spec: StageSpec,
    unit: float,
    stated: Mapping[str, float],
    *,
    surface: bool,
) -> Assigned:
    """The particles with their conversions, and the tables with the new materials at the end.

    asset : with the meshes as they were authored, before some were joined.
    unit : [m] of the stage; stated : values of the options, which replace those of materials;
        surface : flowing material is shown as a surface.

    Later rules have precedence.
    Raises InputError for a rule that matches no particle, or only particles that flow from the
    start.
    """
    if not rules:
        return assigned
    path, particles = asset.facts.path, assigned.particles
    count = len(assigned.tables[0])
    flows = unbounded(particles, assigned.tables[0])
    of = np.full(len(particles), -1)
    parts = [*material_parts(solid, spec), *_joined_parts(solid, asset)]
    named = any(rule.box is None for rule in rules)
    slot = part_of_particles(solid, particles, parts) if named else np.zeros(0, int)
    meant = [_matching_particles(rule, particles, slot, solid, parts, unit) for rule in rules]
    for k, (rule, mine) in enumerate(zip(rules, meant)):
        if not mine.any():
            raise InputError(
                f"{path}: {OPTION} {rule.text} selects none of the {len(particles)} particles"
                f"{_why_none(rule, solid, asset)}",
                "name a baked prim (gf-usd inspect lists them), a GeomSubset whose material is used"
                " (without --material), or a box that holds particles",
            )
        if (mine & ~flows).sum() == 0:
            raise InputError(
                f"{path}: {OPTION} {rule.text}: all of its {int(mine.sum())} particles flow from"
                " the start",
                "leave it out, or give the body a solid --material",
            )
        of[mine & ~flows] = k
    made, notes = [], []
    shown = "a surface around the particles is shown" if surface else "particles are shown"
    for k, rule in enumerate(rules):
        rows = np.flatnonzero(of == k)
        if not len(rows):
            raise InputError(
                f"{path}: {OPTION} {rule.text}: later ones override it for all of its particles",
                "leave it out, or name it after them",
            )
        made.append(Conversion(particles=rows, material=count + k, limit=rule.limit))
        touched = sorted({int(b) for b in particles.body_of[rows]})
        names = ", ".join(f"<{p}>" for b in touched for p in bodies.surfaces[b][:4])
        notes.append(
            f"{len(rows)} of {len(particles)} particles, of {names}, become {rule.material}"
            f" {rule.limit.text}; from the first of them on {shown}, not the mesh"
        )
    targets = tuple(rule.becomes(stated) for rule in rules)
    return replace(
        assigned,
        particles=replace(particles, conversions=tuple(made)),
        tables=tuple((*table, *targets) for table in assigned.tables),
        notes=(*assigned.notes, *notes),
    )


def _joined_parts(solid: Solid, asset: Asset) -> list[MaterialPart]:
    """The meshes of which joined surfaces consist, as subsets of the faces of those.

    Joined surfaces have the faces of their meshes in the order of the asset.
    """
    found = []
    whole = {path: group[0] for group in solid.joined for path in group}
    first = dict.fromkeys(whole.values(), 0)
    for mesh in asset.surfaces:
        name = whole.get(mesh.path)
        if name is None:
            continue
        faces = first[name] + np.arange(len(mesh.face_counts))
        first[name] += len(faces)
        subset = SubsetMaterial(
            path=mesh.path, faces=faces, spec=PhysicsMaterialSpec(), material=None
        )
        found.append(MaterialPart(surface=solid.filled[name], subset=subset))
    return found


def _why_none(rule: ConversionRule, solid: Solid, asset: Asset) -> str:
    """The reason why a prim has no particles, as the end of a message; "": not known."""
    if not rule.path:
        return ""
    for path, reason in (*solid.embedded, *asset.skipped):
        if _is_at_or_below(path, rule.path) or _is_at_or_below(rule.path, path):
            return f": <{path}> is not filled: {reason}"
    return ""


def _matching_particles(
    rule: ConversionRule,
    particles: Particles,
    slot: Ints,
    solid: Solid,
    parts: Sequence[MaterialPart],
    unit: float,
) -> NDArray[np.bool_]:
    """(N,) which particles match a rule; slot : (N,) of `part_of_particles`, for a prim."""
    if rule.box is not None:
        return np.asarray(rule.box.holds(particles.X, unit), bool)
    named = [
        _is_at_or_below(
            solid.surfaces[part.surface].path if part.subset is None else part.subset.path,
            rule.path,
        )
        for part in parts
    ]
    return np.array(named, bool)[slot]


def _is_at_or_below(path: str, root: str) -> bool:
    """Whether a prim is another one or below it; every prim is below ""."""
    return not root or path == root or path.startswith(root.rstrip("/") + "/")
