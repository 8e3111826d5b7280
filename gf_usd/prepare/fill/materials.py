"""The step of `fill` that assigns materials, with their changes over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from gf_usd.core.frames.settings import Settings
from gf_usd.core.materials.material import Material
from gf_usd.core.mesh.measures import areas, signed_volume
from gf_usd.core.stage import Pin, StagePhysics, StageSpec
from gf_usd.prepare import paper as paper_options
from gf_usd.prepare.bodies.contact import skins
from gf_usd.prepare.bodies.sampling import SampledBodies
from gf_usd.prepare.fill.inputs import Inputs
from gf_usd.prepare.materials.assign import Assigned, assign_materials
from gf_usd.prepare.materials.checks import (
    FallingBody,
    folding_notes,
    require_standing,
    require_weighable,
    stiff_in_fall,
)
from gf_usd.prepare.materials.conversion import with_conversions
from gf_usd.prepare.materials.flowing import require_dispatched, require_outside
from gf_usd.prepare.materials.over_time import with_value_keys
from gf_usd.prepare.materials.table import Authored
from gf_usd.prepare.options.implied import replaced_masses, stated_values

if TYPE_CHECKING:
    from gf_usd.geometry.solid import Solid
    from gf_usd.readers.usd_bake.keys import MaterialKeys

# At most, the slenderest, whose thickness is measured: 0.6 s of the 26 s that an inspection of 100
# balls of 5,000 triangles takes.
MEASURED_BODIES = 16
TINY = float(np.finfo(float).tiny)


def material_changes(inputs: Inputs) -> MaterialKeys | None:
    """The time samples of the materials, where the bake uses those of the stage."""
    from gf_usd.readers.usd_bake.keys import material_keys

    of_stage = inputs.spec.says_material and isinstance(inputs.presets[0], Authored)
    if inputs.file is None or not of_stage:
        return None
    paths = [s.path for s in inputs.asset.surfaces]
    return material_keys(inputs.file, inputs.asset.facts, paths)


def assign(
    inputs: Inputs,
    filled: SampledBodies,
    settings: Settings,
    changes: MaterialKeys | None,
    *,
    repeats: bool,
) -> Assigned:
    """The materials of the particles.  repeats : see `with_value_keys`."""
    request, asset, solid, unit = inputs.request, inputs.asset, inputs.solid, inputs.unit
    bodies, stated = filled.bodies, stated_values(inputs.request)

    def assigned(spec: StageSpec) -> Assigned:
        return assign_materials(
            asset.facts.path, solid, filled.particles, bodies, spec, inputs.presets,
            law=inputs.law, stated=stated, regions=request.regions, unit=unit,
            blend_width=(request.blend_width or 0.0) * unit, mass_scaling=settings.mass_scaling,
        )  # fmt: skip

    materials = with_conversions(
        asset, assigned(inputs.spec), request.converted, solid, bodies, inputs.spec, unit, stated,
        surface=bool(request.surface),
    )  # fmt: skip
    if changes is not None and inputs.file is not None:
        materials = with_value_keys(
            materials, changes, asset, inputs.file, inputs.spec, settings, assigned,
            repeats=repeats,
        )  # fmt: skip
    particles = materials.particles
    for table in materials.tables:
        require_weighable(asset.facts.path, particles, np.asarray(particles.material), table)
    if inputs.mixed:
        flows = bodies.flows(inputs.flow.first)
        require_dispatched(asset.facts.path, particles, materials.tables, solid, flows)
        require_outside(asset.facts.path, particles, flows, skins(solid, bodies.of_surface))
    return materials


def settings_of_materials(
    inputs: Inputs,
    filled: SampledBodies,
    settings: Settings,
    materials: Sequence[Material],
    pins: Sequence[Pin],
) -> tuple[Settings, ...]:
    """The settings of the bake of each material."""
    request = inputs.request
    return tuple(
        paper_options.of_material(
            settings, m, float(filled.bodies.radius.max()), paper=inputs.paper,
            pinned=any(not pin.rigid for pin in pins), wls=request.wls,
            procrustes=request.procrustes, clamp=request.parsed["clamp"],
            stress_cap=request.parsed["stress_cap"],
            given={name for name in ("clamp", "stress_cap") if getattr(request, name) is not None},
        )
        for m in materials
    )  # fmt: skip


def softness_notes(
    inputs: Inputs, materials: Assigned, settings: Settings, physics: StagePhysics
) -> tuple[str, ...]:
    """Notes on materials that are too soft to carry the bodies."""
    up = inputs.asset.facts.up
    return require_standing(
        inputs.asset.facts.path, [m for table in materials.tables for m in table],
        max(float(np.ptp(s.face_points @ up)) for s in inputs.solid.surfaces),
        abs(float(np.dot(settings.gravity, up))),
        carried=inputs.request.flesh or (settings.floor is None and not physics.colliders),
    )  # fmt: skip


def mass_notes(inputs: Inputs) -> tuple[str, ...]:
    """A note where presets replace masses of the stage."""
    named = [one.name for one in inputs.presets if not isinstance(one, Authored)]
    return replaced_masses(inputs.spec, ",".join(named), inputs.request) if named else ()


def slenderness_notes(
    inputs: Inputs, filled: SampledBodies, materials: Assigned, settings: Settings, fall: float
) -> tuple[str, ...]:
    """Notes on stiff materials of which bodies that fall onto the floor are too slender.

    fall : [m] from which they do.
    """
    if settings.floor is None or fall <= 0.0 or inputs.request.flesh:
        return ()  # held, or in the floor
    gravity = abs(float(np.dot(settings.gravity, settings.normal)))
    particles, solid = materials.particles, inputs.solid
    stiff: dict[int, list[Material]] = {}  # by body
    for body in range(filled.bodies.count):
        mine = slice(None) if particles.body is None else np.asarray(particles.body) == body
        used = np.unique(np.asarray(particles.material)[mine])
        listed = [table[k] for table in materials.tables for k in used]
        if found := [m for m in listed if stiff_in_fall(m, fall, gravity)]:
            stiff[body] = found
    parts = {body: solid.part(np.flatnonzero(filled.bodies.of_surface == body)) for body in stiff}
    slenderest = sorted(parts, key=lambda body: _slenderness(parts[body]), reverse=True)
    made = []
    for body in slenderest[:MEASURED_BODIES]:
        if (one := _falling_body(parts[body], stiff[body])) is not None:
            made.append(one)
    return folding_notes(made, fall, gravity)


def _length(part: Solid) -> float:
    """The longest edge [m] of the box of a body."""
    return float((part.high - part.low).max())


def _slenderness(part: Solid) -> float:
    """An estimate of the length of a body over its thickness, 2 V / A as that of a plate."""
    meshes = [(s.points, t) for s, t in zip(part.surfaces, part.triangles)]
    volume = sum(abs(signed_volume(*mesh)) for mesh in meshes)
    area = sum(float(areas(*mesh).sum()) for mesh in meshes)
    return _length(part) * area / max(2.0 * volume, TINY)


def _falling_body(part: Solid, stiff: Sequence[Material]) -> FallingBody | None:
    """The body, named after its longest mesh; None where its thickness is not known."""
    from gf_usd.geometry.thin.thickness import thickness

    thick = thickness(part)
    if thick is None:
        return None
    longest = max(part.surfaces, key=lambda s: float(np.ptp(s.face_points, axis=0).max()))
    return FallingBody(path=longest.path, length=_length(part), thick=thick.median, materials=stiff)
