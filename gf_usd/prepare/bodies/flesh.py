"""Flesh on characters (`--flesh`): their animation, pins at the bones, springs to the pose."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import Asset, Surface, first_time_code
from gf_usd.core.errors import InputError
from gf_usd.core.frames import Settings, SurfaceSamples
from gf_usd.core.stage import Goals, Pin, Skeleton
from gf_usd.core.units import code_text, length_text, percent_text
from gf_usd.prepare.bodies.characters import character_paths, overlap_notes
from gf_usd.prepare.bodies.jumps import jump_notes
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
SAME_POSE = 1e-3  # of the skeleton: poses that differ by less are one
JUMP = 2.0  # times the largest displacement in a frame: beyond it, not a cycle


def read_animation(asset: Asset, file: Path, start: float | None) -> Animation:
    """The animation of the skeletons that pose an asset; start : its first time code, as given.

    Where no skeleton poses any of it, that of its points, or else of the only skeleton of the
    stage.  Raises InputError where there is none, and for a broken skeleton.
    """
    from gf_usd.readers.usd.skeleton.bones import (
        animation_range,
        has_skeleton,
        lone_skeleton,
        read_skeleton,
    )
    from gf_usd.readers.usd_bake.caches import cache_range, has_animated_points, read_cache

    paths = [s.path for s in asset.surfaces]
    posed, nearest = has_skeleton(file, paths, asset.facts), ""
    if not (posed or has_animated_points(file, paths, asset.facts)):
        nearest = lone_skeleton(file)
    cached = not (posed or nearest)
    captures = [s.path for s in asset.surfaces if s.splats is not None]
    if cached and captures:
        raise InputError(
            f"{asset.facts.path}: --flesh: no skeleton poses <{captures[0]}>, and an animation of"
            " captured Gaussians themselves is not followed",
            "add a Skeleton under a SkelRoot (UsdSkel), the only one of the stage, whose nearest"
            " bones they follow; leave them out with --prim; or bake without --flesh",
        )
    loose = _surface_points(asset) if nearest else None
    if cached:
        first, last = cache_range(file, paths, asset.facts)
    else:
        first, last = animation_range(file, paths, asset.facts, loose)
    if start is not None:
        first, last = first_time_code(asset.facts, start), max(start, last)
    if cached:
        ends = read_cache(file, paths, asset.facts, first=first, times=[first, last])
        start_points, end_points = (np.concatenate([x[p] for p in paths]) for x in ends)
        extent = float(np.linalg.norm(np.ptp(start_points, axis=0)))
        away = float(np.linalg.norm(end_points - start_points, axis=1).max())
        closed = last > first and away < SAME_POSE * extent
        return Animation(first=first, last=last, reach=0.0, closed=closed, cached=True)
    ends = {"first": first, "times": [first, last], "loose": loose}
    bones = read_skeleton(file, paths, asset.facts, **ends).bones
    reach = max(float(np.linalg.norm(b.path[0] - b.anchors, axis=1).max()) for b in bones)
    steps = [float(np.linalg.norm(b.path[1] - b.path[0], axis=1).max()) for b in bones]
    size = float(np.linalg.norm(bones[0].anchors[1] - bones[0].anchors[0]))
    closed = last > first and max(steps) < SAME_POSE * size
    return Animation(first=first, last=last, reach=reach, closed=closed, nearest=nearest)


def _surface_points(asset: Asset) -> dict[str, Floats]:
    """The points of the surfaces, (V, 3) [m] in the world, by prim path."""
    return {s.path: s.points for s in asset.surfaces}


@dataclass(frozen=True, kw_only=True)
class Poses:
    """How low an animation takes the surfaces, and where they are in its first frame."""

    lowest: float  # [m] height of the lowest point in all poses, of the surfaces that have any
    still: tuple[str, ...] = ()  # prim paths of surfaces without joint weights next to others
    start: Mapping[str, Floats] = field(default_factory=dict)  # (V, 3) [m] by prim path


@dataclass(frozen=True, kw_only=True)
class Flesh:
    """The pins and goals of a character's flesh."""

    pins: tuple[Pin, ...] = ()  # the cores of bones
    goals: Goals | None = None  # springs to the skinned pose
    notes: tuple[str, ...] = ()
    rigid: tuple[str, ...] = ()  # what of --rigid moves with its joints
    poses: Poses | None = None  # of all frames
    sheets: Mapping[str, Sheet] = field(default_factory=dict)  # by prim path


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
        poses=_joined([one.poses for one in every if one.poses]),
        sheets={path: sheet for one in every for path, sheet in one.sheets.items()},
    )


