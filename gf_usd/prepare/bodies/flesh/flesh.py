"""Flesh on characters (`--flesh`): pins at the bones, springs to the pose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import Asset, Surface
from gf_usd.core.errors import InputError
from gf_usd.core.frames.particles import SurfaceSamples
from gf_usd.core.frames.settings import Settings
from gf_usd.core.stage import BlendShapes, Goals, Pin, Skeleton
from gf_usd.core.units import code_text
from gf_usd.prepare.bodies.flesh.animation import animation_times, at_frames, require_closed
from gf_usd.prepare.bodies.flesh.characters import character_paths, overlap_notes
from gf_usd.prepare.bodies.flesh.jumps import jump_notes
from gf_usd.prepare.bodies.flesh.mesh_notes import (
    apart_note,
    hanging_notes,
    loose_note,
    shapes_notes,
    soft_note,
    thin_note,
    unbound_notes,
    worn_note,
)
from gf_usd.prepare.bodies.flesh.poses import (
    Poses,
    changing_shapes,
    joined_poses,
    read_bones,
)
from gf_usd.prepare.pins import FREE
from gf_usd.prepare.settings import Animation

if TYPE_CHECKING:
    from gf_usd.geometry.flesh.cores import Cores
    from gf_usd.geometry.flesh.sheets import Sheet
    from gf_usd.geometry.solid import Solid
    from gf_usd.prepare.bodies.plan import BodyPlan


BONE_RADIUS = 0.5  # of the distance to the skin
GOAL_FREQUENCY = 4.0  # [Hz] of painted goals: flesh of a person swings at 3 to 6
GOAL_DAMPING = 0.5
HANGING = 0.25  # share of the points of a mesh at the flesh that supports it, below which it hangs


@dataclass(frozen=True, kw_only=True)
class Flesh:
    """The pins and goals of a character's flesh."""

    pins: tuple[Pin, ...] = ()  # the cores of bones
    goals: Goals | None = None  # springs to the skinned pose
    notes: tuple[str, ...] = ()
    rigid: tuple[str, ...] = ()  # what of --rigid moves with its joints
    poses: Poses | None = None  # of all frames
    sheets: Mapping[str, Sheet] = field(default_factory=dict)  # by prim path
    shapes: Mapping[str, BlendShapes] = field(default_factory=dict)  # by prim path


def flesh_of(
    asset: Asset,
    solid: Solid,
    X: Floats,
    samples: SurfaceSamples,
    settings: Settings,
    animation: Animation,
    file: Path,
    *,
    bodies: BodyPlan,
    **options: Any,
) -> Flesh:
    """The cores of the bones of each body, and its springs; for the others see `_of_character`.

    bodies : one for each character.
    """
    if bodies.count == 1:
        return _of_character(asset, solid, X, samples, settings, animation, file, **options)
    every = []
    for k, paths in enumerate(character_paths(bodies)):
        own = replace(asset, surfaces=tuple(s for s in asset.surfaces if s.path in paths))
        part = solid.part(np.flatnonzero(bodies.of_surface == k))
        near = samples.subset(np.flatnonzero(samples.body == k))
        every.append(_of_character(own, part, X, near, settings, animation, file, **options))
    starts = [one.poses.start if one.poses else {} for one in every]
    overlaps = overlap_notes(asset, starts, code_text(animation.first))
    goals = None
    if any(one.goals for one in every):
        first, *others = (one.goals or FREE for one in every)
        goals = replace(first, of_body=dict(enumerate(others, 1)))
    return Flesh(
        pins=tuple(replace(pin, body=k) for k, one in enumerate(every) for pin in one.pins),
        goals=goals,
        notes=(*dict.fromkeys(note for one in every for note in one.notes), *overlaps),
        rigid=tuple(dict.fromkeys(name for one in every for name in one.rigid)),
        poses=joined_poses([one.poses for one in every if one.poses]),
        sheets={path: sheet for one in every for path, sheet in one.sheets.items()},
        shapes={path: shapes for one in every for path, shapes in one.shapes.items()},
    )


