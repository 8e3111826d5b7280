"""Framing of images: the bounding box of the motion, without bodies that fall out of the scene.

A body that misses the obstacles falls until the end of the bake, and an image that contains its
whole path shows the others very small.  A body has fallen if it was above the bottom of the others,
is below it until the end of the motion, and still descends then; not if it lands on a floor or
hangs from a ceiling.  For Gaussians, points and surfaces of flowing bodies, this is decided for
each point.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom

from gf_usd.core.arrays import Floats
from gf_usd.core.scene import Bounds
from gf_usd.readers.pictures.extent import MotionBoxes, fitted, near_boxes
from gf_usd.readers.usd.stage import SPLAT_TYPE

BELOW = 0.1  # of the longest side of the rest: so much of a fall is in the picture
WORTH = 1.1  # times as large at least is the box of all: else the picture has all of it
MOST = 0.5  # of the points of a prim, over all times: where more fall, the fall is what happens
SINKS = 0.01  # of its size: what a body moves down in the last step, if it still falls


def framed(
    prims: Sequence[Usd.Prim], boxes: MotionBoxes, whole: Bounds, up: Floats
) -> tuple[Bounds, tuple[str, ...]]:
    """The box [m] to fit a picture to, and the paths of the prims that fall out of it.

    boxes, whole : of the prims over the motion, with the box of all of it.  up : unit.
    """
    height = _Height(up)
    still = boxes.still()
    near = near_boxes(boxes, still)
    if not near:
        return whole, ()
    floor = min(height.bottom(box) for box in near)
    kept = [dict(now) for now in boxes.each]
    fell = []
    for number, prim in enumerate(prims):
        if number in still:
            continue
        times = [i for i, now in enumerate(kept) if number in now]
        if _is_loose(prim):
            left = _without_fallen_points(boxes, number, times, floor, height)
        else:
            left = _until_it_falls([kept[i][number] for i in times], floor, height)
        if any(box is not boxes.each[i][number] for i, box in zip(times, left)):
            fell.append(str(prim.GetPath()))
        for i, box in zip(times, left):
            if box is None:
                del kept[i][number]
            else:
                kept[i][number] = box
    if not any(number not in still for now in kept for number in now):
        return whole, ()
    core = fitted(kept, still)
    assert core is not None
    shown = height.lowered(core, BELOW * float(np.ptp(core, axis=0).max()))
    shown = np.clip(shown, whole.low, whole.high)
    if whole.diagonal <= WORTH * float(np.linalg.norm(shown[1] - shown[0])):
        return whole, ()
    low, high = shown.tolist()
    return Bounds(low=tuple(low), high=tuple(high)), tuple(fell)


class _Height:
    """Heights of boxes (2, 3) along an up axis, which is one of the axes of the boxes."""

    def __init__(self, up: Floats) -> None:
        self.axis = int(np.abs(up).argmax())
        self.sign = float(np.sign(up[self.axis]))

    def bottom(self, box: Floats) -> float:
        return float((self.sign * box[:, self.axis]).min())

    def lowered(self, box: Floats, depth: float) -> Floats:
        """A box with its bottom so much lower."""
        out = np.array(box)
        out[0 if self.sign > 0.0 else 1, self.axis] -= self.sign * depth
        return out

    def top(self, box: Floats) -> float:
        return float((self.sign * box[:, self.axis]).max())

    def middle(self, box: Floats) -> float:
        return 0.5 * (self.bottom(box) + self.top(box))


def _is_loose(prim: Usd.Prim) -> bool:
    if prim.IsA(UsdGeom.Points) or str(prim.GetTypeName()) == SPLAT_TYPE:
        return True
    mesh = UsdGeom.Mesh(prim) if prim.IsA(UsdGeom.Mesh) else None
    return mesh is not None and mesh.GetFaceVertexIndicesAttr().ValueMightBeTimeVarying()


def _until_it_falls(
    own: Sequence[Floats], floor: float, height: _Height
) -> Sequence[Floats | None]:
    """The boxes of a body in time, None for those at which it has fallen."""
    end = len(own)
    while end and height.top(own[end - 1]) < floor:
        end -= 1
    if end == len(own) or len(own) < 2:
        return own
    if not any(height.middle(box) >= floor for box in own):
        return own  # what stays is above it: a ceiling, which its top may touch
    size = float(np.ptp(own[-1], axis=0).max())
    if height.bottom(own[-2]) - height.bottom(own[-1]) <= SINKS * size:
        return own
    return [*own[:end], *(None for _ in own[end:])]


def _without_fallen_points(
    boxes: MotionBoxes, number: int, times: Sequence[int], floor: float, height: _Height
) -> Sequence[Floats | None]:
    """The boxes of the points of a prim that have not fallen, None where all have."""
    own: list[Floats | None] = [boxes.each[i][number] for i in times]
    fallen = total = 0
    left = list(own)
    was_above: NDArray[np.bool_] | None = np.zeros(0, bool)  # so far; None: all of them
    for k, i in enumerate(times):
        if height.bottom(boxes.each[i][number]) >= floor:
            was_above = None
            continue
        points = boxes.points(number, i)
        fell = height.sign * points[:, height.axis] < floor
        if was_above is not None:
            # of points that became more or fewer nobody knows which of them were above
            same = len(was_above) == len(points)
            was_above = ~fell | was_above if same else ~fell
            fell = fell & was_above
        fallen, total = fallen + int(fell.sum()), total + len(points)
        if fell.all():
            left[k] = None
        elif fell.any():
            rest = points[~fell]
            left[k] = np.stack([rest.min(axis=0), rest.max(axis=0)])
    return left if fallen <= MOST * total else own
