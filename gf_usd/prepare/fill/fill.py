"""Makes a plan from an asset: its steps, each with what the next one needs.

The steps read `Inputs`, with the completed request; what they call is given the values that it
needs.  Only `settings.resolve`, `options.implied` and `options.choices` take the whole request.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gf_usd.core.arrays import triple
from gf_usd.core.asset import Asset, Surface
from gf_usd.core.frames.choices import Choices
from gf_usd.core.frames.settings import Settings
from gf_usd.core.stage import Pin, StageSpec, Triple
from gf_usd.prepare.bodies.coarse import cage_notes, coarse_note
from gf_usd.prepare.bodies.contact import (
    LimbPlan,
    contact_setup,
    penetration_notes,
    require_clear_start,
    separate_limbs,
)
from gf_usd.prepare.bodies.facing import turned_to_bodies
from gf_usd.prepare.bodies.flesh.character_file import CharacterFile
from gf_usd.prepare.bodies.flesh.characters import without_props, worn_meshes
from gf_usd.prepare.bodies.flesh.poses import Poses
from gf_usd.prepare.bodies.flow import flow_of
from gf_usd.prepare.bodies.grounds import (
    floor_notes,
    ground_notes,
    without_room_parts,
    without_scenery,
)
from gf_usd.prepare.bodies.open_bodies import comes_off_notes, open_bodies
from gf_usd.prepare.bodies.sampling import SampledBodies, spacing_of
from gf_usd.prepare.bodies.velocities import start_velocities, unpinned_animation_notes
from gf_usd.prepare.fill.bodies import fill_bodies
from gf_usd.prepare.fill.constraints import Constraints, constrain, springs_of
from gf_usd.prepare.fill.inputs import (
    CONTACT,
    LIMBS,
    MESHES,
    Inputs,
    Progress,
    resolution_function,
    silent,
)
from gf_usd.prepare.fill.materials import (
    assign,
    mass_notes,
    material_changes,
    settings_of_materials,
    slenderness_notes,
    softness_notes,
)
from gf_usd.prepare.fill.meshes import build_meshes
from gf_usd.prepare.fill.notes import (
    advice_notes,
    no_internals_notes,
    not_baked_notes,
    not_filled_notes,
    paper_notes,
    rate_notes,
)
from gf_usd.prepare.fill.parts import Parts, collider_of, of_their_own, one_thing
from gf_usd.prepare.fill.shot import Length, plan_length, plan_shot
from gf_usd.prepare.materials.assign import Assigned
from gf_usd.prepare.materials.densities import implausible_densities
from gf_usd.prepare.materials.flowing import dispatch
from gf_usd.prepare.options.choices import chosen, require_stored
from gf_usd.prepare.options.implied import proposed_floor, with_flow, with_stage
from gf_usd.prepare.options.request import Request
from gf_usd.prepare.outputs.outputs import Outputs
from gf_usd.prepare.plan import Plan, embedded_points
from gf_usd.prepare.settings import DEFAULT_PARTICLES, Animation
from gf_usd.readers.notes import ANIMATED, POSED, merged

if TYPE_CHECKING:
    from gf_usd.geometry.diagnosis import Diagnosis
    from gf_usd.geometry.solid import Solid


def fill(
    asset: Asset,
    request: Request,
    presets: Sequence[Any],
    law: str | None,
    files: Outputs,
    file: Path | None,
    *,
    spec: StageSpec,
    repair: bool,
    known: Sequence[Diagnosis] = (),
    built: Solid | None = None,
    more_pins: Callable[[Solid], Sequence[Pin]] | None = None,
    progress: Progress = silent,
) -> tuple[Plan, Solid]:
    """A plan for an asset.  Raises InputError where the asset is refused.

    file : its USD form; None: it has none, and spec has the motion of its obstacles.
    spec : the specification of its stage.
    known : result of `diagnose` for its surfaces, if available.
    built : its solid without `repair`, if available.
    more_pins : of the solid, in addition to those of the options.
    progress : called with each step that takes long for a large mesh.
    """
    from gf_usd.geometry.sampling.tets import tet_lattices
    from gf_usd.geometry.skinning import SKIN_NOTES

    progress(MESHES)
    unit = asset.facts.units.length
    paper = request.preset == "paper"
    in_scene = file is not None and not request.flesh
    if in_scene:
        asset = without_room_parts(asset, repair=repair, bodies=of_their_own(spec))
    build = partial(
        build_meshes, repair=repair, resolution=resolution_function(request, spec, unit),
        paper=paper, parts=Parts(spec) if in_scene else None,
        flesh=request.flesh, known=known,
        one_thing=partial(one_thing, asset, spec) if in_scene else None,
        collider_of=partial(collider_of, spec),
    )  # fmt: skip
    meshes = build(asset, built=built)
    source = CharacterFile(asset, file, request.start) if request.flesh and file else None
    if source is not None:
        by_count = spacing_of(meshes.solid.volume, request.particles or DEFAULT_PARTICLES)
        spacing = request.spacing * unit if request.spacing else by_count
        alone = without_props(asset, meshes.solid, source, spacing)
        if alone is not asset:
            asset = alone
            meshes = build(asset)
        worn = worn_meshes(asset, meshes.solid, source, spacing, repaired=repair)
        if worn:
            meshes = build(asset, unfilled=worn)
    scenery: list[Surface] = []
    come_off: tuple[str, ...] = ()
    if in_scene:
        asset, solid = without_scenery(meshes.asset, meshes.solid)
        kept = {s.path for s in asset.surfaces}
        scenery = [s for s in meshes.asset.surfaces if s.path not in kept]
        meshes = replace(meshes, asset=asset, solid=solid)
        if not repair and built is None:  # what is filled again has been noted
            come_off = comes_off_notes(open_bodies(asset, solid, of_their_own(spec)))
    asset, solid = meshes.asset, meshes.solid
    gravity_keys = spec.physics.gravity_keys if request.gravity is None else ()
    flow = dispatch(solid, spec, presets, law, request.regions, request.converted, unit)
    request, flow_notes = with_flow(request, flow)
    floating = request.floats and not spec.physics.obstacles
    request, stage_notes = with_stage(request, spec, asset)
    inputs = Inputs(
        meshes=meshes, request=request, spec=spec, presets=presets, law=law, file=file, flow=flow,
        characters=source, progress=progress,
    )  # fmt: skip
    filled = fill_bodies(inputs)
    solid.release()
    shot = plan_shot(inputs, filled, gravity_keys)
    constraints = constrain(inputs, filled, shot, more_pins(solid) if more_pins else ())
    changes = material_changes(inputs)
    length = plan_length(inputs, shot, constraints.pins, changes)
    settings = length.settings
    materials = assign(inputs, filled, settings, changes, repeats=bool(constraints.cycle))
    each = settings_of_materials(inputs, filled, settings, materials.main, constraints.pins)
    fall = shot.gap / float(np.array(settings.normal) @ asset.facts.up)
    softness = mass_notes(inputs)
    softness += softness_notes(inputs, materials, settings, length.physics)
    if not constraints.pins:
        softness += slenderness_notes(inputs, filled, materials, settings, fall)
    choices, split_notes = _choose_outputs(inputs, filled, materials, files, length)
    limbs, overlap_notes = _plan_contact(inputs, filled, materials, length, constraints)
    tets = tet_lattices(limbs.particles, limbs.samples) if request.tets else ()
    copies = {t.key: t.copy for t in tets if t.copy is not None}
    goals, goal_notes = springs_of(inputs, filled, shot, constraints.flesh, limbs, settings)
    advice = tuple(spec.advice[s.path] for s in solid.surfaces) if spec.advice else ()
    unpinned: tuple[str, ...] = ()
    if not goals:
        unpinned = unpinned_animation_notes(
            filled.bodies, spec.bodies, limbs.particles, constraints.pins
        )
    drawn = _moving_surfaces(inputs, filled, materials)
    spacing, refined = filled.particles.spacing, request.max_edge_length is not None
    cages = cage_notes(drawn, spacing, refined=refined)
    heavy, stated_heavy = implausible_densities(materials.stated, asset.facts.units)
    coarse, coarse_meshes = coarse_note(drawn, spacing, refined=refined)
    joined_to = {path for pin in constraints.pins for path in pin.meshes}
    notes = (
        *_ground_notes(inputs, scenery), *_asset_notes(asset, shot.animation),
        *(advised := advice_notes(advice)), *meshes.notes, *filled.count_notes, *flow_notes,
        *stage_notes, *_floor_notes(floating, asset, constraints.flesh.poses),
        *rate_notes(asset.facts, settings, request.fps),
        *shot.notes, *length.notes, *constraints.attachment_notes, *goal_notes,
        *filled.resolution_notes, *filled.bodies.notes, *overlap_notes,
        *cages, *filter(None, (coarse,)), *unpinned,
        *filled.character_notes, *constraints.flesh.notes, *limbs.notes, *materials.notes,
        *softness, *length.physics.notes,
        *come_off, *not_filled_notes(solid, constraints.flesh.sheets, joined_to),
        *not_baked_notes(asset.skipped), *SKIN_NOTES.get(settings.skin, ()),
        *paper_notes(materials.main, each), *split_notes,
        *no_internals_notes(materials.main, settings),
    )  # fmt: skip
    moving = {s.path for s in asset.surfaces}
    plan = Plan(
        asset=asset,
        particles=limbs.particles,
        samples=limbs.samples,
        materials=materials.main,
        tables=materials.tables,
        settings=each[0],
        each=each,
        outputs=files,
        source=files.source or file or asset.facts.path,
        embedded=solid.embedded,
        repairs=tuple(r for r in meshes.repairs if r.path in moving),
        drop=fall,
        pins=constraints.pins,
        goals=goals,
        sheets=constraints.flesh.sheets,
        shapes=constraints.flesh.shapes,
        cycle=constraints.cycle if request.cycles.repeats else 0,
        repeats=request.cycles.repeats,
        until_periodic=request.cycles.until_periodic,
        choices=choices,
        extension=length.extension,
        bodies=filled.bodies,
        contact_setup=limbs.contact_setup,
        embedded_copies={**limbs.embedded_copies, **copies},
        tets=tets,
        velocity=_start_velocities(inputs, filled, limbs, settings),
        advice=advice,
        coarse=coarse_meshes,
        lost=meshes.lost,
        heavy=heavy,
        stated_heavy=stated_heavy,
        notes=merged(notes, advised),
    )
    return plan, solid


def _floor_notes(floating: bool, asset: Asset, poses: Poses | None) -> tuple[str, ...]:
    return (proposed_floor(asset, poses.lowest, poses.still),) if floating and poses else ()


def _ground_notes(inputs: Inputs, scenery: Sequence[Surface]) -> tuple[str, ...]:
    if inputs.file is None:  # bodies and obstacles of a scene have calls of their own
        return ()
    asset = inputs.asset
    filled = inputs.solid.filled
    by_default = scenery and inputs.request.floor is None and not inputs.request.pins
    return (
        *(floor_notes(scenery, inputs.solid.surfaces, asset.facts) if by_default else ()),
        *ground_notes(
            (*inputs.solid.surfaces, *(s for s in asset.surfaces if s.path not in filled)),
            dict(inputs.solid.embedded),
            asset.facts.up,
            asset.facts.units.length,
        ),
    )


def _moving_surfaces(
    inputs: Inputs, filled: SampledBodies, materials: Assigned
) -> Sequence[Surface]:
    """The surfaces that particles do not replace in every variant."""
    hidden = [
        set(flow_of(inputs.solid, filled.bodies, materials.particles, table).meshes)
        for table in materials.tables
    ]
    return [s for s in inputs.solid.surfaces if s.path not in set.intersection(*hidden)]


def _choose_outputs(
    inputs: Inputs,
    filled: SampledBodies,
    materials: Assigned,
    files: Outputs,
    length: Length,
) -> tuple[Choices, tuple[str, ...]]:
    """What is written, and notes on it."""
    request, settings, particles = inputs.request, length.settings, materials.particles
    flow = flow_of(inputs.solid, filled.bodies, particles, materials.tables[0])
    choices, notes = chosen(
        request, files, settings, inputs.asset, len(particles), length.open_end, flow
    )
    if (inputs.mixed or request.converted) and not choices.flowing:
        choices = replace(choices, flowing=flow.meshes)
    require_stored(choices.precision, particles, settings)
    return choices, notes


def _plan_contact(
    inputs: Inputs,
    filled: SampledBodies,
    materials: Assigned,
    length: Length,
    constraints: Constraints,
) -> tuple[LimbPlan, tuple[str, ...]]:
    """Contact between bodies, and notes on obstacles that are inside one.

    Raises InputError where bodies are moved into an obstacle.
    """
    request, asset, solid = inputs.request, inputs.asset, inputs.solid
    bodies, particles, settings = filled.bodies, materials.particles, length.settings
    inputs.progress(CONTACT)
    limbs = LimbPlan(
        particles=particles,
        samples=filled.samples,
        contact_setup=contact_setup(
            solid, bodies, length.physics, spacing=particles.spacing,
            self_contact=False
            if inputs.paper or settings.solver == "ul"
            else request.self_contact,
            meet_from=constraints.meet_from,
        ),
    )  # fmt: skip
    notes: tuple[str, ...] = ()
    if not inputs.paper:
        setup, turned = turned_to_bodies(limbs.contact_setup, particles, settings.lift)
        limbs = replace(limbs, contact_setup=setup)
        require_clear_start(asset.facts.path, particles, settings.lift, setup, inputs.unit)
        lifts = settings.floor is None and not constraints.pins
        free = (np.asarray(asset.facts.up, float), inputs.unit) if lifts else None
        notes = (*turned, *penetration_notes(particles, settings.lift, setup, bodies, free))
    if not inputs.paper and request.solver != "ul":
        inputs.progress(LIMBS)
        limbs = separate_limbs(
            solid, bodies, limbs, embedded_points(asset, constraints.flesh.sheets)
        )
    return limbs, notes


def _start_velocities(
    inputs: Inputs, filled: SampledBodies, limbs: LimbPlan, settings: Settings
) -> tuple[Any, ...]:
    options = inputs.request.parsed
    return tuple(
        start_velocities(
            inputs.asset, filled.bodies, inputs.spec.bodies, settings.time_scale, limbs.particles,
            velocity=_scaled(options["velocity"], inputs.unit),
            spin=_scaled(options["spin"], np.pi / 180.0),
        )
    )  # fmt: skip


def _scaled(vector: Triple | None, unit: float) -> Triple | None:
    return None if vector is None else triple(unit * np.array(vector))


def _asset_notes(asset: Asset, animation: Animation | None) -> tuple[str, ...]:
    """Notes on the asset; of its animation only where no --flesh follows it."""
    followed = animation is not None and animation.cached
    about_motion = (ANIMATED, POSED) if followed else ()
    return tuple(note for note in asset.facts.notes if not note.endswith(about_motion))
