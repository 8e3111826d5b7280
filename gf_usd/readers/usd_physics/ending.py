"""The time code at which the animation of prims ends, for the length of a bake."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Gf, Usd, UsdGeom, UsdSkel

from gf_usd.core.asset import StageFacts
from gf_usd.readers.usd.select import PROXIES, named_prim
from gf_usd.readers.usd.stage import open_stage, reading, upwards
from gf_usd.readers.usd_physics.attachments import ANCHORS, KINDS
from gf_usd.readers.usd_physics.motion import SHAPE, bare_reading


def end_of_motion(file: Path, paths: Sequence[str], facts: StageFacts) -> dict[str, float]:
    """By prim path, the first time code after which nothing at or below the prim moves.

    An attachment moves with what it attaches to.  Prims that do not move are left out.  The end of
    the stage, where it is authored, bounds the motion.

    Raises InputError for a path without a prim.
    """
    last = np.inf if facts.end_time_code is None else facts.end_time_code
    ends = {}
    with reading(file):
        stage = open_stage(file)
        for path in paths:
            prim = named_prim(stage, facts.path, path)
            codes = [end for one in _moved_by(prim) for end in _ends(one, facts)]
            if codes:
                ends[path] = min(max(codes), last)
    return ends


def _moved_by(prim: Usd.Prim) -> Iterable[Usd.Prim]:
    """The prim, or for an attachment itself and what it attaches to."""
    if prim.GetTypeName() not in KINDS:
        return [prim.GetParent() if UsdGeom.Subset(prim) else prim]
    targets = [t for relation in prim.GetRelationships() for t in relation.GetForwardedTargets()]
    found = (prim.GetStage().GetPrimAtPath(target) for target in targets)
    return [prim, *(one for one in found if one)]


def _ends(prim: Usd.Prim, facts: StageFacts) -> Iterable[float]:
    """The ends of the motions of a prim, of those above it, and of those below it."""
    for above in upwards(prim.GetParent()):
        yield from _of_one(above)
    skins = bare_reading(facts, Usd.TimeCode.EarliestTime()).skins
    for one in Usd.PrimRange(prim, PROXIES):
        yield from _of_one(one)
        bound = skins.skeleton(one) if one.IsA(UsdGeom.Mesh) else None
        if bound is not None:
            skeleton, animation = bound[0], skins.query(bound[0]).GetAnimQuery()
            yield from _ends_of_skeleton(animation, skeleton)


def _ends_of_skeleton(animation: UsdSkel.AnimQuery | None, skeleton: Usd.Prim) -> Iterable[float]:
    for prim in upwards(skeleton):
        yield from _of_one(prim)
    if animation:
        codes = animation.GetJointTransformTimeSamples()
        yield from _end(codes, animation.ComputeJointLocalTransforms)


def _of_one(prim: Usd.Prim) -> Iterable[float]:
    """The ends of the motion of the transform of one prim, and of its shape."""
    placed = UsdGeom.Xformable(prim)
    if placed and placed.TransformMightBeTimeVarying():
        yield from _end(placed.GetTimeSamples(), lambda code: _local(placed, code))
    for name in (*SHAPE, ANCHORS):
        if (attribute := prim.GetAttribute(name)) and attribute.GetNumTimeSamples() > 1:
            yield from _end(attribute.GetTimeSamples(), attribute.Get)


def _local(placed: UsdGeom.Xformable, code: float) -> Gf.Matrix4d:
    return placed.GetLocalTransformation(code)


def _end(codes: Sequence[float], value: Callable[[float], Any]) -> Iterable[float]:
    """The first code from which on all values are equal; none where all of them are."""
    later = None
    for code in sorted(codes, reverse=True):
        now = np.asarray(value(code))
        if later is not None and not np.array_equal(now, later[1]):
            yield later[0]
            return
        later = (code, now)
