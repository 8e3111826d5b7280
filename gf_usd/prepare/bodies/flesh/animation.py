"""The animation of a character: its range, the time codes of the frames, and cycles of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.asset import Asset, first_time_code
from gf_usd.core.errors import InputError
from gf_usd.core.frames.settings import Settings
from gf_usd.core.stage import Skeleton
from gf_usd.core.units import length_text
from gf_usd.prepare.settings import Animation

SAME_POSE = 1e-3  # of the skeleton: poses that differ by less are one
JUMP = 2.0  # times the largest displacement in a frame: beyond it, not a cycle


def read_animation(asset: Asset, file: Path, start: float | None, posed: bool) -> Animation:
    """The animation of the skeletons that pose an asset.

    start : its first time code, as given; posed : whether a skeleton poses any of its surfaces.

    Where no skeleton poses any of it, that of its points, or else of the only skeleton of the
    stage.  Raises InputError where there is none, and for a broken skeleton.
    """
    from gf_usd.readers.usd.skeleton.bones import animation_range, lone_skeleton, read_skeleton
    from gf_usd.readers.usd_bake.caches import cache_range, has_animated_points, read_cache

    paths, nearest = [s.path for s in asset.surfaces], ""
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
    loose = surface_points(asset) if nearest else None
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


def surface_points(asset: Asset) -> dict[str, Floats]:
    """The points of the surfaces, (V, 3) [m] in the world, by prim path."""
    return {s.path: s.points for s in asset.surfaces}


def animation_times(
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


def at_frames(skeleton: Skeleton, rows: list[int]) -> Skeleton:
    """A skeleton with a selection of its frames."""
    bones = tuple(replace(bone, path=bone.path[rows]) for bone in skeleton.bones)
    skin = skeleton.samples
    if skin is not None:
        skin = replace(skin, offsets=[skin.offsets[row] for row in rows])
    return replace(skeleton, bones=bones, samples=skin)


def require_closed(asset: Asset, skeleton: Skeleton, first: int, cycle: int) -> None:
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
