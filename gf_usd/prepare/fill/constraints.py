"""The step of `fill` that finds what holds or drives parts of the bodies."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from gf_usd.core.errors import InputError, agreed, counted, listed_paths
from gf_usd.core.frames.settings import Settings, sampled, written
from gf_usd.core.stage import Goals, Pin
from gf_usd.prepare.bodies.contact import LimbPlan
from gf_usd.prepare.bodies.flesh.characters import THIN
from gf_usd.prepare.bodies.flesh.flesh import Flesh, flesh_of
from gf_usd.prepare.bodies.sampling import SampledBodies
from gf_usd.prepare.fill.bodies import FilledBodies
from gf_usd.prepare.fill.inputs import Inputs
from gf_usd.prepare.fill.shot import Shot
from gf_usd.prepare.materials.flowing import require_solid_pins
from gf_usd.prepare.pins import attachment_pins, make_pins, soft_attachment_goals


@dataclass(frozen=True, kw_only=True)
class Constraints:
    """What holds or drives parts of the bodies."""

    pins: tuple[Pin, ...]
    flesh: Flesh
    cycle: int  # frames of the period of the animation; 0: it is not repeated
    meet_from: int  # frame from which characters collide with each other
    attachment_notes: tuple[str, ...]


def constrain(inputs: Inputs, filled: FilledBodies, shot: Shot, pins: Sequence[Pin]) -> Constraints:
    """pins : in addition to those of the options and of the stage.

    Raises InputError and UsageError for pins that bodies that flow or can be converted, or solid
    ones next to them, do not support, and for a sheet of a character in --rigid.
    """
    found = _find_constraints(inputs, filled, shot, pins)
    flow = inputs.flow
    require_solid_pins(
        inputs.asset.facts.path, found.pins, filled.particles, filled.bodies.flows(flow.first),
        converts=inputs.mixed and flow.later, springs=tuple(shot.springs),
    )  # fmt: skip
    return found


def _find_constraints(
    inputs: Inputs, filled: FilledBodies, shot: Shot, pins: Sequence[Pin]
) -> Constraints:
    request, asset, solid, file = inputs.request, inputs.asset, inputs.solid, inputs.file
    settings, every = shot.settings, sampled(shot.settings)
    if file is None:
        return Constraints(
            pins=tuple(pins), flesh=Flesh(), cycle=0, meet_from=0,
            attachment_notes=_ignored_attachment_notes(inputs, shot),
        )  # fmt: skip
    animation, flesh, cycle, meet_from = shot.animation, Flesh(), 0, 0
    found, of_surface = list(pins), filled.bodies.of_surface
    found += make_pins(
        request.listed("pins"), asset, solid, every, file, rest=request.start, bodies=of_surface
    )
    attached, notes = attachment_pins(
        shot.attachments, asset, solid, every, file, request.start, of_surface
    )
    found += attached
    if animation:
        cycle = animation.cycle(written(settings)) if request.loop else 0
        repeats = request.cycles.repeats
        flesh = flesh_of(
            asset, solid, filled.particles.X, filled.samples, every, animation, file,
            share=request.bone_radius, frequency=request.goal_frequency,
            damping=request.goal_damping, squish=request.squish, stretch=request.stretch,
            lattice=filled.particles.lattice, spacing=filled.particles.spacing,
            cycle=cycle * settings.samples_per_frame, repeats=repeats,
            rigid=request.listed("rigid"), bodies=filled.bodies,
        )  # fmt: skip
        found += flesh.pins
        if filled.characters:
            meet_from = animation.lead(every, cycle * settings.samples_per_frame * repeats)
    names = [name for name in request.listed("rigid") if name not in flesh.rigid]
    _require_no_sheets(names, inputs, flesh.sheets)
    found += make_pins(
        names, asset, solid, every, file, rest=request.start, option="--rigid", bodies=of_surface,
        without=flesh.sheets.keys(),
    )  # fmt: skip
    return Constraints(
        pins=tuple(found), flesh=flesh, cycle=cycle, meet_from=meet_from,
        attachment_notes=(*notes, *_ignored_attachment_notes(inputs, shot)),
    )  # fmt: skip


def _require_no_sheets(names: Sequence[str], inputs: Inputs, sheets: Collection[str]) -> None:
    """Raise InputError for a name of --rigid at and below which all meshes are sheets.

    sheets : prim paths.
    """
    reasons = dict(inputs.solid.embedded)
    for name in names:
        above = f"{name.rstrip('/')}/"
        found = [s.path for s in inputs.asset.surfaces if f"{s.path}/".startswith(above)]
        if not found or any(path not in sheets for path in found):
            continue
        text = agreed(
            len(found),
            "[is/are] not filled and cannot be rigid: [it follows its/they follow their] skinned"
            " [pose/poses], and the flesh near [it/them]",
        )
        them = agreed(len(found), "[it/them]")
        reason = reasons[found[0]]
        way = "use more --particles" if reason.endswith(THIN) else "name a mesh that is closed"
        raise InputError(
            f"{inputs.asset.facts.path}: --rigid {name} --flesh: {listed_paths(found)} {text};"
            f" {reason}",
            f"omit it; or {way}, or bind {them} to a single joint",
        )


def _ignored_attachment_notes(inputs: Inputs, shot: Shot) -> tuple[str, ...]:
    physics = inputs.spec.physics
    used = {*shot.attachments, *shot.springs}
    ignored = {*physics.attachments, *physics.soft_attachments} - used
    if not ignored:
        return ()
    return (f"{counted(len(ignored), 'attachment')} not read with --flesh and --solver ul",)


def springs_of(
    inputs: Inputs, filled: SampledBodies, shot: Shot, flesh: Flesh, limbs: LimbPlan,
    settings: Settings,
) -> tuple[Goals | None, tuple[str, ...]]:  # fmt: skip
    """The springs of --flesh, or of the attachments of the stage with a note."""
    if not shot.springs or inputs.file is None:
        return flesh.goals, ()
    goals = soft_attachment_goals(
        shot.springs, inputs.asset, sampled(settings), inputs.file, inputs.request.start,
        body=filled.bodies.embedded, copies=limbs.embedded_copies,
    )  # fmt: skip
    return goals, (f"attachments pull parts of the body with springs: {', '.join(shot.springs)}",)