def _of_character(
    asset: Asset,
    solid: Solid,
    X: Floats,
    samples: SurfaceSamples,
    settings: Settings,
    animation: Animation,
    file: Path,
    *,
    share: float | None,
    frequency: float | None,
    damping: float | None,
    squish: float | None = None,
    stretch: float | None = None,
    rigid: Sequence[str] = (),
    lattice: float,
    spacing: float,
    cycle: int = 0,
    repeats: int = 0,
) -> Flesh:
    """The cores of the bones, and the springs that are requested, of the surfaces of one body.

    X : (n, 3) [m] of the particles.  settings : as `sampled`.  share, frequency [Hz], damping,
    squish, stretch : of --bone-radius, --goal-frequency, --goal-damping, --squish and --stretch;
    None: not given.  rigid : names of --rigid.  lattice : [m] half the edge of a cell;
    spacing : [m] of the samples.  cycle : samples of a period, which comes `repeats` times before
    it is written; 0: the animation is none.  Raises InputError as
    `read_animation`, where no bone lies in the flesh, and for a cycle that does not close.
    """
    from gf_usd.geometry.flesh.cores import bone_cores
    from gf_usd.geometry.flesh.limits import flesh_limits
    from gf_usd.geometry.flesh.sheets import skinned_sheets
    from gf_usd.readers.usd_bake.settings import read_goals

    cell, radius = 2.0 * lattice, share or BONE_RADIUS
    times, lead = animation_times(settings, animation, cycle, repeats)
    different, frame_rows = np.unique(times, return_inverse=True)
    skeleton, cores, poses, notes = read_bones(
        asset, solid, X, samples, animation, file, different.tolist(),
        radius=radius, cell=cell, spacing=spacing,
    )  # fmt: skip
    skeleton = at_frames(skeleton, frame_rows.tolist())
    shapes = changing_shapes(asset, animation, file, different, frame_rows)
    if cycle and repeats:
        require_closed(asset, skeleton, lead, cycle)
    jumps = () if cycle else jump_notes(skeleton, times, lead)
    if cores is None:
        cores, notes = bone_cores(skeleton.bones, solid, radius, cell)
    if animation.nearest:
        notes = (
            f"{', '.join(s.path for s in asset.surfaces)} without joint weights: each point follows"
            f" the nearest bones of {animation.nearest}",
            *notes,
        )
    goals_painted = read_goals(file, asset.facts, asset.surfaces, rest=animation.first)
    pins, kept, pin_notes = _pin_to_bones(
        asset, solid, X, skeleton, cores, rigid, radius, cell,
        springs=frequency is not None or bool(goals_painted),
    )  # fmt: skip
    held = {path for pin in pins for path in pin.meshes}
    sheets = skinned_sheets(asset.surfaces, solid, skeleton, held)
    found: dict[str, Any] = {
        "pins": pins, "rigid": tuple(kept), "poses": poses, "sheets": sheets, "shapes": shapes,
    }  # fmt: skip
    limits = None
    if squish is not None or stretch is not None:
        limits = flesh_limits(cores, skeleton, squish=squish, stretch=stretch, cell=cell)
    painted, frequency, goal_notes = _goal_weights(
        asset, solid, skeleton, cores, goals_painted, frequency, cell
    )
    unbound = {path: (one.unbound, len(one.share)) for path, one in sheets.items()}
    notes = (
        *jumps, *notes, *shapes_notes(shapes), *pin_notes, *goal_notes, *unbound_notes(unbound),
    )  # fmt: skip
    if frequency is None and limits is None:
        return Flesh(notes=notes, **found)
    goals, key_notes = _springs(
        asset, solid, samples, skeleton, painted, animation, file, different, frame_rows,
        frequency=frequency or 0.0,  # limits alone: no springs
        damping=GOAL_DAMPING if damping is None else damping, spacing=spacing, limits=limits,
    )  # fmt: skip
    notes = (*notes, *key_notes)
    return Flesh(goals=goals, notes=notes, **found)


