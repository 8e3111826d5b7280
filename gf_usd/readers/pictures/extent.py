"""Time samples of the animation of a stage, and the bounding box over its time range."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom, UsdSkel

from gf_usd.core.arrays import Floats
from gf_usd.core.scene import Bounds, to_frame
from gf_usd.readers.notes import Notes
from gf_usd.readers.usd.implicit import IMPLICIT, tessellate
from gf_usd.readers.usd.skeleton import Skins
from gf_usd.readers.usd.stage import SPLAT_TYPE, Placement, SkippedPrim, is_bake_particles

SAMPLED_TIMES = (
    48  # times at which a longer motion is looked at, evenly spread, first and last included
)
AROUND = 0.1  # of the diagonal of the box of what moves
POINTS = ("points", "positions", "positionsh")
HEALTH = "gaussianFlesh:health:kineticEnergy"  # has a sample at every frame of a bake


def sample_times(prims: Sequence[Usd.Prim]) -> list[float]:
    """Every time code at which points, transforms or skeletons of the prims have a sample.

    A bake that leaves samples out has those of its frames still, in its health.
    """
    times: set[float] = set()
    seen: set[str] = set()
    for prim in prims:
        for name in POINTS:
            if attribute := prim.GetAttribute(name):
                times.update(attribute.GetTimeSamples())
        above = prim
        while above and str(above.GetPath()) not in seen:
            seen.add(str(above.GetPath()))
            if xformable := UsdGeom.Xformable(above):
                times.update(xformable.GetTimeSamples())
            if health := above.GetAttribute(HEALTH):
                times.update(health.GetTimeSamples())
            if above.IsA(UsdSkel.Root):
                times.update(_skeleton_times(above))
            above = above.GetParent()
    return sorted(times)


def _skeleton_times(root: Usd.Prim) -> set[float]:
    """Samples of what poses the skeletons of a SkelRoot, wherever in the stage that is."""
    times: set[float] = set()
    cache = UsdSkel.Cache()
    skel_root = UsdSkel.Root(root)
    cache.Populate(skel_root, Usd.TraverseInstanceProxies())
    for binding in cache.ComputeSkelBindings(skel_root, Usd.TraverseInstanceProxies()):
        skeleton = binding.GetSkeleton()
        animation = cache.GetSkelQuery(skeleton).GetAnimQuery()
        if animation:
            times.update(animation.GetJointTransformTimeSamples())
            times.update(animation.GetBlendShapeWeightTimeSamples())
        above = skeleton.GetPrim()
        while above and not above.IsPseudoRoot():
            if xformable := UsdGeom.Xformable(above):
                times.update(xformable.GetTimeSamples())
            above = above.GetParent()
    return times


def comes_and_goes(prim: Usd.Prim) -> bool:
    """Whether the visibility of a prim changes over time."""
    return any(one.ValueMightBeTimeVarying() for one in _visibilities(prim))


def _visibilities(prim: Usd.Prim) -> Iterator[Usd.Attribute]:
    """The attributes that say whether a prim is visible: its own and those above."""
    while prim and not prim.IsPseudoRoot():
        if visibility := UsdGeom.Imageable(prim).GetVisibilityAttr():
            yield visibility
        prim = prim.GetParent()


def is_visible(prim: Usd.Prim, time: Usd.TimeCode) -> bool:
    """Whether a prim is visible at a time."""
    return UsdGeom.Imageable(prim).ComputeVisibility(time) != UsdGeom.Tokens.invisible


def is_shown(prim: Usd.Prim, time: Usd.TimeCode) -> bool:
    """Whether a prim that is to be drawn is so at a time; what never changes always is."""
    return not comes_and_goes(prim) or is_visible(prim, time)


def sometimes_visible(prim: Usd.Prim, time: Usd.TimeCode) -> bool:
    """Whether a prim is visible at a time, or at one at which its visibility changes."""
    if is_visible(prim, time):
        return True
    samples = {code for one in _visibilities(prim) for code in one.GetTimeSamples()}
    return any(is_visible(prim, Usd.TimeCode(code)) for code in sorted(samples))


@dataclass(frozen=True)
class MotionBoxes:
    """The boxes of prims at times of a motion, and what they are of."""

    prims: Sequence[Usd.Prim]
    unit: float  # [m]
    codes: Sequence[float | None]  # None: the earliest time
    each: Sequence[Mapping[int, Floats]]  # (2, 3) [m] of each visible prim, at each time

    def still(self) -> set[int]:
        """The prims whose box never changes."""
        own: dict[int, list[Floats]] = {}
        for now in self.each:
            for number, box in now.items():
                own.setdefault(number, []).append(box)
        return {k for k, of in own.items() if all(np.array_equal(box, of[0]) for box in of)}

    def points(self, number: int, which: int) -> Floats:
        """(n, 3) [m] of a prim at one of the times."""
        time = _time_of(self.codes[which])
        xforms = UsdGeom.XformCache(time)
        return _finite(self.prims[number], time, xforms, Skins(time, xforms, Notes()), self.unit)

    @property
    def bounds(self) -> Bounds | None:
        """The box of all; see `motion_bounds`."""
        whole = fitted(self.each, self.still())
        if whole is None:
            return None
        low, high = whole.tolist()
        return Bounds(low=tuple(low), high=tuple(high))


def motion_boxes(prims: Sequence[Usd.Prim], times: Sequence[float], unit: float) -> MotionBoxes:
    """The boxes of the prims' points over up to 48 of the times."""
    chosen: list[float | None] = [None]
    if times:
        spread = np.linspace(0, len(times) - 1, min(SAMPLED_TIMES, len(times)))
        chosen = [times[i] for i in np.unique(np.round(spread).astype(int))]
    changing = {number for number, prim in enumerate(prims) if comes_and_goes(prim)}
    chosen += _missed([prims[number] for number in sorted(changing)], chosen)
    boxes: list[dict[int, Floats]] = []  # of each prim, at each time
    for code in chosen:
        time = _time_of(code)
        xforms = UsdGeom.XformCache(time)
        skins = Skins(time, xforms, Notes())
        now: dict[int, Floats] = {}
        for number, prim in enumerate(prims):
            if number in changing and not is_visible(prim, time):
                continue
            points = _finite(prim, time, xforms, skins, unit)
            if len(points):
                now[number] = np.stack([points.min(axis=0), points.max(axis=0)])
        boxes.append(now)
    return MotionBoxes(prims, unit, chosen, boxes)


