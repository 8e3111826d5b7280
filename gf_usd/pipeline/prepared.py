"""A bake that is ready to run: its plan, solvers, cost estimate and checkpoints."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gf_usd.core.errors import UsageError
from gf_usd.core.frames.settings import MIXED, sampled, written
from gf_usd.pipeline.checkpoint import Resume, find_resume, identity
from gf_usd.pipeline.cost.budget import (
    Cost,
    estimate,
    fall_frames,
    first_contact,
    typical_rest,
)
from gf_usd.pipeline.cost.cpu import cpu_time_ratio, first_seconds
from gf_usd.pipeline.cost.forecast import (
    FILLING,
    READING,
    Stages,
    Watch,
)
from gf_usd.pipeline.cost.hanging import hanging
from gf_usd.pipeline.cost.limbs import Limbs, limbs_of
from gf_usd.pipeline.cost.shortcuts import shortcuts
from gf_usd.pipeline.cost.solvers import Solvers
from gf_usd.prepare.materials.mass_scaling import mass_scaled, scaled_material
from gf_usd.prepare.options.choices import split_again
from gf_usd.prepare.plan import Plan, Variant
from gf_usd.prepare.prepare import Refill
from gf_usd.prepare.prepare import prepare as prepare_plan
from gf_usd.prepare.settings import REST_SECONDS, REST_WORK, Extension, shot_frames
from gf_usd.system.taichi_runtime import watching

if TYPE_CHECKING:
    from gf_usd.core.scene import Scene
    from gf_usd.physics.frame_loop import Solver
    from gf_usd.readers.mesh.to_usd import MeshSource


@dataclass(frozen=True, kw_only=True)
class Prepared:
    """A bake that is ready to run: its plan, and data that exist only in this process."""

    plan: Plan
    converted: MeshSource | None = None  # of an asset that is not USD; holds a temporary folder
    resume: Resume = field(default_factory=Resume)
    refill: Refill | None = None  # fills the same asset at a lower resolution; None: not needed
    warned: frozenset[str] = frozenset()  # warnings of USD that are in the plan's notes
    until_rest: Plan | None = None  # the plan before its length was limited
    given_solvers: Solvers | None = None  # whose demand is known already; None: made by `solvers`

    @cached_property
    def solvers(self) -> Solvers:
        """The solvers of its variants."""
        return self.given_solvers or Solvers(
            partial(solver_of, self.plan), len(self.plan.particles)
        )

    @cached_property
    def cost(self) -> Cost:
        """The result of `budget.estimate`; builds the solvers."""
        plan = self.plan
        setup = plan.contact_setup
        samples = plan.settings.samples_per_frame
        surfaces = plan.asset.surfaces
        contact = None if has_driven_motion(plan) else first_contact(plan.settings, plan.drop)
        ends = plan.choices.until_rest or plan.choices.settled
        demands = [self.solvers.demand(variant) for variant in plan.variants]
        # bodies next to each other take substeps in flight too (`Shortcuts.take`)
        near = any(one.touching > 1.0 for one in demands)
        return estimate(
            plan.settings,
            plan.materials,
            [samples * one.substeps for one in demands],
            tables=plan.used_tables,
            particles=len(plan.particles),
            vertices=sum(len(s.points if s.splats is None else s.splats) for s in surfaces),
            paired=len(plan.samples.X) if setup and setup.any else 0,
            frame_bytes=plan.frame_bytes,
            first_contact=None if reason_not_free_fall(plan) else contact,
            flying=0 if near else flying(plan),
            radius=0.0 if plan.held or plan.goals else plan.particles.radius,
            demands=demands,
            hangings=[
                hanging(
                    plan.particles, variant.table, () if plan.goals else plan.pins, plan.settings
                )
                for variant in plan.variants
            ],
            crowd=bool(setup and (setup.colliders or len(setup.skins) > 1)),
            limbs=limbs(plan),
            usual=[
                typical_rest(plan.settings, material, plan.particles.radius, contact)
                for material in plan.materials
            ]
            if ends
            else (),
            ends_early=ends or plan.until_periodic,
            cpu_ratio=cpu_time_ratio(),
        )

    @cached_property
    def shortcuts(self) -> tuple[str, ...]:
        """Hints at options with which a long bake would take less time; see `cost.shortcuts`."""
        plan = self.plan
        samples = plan.settings.samples_per_frame

        def damped(number: int, time: float) -> int:
            made = _damped(plan, time)
            return samples * solver_of(made, made.variants[number]).substeps

        def scaled(factor: float) -> float:
            made = _mass_scaled(self.until_rest or plan, factor)
            solvers = Solvers(partial(solver_of, made), len(made.particles), keep=False)
            whole = replace(self, plan=made, given_solvers=solvers)
            return with_shot_length(whole).cost["usual_seconds"]

        return shortcuts(
            self.cost, plan.used_tables, damped=damped, scaled=scaled,
            scaling=plan.settings.mass_scaling,
        )  # fmt: skip


def _damped(plan: Plan, time: float) -> Plan:
    """The plan with a damping time [s] of all materials."""
    own = plan.particles.own
    if own is not None and "damping_time" in own:
        own = {**own, "damping_time": np.full_like(own["damping_time"], time)}
    return replace(
        plan,
        materials=tuple(replace(one, damping_time=time) for one in plan.materials),
        tables=tuple(
            tuple(replace(one, damping_time=time) for one in table) for table in plan.tables
        ),
        particles=replace(plan.particles, own=own),
    )


def _mass_scaled(plan: Plan, factor: float) -> Plan:
    """The plan with a mass scaling."""
    tables = plan.tables or tuple((material,) for material in plan.materials)
    scaled, particles, _ = mass_scaled(tables, plan.particles, factor)
    return replace(
        plan,
        materials=tuple(scaled_material(one, factor) for one in plan.materials),
        tables=tuple(scaled),
        particles=particles,
    )


def prepare(
    path: str | Path,
    *,
    overwrite: bool = False,
    resume: bool = False,
    watch: Watch | None = None,
    **options: Any,
) -> Prepared:
    """Prepare a bake, with the checkpoints that it resumes from; see `gf_usd.bake`.

    watch : called with the current stage.
    """
    from gf_usd.layers.usd_warnings import gathered
    from gf_usd.readers.usd.stage import layers_kept

    stages = Stages(watch)
    if resume and options.get("certify"):
        raise UsageError(
            "--certify cannot be combined with --resume, because it needs all frames of one run",
            "start over with --overwrite, or omit --certify",
        )
    stages.begin(READING, Path(path).name)
    first_seconds()
    refills: list[Refill] = []
    with gathered() as warned, layers_kept(), watching(stages.compile):
        plan, converted = prepare_plan(
            path, overwrite=overwrite, resume=resume, draw=draw,
            progress=partial(stages.begin, FILLING), once_filled=refills.append, **options,
        )  # fmt: skip
    plan = replace(plan, notes=(*plan.notes, *warned.lines(stated=plan.notes)))
    known_warnings = frozenset(warned.counts)
    refill = refills[0] if plan.choices.certify else None
    prepared = with_shot_length(
        Prepared(plan=plan, converted=converted, refill=refill, warned=known_warnings)
    )
    if not resume:
        return prepared
    plan = prepared.plan
    clips = bool(plan.choices.clip_frames)
    identify = partial(identity_of, plan)
    found = find_resume(plan.variants, identify, clips=clips, overwrite=overwrite)
    plan = replace(plan, notes=(*plan.notes, *found.notes))
    return replace(prepared, plan=plan, resume=found)


def with_shot_length(prepared: Prepared) -> Prepared:
    """A bake of unspecified length, limited to a shot where simulating until rest takes too long.

    The limits are REST_WORK, and REST_SECONDS of playback, which bodies tens of meters wide
    typically exceed. They are counts of substeps and frames, so the length is the same on every
    machine. So is the note, which is in the report: it has no estimate of time.
    """
    plan = prepared.plan
    if not plan.choices.open_end:
        return _with_limited_motion(prepared)
    usual = prepared.cost["usual_frames"]
    if _work(prepared) <= REST_WORK and usual <= REST_SECONDS * plan.settings.fps:
        return prepared
    obstacles = plan.contact_setup.colliders if plan.contact_setup else ()
    still_from = max((one.still_from for one in obstacles), default=0)  # a sample
    moving = math.ceil(still_from / plan.settings.samples_per_frame)
    frames = min(max(shot_frames(plan.settings.frames), moving + 1), plan.settings.frames)
    note = (
        f"{frames} frames are simulated, not until rest, which usually takes about {usual} frames,"
        f" at most {plan.settings.frames}; use --frames rest for that"
    )
    return _shortened(prepared, frames, plan.notes, note)


def _with_limited_motion(prepared: Prepared) -> Prepared:
    """A bake that pins or obstacles make longer, limited to REST_WORK or to its default length."""
    plan = prepared.plan
    extension, settings = plan.extension, plan.settings
    if extension is None or settings.frames <= extension.least:
        return prepared
    fitting = int(settings.frames * REST_WORK / _work(prepared))
    if fitting >= settings.frames:
        return prepared
    frames = max(extension.least, fitting)
    limited = replace(extension, limit=f"{REST_WORK / 1e9:g} billion particle substeps")
    notes = tuple(note for note in plan.notes if note != extension.note(settings))
    note = limited.note(replace(settings, frames=frames))
    return _shortened(prepared, frames, notes, note, limited)


def _work(prepared: Prepared) -> float:
    """Substeps of all particles in a bake."""
    rows = prepared.cost["per_material"]
    return max(row["substeps"] for row in rows) * len(prepared.plan.particles)


def _shortened(
    prepared: Prepared,
    frames: int,
    notes: tuple[str, ...],
    note: str,
    extension: Extension | None = None,
) -> Prepared:
    """The bake with fewer frames and a note on them, in addition to `notes`."""
    plan = prepared.plan
    settings = replace(plan.settings, frames=frames)
    choices, notes = split_again(
        plan.choices, notes, plan.frame_bytes, written(plan.settings), written(settings)
    )
    shorter = replace(
        plan,
        settings=settings,
        each=tuple(replace(one, frames=frames) for one in plan.each),
        choices=replace(choices, until_rest=False, open_end=False),
        extension=extension,
        notes=(*notes, note),
    )
    solvers = prepared.solvers.of_length(partial(solver_of, shorter))
    return replace(prepared, plan=shorter, until_rest=plan, given_solvers=solvers)


def identity_of(plan: Plan, variant: Variant) -> dict[str, str]:
    """The identity of a variant's checkpoint."""
    return identity(
        variant.settings, variant.table, plan.choices, plan.particles,
        plan.contact_setup.colliders if plan.contact_setup else (),
        asset=plan.asset.facts.path, command=plan.command,
    )  # fmt: skip


