"""Makes a plan from an asset: bodies, particles, materials, settings, contact.

No function that is called from here takes the whole request, except `settings.resolve`,
`options.implied` and `options.choices`, which complete it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gf_usd.core.arrays import Ints, triple
from gf_usd.core.asset import Asset
from gf_usd.core.errors import UsageError
from gf_usd.core.frames import (
    MIXED,
    Particles,
    Settings,
    SurfaceSamples,
    sampled,
    written,
)
from gf_usd.core.materials.laws import LAWS
from gf_usd.core.materials.material import Material
from gf_usd.core.stage import Pin, StageSpec, Triple
from gf_usd.prepare import paper as paper_options
from gf_usd.prepare.bodies.cages import cage_notes
from gf_usd.prepare.bodies.characters import characters_of
from gf_usd.prepare.bodies.contact import (
    LimbPlan,
    contact_setup,
    penetration_notes,
    require_clear_start,
    separate_limbs,
    skins,
)
from gf_usd.prepare.bodies.flow import flow_of
from gf_usd.prepare.bodies.plan import plan_bodies
from gf_usd.prepare.bodies.velocities import start_velocities, unpinned_animation_notes
from gf_usd.prepare.materials.assign import Assigned, assign_materials
from gf_usd.prepare.materials.checks import require_standing
from gf_usd.prepare.materials.conversion import with_conversions
from gf_usd.prepare.materials.flowing import dispatch, require_dispatched, require_outside
from gf_usd.prepare.materials.over_time import with_value_keys
from gf_usd.prepare.materials.table import Authored
from gf_usd.prepare.options.choices import chosen, require_resolved, require_stored
from gf_usd.prepare.options.fields import upward_note
from gf_usd.prepare.options.implied import stated_values, with_flow, with_stage
from gf_usd.prepare.options.request import Request
from gf_usd.prepare.outputs import Outputs
from gf_usd.prepare.pins import (
    Flesh,
    attachment_pins,
    flesh_of,
    make_pins,
    read_animation,
    soft_attachment_goals,
)
from gf_usd.prepare.plan import Plan, embedded_points
from gf_usd.prepare.settings import (
    Resolution,
    floor_plane,
    resolution,
    resolve,
    settled_frames,
)
from gf_usd.readers.notes import ANIMATED
from gf_usd.readers.usd_bake.spec import read_motion

if TYPE_CHECKING:
    from gf_usd.geometry.diagnosis import Diagnosis
    from gf_usd.geometry.repair import Repairs
    from gf_usd.geometry.solid import Solid
    from gf_usd.geometry.thin.thickness import Thickness


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
) -> tuple[Plan, Solid]:
    """A plan for an asset.  Raises InputError where the asset is refused.

    file : its USD form; None: it has none, and spec has the motion of its obstacles.
    spec : the specification of its stage.
    known : result of `diagnose` for its surfaces, if available.
    built : its solid without `repair`, if available.
    more_pins : of the solid, in addition to those of the options.
    """
    from gf_usd.core.mesh import signed_volume
    from gf_usd.geometry.diagnosis import diagnose, lost_volume_warning, tolerated_defects
    from gf_usd.geometry.repair import consistently_oriented_asset, notes
    from gf_usd.geometry.sampling.contact_samples import sample_surface
    from gf_usd.geometry.sampling.particles import sample_solid
    from gf_usd.geometry.sampling.tets import tet_lattices
    from gf_usd.geometry.skinning import SKIN_NOTES
    from gf_usd.geometry.solid import build_solid
    from gf_usd.geometry.thin.thickness import thickness
    from gf_usd.readers.usd_bake.keys import material_keys

    mended: tuple[str, ...] = ()
    agreed: tuple[str, ...] = ()
    follows = False  # a sheet is as thick as the spacing
    fitted: float | None = None  # [m] spacing of as many particles as asked for, sheets included
    if repair:
        asset, filled, repairs, fitted = repair_asset_for_fill(asset, request, spec)
        mended = notes(repairs)
        follows = any(one.thickened for one in repairs)
    else:
        asset, agreed = consistently_oriented_asset(asset)
        filled = asset
    solid = built or build_solid(filled, repaired=repair)
    if not (repair or built):
        by_path = {} if agreed else {seen.path: seen for seen in known}
        all_seen = [by_path.get(s.path) or diagnose(s) for s in solid.surfaces]
        said = (
            *(tolerated_defects(seen) for seen in all_seen),
            lost_volume_warning(all_seen, solid.volume),
        )
        mended = (*agreed, *filter(None, said))
    keys = spec.physics.gravity_keys if request.gravity is None else ()
    unit = asset.facts.units.length
    flow = dispatch(solid, spec, presets, law, request.regions, request.converted, unit)
    request, flowing = with_flow(request, flow)
    request, stated = with_stage(request, spec, asset)
    mixed = request.solver == MIXED
    paper = request.preset == "paper"
    closed = zip(solid.surfaces, solid.triangles, strict=True)
    asked = _resolution(
        request, spec, unit,
        lambda: {s.path: abs(signed_volume(s.points, triangles)) for s, triangles in closed},
        None if follows else lambda: (solid.volume, thickness(solid)),
    )  # fmt: skip
    wanted = 0 if paper or (asked.spacing and not fitted) else asked.particles
    asked = replace(asked, spacing=fitted or asked.spacing)

    def sample(of: Ints) -> Particles:
        return sample_solid(
            solid,
            particles=asked.particles if asked.spacing is None else None,
            spacing=asked.spacing,
            seed=request.seed or 0,
            uniform=paper,
            up=asset.facts.up_axis,
            bodies=of,
            scattered=None if paper else flow.first,
            later=None if paper else flow.flows & ~flow.first,
        )

    owners = {path: body.owner for path, body in spec.bodies.items()}
    spacing = asked.spacing or float(np.cbrt(solid.volume / (asked.particles or 1)))
    characters, told = characters_of(asset, file) if request.flesh and file else ({}, ())
    combine = request.combine or paper or request.solver == "ul"
    combine = combine or (request.flesh and not characters)
    bodies, particles = plan_bodies(
        asset, solid, spacing, sample, characters or owners, combine=combine,
        kinds=flow.first if mixed else None, characters=bool(characters),
    )  # fmt: skip
    mended += _count_note(wanted, particles, sheets=bool(fitted))
    _require_one_body(request, bodies.count)
    if paper or (flow.flows.any() and not mixed):
        # There every particle feels the floor; a mass of rho * area * spacing is its own.
        samples = SurfaceSamples(X=particles.X, area=particles.V0 / particles.spacing)
    else:
        samples = sample_surface(
            solid,
            particles.spacing,
            bodies.of_surface if bodies.count > 1 else None,
            asset.facts.up_axis,
        )
    if mixed:
        samples = samples.with_grains(particles, bodies.flows(flow.first))
    floor, normal = floor_plane(request.parsed["floor"], asset.facts.up, unit)
    # a sheet that was thickened reaches below what is drawn
    every_surface = (*asset.surfaces, *solid.surfaces)
    lowest = min(float((s.face_points @ normal).min()) for s in every_surface)
    radius = float(bodies.radius.max())
    animation = read_animation(asset, file, request.start) if request.flesh and file else None
    cached = animation is not None and animation.cached
    unread = request.flesh or request.solver == "ul"
    attachments = () if unread else spec.physics.attachments
    springs = () if unread else spec.physics.soft_attachments
    settings = resolve(
        request, asset.facts, radius, lowest, animation, keys,
        stated_fields=spec.physics.fields, attached=bool(attachments or springs),
    )  # fmt: skip
    stated += upward_note(request.parsed["gravity"])
    gap = float(np.dot(settings.lift, normal)) + lowest - (floor or 0.0)
    require_resolved(request, settings, gap, particles.spacing)
    pins = tuple(more_pins(solid)) if more_pins else ()
    flesh = Flesh()
    cycle = meet_from = 0  # frames
    if file is not None:
        names = request.listed("pins")
        every = sampled(settings)
        pins += make_pins(names, asset, solid, every, file, rest=request.start)
        held, attached = attachment_pins(attachments, asset, solid, every, file, request.start)
        pins += held
        stated += attached
    if animation and file is not None:
        cycle = animation.cycle(written(settings)) if request.loop else 0
        flesh = flesh_of(
            asset, solid, particles.X, samples, sampled(settings), animation, file,
            share=request.bone_radius, frequency=request.goal_frequency,
            damping=request.goal_damping, squish=request.squish, stretch=request.stretch,
            lattice=particles.lattice, spacing=particles.spacing,
            cycle=cycle * settings.samples_per_frame, repeats=request.cycles.repeats,
            rigid=request.listed("rigid"), bodies=bodies,
        )  # fmt: skip
        pins += flesh.pins
        if characters:
            repeated = cycle * settings.samples_per_frame * request.cycles.repeats
            meet_from = animation.lead(sampled(settings), repeated)
    if file is not None:
        names = [name for name in request.listed("rigid") if name not in flesh.rigid]
        every = sampled(settings)
        pins += make_pins(names, asset, solid, every, file, rest=request.start, option="--rigid")
    physics = spec.physics
    left_out = {*physics.attachments, *physics.soft_attachments} - {*attachments, *springs}
    if left_out:
        stated += (f"{len(left_out)} attachments are not read with --flesh and --solver ul",)
    # Without anything below them bodies fall for ever.
    falls = (settings.floor is None and not physics.colliders) or _weightless(settings)
    changes = None
    if file is not None and spec.says_material and isinstance(presets[0], Authored):
        changes = material_keys(file, asset.facts, [s.path for s in asset.surfaces])
    changing = changes is not None and bool(changes.codes)
    pushed = bool(pins or springs or settings.fields) or changing
    open_end = request.length_is_open and not (falls or pushed)
    shot = settings
    if open_end:
        settings = replace(settings, frames=settled_frames(settings.frames))
    if physics.colliders and file is not None:
        every = sampled(settings)
        times = [every.time_code(i) for i in range(every.frames)]
        moving = read_motion(asset, file, rest=request.start, times=times, elastic=False)
        physics = replace(moving, of_files=physics.of_files)
    if open_end and any(one.deformed is not None for one in physics.colliders):
        open_end, settings = False, shot  # its points may move for as long as there are frames

    def assigned(spec: StageSpec) -> Assigned:
        return assign_materials(
            asset.facts.path, solid, particles, bodies, spec, presets,
            law=law, stated=stated_values(request), regions=request.regions, unit=unit,
            blend_width=(request.blend_width or 0.0) * unit, mass_scaling=settings.mass_scaling,
        )  # fmt: skip

    materials = with_conversions(
        asset.facts.path, assigned(spec), request.converted, solid, bodies, spec, unit,
        stated_values(request), surface=bool(request.surface),
    )  # fmt: skip
    if changes is not None and file is not None:
        materials = with_value_keys(
            materials, changes, asset, file, spec, settings, assigned, repeats=bool(cycle)
        )
    particles, made = materials.particles, materials.main
    if mixed:
        flows = bodies.flows(flow.first)
        require_dispatched(asset.facts.path, particles, materials.tables, solid, flows)
        require_outside(asset.facts.path, particles, flows, skins(solid, bodies.of_surface))
    held = any(not pin.rigid for pin in pins)
    each = tuple(
        paper_options.of_material(
            settings, m, radius, paper=paper, pinned=held, wls=request.wls,
            procrustes=request.procrustes, clamp=request.parsed["clamp"],
            stress_cap=request.parsed["stress_cap"],
            given={name for name in ("clamp", "stress_cap") if getattr(request, name) is not None},
        )
        for m in made
    )  # fmt: skip
    weak = require_standing(
        asset.facts.path, [m for table in materials.tables for m in table],
        max(float(np.ptp(s.face_points @ asset.facts.up)) for s in solid.surfaces),
        abs(float(np.dot(settings.gravity, asset.facts.up))),
        carried=request.flesh or (settings.floor is None and not physics.colliders),
    )  # fmt: skip
    drawn = flow_of(solid, bodies, particles, materials.tables[0])
    choices, split = chosen(request, files, settings, asset, len(particles), open_end, drawn)
    if (mixed or request.converted) and not choices.flowing:
        choices = replace(choices, flowing=drawn.meshes)
    require_stored(choices.precision, particles, settings)
    unfilled = [
        f"<{path}> is not filled: it moves with the nearest body and does not collide; {why}"
        if not more
        else f"<{path}> and {more} more are not filled: they move with the nearest body and do not"
        f" collide; {why}"
        for path, more, why in _alike(solid.embedded)
    ]
    left = not_baked_notes(asset.skipped)
    advice = tuple(spec.advice[s.path] for s in solid.surfaces) if spec.advice else ()
    skin = SKIN_NOTES.get(settings.skin, ())
    limbs = LimbPlan(
        particles=particles,
        samples=samples,
        contact_setup=contact_setup(
            solid, bodies, physics, spacing=particles.spacing,
            self_contact=False if paper or settings.solver == "ul" else request.self_contact,
            meet_from=meet_from,
        ),
    )  # fmt: skip
    sunk: tuple[str, ...] = ()
    if not paper:
        require_clear_start(asset.facts.path, particles, settings.lift, limbs.contact_setup, unit)
        sunk = penetration_notes(particles, settings.lift, limbs.contact_setup, bodies)
    if not paper and request.solver != "ul":
        limbs = separate_limbs(solid, bodies, limbs, embedded_points(asset))
    tets = tet_lattices(limbs.particles, limbs.samples) if request.tets else ()
    copies = {t.key: t.copy for t in tets if t.copy is not None}
    goals = flesh.goals
    if springs and file is not None:
        goals = soft_attachment_goals(
            springs, asset, sampled(settings), file, request.start,
            body=bodies.embedded, copies=limbs.embedded_copies,
        )  # fmt: skip
        stated += (f"attachments pull parts of the body with springs: {', '.join(springs)}",)
    alone = () if goals else unpinned_animation_notes(bodies, spec.bodies, limbs.particles, pins)
    plan = Plan(
        asset=asset,
        particles=limbs.particles,
        samples=limbs.samples,
        materials=made,
        tables=materials.tables,
        settings=each[0],
        each=each,
        outputs=files,
        source=files.source or file or asset.facts.path,
        embedded=solid.embedded,
        drop=gap / float(normal @ asset.facts.up),
        pins=pins,
        goals=goals,
        cycle=cycle if request.cycles.repeats else 0,
        repeats=request.cycles.repeats,
        until_periodic=request.cycles.until_periodic,
        choices=choices,
        bodies=bodies,
        contact_setup=limbs.contact_setup,
        embedded_copies={**limbs.embedded_copies, **copies},
        tets=tets,
        velocity=tuple(
            start_velocities(
                asset, bodies, spec.bodies, settings.time_scale, limbs.particles,
                velocity=_scaled(request.parsed["velocity"], unit),
                spin=_scaled(request.parsed["spin"], np.pi / 180.0),
            )
        ),
        advice=advice,
        notes=(
            *(note for note in asset.facts.notes if not (cached and note.endswith(ANIMATED))),
            *(one.note for one in advice),
            *mended, *flowing, *stated, *([asked.note] if asked.note else ()), *bodies.notes, *sunk,
            *cage_notes(
                solid.surfaces, particles.spacing, refined=request.max_edge_length is not None
            ),
            *alone, *told, *flesh.notes, *limbs.notes, *materials.notes, *weak,
            *physics.notes,
            *unfilled, *left, *skin, *_options(made, each), *split,
            *_nothing_remembered(made, settings),
        ),
    )  # fmt: skip
    return plan, solid


def not_baked_notes(skipped: Iterable[tuple[str, str]]) -> tuple[str, ...]:
    """The notes on prims that are not baked, each with a reason of the reader."""
    from gf_usd.readers.usd.select import KINDS, PROXY, REPEATED

    stays = "keeps the place and motion of its source and does not follow what is baked"
    ways = {
        KINDS: f"; it {stays}: attach it to a baked mesh in another program, or convert it to one",
        REPEATED: f"; it {stays}: attach its instances in another program, or make them prims",
        PROXY: f"; it {stays}: viewers that draw proxies, as usdview does by default, show it at"
        " rest unless it is hidden, or the purpose render is drawn instead",
    }

    def note(path: str, more: int, why: str) -> str:
        way = next((said for end, said in ways.items() if why.endswith(end)), "")
        others = f" and {more} more are" if more else " is"
        return f"<{path}>{others} not baked: {why}{way}"

    return tuple(note(*one) for one in _alike(skipped))


MOST_NAMED = 3  # prims that each have a note of their own for the same reason


def _alike(said: Iterable[tuple[str, str]]) -> list[tuple[str, int, str]]:
    """Paths with their reasons; of more than `MOST_NAMED` with the same one, the first alone.

    In between: how many more there are.
    """
    paths: dict[str, list[str]] = {}
    for path, why in said:
        paths.setdefault(why, []).append(path)
    return [
        (path, len(all_) - 1 if len(all_) > MOST_NAMED else 0, why)
        for why, all_ in paths.items()
        for path in (all_ if len(all_) <= MOST_NAMED else all_[:1])
    ]


def _scaled(vector: Triple | None, unit: float) -> Triple | None:
    return None if vector is None else triple(unit * np.array(vector))


def _require_one_body(request: Request, count: int) -> None:
    """Raise UsageError for options that support a single body only."""
    asked = {
        "--skin " + str(request.skin): request.skin not in (None, "embed"),
        "--wls": bool(request.wls),
        "--procrustes": bool(request.procrustes),
    }
    for option, given in asked.items():
        if given and count > 1:
            raise UsageError(
                f"{option} supports one body, but there are {count}", "add --combine, or omit it"
            )


def _weightless(settings: Settings) -> bool:
    """Whether no gravity presses bodies against the floor."""
    return float(np.dot(settings.gravity, settings.normal)) >= 0.0


def _options(materials: Sequence[Material], each: Sequence[Settings]) -> tuple[str, ...]:
    """Notes on the paper's options, once where they are the same for all materials."""
    if all(settings == each[0] for settings in each):
        return paper_options.notes(each[0])
    pairs = zip(materials, each)
    return tuple(note for m, s in pairs for note in paper_options.notes(s, m.name))


