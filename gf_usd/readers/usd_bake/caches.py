"""Animated points of meshes, such as those of a simulation cache, at each frame.

Times before the first frame are a pre-roll from the first pose, at rest, into the motion, as for
skeletons (`readers.usd.skeleton.joint_motion`): x = x_0 + n s (x_1 - x_0), with n the frames by
which the motion is extrapolated backward, and s from 0 to 1.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom

from gf_usd.core.arrays import Floats
from gf_usd.core.asset import StageFacts
from gf_usd.core.errors import InputError
from gf_usd.core.units import code_text
from gf_usd.readers.usd.mesh import posed_points
from gf_usd.readers.usd.select import named_prim
from gf_usd.readers.usd.skeleton.joint_motion import lead_in
from gf_usd.readers.usd.skeleton.skins import has_influences, unposed
from gf_usd.readers.usd.stage import open_stage, reading, upwards
from gf_usd.readers.usd_physics.motion import bare_reading

SAME = 1e-9  # entries of transforms that are alike differ by less


def has_animated_points(file: Path, paths: Sequence[str], facts: StageFacts) -> bool:
    """Whether the points of any of some meshes have time samples."""
    with reading(file):
        stage = open_stage(file)
        every = (UsdGeom.PointBased(named_prim(stage, facts.path, path)) for path in paths)
        return any(one and one.GetPointsAttr().GetNumTimeSamples() > 1 for one in every)


def animated_meshes(
    file: Path, paths: Sequence[str], facts: StageFacts, beside: Sequence[str] = ()
) -> set[str]:
    """Those of some meshes whose points or transforms, or those of prims above, have time samples.

    A mesh under an animated transform is one of them.

    beside : prim paths of what moves with the transforms above it: these do not count, and neither
        does a transform that is the same at all its samples.
    """
    found = set()
    with reading(file):
        stage = open_stage(file)
        common = {p for one in beside for p in Sdf.Path(one).GetPrefixes()}
        for path in paths:
            prim = named_prim(stage, facts.path, path)
            points = UsdGeom.PointBased(prim)
            if points and points.GetPointsAttr().GetNumTimeSamples() > 1:
                found.add(path)
            for above in () if path in found else upwards(prim):
                placed = UsdGeom.Xformable(above)
                if placed and above.GetPath() not in common and _moves(placed, bool(beside)):
                    found.add(path)
                    break
    return found


def _moves(placed: UsdGeom.Xformable, values: bool) -> bool:
    """Whether a transform has several time samples, and, with `values`, not all alike."""
    codes = placed.GetTimeSamples()
    if not values or len(codes) < 2:
        return len(codes) > 1
    first = placed.GetLocalTransformation(Usd.TimeCode(codes[0]))
    return any(
        not Gf.IsClose(placed.GetLocalTransformation(Usd.TimeCode(code)), first, SAME)
        for code in codes[1:]
    )


def cache_range(file: Path, paths: Sequence[str], facts: StageFacts) -> tuple[float, float]:
    """First and last time code of the animation of some meshes without skeletons.

    The stage's own if it authors both, else those of the time samples of the points and of the
    transforms.  Raises InputError where nothing is animated.
    """
    codes: set[float] = set()
    why = ""  # of the first mesh, where it has joint influences
    with reading(file):
        stage = open_stage(file)
        for path in paths:
            prim = named_prim(stage, facts.path, path)
            if path == paths[0] and has_influences(prim):
                why = f" ({unposed(prim)})"
            if points := UsdGeom.PointBased(prim):
                codes.update(points.GetPointsAttr().GetTimeSamples())
            for above in upwards(prim):
                if placed := UsdGeom.Xformable(above):
                    codes.update(placed.GetTimeSamples())
    if len(codes) < 2:
        here = f"<{paths[0]}>" + (f" and {len(paths) - 1} more" if len(paths) > 1 else "")
        raise InputError(
            f"{facts.path}: --flesh: no skeleton poses {here}{why}, and its points have no"
            " animation",
            "bind the mesh to a Skeleton under a SkelRoot (UsdSkel), with joint indices and"
            " weights, give it time samples, or bake it without --flesh",
        )
    first = min(codes) if facts.start_time_code is None else facts.start_time_code
    last = max(codes) if facts.end_time_code is None else facts.end_time_code
    return first, max(first, last)


def read_cache(
    file: Path, paths: Sequence[str], facts: StageFacts, *, first: float, times: Sequence[float]
) -> Iterator[dict[str, Floats]]:
    """World points (V, 3) [m] of meshes by prim path, for each time in order.

    first : time code of the first frame.
    times : ascending time codes; those before `first` are a pre-roll from the rest shape.

    Raises InputError where the number of points changes, or they are not finite.
    """
    codes = np.asarray(times, float)
    before = codes[codes < first]
    step = float(codes[1] - codes[0]) if len(codes) > 1 else 1.0
    with reading(file):
        stage = open_stage(file)
        start = _posed(stage, paths, facts, first)
        if len(before):
            change = {p: x - start[p] for p, x in _posed(stage, paths, facts, first + step).items()}
            _require_same(start, change, facts, first + step)
            for s, back in lead_in(before, first, step):
                yield {p: start[p] + back * s * change[p] for p in paths}
        for code in codes[codes >= first].tolist():
            now = _posed(stage, paths, facts, code)
            _require_same(start, now, facts, code)
            yield now


def _posed(
    stage: Usd.Stage, paths: Sequence[str], facts: StageFacts, code: float
) -> dict[str, Floats]:
    now = bare_reading(facts, Usd.TimeCode(code))
    return {path: posed_points(named_prim(stage, facts.path, path), now) for path in paths}


def _require_same(
    start: dict[str, Floats], now: dict[str, Floats], facts: StageFacts, code: float
) -> None:
    for path, points in start.items():
        if now[path].shape != points.shape:
            raise InputError(
                f"{facts.path}: --flesh: <{path}> has {len(points)} points at the first frame "
                f"but {len(now[path])} at time code {code_text(code)}",
                "give a cache with the same number of points in all frames",
            )