def motion_bounds(prims: Sequence[Usd.Prim], times: Sequence[float], unit: float) -> Bounds | None:
    """The box [m] of the prims' points over up to 48 of the times; None where there are none.

    If some prims move and others, such as a ground, do not, the box includes of the latter only
    what is within AROUND times the size of the box of the motion, so that the image fits the
    motion.
    """
    return motion_boxes(prims, times, unit).bounds


def _missed(changing: Sequence[Usd.Prim], chosen: Sequence[float | None]) -> list[float]:
    """The first times, in the range of the chosen, of prims that are visible at none of these."""
    within = [code for code in chosen if code is not None]
    low, high = (within[0], within[-1]) if within else (-np.inf, np.inf)
    found: list[float] = []
    for prim in changing:
        if any(is_visible(prim, _time_of(code)) for code in (*chosen, *found)):
            continue
        samples = {code for one in _visibilities(prim) for code in one.GetTimeSamples()}
        inside = (code for code in sorted(samples) if low <= code <= high)
        found += [code for code in inside if is_visible(prim, Usd.TimeCode(code))][:1]
    return found


def _time_of(code: float | None) -> Usd.TimeCode:
    return Usd.TimeCode.EarliestTime() if code is None else Usd.TimeCode(code)


def fitted(boxes: Sequence[Mapping[int, Floats]], still: Collection[int]) -> Floats | None:
    """(2, 3) box of what moves, and of what stays near it; None where there is nothing.

    still : which of the numbers stay.
    """
    moving, resting = _apart(boxes, still)
    if not moving:
        return _union(resting) if resting else None
    own, low, high = _around(moving)
    near = [box for box in resting if (box[0] <= high).all() and (box[1] >= low).all()]
    return _union([own, *(np.clip(box, low, high) for box in near)])