def _pin_to_bones(
    asset: Asset,
    solid: Solid,
    X: Floats,
    skeleton: Skeleton,
    cores: Cores,
    rigid: Sequence[str],
    share: float,
    cell: float,
    springs: bool,
) -> tuple[tuple[Pin, ...], list[str], tuple[str, ...]]:
    """Pins of the cores, and of meshes that move rigidly with a joint: those named by --rigid, and
    those apart from the flesh, too thin for the grid, or accessories.  Which of `rigid` they are;
    notes.

    X : (n, 3) [m] of the particles; share, cell [m] : of `bone_cores`; springs : whether these hold
    all flesh, accessories too.

    Raises InputError where no pin holds flesh.
    """
    from gf_usd.geometry.flesh.cores import bone_pins
    from gf_usd.geometry.flesh.single_joint import (
        accessories,
        meshes_apart,
        named_single_joint_meshes,
        single_joint_meshes,
        single_joint_pins,
        thin_meshes,
    )

    bones = skeleton.bones
    pins = bone_pins(bones, cores)
    bound = single_joint_meshes(skeleton)
    kept = named_single_joint_meshes(rigid, bound, [s.path for s in asset.surfaces])
    pins += single_joint_pins(kept, bound, skeleton, solid, cell)
    taken = {path for pin in pins for path in pin.meshes}
    soft = [path for path in bound if path not in taken]
    apart = meshes_apart(soft, bound, solid, cores, cell)
    soft = [path for path in soft if path not in apart]
    thin = thin_meshes(soft, solid, X, share, cell)
    soft = [path for path in soft if path not in thin and path in solid.filled]
    worn = [] if springs else accessories(soft, bound, solid, cores)
    pins += single_joint_pins([*apart, *thin, *worn], bound, skeleton, solid, cell)
    if not pins or (len(pins) == len(apart) and not springs):  # those hold none but themselves
        raise InputError(
            f"{asset.facts.path}: --flesh: none of {len(bones)} bones lies inside the flesh, such"
            f" as {bones[0].name}",
            "bind the mesh again, so that in the bind pose its skeleton is inside it",
        )
    soft = [path for path in soft if path not in worn]
    notes = (*apart_note(apart), *thin_note(thin, cell), *worn_note(worn))
    return pins, kept, (*notes, *soft_note(soft))


def _goal_weights(
    asset: Asset,
    solid: Solid,
    skeleton: Skeleton,
    cores: Cores,
    painted: dict[str, Floats],
    frequency: float | None,
    cell: float,
) -> tuple[dict[str, Floats], float | None, tuple[str, ...]]:
    """Goal weights by prim path, the frequency [Hz] of their springs, and notes: painted ones, or,
    where neither these nor a frequency are given, those of meshes that little or no flesh supports.
    The frequency is None where there are no springs.
    """
    from gf_usd.geometry.flesh.goals import UNPAINTED
    from gf_usd.geometry.flesh.single_joint import loose_meshes, single_joint_meshes

    if frequency is not None:
        return painted, frequency, ()
    if painted:
        note = f"painted goals are springs of {GOAL_FREQUENCY:g} Hz: --goal-frequency"
        return painted, GOAL_FREQUENCY, (note,)
    loose, near = loose_meshes(skeleton, single_joint_meshes(skeleton), solid, cores, cell)
    hanging = {path: share for path, share in near.items() if share < HANGING}
    notes = (*loose_note(loose), *hanging_notes(hanging, GOAL_FREQUENCY))
    if loose or hanging:
        goals = dict.fromkeys(loose, 1.0) | dict.fromkeys(hanging, UNPAINTED)
        return _held(asset.surfaces, goals), GOAL_FREQUENCY, notes
    return painted, None, notes


def _springs(
    asset: Asset,
    solid: Solid,
    samples: SurfaceSamples,
    skeleton: Skeleton,
    painted: Mapping[str, Floats],
    animation: Animation,
    file: Path,
    times: Floats,
    frame_rows: Ints,
    **options: Any,
) -> tuple[Goals, tuple[str, ...]]:
    """The springs and limits of the flesh, and notes; options : of `flesh_goals`.

    times : different time codes of the animation; frame_rows : of each frame, in `times`.
    """
    from gf_usd.geometry.flesh.goals import flesh_goals
    from gf_usd.readers.usd_bake.settings import goals_vary, read_goals

    keys: list[Mapping[str, Floats]] = []
    notes: tuple[str, ...] = ()
    if painted and goals_vary(file, asset.facts, asset.surfaces):
        codes = np.maximum(times, animation.first).tolist()
        keys = [read_goals(file, asset.facts, asset.surfaces, rest=code) for code in codes]
        notes = ("painted goals have time samples: springs change with them",)
    goals = flesh_goals(
        solid, samples, skeleton, painted, keys=keys, key_of_frame=frame_rows.tolist(), **options
    )
    return goals, notes


def _held(surfaces: Sequence[Surface], goals: Mapping[str, float]) -> dict[str, Floats]:
    """Goal weights at the face corners of surfaces, by prim path: those given, else 0."""
    return {
        one.path: np.full(int(np.sum(one.face_counts)), goals.get(one.path, 0.0))
        for one in surfaces
    }
