"""The floor of images: the one that was baked, else one that cuts nothing that is drawn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pxr import Usd, UsdGeom

from gf_usd.core.arrays import Floats
from gf_usd.core.scene import Bounds
from gf_usd.readers.pictures.extent import MotionBoxes, near_boxes
from gf_usd.readers.usd_physics.attributes import is_collider

LEVEL = 0.9999  # cosine of the angle between the up axis and the normal of a level plane
TILTED = "its floor is tilted and is not drawn"
# of the diagonal of the motion: how far from height 0 a body may be to stand on a floor there
FLOOR_TOLERANCE = 0.05
# likewise, but of something that is below height 0 from the start, so that a floor would cut it
CUT_TOLERANCE = 1e-3


@dataclass(frozen=True)
class BakedFloor:
    """The floor that a variant of a bake was simulated with."""

    height: float | None  # [m] along up; None: there was no floor, or a tilted one
    tilted: bool


def baked_floor(about: Mapping[str, Any], variant: str) -> BakedFloor | None:
    """The floor of a variant; None where the metadata `about` of a bake does not contain it."""
    variants = about.get("looks")
    bake = variants.get(variant) if isinstance(variants, dict) else None
    settings = bake.get("settings") if isinstance(bake, dict) else None
    if not isinstance(settings, dict):
        return None
    if settings.get("floor_normal") is not None:
        return BakedFloor(None, True)
    height = settings.get("floor")
    return BakedFloor(float(height) if isinstance(height, int | float) else None, False)


def lowest_height(boxes: MotionBoxes, bounds: Bounds | None, up: Floats) -> float | None:
    """Height [m] of shadows for a bake without a floor: the lowest point of what is drawn.

    None where something descends below everything that there is at the start: shadows would appear
    in mid-air until then.

    bounds : of the motion; None: nothing is visible.
    """
    if bounds is None:
        return None
    start, lowest = _lowest(boxes, up)
    return lowest if start - lowest <= FLOOR_TOLERANCE * bounds.diagonal else None


def plane_height(
    stage: Usd.Stage, time: Usd.TimeCode, up: Floats, unit: float, bounds: Bounds | None
) -> float | None:
    """Height [m] of the highest `Plane` collider that faces up below the middle of what is drawn at
    the start; it is not drawn itself.  None: there is none.

    unit : [m] per stage unit; bounds : of the start; None: nothing is visible.
    """
    if bounds is None:
        return None
    middle = float((bounds.corners @ up).mean())
    xforms = UsdGeom.XformCache(time)
    heights = []
    for prim in stage.Traverse(Usd.TraverseInstanceProxies()):
        if not (prim.IsA(UsdGeom.Plane) and is_collider(prim, time)):
            continue
        world = np.array(xforms.GetLocalToWorldTransform(prim))
        k = "XYZ".index(UsdGeom.Plane(prim).GetAxisAttr().Get())
        normal = np.cross(world[(k + 1) % 3, :3], world[(k + 2) % 3, :3])
        height = float(world[3, :3] @ up) * unit
        if normal @ up >= LEVEL * np.linalg.norm(normal) > 0.0 and height <= middle:
            heights.append(height)
    return max(heights, default=None)


def guessed_height(
    boxes: MotionBoxes, bounds: Bounds | None, first: Bounds | None, up: Floats
) -> float | None:
    """Height [m] of the floor of a stage that is no bake; None: no floor.

    It is 0 where the body rests there, to FLOOR_TOLERANCE of its size, or descends to it from
    above; else the lowest point, also where something reaches below height 0 from the start.
    There is none where something falls past height 0 by more than the height of all prims at the
    start.

    bounds, first : the boxes of the motion and of its first frame; None: nothing is visible.
    """
    if bounds is None or first is None:
        return None
    start, lowest = _lowest(boxes, up)
    near = FLOOR_TOLERANCE * bounds.diagonal
    if start < -CUT_TOLERANCE * bounds.diagonal:
        return lowest
    if lowest > near:
        return lowest
    if lowest < -max(near, float(np.ptp(first.corners @ up))):
        return None
    return 0.0


def _lowest(boxes: MotionBoxes, up: Floats) -> tuple[float, float]:
    """The lowest heights [m] at the first time and of the motion, of prims in the picture.

    Static prims far from all that moves are not in the picture.
    """
    static = boxes.static_prims()
    moves = any(index not in static for now in boxes.by_time for index in now)
    near = near_boxes(boxes, static)
    shown = [
        [*near, *(box for index, box in now.items() if not (moves and index in static))]
        for now in boxes.by_time
    ]
    lows = [min(float((box @ up).min()) for box in now) for now in shown if now]
    return lows[0], min(lows)
