"""Time samples of the animation of a stage, and the bounding box over its time range."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf, Usd, UsdGeom, UsdSkel

from gf_usd.core.arrays import Floats
from gf_usd.core.scene import Bounds, to_frame
from gf_usd.readers.notes import Notes
from gf_usd.readers.pictures.prims import baked_bodies
from gf_usd.readers.usd.implicit import IMPLICIT, tessellate
from gf_usd.readers.usd.skeleton.skins import Skins
from gf_usd.readers.usd.stage import SPLAT_TYPE, Placement, SkippedPrim, is_bake_particles, upwards

SAMPLED_TIMES = 48  # maximal number of evenly spaced times for the boxes of a motion
STATIC_MARGIN = (
    0.1  # around moving prims, as a fraction of their box diagonal, in which static ones count
)
# Largest sides of static prims that count as a whole, longest and second longest, and diagonal of
# all of them with what moves, as multiples of the diagonal of the box of that: a bowl and the
# handle of a brush, but no ground and no table.
WHOLE_SIDES, WHOLE_DIAGONAL = (2.5, 1.5), 3.0
TOUCH = 0.01  # of its diagonal: the distance at which a static prim touches another
DIRECTIONS = 96  # of support points; no direction is 0.27 rad from all: a ball loses 4 % at most
POINTS = ("points", "positions", "positionsh")
HEALTH = "gaussianFlesh:health:kineticEnergy"  # has a sample at every frame of a bake


def sample_times(prims: Sequence[Usd.Prim]) -> list[float]:
    """All time codes of samples of points, transforms or skeletons of the prims.

    A bake may omit samples of points; its health attributes have a sample at every frame.
    """
    times: set[float] = set()
    visited: set[str] = set()
    for prim in prims:
        for name in POINTS:
            if attribute := prim.GetAttribute(name):
                times.update(attribute.GetTimeSamples())
        ancestor = prim
        while ancestor and str(ancestor.GetPath()) not in visited:
            visited.add(str(ancestor.GetPath()))
            if xformable := UsdGeom.Xformable(ancestor):
                times.update(xformable.GetTimeSamples())
            if health := ancestor.GetAttribute(HEALTH):
                times.update(health.GetTimeSamples())
            if ancestor.IsA(UsdSkel.Root):
                times.update(_skeleton_times(ancestor))
            ancestor = ancestor.GetParent()
    return sorted(times)


def frame_times(prims: Sequence[Usd.Prim]) -> list[float]:
    """Time codes of the frames of a bake; for other files those of `sample_times`.

    What the bodies are below may be animated at other times, and for longer.
    """
    frames: set[float] = set()
    for prim in _with_ancestors(prims):
        if health := prim.GetAttribute(HEALTH):
            frames.update(health.GetTimeSamples())
    return sorted(frames) or sample_times(prims)


def _with_ancestors(prims: Sequence[Usd.Prim]) -> Iterator[Usd.Prim]:
    """The prims and those above them, each once."""
    for path in {path for prim in prims for path in prim.GetPath().GetPrefixes()}:
        yield prims[0].GetStage().GetPrimAtPath(path)


def _skeleton_times(root: Usd.Prim) -> set[float]:
    """Time codes of the animations and transforms of all skeletons bound below a SkelRoot."""
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
        for ancestor in upwards(skeleton.GetPrim()):
            if xformable := UsdGeom.Xformable(ancestor):
                times.update(xformable.GetTimeSamples())
    return times


def has_animated_visibility(prim: Usd.Prim) -> bool:
    """Whether the visibility of a prim changes over time."""
    return any(attribute.ValueMightBeTimeVarying() for attribute in _visibilities(prim))


def _visibilities(prim: Usd.Prim) -> Iterator[Usd.Attribute]:
    """The visibility attributes of a prim and its ancestors."""
    for one in upwards(prim):
        if visibility := UsdGeom.Imageable(one).GetVisibilityAttr():
            yield visibility


def is_visible(prim: Usd.Prim, time: Usd.TimeCode) -> bool:
    """Whether a prim is visible at a time."""
    return UsdGeom.Imageable(prim).ComputeVisibility(time) != UsdGeom.Tokens.invisible


def is_drawn(prim: Usd.Prim, time: Usd.TimeCode) -> bool:
    """Whether a prim to be drawn is visible at a time; True for constant visibility."""
    return not has_animated_visibility(prim) or is_visible(prim, time)


def is_ever_visible(prim: Usd.Prim, time: Usd.TimeCode) -> bool:
    """Whether a prim is visible at a time, or at any sample of its visibility."""
    if is_visible(prim, time):
        return True
    samples = {code for attribute in _visibilities(prim) for code in attribute.GetTimeSamples()}
    return any(is_visible(prim, Usd.TimeCode(code)) for code in sorted(samples))


@dataclass(frozen=True)
class MotionBoxes:
    """Bounding boxes of prims at times of a motion."""

    prims: Sequence[Usd.Prim]
    unit: float  # [m]
    codes: Sequence[float | None]  # None: the earliest time
    by_time: Sequence[Mapping[int, Floats]]  # (2, 3) [m] of each visible prim, at each time
    outermost: Sequence[Mapping[int, Floats]]  # (k, 3) [m] its support points, likewise

    def static_prims(self) -> set[int]:
        """Indices of the prims whose box is constant, and that are not bodies of a bake.

        A body that is pinned as a whole stays where it is, but is part of the motion.
        """
        return self._static

    @cached_property
    def _static(self) -> set[int]:
        boxes_of: dict[int, list[Floats]] = {}
        for boxes_now in self.by_time:
            for index, box in boxes_now.items():
                boxes_of.setdefault(index, []).append(box)
        constant = {
            k for k, own in boxes_of.items() if all(np.array_equal(box, own[0]) for box in own)
        }
        bodies = _bodies(self.prims)
        return {k for k in constant if str(self.prims[k].GetPath()) not in bodies}

    def points(self, index: int, which: int) -> Floats:
        """Points (n, 3) [m] of a prim at time number `which`."""
        time = _time_of(self.codes[which])
        xforms = UsdGeom.XformCache(time)
        return _finite_points(
            self.prims[index], time, xforms, Skins(time, xforms, Notes()), self.unit
        )

    @property
    def bounds(self) -> Bounds | None:
        """The box of the motion; see `motion_bounds`."""
        whole = motion_box(self.by_time, self.static_prims())
        if whole is None:
            return None
        low, high = whole.tolist()
        return Bounds(low=tuple(low), high=tuple(high))

    def outline(self) -> Floats:
        """Points (K, 3) [m] whose convex hull a picture should contain.

        They are support points of all that moves, and of static prims near it that count as a
        whole; of all prims where none moves.
        """
        static = self.static_prims()
        moving, static_boxes = _split_static(self.by_time, static)
        whole = _whole_prims(moving, static_boxes) if moving else {*static_boxes}
        kept = [
            points
            for points_now in self.outermost
            for k, points in points_now.items()
            if k not in static or k in whole
        ]
        return support_points(np.concatenate(kept)) if kept else np.zeros((0, 3))


def support_points(points: Floats) -> Floats:
    """Those of points (n, 3) that are farthest in one of DIRECTIONS: (k, 3), k <= DIRECTIONS."""
    # The maximum along rows is 20 times as fast as along columns, for 4,000 points.
    return points[np.unique((_directions() @ points.T).argmax(axis=1))]


@cache
def _directions() -> Floats:
    """Unit vectors (DIRECTIONS, 3), evenly spread on a Fibonacci spiral."""
    k = np.arange(DIRECTIONS) + 0.5
    z, turn = 1.0 - 2.0 * k / DIRECTIONS, np.pi * (1.0 + 5.0**0.5) * k
    across = np.sqrt(1.0 - z * z)
    return np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=1)


def _bodies(prims: Sequence[Usd.Prim]) -> set[str]:
    """Paths of the bodies of the bakes in a stage, and of the particles that show them.

    A bake without Gaussians and points, as of meshes only, has no list of its bodies: they are the
    prims whose points have samples in its cache.  Samples elsewhere say nothing: exporters sample
    all meshes at every frame.
    """
    if not prims:
        return set()
    if named := baked_bodies(prims[0].GetStage()):
        return named
    caches = {
        spec.layer
        for prim in _with_ancestors(prims)
        if (health := prim.GetAttribute(HEALTH))
        for spec in health.GetPropertyStack()
    }
    return {str(prim.GetPath()) for prim in prims if _is_sampled(prim, caches)}


def _is_sampled(prim: Usd.Prim, caches: Collection[Sdf.Layer]) -> bool:
    """Whether the points of a prim have several samples in the cache of a bake or in its clips."""
    if not caches:
        return False
    for one in filter(None, map(prim.GetAttribute, POINTS)):
        if one.GetNumTimeSamples() > 1:
            clips = one.GetResolveInfo().GetSource() == Usd.ResolveInfoSourceValueClips
            if clips or any(spec.layer in caches for spec in one.GetPropertyStack()):
                return True
    return False


def motion_boxes(prims: Sequence[Usd.Prim], times: Sequence[float], unit: float) -> MotionBoxes:
    """The boxes of the prims' points at up to SAMPLED_TIMES of the times."""
    codes: list[float | None] = [None]
    if times:
        spread = np.linspace(0, len(times) - 1, min(SAMPLED_TIMES, len(times)))
        codes = [times[i] for i in np.unique(np.round(spread).astype(int))]
    changing = {index for index, prim in enumerate(prims) if has_animated_visibility(prim)}
    codes += _times_of_missed_prims([prims[index] for index in sorted(changing)], codes)
    boxes: list[dict[int, Floats]] = []  # of each prim, at each time
    outermost: list[dict[int, Floats]] = []
    for code in codes:
        time = _time_of(code)
        xforms = UsdGeom.XformCache(time)
        skins = Skins(time, xforms, Notes())
        boxes_now: dict[int, Floats] = {}
        outermost_now: dict[int, Floats] = {}
        for index, prim in enumerate(prims):
            if index in changing and not is_visible(prim, time):
                continue
            points = _finite_points(prim, time, xforms, skins, unit)
            if len(points):
                boxes_now[index] = np.stack([points.min(axis=0), points.max(axis=0)])
                outermost_now[index] = support_points(points)
        boxes.append(boxes_now)
        outermost.append(outermost_now)
    return MotionBoxes(prims, unit, codes, boxes, outermost)