def _nothing_remembered(materials: Sequence[Material], settings: Settings) -> tuple[str, ...]:
    if not settings.internal or any(LAWS[m.law].flows for m in materials):
        return ()
    laws = ", ".join(dict.fromkeys(m.law for m in materials))
    return (f"--internal writes nothing: the law {laws} has no internal variables",)


def _resolution(
    request: Request,
    spec: StageSpec,
    unit: float,
    volumes: Callable[[], Mapping[str, float]],
    thin: Callable[[], tuple[float, Thickness | None]] | None = None,
) -> Resolution:
    """See `resolution`; unit : [m] of the stage's."""
    spacing = request.spacing * unit if request.spacing else None
    paper = request.preset == "paper"
    return resolution(request.particles, spacing, spec, volumes, thin, paper=paper)


def _count_note(wanted: int, particles: Particles, *, sheets: bool) -> tuple[str, ...]:
    """What to say where there are other than the wanted number of particles; 0: none was wanted.

    sheets : sheets of one layer are filled at a spacing that was to give as many.
    """
    count = len(particles)
    if not wanted or abs(count - wanted) <= OTHER_COUNT * wanted:
        return ()
    if sheets:
        return (
            f"sheets of one layer have {count} particles instead of {wanted}: --spacing sets how"
            " fine they are",
        )
    if count < wanted:
        return ()
    from gf_usd.geometry.sampling.particles import CELL_PER_LATTICE

    return (
        f"there are {count} particles instead of {wanted}: cells at the surface have four or eight"
        f" each, and parts are thinner than a cell, {CELL_PER_LATTICE * particles.lattice:.3g} m;"
        " fewer --particles make the cells larger",
    )


OTHER_COUNT = 0.25  # of the number asked for: solids alone are as far from it


def repair_asset_for_fill(
    asset: Asset, request: Request, spec: StageSpec
) -> tuple[Asset, Asset, tuple[Repairs, ...], float | None]:
    """The repaired asset, the same with sheets thickened for the fill, and the repairs.

    The first is for display: its points are those of the source.  The last value is the spacing [m]
    that gives the requested number of particles; None: nothing is thickened, or the spacing is
    given.
    """
    from gf_usd.core.mesh import signed_volume
    from gf_usd.geometry.repair import repair_asset
    from gf_usd.geometry.thin.thicken import thicken_asset, thicken_to_count

    mended, repairs = repair_asset(asset)
    asked = _resolution(
        request, spec, asset.facts.units.length,
        lambda: {s.path: abs(signed_volume(s.points, s.triangles)) for s in mended.surfaces},
    )  # fmt: skip
    if asked.spacing is None and request.preset != "paper":
        return mended, *thicken_to_count(mended, repairs, asked.particles)
    filled, repairs = thicken_asset(
        mended, repairs, spacing=asked.spacing, particles=asked.particles
    )
    return mended, filled, repairs, None