def near_boxes(boxes: MotionBoxes, still: Collection[int]) -> list[Floats]:
    """(2, 3) each, the boxes of what stays near what moves; none where nothing moves."""
    moving, resting = _apart(boxes.each, still)
    if not moving:
        return []
    _, low, high = _around(moving)
    return [box for box in resting if (box[0] <= high).all() and (box[1] >= low).all()]


def _apart(
    boxes: Sequence[Mapping[int, Floats]], still: Collection[int]
) -> tuple[list[Floats], list[Floats]]:
    """The boxes of what moves at all times, and one of each prim that stays."""
    moving = [box for now in boxes for number, box in now.items() if number not in still]
    resting = {k: box for now in boxes for k, box in now.items() if k in still}
    return moving, list(resting.values())


def _around(moving: Sequence[Floats]) -> tuple[Floats, Floats, Floats]:
    """(2, 3) box of boxes, and the corners of a larger one in which others are near."""
    own = _union(moving)
    reach = AROUND * float(np.linalg.norm(own[1] - own[0]))
    return own, own[0] - reach, own[1] + reach


def _union(boxes: Sequence[Floats]) -> Floats:
    """(2, 3) box of boxes."""
    every = np.array(boxes)
    return np.stack([every[:, 0].min(0), every[:, 1].max(0)])


def _finite(
    prim: Usd.Prim, time: Usd.TimeCode, xforms: UsdGeom.XformCache, skins: Skins, unit: float
) -> Floats:
    """(n, 3) [m] those of `_world_points` that are numbers."""
    points = _world_points(prim, time, xforms, skins)
    return points[np.isfinite(points).all(axis=1)] * unit


def _world_points(
    prim: Usd.Prim, time: Usd.TimeCode, xforms: UsdGeom.XformCache, skins: Skins
) -> Floats:
    """(n, 3) points of a prim, grown by its widths or scales; none where it is left alone."""
    try:
        posed = skins.placement(prim) if prim.IsA(UsdGeom.Mesh) else None
        place = posed or Placement.of(xforms.GetLocalToWorldTransform(prim))
        if str(prim.GetTypeName()) in IMPLICIT:
            return place.points(np.asarray(tessellate(prim, time)[0], dtype=np.float64))
    except SkippedPrim:
        return np.zeros((0, 3))
    for name in POINTS:
        values = prim.GetAttribute(name).Get(time) if prim.HasAttribute(name) else None
        if values is not None and len(values):
            local = np.asarray(values, dtype=np.float64).reshape(-1, 3)
            if str(prim.GetTypeName()) == SPLAT_TYPE and not is_bake_particles(prim):
                local = local[_of_the_object(prim, time, local)]
            reach = _reach(prim, time)
            return np.concatenate([place.points(local - reach), place.points(local + reach)])
    return np.zeros((0, 3))


def _of_the_object(prim: Usd.Prim, time: Usd.TimeCode, local: Floats) -> NDArray[np.bool_]:
    """(n,) which captured Gaussians at local (n, 3) are no strays."""
    opacities = np.ones(len(local))
    for name in ("opacities", "opacitiesh"):
        values = prim.GetAttribute(name).Get(time) if prim.HasAttribute(name) else None
        if values is not None and len(values) == len(local):
            opacities = np.asarray(values, dtype=np.float64)
            break
    finite = np.isfinite(local).all(axis=1)
    out = np.zeros(len(local), bool)
    out[finite] = to_frame(local[finite], opacities[finite])
    return out


def _reach(prim: Usd.Prim, time: Usd.TimeCode) -> float:
    """How far a prim extends beyond its points: a typical radius, or two standard deviations."""
    for name, factor in (("widths", 0.5), ("scales", 2.0), ("scalesh", 2.0)):
        values = prim.GetAttribute(name).Get(time) if prim.HasAttribute(name) else None
        if values is not None and len(values):
            sizes = np.asarray(values, dtype=np.float64)
            return factor * float(np.median(sizes.reshape(len(sizes), -1).max(axis=1)))
    return 0.0