def motion_bounds(prims: Sequence[Usd.Prim], times: Sequence[float], unit: float) -> Bounds | None:
    """The box [m] of the prims' points at up to SAMPLED_TIMES of the times; None without points.

    If some prims move and others are static, the box is that of the moving prims, and of static
    ones within a margin, STATIC_MARGIN times its diagonal: of all of them, or for large ones, such
    as a ground, of what is in the margin.
    """
    return motion_boxes(prims, times, unit).bounds


def _times_of_missed_prims(
    changing: Sequence[Usd.Prim], codes: Sequence[float | None]
) -> list[float]:
    """The first visible time, within the range of `codes`, of each prim visible at none of them."""
    known = [code for code in codes if code is not None]
    low, high = (known[0], known[-1]) if known else (-np.inf, np.inf)
    found: list[float] = []
    for prim in changing:
        if any(is_visible(prim, _time_of(code)) for code in (*codes, *found)):
            continue
        samples = {code for attribute in _visibilities(prim) for code in attribute.GetTimeSamples()}
        candidates = (code for code in sorted(samples) if low <= code <= high)
        found += [code for code in candidates if is_visible(prim, Usd.TimeCode(code))][:1]
    return found


def _time_of(code: float | None) -> Usd.TimeCode:
    return Usd.TimeCode.EarliestTime() if code is None else Usd.TimeCode(code)


