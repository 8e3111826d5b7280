"""Framing of images: the bounding box of the motion, without bodies that fall out of the scene.

A body that misses the obstacles falls until the end of the bake, and an image that contains its
whole path shows the others very small.  A body has fallen if it was above the bottom of the others,
is below it until the end of the motion, and still descends then; not if it lands on a floor or
hangs from a ceiling.  For Gaussians, points and surfaces of flowing bodies, this is decided for
each point.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom

from gf_usd.core.arrays import Floats
from gf_usd.core.scene import Bounds
from gf_usd.readers.pictures.extent import MotionBoxes, motion_box, near_boxes
from gf_usd.readers.usd.stage import SPLAT_TYPE

FALL_MARGIN = 0.1  # of the longest side of the rest: part of a fall that the image contains
MIN_RATIO = (
    1.1  # of the diagonals of the full box and the reduced one, below which the full box is used
)
MAX_FALLEN_SHARE = 0.5  # of points and times of a prim: above it the fall is its main motion
MIN_DESCENT = 0.01  # of a falling body in the last step, as a fraction of its size


@dataclass(frozen=True)
class Framing:
    """What images of a motion contain."""

    bounds: Bounds  # [m]
    fallen: tuple[str, ...] = ()  # paths of prims that fall out of it
    until: float | None = None  # last time code at which it has anything that moves; None: always


def frame_motion(
    prims: Sequence[Usd.Prim], boxes: MotionBoxes, whole: Bounds, up: Floats
) -> Framing:
    """The framing of prims, whose boxes over the motion have the box `whole` [m]; up : unit."""
    height = _Height(up)
    static = boxes.static_prims()
    near = near_boxes(boxes, static)
    if not near:
        return Framing(whole)
    floor = min(height.bottom(box) for box in near)
    kept = [dict(boxes_now) for boxes_now in boxes.by_time]
    fallen = []
    for index, prim in enumerate(prims):
        if index in static:
            continue
        times = [i for i, boxes_now in enumerate(kept) if index in boxes_now]
        if _has_loose_points(prim):
            remaining = _without_fallen_points(boxes, index, times, floor, height)
        else:
            remaining = _boxes_before_fall([kept[i][index] for i in times], floor, height)
        if any(box is not boxes.by_time[i][index] for i, box in zip(times, remaining)):
            fallen.append(str(prim.GetPath()))
        for i, box in zip(times, remaining):
            if box is None:
                del kept[i][index]
            else:
                kept[i][index] = box
    if not any(index not in static for boxes_now in kept for index in boxes_now):
        return Framing(whole)
    box = motion_box(kept, static)
    assert box is not None
    box_shown = height.lowered(box, FALL_MARGIN * float(np.ptp(box, axis=0).max()))
    box_shown = np.clip(box_shown, whole.low, whole.high)
    if whole.diagonal <= MIN_RATIO * float(np.linalg.norm(box_shown[1] - box_shown[0])):
        return Framing(whole)
    low, high = box_shown.tolist()
    shown = [any(index not in static for index in now) for now in kept]
    codes = [(code, seen) for code, seen in zip(boxes.codes, shown) if code is not None]
    last = max((code for code, seen in codes if seen), default=None)
    return Framing(
        Bounds(low=tuple(low), high=tuple(high)),
        tuple(fallen),
        None if last is None or last == max(codes)[0] else last,
    )


class _Height:
    """Heights of boxes (2, 3) along an up axis, which is one of the axes of the boxes."""

    def __init__(self, up: Floats) -> None:
        self.axis = int(np.abs(up).argmax())
        self.sign = float(np.sign(up[self.axis]))

    def bottom(self, box: Floats) -> float:
        return float((self.sign * box[:, self.axis]).min())

    def lowered(self, box: Floats, depth: float) -> Floats:
        """A box extended downwards by `depth`."""
        out = np.array(box)
        out[0 if self.sign > 0.0 else 1, self.axis] -= self.sign * depth
        return out

    def top(self, box: Floats) -> float:
        return float((self.sign * box[:, self.axis]).max())

    def middle(self, box: Floats) -> float:
        return 0.5 * (self.bottom(box) + self.top(box))


def _has_loose_points(prim: Usd.Prim) -> bool:
    if prim.IsA(UsdGeom.Points) or str(prim.GetTypeName()) == SPLAT_TYPE:
        return True
    mesh = UsdGeom.Mesh(prim) if prim.IsA(UsdGeom.Mesh) else None
    return mesh is not None and mesh.GetFaceVertexIndicesAttr().ValueMightBeTimeVarying()


def _boxes_before_fall(
    own_boxes: Sequence[Floats], floor: float, height: _Height
) -> Sequence[Floats | None]:
    """The boxes of a body over time; None after it has fallen."""
    end = len(own_boxes)
    while end and height.top(own_boxes[end - 1]) < floor:
        end -= 1
    if end == len(own_boxes) or len(own_boxes) < 2:
        return own_boxes
    if not any(height.middle(box) >= floor for box in own_boxes):
        return own_boxes  # the static prims are above it, like a ceiling that it touches
    size = float(np.ptp(own_boxes[-1], axis=0).max())
    if height.bottom(own_boxes[-2]) - height.bottom(own_boxes[-1]) <= MIN_DESCENT * size:
        return own_boxes
    return [*own_boxes[:end], *(None for _ in own_boxes[end:])]


def _without_fallen_points(
    boxes: MotionBoxes, index: int, times: Sequence[int], floor: float, height: _Height
) -> Sequence[Floats | None]:
    """The boxes over time of the points of a prim that have not fallen; None where all have."""
    own_boxes: list[Floats | None] = [boxes.by_time[i][index] for i in times]
    fallen_count = total = 0
    remaining = list(own_boxes)
    was_above: NDArray[np.bool_] | None = np.zeros(0, bool)  # until now; None: all points
    for k, i in enumerate(times):
        if height.bottom(boxes.by_time[i][index]) >= floor:
            was_above = None
            continue
        points = boxes.points(index, i)
        fallen = height.sign * points[:, height.axis] < floor
        if was_above is not None:
            # where the number of points changes, their identities are unknown
            same = len(was_above) == len(points)
            was_above = ~fallen | was_above if same else ~fallen
            fallen = fallen & was_above
        fallen_count, total = fallen_count + int(fallen.sum()), total + len(points)
        if fallen.all():
            remaining[k] = None
        elif fallen.any():
            rest = points[~fallen]
            remaining[k] = np.stack([rest.min(axis=0), rest.max(axis=0)])
    return remaining if fallen_count <= MAX_FALLEN_SHARE * total else own_boxes
