"""From an asset that was read to a plan: bodies, particles, materials, settings, contact.

Nothing that is called from here takes the whole request but `settings.resolve`.

What --repair does to an asset before it is filled.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints, triple
from gf_usd.core.asset import ASSUMED, Asset
from gf_usd.core.errors import InputError, UsageError
from gf_usd.core.frames import (
    SHAPES,
    Choices,
    Particles,
    Settings,
    SurfaceSamples,
    clip_length,
    sampled,
    written,
)
from gf_usd.core.materials.laws import LAWS
from gf_usd.core.materials.material import Material
from gf_usd.core.materials.presets import Preset
from gf_usd.core.stage import Pin, StageSpec, Triple
from gf_usd.core.units import PLAUSIBLE, Precision
from gf_usd.prepare import materials as body_materials
from gf_usd.prepare import paper as paper_options
from gf_usd.prepare import regions as material_regions
from gf_usd.prepare.bodies import (
    LimbPlan,
    contact_setup,
    keep_limbs_apart,
    plan_bodies,
    require_clear_start,
    start_velocities,
)
from gf_usd.prepare.materials import with_own_values
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
from gf_usd.prepare.plan import Plan, embedded_points, frame_bytes
from gf_usd.prepare.settings import (
    Resolution,
    floor_plane,
    resolution,
    resolve,
    settled_frames,
)
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
    more_pins: Callable[[Solid], Sequence[Pin]] | None = None,
) -> tuple[Plan, Solid]:
    """A plan for an asset that was read.  Raises InputError where it is refused.

    file : its USD form; None: it has none, and spec has the motion of its obstacles.
    spec : what its stage says.
    known : what `diagnose` said of its surfaces, if it was asked already.
    more_pins : of the solid, besides those that are asked for.
    """
    from gf_usd.core.mesh import signed_volume
    from gf_usd.geometry.diagnosis import diagnose, tolerated
    from gf_usd.geometry.repair import notes
    from gf_usd.geometry.sampling.contact_samples import sample_surface
    from gf_usd.geometry.sampling.particles import sample_solid
    from gf_usd.geometry.sampling.tets import tet_lattices
    from gf_usd.geometry.skinning import SKIN_NOTES
    from gf_usd.geometry.solid import build_solid
    from gf_usd.geometry.thin.thickness import thickness

    mended: tuple[str, ...] = ()
    filled = asset
    follows = False  # a sheet is as thick as the spacing
    if repair:
        asset, filled, repairs = mend(asset, request, spec)
        mended = notes(repairs)
        follows = any(one.thickened for one in repairs)
    solid = build_solid(filled, repaired=repair)
    if not repair:
        by_path = {seen.path: seen for seen in known}
        all_seen = (by_path.get(s.path) or diagnose(s) for s in solid.surfaces)
        mended = tuple(line for seen in all_seen if (line := tolerated(seen)))
    keys = spec.physics.gravity_keys if request.gravity is None else ()
    request, flowing = _unbounded(request, presets, law)
    request, stated = _with_stage(request, spec, asset)
    unit = asset.facts.units.length
    paper = request.preset == "paper"
    closed = zip(solid.surfaces, solid.triangles, strict=True)
    asked = _resolution(
        request, spec, unit,
        lambda: {s.path: abs(signed_volume(s.points, triangles)) for s, triangles in closed},
        None if follows else lambda: (solid.volume, thickness(solid)),
    )  # fmt: skip

    def sample(of: Ints) -> Particles:
        return sample_solid(
            solid,
            particles=asked.particles if asked.spacing is None else None,
            spacing=asked.spacing,
            seed=request.seed or 0,
            uniform=paper,
            up=asset.facts.up_axis,
            bodies=of,
        )

    owners = {path: body.owner for path, body in spec.bodies.items()}
    spacing = asked.spacing or float(np.cbrt(solid.volume / (asked.particles or 1)))
    combine = request.combine or paper or request.flesh or request.solver == "ul"
    bodies, particles = plan_bodies(asset, solid, spacing, sample, owners, combine=combine)
    _require_one_body(request, bodies.count)
    if paper or flowing:
        # There every particle feels the floor; a mass of rho * area * spacing is its own.
        samples = SurfaceSamples(X=particles.X, area=particles.V0 / particles.spacing)
    else:
        samples = sample_surface(
            solid,
            particles.spacing,
            bodies.of_surface if bodies.count > 1 else None,
            asset.facts.up_axis,
        )
    floor, normal = floor_plane(request.parsed["floor"], asset.facts.up, unit)
    # a sheet that was thickened reaches below what is drawn
    every_surface = (*asset.surfaces, *solid.surfaces)
    lowest = min(float((s.points @ normal).min()) for s in every_surface)
    radius = float(bodies.radius.max())
    animation = read_animation(asset, file, request.start) if request.flesh and file else None
    unread = request.flesh or request.solver == "ul"
    attachments = () if unread else spec.physics.attachments
    springs = () if unread else spec.physics.soft_attachments
    settings = resolve(
        request, asset.facts, radius, lowest, animation, keys,
        stated_fields=spec.physics.fields, attached=bool(attachments or springs),
    )  # fmt: skip
    gap = float(np.dot(settings.lift, normal)) + lowest - (floor or 0.0)
    pins = tuple(more_pins(solid)) if more_pins else ()
    flesh = Flesh()
    cycle = 0  # frames
    if file is not None:
        names = request.listed("pins")
        every = sampled(settings)
        pins += make_pins(names, asset, solid, every, file, rest=request.start)
        names = request.listed("rigid")
        pins += make_pins(names, asset, solid, every, file, rest=request.start, option="--rigid")
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
        )  # fmt: skip
        pins += flesh.pins
    physics = spec.physics
    left_out = {*physics.attachments, *physics.soft_attachments} - {*attachments, *springs}
    if left_out:
        stated += (f"{len(left_out)} attachments are not read with --flesh and --solver ul",)
    # Without anything below them bodies fall for ever.
    falls = (settings.floor is None and not physics.colliders) or _weightless(settings)
    pushed = bool(pins or springs or settings.fields)
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
    parts = body_materials.material_parts(solid, spec, request.regions)
    slot = body_materials.part_of_particles(solid, particles, parts)
    of, regional = material_regions.owners(request.regions, solid.surfaces, particles, unit)
    slot = body_materials.in_regions(slot, particles, parts, of)

    own_values = _stated_values(request)

    def finish(preset: Any, radius: float) -> Material:
        return replace(preset.material(radius, law), **own_values)

    tables, index, flow = [], particles.material, []
    for preset in presets:
        table, index = body_materials.table(
            preset, parts, slot, particles, solid, bodies, spec, finish
        )
        table = tuple(replace(m, law=law or m.law) for m in table)
        tables.append(table)
        of_part = {int(k): table[int(index[slot == k][0])] for k in np.unique(slot)}
        body_materials.require_parameters(asset.facts.path, particles, slot, of_part, solid, spec)
        flow += body_materials.flow_notes(preset, law, parts, of_part, solid, spec)
    particles, own = with_own_values(
        replace(particles, material=index), tables[0], slot, parts, solid, bodies, spec,
        (request.blend_width or 0.0) * unit,
    )  # fmt: skip
    tables, particles, scaled = body_materials.mass_scaled(tables, particles, settings.mass_scaling)
    made = tuple(
        replace(_main(table, index, particles.V0), name=preset.name)
        for preset, table in zip(presets, tables)
    )
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
    weak = body_materials.require_standing(
        asset.facts.path, [m for table in tables for m in table],
        max(float(np.ptp(s.points @ asset.facts.up)) for s in solid.surfaces),
        abs(float(np.dot(settings.gravity, asset.facts.up))),
    )  # fmt: skip
    choices, split = _chosen(request, files, settings, asset, len(particles), open_end)
    _require_stored(choices.precision, particles, settings)
    unfilled = [f"<{p}> is not filled and moves with the body: {why}" for p, why in solid.embedded]
    left = [f"<{p}> is left as it is: {why}" for p, why in asset.skipped]
    advice = tuple(spec.advice[s.path] for s in solid.surfaces) if spec.advice else ()
    skin = SKIN_NOTES.get(settings.skin, ())
    limbs = LimbPlan(
        particles=particles,
        samples=samples,
        contact_setup=contact_setup(
            solid, bodies, physics,
            self_contact=False if paper or settings.solver == "ul" else request.self_contact,
        ),
    )  # fmt: skip
    if not paper and request.solver != "ul":
        require_clear_start(asset.facts.path, particles, settings.lift, limbs.contact_setup, unit)
        limbs = keep_limbs_apart(solid, bodies, limbs, embedded_points(asset))
    tets = tet_lattices(limbs.particles, limbs.samples) if request.tets else ()
    copies = {t.key: t.copy for t in tets if t.copy is not None}
    goals = flesh.goals
    if springs and file is not None:
        goals = soft_attachment_goals(
            springs, asset, sampled(settings), file, request.start,
            body=bodies.embedded, copies=limbs.embedded_copies,
        )  # fmt: skip
        stated += (f"attachments draw parts of the body by springs: {', '.join(springs)}",)
    plan = Plan(
        asset=asset,
        particles=limbs.particles,
        samples=limbs.samples,
        materials=made,
        tables=tuple(tables),
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
            *asset.facts.notes, *(one.note for one in advice),
            *mended, *flowing, *stated, *([asked.note] if asked.note else ()), *bodies.notes,
            *flesh.notes, *limbs.notes, *regional, *own, *dict.fromkeys(flow), *scaled, *weak,
            *physics.notes,
            *unfilled, *left, *skin, *_options(made, each), *split,
            *_nothing_remembered(made, settings),
        ),
    )  # fmt: skip
    return plan, solid


def _with_stage(request: Request, spec: StageSpec, asset: Asset) -> tuple[Request, tuple[str, ...]]:
    """The request with what the stage says where it says nothing, and notes on that."""
    notes = []
    path, physics = asset.facts.path, spec.physics
    more: dict[str, Any] = {}
    if request.gravity is None and physics.gravity is not None:
        more["gravity"] = ",".join(repr(g) for g in physics.gravity)
        notes.append(
            f"gravity is that of <{physics.scene}>: {material_regions.shown(physics.gravity)} m/s^2"
            + (f", and {len(physics.gravity_keys)} time samples" if physics.gravity_keys else "")
        )
        if physics.gravity_keys and (request.rigid or request.solver == "ul"):
            raise UsageError(
                f"{path}: gravity of <{physics.scene}> changes, which --rigid and --solver ul do"
                " not know",
                "give one with --gravity",
            )
    if physics.fields and not request.fields:
        if request.rigid or request.solver == "ul":
            raise UsageError(
                f"{path}: <{physics.scene}> has fields, which --rigid and --solver ul do not know",
                "leave --rigid or --solver ul out",
            )
        notes.append(f"fields are those of <{physics.scene}>: {' '.join(physics.fields)}")
    if request.flesh and request.floor is None:
        more["floor"] = "none"
        notes.append("there is no floor under the animation; --floor 0 adds one")
    if obstacles := physics.obstacles:
        several = len(obstacles) > 1
        counted = f"there {'are' if several else 'is'} {len(obstacles)} obstacle{'s' * several}"
        if request.floor is None and not request.flesh:
            more["floor"] = "none"
            notes.append(f"{counted}, so there is no floor; --floor 0 adds one")
        if request.solver == "ul":
            raise UsageError(
                f"{path}: --solver ul does not know obstacles, and {counted}:"
                f" <{obstacles[0].path}>",
                "use --solver tl",
            )
    for name in ("seed", "solver"):
        if getattr(request, name) is None:
            said = one_said(name, [(p, getattr(b, name)) for p, b in spec.bakes.items()], path)
            if said is not None:
                more[name] = said
                notes.append(f"{name} is {said}, as the stage asks for")
    return replace(request, **more), tuple(notes)


def _scaled(vector: Triple | None, unit: float) -> Triple | None:
    return None if vector is None else triple(unit * np.array(vector))


def _require_one_body(request: Request, count: int) -> None:
    """Raise UsageError for options that know one body only."""
    asked = {
        "--skin " + str(request.skin): request.skin not in (None, "embed"),
        "--wls": bool(request.wls),
        "--procrustes": bool(request.procrustes),
    }
    for option, given in asked.items():
        if given and count > 1:
            raise UsageError(
                f"{option} knows one body, and there are {count}", "add --combine, or leave it out"
            )


def _weightless(settings: Settings) -> bool:
    """Whether no gravity presses bodies on the floor."""
    return float(np.dot(settings.gravity, settings.normal)) >= 0.0


def _unbounded(
    request: Request, presets: Sequence[Any], law: str | None
) -> tuple[Request, tuple[str, ...]]:
    """The request for what flows without end, with a note; as it is where nothing does.

    Raises UsageError where only some of the variants do, or where the solver does not let them.
    """
    laws = [law or (p.law if isinstance(p, Preset) else "") for p in presets]
    flows = [one in LAWS and LAWS[one].unbounded for one in laws]
    if not any(flows):
        return request, ()
    names = ", ".join(preset.name for preset in presets)
    if not all(flows):
        raise UsageError(
            f"{names}: some of these flow without end, and are simulated by another solver",
            "bake them one by one",
        )
    if request.solver == "tl":
        raise UsageError(
            f"--solver tl does not go with {names}, which flows without end",
            "leave it out, or use --solver ul",
        )
    if request.only is None:
        request = replace(request, only="gaussians,points")
    note = f"{names}: flows without end (Updated Lagrangian solver; every particle feels the floor)"
    if "mesh" not in (request.parsed["only"] or ()):
        note += "; the mesh is hidden"
    return replace(request, solver="ul"), (note,)


def _main(table: Sequence[Material], index: Any, V0: Any) -> Material:
    """The material that most of the volume has."""
    return table[int(np.bincount(index, V0).argmax())]


def _chosen(
    request: Request,
    files: Outputs,
    settings: Settings,
    asset: Asset,
    particles: int,
    open_end: bool,
) -> tuple[Choices, tuple[str, ...]]:
    """The output choices, with notes on what nobody asked for."""
    if files.flat and request.clip_frames:
        raise UsageError(
            f"--clip-frames {request.clip_frames} and a package were both asked for",
            "a package is one file: leave one of them out",
        )
    choices = Choices(
        shapes=request.parsed["only"] or SHAPES,
        half=request.half,
        precision=request.parsed["precision"],
        adaptive=request.adaptive_samples,
        velocities=not request.no_velocities,
        flat=request.flatten or files.flat,
        settled=request.settle_only,
        tets=request.tets,
        until_rest=request.until_rest or open_end,
        open_end=open_end,
        certify=request.certify,
    )
    size = frame_bytes(asset, particles, settings, choices)
    length = (
        0
        if choices.flat or choices.settled
        else clip_length(request.clip_frames, size, written(settings))
    )
    notes = ()
    if length and request.clip_frames is None:
        notes = (
            f"the cache, about {size * written(settings) / 1e9:.1f} GB, is split into value clips"
            f" of {length} frames: --clip-frames 0 keeps it in one file",
        )
    return replace(choices, clip_frames=length), notes


SINGLE = 2.0  # of the distance between neighboring numbers: rounding in three axes, and of a line


def _require_stored(precision: Precision | None, particles: Particles, settings: Settings) -> None:
    """Raise UsageError for a precision that single precision does not have where the bodies are."""
    if precision is None:
        return
    farthest = float(np.abs(particles.X + np.asarray(settings.lift)).max())
    rounding = SINGLE * float(np.finfo(np.float32).eps) * farthest
    radii = particles.radii
    least = precision.meters(float(radii[radii > 0.0].min()))
    if least < rounding:
        raise UsageError(
            f"--precision {precision.said} is {least:.3g} m for the smallest body, and points have"
            f" single precision, which is off by {rounding:.2g} m at {farthest:.3g} m from the"
            " origin",
            f"give {rounding:.2g}m or more",
        )


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
    return (f"--internal writes nothing: the law {laws} remembers nothing",)


def _stated_values(request: Request) -> dict[str, float]:
    """What the request says in place of a material's own values."""
    own = {
        name: value
        for name in ("damping_time", "friction", "restitution")
        if (value := getattr(request, name)) is not None
    }
    if request.preset == "paper":
        own.setdefault("damping_time", 0.0)  # the paper has none
    return own


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