def draw(scene: Scene, size: tuple[int, int]) -> Any:
    """The picture of an asset for an advisor."""
    from gf_usd.view.render.render import render

    return render(scene, size=size)


def has_driven_motion(plan: Plan) -> bool:
    """Whether pins, bones or fields move the bodies, in addition to gravity and contact."""
    return plan.held or bool(plan.settings.fields)


def limbs(plan: Plan) -> Limbs:
    """Limbs of the bodies that can touch themselves; none where bodies are held, whose limbs stay
    apart.
    """
    setup = plan.contact_setup
    if setup is None or plan.held or plan.goals:
        return Limbs()
    return limbs_of(plan.samples, plan.particles, sorted(setup.self_contact))


def reason_not_free_fall(plan: Plan) -> str:
    """Why the bodies are not in free fall until `first_contact`, as a word; "": they are."""
    if plan.contact_setup is not None and plan.contact_setup.colliders:
        return "obstacles"
    if plan.held or plan.goals:
        return "pins or animation"
    if plan.settings.fields:
        return "fields"
    return "velocities" if any(map(callable, plan.velocity)) else ""


def flying(plan: Plan) -> int:
    """Number of frames at the start in free flight, which need no substeps."""
    from gf_usd.physics.total_lagrangian.shape_correction import is_active

    s = plan.settings
    held = plan.pins or plan.goals or s.fields or any(map(callable, plan.velocity))
    if held or not s.shortcuts or s.solver != "tl" or s.drag or is_active(s):
        return 0
    if plan.contact_setup is not None and plan.contact_setup.colliders:
        return 0
    frame = fall_frames(s, plan.drop)
    # with a margin of one frame, also where the bake ends just before the floor
    return s.frames if frame is None else min(s.frames, max(0, frame - 2))


def solver_of(plan: Plan, variant: Variant) -> Solver:
    """The solver of a variant, in its initial state."""
    from gf_usd.physics.solvers import make_solver

    more: dict[str, Any] = {}
    if plan.velocity:
        more["velocity"] = list(plan.velocity) if plan.velocity[1:] else plan.velocity[0]
    if plan.settings.solver == "ul" and plan.contact_setup is not None:
        more["contact_setup"] = plan.contact_setup
    if plan.settings.solver in ("tl", MIXED) and plan.bodies is not None:
        more |= {
            "contact_setup": plan.contact_setup,
            "goals": plan.goals,
            "embedded_body": {**plan.bodies.embedded, **{t.key: t.body for t in plan.tets}},
            "embedded_copy": plan.embedded_copies,
        }
    return make_solver(
        sampled(variant.settings),
        plan.particles,
        variant.table,
        samples=plan.samples,
        embedded=plan.points if plan.settings.skin == "embed" else {},
        pins=plan.pins,
        **more,
    )