def _joined(every: Sequence[Poses]) -> Poses:
    """The poses of one or several characters."""
    return Poses(
        lowest=min(one.lowest for one in every),
        still=tuple(path for one in every for path in one.still),
    )


def _poses(asset: Asset, skeleton: Skeleton, first: int) -> Poses:
    """The poses of the surfaces that have weights; first : row of the animation's first frame."""
    from gf_usd.geometry.flesh.linear_blend import bone_transforms, skinned

    linear, offset = bone_transforms(skeleton)
    # The height alone takes a third of the time of all three coordinates.
    slopes, heights = asset.facts.up @ linear, offset @ asset.facts.up
    least, start = np.inf, {}
    for surface in asset.surfaces:
        if surface.path not in skeleton.weights:
            continue
        weights, X = skeleton.weights[surface.path], surface.points
        for slope, height in zip(slopes, heights, strict=True):
            low = skinned(weights, slope[:, None], height[:, None], X).min(initial=np.inf)
            least = min(least, float(low))
        start[surface.path] = skinned(weights, linear[first], offset[first], X)
    still = tuple(s.path for s in asset.surfaces if s.path not in skeleton.weights)
    return Poses(lowest=least, still=still, start=start)


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
    times, lead = _animation_times(settings, animation, cycle, repeats)
    different, frame_rows = np.unique(times, return_inverse=True)
    skeleton, cores, poses, notes = _read_bones(
        asset, solid, X, samples, animation, file, different.tolist(),
        radius=radius, cell=cell, spacing=spacing,
    )  # fmt: skip
    skeleton = _at_frames(skeleton, frame_rows.tolist())
    if cycle and repeats:
        _require_closed(asset, skeleton, lead, cycle)
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
    found: dict[str, Any] = {
        "pins": pins, "rigid": tuple(kept), "poses": poses,
        "sheets": skinned_sheets(asset.surfaces, solid, skeleton, held),
    }  # fmt: skip
    limits = None
    if squish is not None or stretch is not None:
        limits = flesh_limits(cores, skeleton, squish=squish, stretch=stretch, cell=cell)
    painted, frequency, goal_notes = _goal_weights(
        asset, solid, skeleton, cores, goals_painted, frequency, cell
    )
    notes = (*jumps, *notes, *pin_notes, *goal_notes)
    if frequency is None and limits is None:
        return Flesh(notes=notes, **found)
    goals, key_notes = _springs(
        asset, solid, samples, skeleton, painted, animation, file, different, frame_rows,
        frequency=frequency or 0.0,  # limits alone: no springs
        damping=GOAL_DAMPING if damping is None else damping, spacing=spacing, limits=limits,
    )  # fmt: skip
    notes = (*notes, *key_notes)
    return Flesh(goals=goals, notes=notes, **found)