HUGE, TINY = 30.0, 0.005  # [m] beyond these the unit is more likely wrong than the asset odd


UNIT = "--meters-per-unit"
COMMON_UNITS = (0.01, 1.0, 0.001)  # [m]


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
    least = PLAUSIBLE[0] if asset.facts.unit_from == ASSUMED else TINY
    if least <= width <= HUGE:
        return ""
    likely = [u for u in COMMON_UNITS if u != unit and PLAUSIBLE[0] <= units * u <= PLAUSIBLE[1]]
    # Of the units that fit, a tiny asset wants the largest and a huge one the first named.
    fitting = max(likely, default=None) if width < least else next(iter(likely), None)
    said = f"the asset is {width:.3g} m wide: {units:.4g} units of {unit:g} m"
    if fitting is None:
        return f"{said}; check its unit ({UNIT})"
    return f"{said}; with {UNIT} {fitting:g} it would be {units * fitting:.3g} m"


def mend(
    asset: Asset, request: Request, spec: StageSpec
) -> tuple[Asset, Asset, tuple[Repairs, ...]]:
    """The asset mended, the same with its sheets thickened for the fill, and what was done.

    The first is what is drawn and carried: its points are those of the source.
    """
    from gf_usd.core.mesh import signed_volume
    from gf_usd.geometry.repair import repair_asset
    from gf_usd.geometry.thin.thicken import thicken_asset

    mended, repairs = repair_asset(asset)
    asked = _resolution(
        request, spec, asset.facts.units.length,
        lambda: {s.path: abs(signed_volume(s.points, s.triangles)) for s in mended.surfaces},
    )  # fmt: skip
    filled, repairs = thicken_asset(
        mended, repairs, spacing=asked.spacing, particles=asked.particles
    )
    return mended, filled, repairs


def one_said(what: str, said: Sequence[tuple[str, object]], file: Path) -> object | None:
    """The value that all who say something agree on; None where nobody does.

    said : (prim path, value or None).  Raises InputError where two disagree.
    """
    known = [(path, value) for path, value in said if value is not None]
    for path, value in known:
        if value != known[0][1]:
            raise InputError(
                f"{file}: <{known[0][0]}> asks for {what} {known[0][1]}, <{path}> for {value}:"
                " a bake has one",
                f"give --{what}, or bake them apart with --prim",
            )
    return known[0][1] if known else None