def motion_box(boxes: Sequence[Mapping[int, Floats]], static: Collection[int]) -> Floats | None:
    """Box (2, 3) of moving prims and of static ones near them; None without any boxes.

    static : indices of the static prims.
    """
    moving, static_boxes = _split_static(boxes, static)
    if not moving:
        return _union_of_boxes([*static_boxes.values()]) if static_boxes else None
    box_of_moving, low, high = _grow_box(moving)
    whole = _whole_prims(moving, static_boxes)
    seen = [
        box if k in whole else np.clip(box, low, high)
        for k, box in static_boxes.items()
        if k in whole or _is_near(box, low, high)
    ]
    return _union_of_boxes([box_of_moving, *seen])


def near_boxes(boxes: MotionBoxes, static: Collection[int]) -> list[Floats]:
    """Boxes (2, 3) of static prims near moving ones; empty where nothing moves."""
    moving, static_boxes = _split_static(boxes.by_time, static)
    if not moving:
        return []
    _, low, high = _grow_box(moving)
    return [box for box in static_boxes.values() if _is_near(box, low, high)]


def _is_near(box: Floats, low: Floats, high: Floats) -> bool:
    """Whether a box overlaps that of low and high (3,)."""
    return bool((box[0] <= high).all() and (box[1] >= low).all())