def _read_bones(
    asset: Asset,
    solid: Solid,
    X: Floats,
    samples: SurfaceSamples,
    animation: Animation,
    file: Path,
    times: Sequence[float],
    *,
    radius: float,
    cell: float,
    spacing: float,
) -> tuple[Skeleton, Cores | None, Poses, tuple[str, ...]]:
    """The bones at some time codes: of the skeleton, or pieces of a body without one, whose cores
    are found with them.  The cores, else None; the poses; notes.
    """
    from gf_usd.geometry.flesh.medial import medial_skeleton
    from gf_usd.readers.usd.skeleton.bones import read_skeleton
    from gf_usd.readers.usd_bake.caches import read_cache

    paths = [s.path for s in asset.surfaces]
    when = {"first": animation.first, "times": times}
    if not animation.cached:
        loose = _surface_points(asset) if animation.nearest else None
        skeleton = read_skeleton(file, paths, asset.facts, **when, loose=loose)
        start = int(np.searchsorted(times, animation.first))
        return skeleton, None, _poses(asset, skeleton, start), ()
    lows: list[float] = []
    poses = _with_lows(read_cache(file, paths, asset.facts, **when), asset.facts.up, lows)
    skeleton, cores = medial_skeleton(
        solid, X, samples, poses,
        share=radius, cell=cell, spacing=spacing, where=str(asset.facts.path),
    )  # fmt: skip
    note = (
        f"it has no skeleton: {len(skeleton.bones)} pieces along its medial axis follow its"
        f" animated points as bones"
    )
    return skeleton, cores, Poses(lowest=min(lows)), (note,)


