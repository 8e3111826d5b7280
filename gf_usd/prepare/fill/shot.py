"""The steps of `fill` that resolve the settings: before the bodies are constrained, and after."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from gf_usd.core.asset import Asset, Surface
from gf_usd.core.frames.settings import Settings, sampled
from gf_usd.core.stage import Pin, StagePhysics, Triple
from gf_usd.core.units import length_text, rounded_text
from gf_usd.prepare.bodies.sampling import SampledBodies
from gf_usd.prepare.fill.inputs import Inputs
from gf_usd.prepare.options.choices import own_space_notes, require_resolved
from gf_usd.prepare.options.fields import upward_note
from gf_usd.prepare.settings import (
    REST_SECONDS,
    Animation,
    Extension,
    floor_plane,
    frames_until,
    is_placed,
    resolve,
    settled_frames,
)
from gf_usd.readers.usd_bake.spec import read_motion

if TYPE_CHECKING:
    from gf_usd.readers.usd_bake.keys import MaterialKeys


BELOW = 0.01  # [r] that a held body may begin in the floor at height 0: its surface is coarse
# Points are in single precision, and a rotation sums three of their coordinates.
ROUNDING = 4.0 * float(np.finfo(np.float32).eps)  # of the largest coordinate
MOST_ROUNDING = 1e-3  # [r] that cannot be seen: a small body far from the origin


@dataclass(frozen=True, kw_only=True)
class Shot:
    """The settings of a bake as requested, and what of the stage moves the bodies."""

    settings: Settings
    gap: float  # [m] along the normal of the floor from it to the lowest point, lifted
    animation: Animation | None  # that --flesh follows
    attachments: Sequence[str]  # prim paths of those that pin
    springs: Sequence[str]  # and of those that pull
    extension: Extension | None  # of the number of frames
    notes: tuple[str, ...]


def plan_shot(
    inputs: Inputs, filled: SampledBodies, gravity_keys: Sequence[tuple[float, Triple]]
) -> Shot:
    """The settings of a bake and its notes: floor, drop, frames, animation.

    gravity_keys : (time code, gravity [m/s^2]) of time-dependent gravity; empty: it is constant.
    """
    request, asset, physics = inputs.request, inputs.asset, inputs.spec.physics
    floor, normal = floor_plane(request.parsed["floor"], asset.facts.up, inputs.unit)
    # a sheet that was thickened reaches below what is drawn
    surfaces = (*asset.surfaces, *inputs.solid.surfaces)
    lowest = min(float((s.face_points @ normal).min()) for s in surfaces)
    radius = float(filled.bodies.radius.max())
    farthest = max(float(np.abs(s.face_points).max()) for s in surfaces)
    rounding = min(ROUNDING * farthest, MOST_ROUNDING * radius)
    animation = inputs.characters.animation(asset) if inputs.characters else None
    unsupported = request.flesh or request.solver == "ul"
    attachments = () if unsupported else physics.attachments
    springs = () if unsupported else physics.soft_attachments
    settings = resolve(
        request, asset.facts, radius, lowest, animation, gravity_keys, rounding=rounding,
        stated_fields=physics.fields, attached=bool(attachments or springs),
    )  # fmt: skip
    gap = float(np.dot(settings.lift, normal)) + lowest - (floor or 0.0)
    pinned = _prims_of_pins((*request.listed("pins"), *attachments, *springs), asset)
    settings, extension = _as_long_as_they_move(settings, pinned, "what is pinned", inputs)
    notes = upward_note(request.parsed["gravity"])
    # With several bodies some may be free, and need the floor.
    alone = filled.bodies.count == 1
    held = alone and not any(settings.lift) and (request.pins or attachments or springs)
    own = request.parsed["floor"] is None and request.preset != "paper"
    if held and own and gap < -BELOW * radius:
        settings = replace(settings, floor=None, floor_normal=None)
        notes += (
            f"the pinned asset reaches {length_text(-gap)} below height 0, so there is no floor;"
            " --floor adds one",
        )
    notes += _deep_notes(settings, gap, filled.particles.spacing, inputs)
    notes += _raised_notes(settings, lowest, inputs)
    notes += _moved_notes(settings, surfaces, radius, inputs)
    notes += own_space_notes(asset.surfaces, np.asarray(settings.lift), filled.particles.spacing)
    require_resolved(request, settings, gap, filled.particles.spacing)
    return Shot(
        settings=settings,
        gap=gap,
        animation=animation,
        attachments=attachments,
        springs=springs,
        extension=extension,
        notes=notes,
    )


def _deep_notes(settings: Settings, gap: float, spacing: float, inputs: Inputs) -> tuple[str, ...]:
    """A note where bodies begin deeper in the floor than contact is designed for."""
    if settings.floor is None or gap >= -spacing:
        return ()
    to = f" to {(settings.floor + gap) / inputs.unit:.3g}" if settings.floor_normal is None else ""
    given = inputs.request.parsed["floor"] is not None
    return (
        f"the asset begins {length_text(-gap)} ({rounded_text(-gap / spacing)} spacings) below"
        f" the floor, which pushes it out at once: lower"
        f" --floor{to}{', or leave it out' if given else ''}",
    )


def _raised_notes(settings: Settings, lowest: float, inputs: Inputs) -> tuple[str, ...]:
    """A note where what a physics stage has placed below the floor is moved up onto it."""
    raised = float(np.dot(settings.lift, settings.normal))
    if not is_placed(inputs.request, inputs.asset.facts) or raised <= 0.0:
        return ()
    return (
        f"the asset begins {length_text(raised)} below the floor and is moved up onto it: --floor"
        f" {lowest / inputs.unit:.3g} keeps it where it is, with a floor there",
    )


def _moved_notes(
    settings: Settings, surfaces: Sequence[Surface], radius: float, inputs: Inputs
) -> tuple[str, ...]:
    """A note where the default drop moves the asset down by more than its radius [m], or up from
    wholly below the floor: somebody may have placed it there.
    """
    request, normal = inputs.request, settings.normal
    if settings.floor is None or request.drop is not None or request.preset == "paper":
        return ()
    heights = [s.face_points @ normal - settings.floor for s in surfaces]
    low, high = min(float(h.min()) for h in heights), max(float(h.max()) for h in heights)
    lift = float(np.dot(settings.lift, normal))
    if is_placed(request, inputs.asset.facts) or lift == 0.0 or (lift >= -radius and high >= 0.0):
        return ()
    unit, start = inputs.unit, low + lift
    floor = f"--floor {(settings.floor - lift) / unit:.7g} puts the floor so far under it"
    hints = [f"--drop {low / unit:.7g} leaves it where it is"] if low >= 0.0 else []
    hints += [floor] if settings.floor_normal is None else []
    side, way = ("above", "down") if low >= 0.0 else ("below", "up")
    return (
        f"the lowest point of the asset is {length_text(abs(low))} {side} the floor and is"
        f" moved {way} to {length_text(start)} above it{': ' if hints else ''}{'; '.join(hints)}",
    )


def _prims_of_pins(names: Sequence[str], asset: Asset) -> list[str]:
    """The prims whose motion a pin follows: those that are named, and all meshes for a box or a
    weight map.
    """
    from gf_usd.geometry.regions import BOX
    from gf_usd.readers.usd_bake.regions import JOINT, PAINT

    prims = [name for name in names if not name.startswith((BOX, PAINT, JOINT))]
    if len(prims) < len(names):
        prims += [s.path for s in asset.surfaces if s.splats is None]
    return prims


def _as_long_as_they_move(
    settings: Settings,
    prims: Sequence[str],
    what: str,
    inputs: Inputs,
    before: Extension | None = None,
) -> tuple[Settings, Extension | None]:
    """The settings with frames until prims stay, unless the length is given.

    A bake that ends sooner leaves the bodies where they are, while the prims move on.  REST_SECONDS
    of playback limit it, as they limit a bake until rest.

    what : name of the prims, for the note; before : what has extended these settings.
    """
    request, file = inputs.request, inputs.file
    given = (request.frames, request.range, request.flesh, request.preset, request.settle_only)
    if file is None or not prims or any(given):
        return settings, before
    from gf_usd.readers.usd_physics.ending import end_of_motion

    ends = end_of_motion(file, prims, inputs.asset.facts)
    until = max(ends.values(), default=settings.start)
    step = settings.time_codes_per_second / settings.fps
    needed = frames_until(until, settings.start, step) + (request.handles or 0)
    if needed <= (before.needed if before else settings.frames):
        return settings, before
    least = before.least if before else settings.frames
    frames = min(needed, max(least, int(REST_SECONDS * settings.fps)))
    limit = f"{REST_SECONDS:g} s of playback" if frames < needed else ""
    extension = Extension(what=what, until=until, least=least, needed=needed, limit=limit)
    return replace(settings, frames=frames), extension


@dataclass(frozen=True, kw_only=True)
class Length:
    """The settings with the number of frames, and obstacles with their motion over these."""

    settings: Settings
    physics: StagePhysics
    open_end: bool  # the bake may end sooner, with everything at rest
    extension: Extension | None = None  # of the number of frames, where the end is not open

    @property
    def notes(self) -> tuple[str, ...]:
        """On the number of frames."""
        return () if self.extension is None else (self.extension.note(self.settings),)


def plan_length(
    inputs: Inputs, shot: Shot, pins: Sequence[Pin], changes: MaterialKeys | None
) -> Length:
    """The number of frames, with the motion of the obstacles over them.

    pins, changes : a driven motion, or one whose materials change, has no open end.
    """
    request, asset, file = inputs.request, inputs.asset, inputs.file
    settings, physics = shot.settings, inputs.spec.physics
    # Without anything below them bodies fall without limit.
    falls = (settings.floor is None and not physics.colliders) or _weightless(settings)
    changing = changes is not None and bool(changes.codes)
    driven = bool(pins or shot.springs or settings.fields) or changing
    open_end = request.length_is_open and not (falls or driven)
    extension: Extension | None = None
    moved = [one.path for one in physics.colliders]
    if open_end:
        settings = replace(settings, frames=settled_frames(settings.frames))
    else:
        settings, extension = _as_long_as_they_move(
            settings, moved, "an obstacle", inputs, shot.extension
        )
    if physics.colliders and file is not None:
        every = sampled(settings)
        times = [every.time_code(i) for i in range(every.frames)]
        moving = read_motion(asset, file, rest=request.start, times=times, elastic=False)
        physics = replace(moving, of_files=physics.of_files)
    if open_end and any(one.deformed is not None for one in physics.colliders):
        # its points may move for as long as there are frames
        settings, extension = _as_long_as_they_move(shot.settings, moved, "an obstacle", inputs)
        open_end = False
    return Length(settings=settings, physics=physics, open_end=open_end, extension=extension)


def _weightless(settings: Settings) -> bool:
    """Whether no gravity presses bodies against the floor."""
    return float(np.dot(settings.gravity, settings.normal)) >= 0.0
