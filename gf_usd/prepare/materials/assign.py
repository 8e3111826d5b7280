"""Materials for all particles of a bake, one table of them for each variant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gf_usd.core.frames.particles import Particles
from gf_usd.core.materials.material import Material
from gf_usd.core.stage import StageSpec
from gf_usd.prepare.bodies.plan import BodyPlan
from gf_usd.prepare.materials.blending import with_own_values
from gf_usd.prepare.materials.checks import flow_notes, require_parameters, unused_notes
from gf_usd.prepare.materials.densities import StatedDensity, stated_densities
from gf_usd.prepare.materials.mass_scaling import mass_scaled
from gf_usd.prepare.materials.parts import in_regions, material_parts, part_of_particles
from gf_usd.prepare.materials.regions import Region, owners
from gf_usd.prepare.materials.table import Authored, table

if TYPE_CHECKING:
    from gf_usd.geometry.solid import Solid


@dataclass(frozen=True, kw_only=True)
class Assigned:
    """Particles with their materials."""

    particles: Particles  # their `material` indexes each of the tables
    tables: tuple[tuple[Material, ...], ...]  # one for each preset
    main: tuple[Material, ...]  # that most of the volume has; named after the preset
    notes: tuple[str, ...]
    stated: tuple[StatedDensity, ...] = ()  # by the stage, where its materials are used


def assign_materials(
    path: Path,
    solid: Solid,
    particles: Particles,
    bodies: BodyPlan,
    spec: StageSpec,
    presets: Sequence[Any],
    *,
    law: str | None,
    stated: Mapping[str, float],
    regions: Sequence[Region],
    unit: float,
    blend_width: float,
    mass_scaling: float,
) -> Assigned:
    """The materials of all particles, for each preset.

    path : of the asset, for messages.
    presets : as in `table`, one variant each.
    law, stated : values of the options, which replace those of materials; law None: not given.
    unit : [m] of the stage; blend_width : [m]; mass_scaling : see `mass_scaled`.

    Raises InputError for a law without its parameters and a region without particles, and
    UsageError for `--mass-scaling` where nothing flows.
    """

    def finish(preset: Any, radius: float) -> Material:
        return replace(preset.material(radius, law), **stated)

    parts = material_parts(solid, spec, regions)
    slot = part_of_particles(solid, particles, parts)
    of, regional = owners(regions, solid.surfaces, particles, unit)
    slot = in_regions(slot, particles, parts, of)
    tables, index, flow, densities, unused = [], particles.material, [], (), ()
    for preset in presets:
        made, index = table(preset, parts, slot, particles, solid, bodies, spec, finish)
        made = tuple(replace(m, law=law or m.law, **stated) for m in made)
        tables.append(made)
        of_part = {int(k): made[int(index[slot == k][0])] for k in np.unique(slot)}
        require_parameters(path, particles, slot, of_part, solid, spec)
        flow += flow_notes(preset, law, parts, of_part, solid, spec)
        if isinstance(preset, Authored):
            densities = stated_densities(of_part, slot, particles, parts, solid, spec)
            unused = unused_notes(parts, particles, solid, spec, finish, unit)
    particles, own = with_own_values(
        replace(particles, material=index),
        tables[0], slot, parts, solid, bodies, spec, blend_width,
    )  # fmt: skip
    tables, particles, scaled = mass_scaled(tables, particles, mass_scaling)
    most = int(np.bincount(particles.material, particles.V0).argmax())
    return Assigned(
        particles=particles,
        tables=tuple(tables),
        main=tuple(replace(t[most], name=p.name) for p, t in zip(presets, tables)),
        notes=(*regional, *own, *dict.fromkeys(flow), *scaled, *unused),
        stated=densities,
    )