def _with_lows(
    poses: Iterable[dict[str, Floats]], up: Floats, lows: list[float]
) -> Iterator[dict[str, Floats]]:
    """The poses; the height [m] of the lowest point of each is appended to `lows`."""
    for pose in poses:
        lows.append(min(float((points @ up).min()) for points in pose.values()))
        yield pose


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

    Raises InputError where nothing is pinned.
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
    if not pins:
        raise InputError(
            f"{asset.facts.path}: --flesh: none of {len(bones)} bones lies inside the flesh, such"
            f" as {bones[0].name}",
            "bind the mesh again, so that in the bind pose its skeleton is inside it",
        )
    soft = [path for path in soft if path not in worn]
    notes = (*_apart_meshes(apart), *_thin_meshes(thin, cell), *_worn_meshes(worn))
    return pins, kept, (*notes, *_soft_meshes(soft))


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
    where neither these nor a frequency are given, those of meshes that no flesh supports.  The
    frequency is None where there are no springs.
    """
    from gf_usd.geometry.flesh.single_joint import loose_meshes, single_joint_meshes

    if frequency is not None:
        return painted, frequency, ()
    if painted:
        note = f"painted goals are springs of {GOAL_FREQUENCY:g} Hz: --goal-frequency"
        return painted, GOAL_FREQUENCY, (note,)
    loose, near = loose_meshes(skeleton, single_joint_meshes(skeleton), solid, cores, cell)
    notes = (*_loose_meshes(loose), *_hanging_meshes(near))
    if loose:
        return _held(asset.surfaces, loose), GOAL_FREQUENCY, notes
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


def _held(surfaces: Sequence[Surface], paths: Sequence[str]) -> dict[str, Floats]:
    """Goal weights at the face corners of surfaces, by prim path: 1 of those named, else 0."""
    return {
        one.path: np.full(int(np.sum(one.face_counts)), 1.0 if one.path in paths else 0.0)
        for one in surfaces
    }


def _loose_meshes(paths: Sequence[str]) -> tuple[str, ...]:
    """The note on meshes of several joints that no flesh supports."""
    if not paths:
        return ()
    follows, touches, it, its, pose = (
        ("follows", "touches", "it", "its", "pose")
        if len(paths) == 1
        else ("follow", "touch", "they", "their", "poses")
    )
    them = "it" if len(paths) == 1 else "them"
    return (
        f"{_listed(paths)} {follows} several joints and {touches} no flesh: springs hold {them} in"
        f" {its} skinned {pose}, because {it} would fall; --goal-frequency gives all flesh springs"
        f" instead",
    )


def _hanging_meshes(near: Mapping[str, float]) -> tuple[str, ...]:
    """Notes on meshes of several joints that the flesh supports at few of their points."""
    return tuple(
        f"<{path}> follows several joints, and only {percent_text(share)} of its points are near"
        f" the flesh that holds it: the rest hangs from there; --goal-frequency pulls it to its"
        f" skinned pose"
        for path, share in near.items()
        if share < HANGING
    )


def _animation_times(
    settings: Settings, animation: Animation, cycle: int, repeats: int
) -> tuple[Floats, int]:
    """The time code of the animation at each sample, and the number of samples before its start;
    see `_of_character`.
    """
    step = settings.time_codes_per_second / settings.fps
    lead = animation.lead(settings, cycle * repeats)
    frame = np.arange(settings.frames) - lead
    frame = np.where((frame > 0) & (cycle > 0), frame % max(cycle, 1), frame)
    return animation.first + frame * step, lead


def _apart_meshes(paths: Sequence[str]) -> tuple[str, ...]:
    """The note on meshes that move with a single joint and that no flesh supports."""
    if not paths:
        return ()
    moves, touches, is_, it = (
        ("moves", "touches", "is", "it") if len(paths) == 1 else ("move", "touch", "are", "they")
    )
    return (
        f"{_listed(paths)} {moves} with a single joint and {touches} no flesh: {it} {is_} kept"
        f" rigid, because {it} would fall",
    )


def _thin_meshes(paths: Sequence[str], cell: float) -> tuple[str, ...]:
    """The note on meshes that move with a single joint and are too thin to be soft."""
    if not paths:
        return ()
    moves, is_, it = ("moves", "is", "it is") if len(paths) == 1 else ("move", "are", "they are")
    return (
        f"{_listed(paths)} {moves} with a single joint and {is_} too thin for the grid, which has"
        f" cells of {length_text(cell)}: {it} kept rigid; more --particles make the grid finer",
    )


def _worn_meshes(paths: Sequence[str]) -> tuple[str, ...]:
    """The note on meshes that move with a single joint and have no bone of their own."""
    if not paths:
        return ()
    moves, is_, it, has = (
        ("moves", "is", "it", "has") if len(paths) == 1 else ("move", "are", "they", "have")
    )
    return (
        f"{_listed(paths)} {moves} with a single joint and {has} no bone of"
        f" {'its' if len(paths) == 1 else 'their'} own: {it} {is_} kept rigid, because {it} would"
        f" hang from the rest; with --goal-frequency {it} {is_} as soft as the rest",
    )


def _listed(paths: Sequence[str]) -> str:
    """The first three of some prim paths, and how many more there are."""
    left = len(paths) - 3
    more = f" and {left} more mesh{'es' * (left > 1)}" if left > 0 else ""
    return ", ".join(f"<{path}>" for path in paths[:3]) + more


def _soft_meshes(paths: Sequence[str]) -> tuple[str, ...]:
    """The note on meshes that move with a single joint and are not kept rigid."""
    if not paths:
        return ()
    moves, becomes = ("moves", "becomes") if len(paths) == 1 else ("move", "become")
    return (
        f"{_listed(paths)} {moves} with a single joint and {becomes} as soft as the"
        f" rest; --rigid keeps a mesh rigid, such as --rigid {paths[0]}",
    )


def _at_frames(skeleton: Skeleton, rows: list[int]) -> Skeleton:
    """A skeleton with a selection of its frames."""
    bones = tuple(replace(bone, path=bone.path[rows]) for bone in skeleton.bones)
    skin = skeleton.samples
    if skin is not None:
        skin = replace(skin, offsets=[skin.offsets[row] for row in rows])
    return replace(skeleton, bones=bones, samples=skin)


def _require_closed(asset: Asset, skeleton: Skeleton, first: int, cycle: int) -> None:
    """Raise InputError where the motion jumps from the end of a cycle to its start.

    first : sample at which the animation begins; cycle : samples of a period.
    """
    path = np.concatenate([b.path[first : first + cycle + 1] for b in skeleton.bones], axis=1)
    ways = np.linalg.norm(np.diff(path, axis=0), axis=2).max(1)
    size = float(np.linalg.norm(skeleton.bones[0].anchors[1] - skeleton.bones[0].anchors[0]))
    if ways[-1] > JUMP * ways[:-1].max(initial=0.0) + SAME_POSE * size:
        raise InputError(
            f"{asset.facts.path}: --loop: the animation is not cyclic: the distance from its"
            f" last frame to its first is {length_text(ways[-1])}, and at most"
            f" {length_text(ways[:-1].max(initial=0.0))} between"
            " others",
            "give a stage whose time range is one cycle, in place, or omit --loop",
        )