def _whole_prims(moving: Sequence[Floats], static_boxes: Mapping[int, Floats]) -> set[int]:
    """Indices of the static prims that count as a whole: those near moving ones, and then those
    that touch them, as the handle of a brush touches its head.
    """
    box, low, high = _grow_box(moving)
    diagonal = float(np.linalg.norm(box[1] - box[0]))
    found: set[int] = set()
    last = {k for k, own in static_boxes.items() if _is_near(own, low, high)}
    while last:
        for k in sorted(last):
            union = _union_of_boxes([box, static_boxes[k]])
            sides = np.sort(static_boxes[k][1] - static_boxes[k][0])[:0:-1]
            fits = np.linalg.norm(union[1] - union[0]) <= WHOLE_DIAGONAL * diagonal
            if fits and (sides <= np.multiply(WHOLE_SIDES, diagonal)).all():
                found.add(k)
                box = union
            else:
                last.discard(k)
        last = {
            k
            for k, own in static_boxes.items()
            if k not in found and any(_is_near(own, *_touching(static_boxes[j])) for j in last)
        }
    return found


def _touching(box: Floats) -> Floats:
    """A box (2, 3) grown so that it overlaps what touches it, within rounding."""
    return box + TOUCH * float(np.linalg.norm(box[1] - box[0])) * np.array([[-1.0], [1.0]])


def _split_static(
    boxes: Sequence[Mapping[int, Floats]], static: Collection[int]
) -> tuple[list[Floats], dict[int, Floats]]:
    """The boxes of moving prims at all times, and one box of each static prim by its index."""
    moving = [box for boxes_now in boxes for index, box in boxes_now.items() if index not in static]
    static_boxes = {k: box for boxes_now in boxes for k, box in boxes_now.items() if k in static}
    return moving, static_boxes


def _grow_box(moving: Sequence[Floats]) -> tuple[Floats, Floats, Floats]:
    """The union (2, 3) of boxes, and its low and high corner after growth by the margin."""
    box_of_moving = _union_of_boxes(moving)
    margin = STATIC_MARGIN * float(np.linalg.norm(box_of_moving[1] - box_of_moving[0]))
    return box_of_moving, box_of_moving[0] - margin, box_of_moving[1] + margin


def _union_of_boxes(boxes: Sequence[Floats]) -> Floats:
    """The bounding box (2, 3) of boxes."""
    every = np.array(boxes)
    return np.stack([every[:, 0].min(0), every[:, 1].max(0)])


def _finite_points(
    prim: Usd.Prim, time: Usd.TimeCode, xforms: UsdGeom.XformCache, skins: Skins, unit: float
) -> Floats:
    """The finite points (n, 3) [m] of `_world_points`."""
    points = _world_points(prim, time, xforms, skins)
    return points[np.isfinite(points).all(axis=1)] * unit


def _world_points(
    prim: Usd.Prim, time: Usd.TimeCode, xforms: UsdGeom.XformCache, skins: Skins
) -> Floats:
    """World points (n, 3) of a prim, offset by its widths or scales; empty for a skipped prim."""
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
                local = local[_inlier_mask(prim, time, local)]
            margin = _point_radius(prim, time)
            return np.concatenate([place.points(local - margin), place.points(local + margin)])
    return np.zeros((0, 3))


def _inlier_mask(prim: Usd.Prim, time: Usd.TimeCode, local: Floats) -> NDArray[np.bool_]:
    """Mask (n,) of captured Gaussians at local positions (n, 3), False for outliers."""
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


def _point_radius(prim: Usd.Prim, time: Usd.TimeCode) -> float:
    """The extent of a prim beyond its points: median radius, or two standard deviations."""
    for name, factor in (("widths", 0.5), ("scales", 2.0), ("scalesh", 2.0)):
        values = prim.GetAttribute(name).Get(time) if prim.HasAttribute(name) else None
        if values is not None and len(values):
            sizes = np.asarray(values, dtype=np.float64)
            return factor * float(np.median(sizes.reshape(len(sizes), -1).max(axis=1)))
    return 0.0
