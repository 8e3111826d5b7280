"""Meshes that look like the ground or the backdrop of a scene."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.asset import Asset, Surface

if TYPE_CHECKING:
    from gf_usd.geometry.solid import Solid

FLAT = 0.05  # its height, as a share of its smaller width
SUNK = 0.05  # how far others are below its top, as a share of their height
LARGER = 3.0  # the diagonal of scenery, over that of all bodies
SCENERY = (
    "it encloses no volume, lies under the bodies and reaches far beyond them, as a ground or a"
    " backdrop does"
)


def without_scenery(asset: Asset, solid: Solid) -> tuple[Asset, Solid]:
    """The asset and its solid, with open meshes that are scenery among the prims that are skipped.

    They would follow a body that is much smaller than they are, whose motion is not theirs.
    """
    if not solid.embedded:
        return asset, solid
    embedded = dict(solid.embedded)
    filled = [s.face_points for s in asset.surfaces if s.path not in embedded]
    up = asset.facts.up
    low, high = (np.min([p.min(0) for p in filled], 0), np.max([p.max(0) for p in filled], 0))

    def surrounds(surface: Surface) -> bool:
        least, most = surface.face_points.min(0), surface.face_points.max(0)
        return bool(
            _beyond((least, most), (low, high), up)
            and least @ up <= low @ up + SUNK * ((high - low) @ up)
            and np.linalg.norm(most - least) >= LARGER * np.linalg.norm(high - low)
        )

    found = {
        s.path
        for s in asset.surfaces
        if s.path in embedded and not s.skinned and s.splats is None and surrounds(s)
    }
    if not found:
        return asset, solid
    kept = tuple(s for s in asset.surfaces if s.path not in found)
    skipped = (*asset.skipped, *((path, SCENERY) for path in embedded if path in found))
    left = tuple(one for one in solid.embedded if one[0] not in found)
    return replace(asset, surfaces=kept, skipped=skipped), replace(solid, embedded=left)


def _beyond(box: tuple[Floats, Floats], other: tuple[Floats, Floats], up: Floats) -> bool:
    """Whether a box, of its low and its high corner, reaches as far as another across up."""
    across = up == 0.0
    return bool((box[0] <= other[0])[across].all() and (box[1] >= other[1])[across].all())


def ground_notes(
    surfaces: Sequence[Surface], embedded: Collection[str], up: Floats, unit: float
) -> tuple[str, ...]:
    """Notes on flat meshes that lie under all others and reach beyond them.

    They are soft as the others are: a mesh may be a mattress, and a name proves nothing.

    embedded : paths of the meshes that are not filled; up : (3,) unit; unit : [m] of the stage.
    """
    boxes = [(s.face_points.min(0), s.face_points.max(0)) for s in surfaces]
    axis = int(np.abs(up).argmax())
    across = [k for k in range(3) if k != axis]
    notes = []
    for k, surface in enumerate(surfaces):
        others = [box for j, box in enumerate(boxes) if j != k]
        if not others:
            continue
        low, high = boxes[k]
        lows, highs = (np.array(ends) for ends in zip(*others, strict=True))
        # along up, which may be minus an axis
        bottom, top = sorted((up[axis] * low[axis], up[axis] * high[axis]))
        heights = np.sort(up[axis] * np.stack((lows[:, axis], highs[:, axis])), axis=0)
        lowest, highest = heights[0].min(), heights[1].max()
        flat = top - bottom <= FLAT * (high - low)[across].min()
        under = top <= lowest + SUNK * (highest - lowest)
        if flat and under and _beyond(boxes[k], (lows.min(0), highs.max(0)), up):
            does = (
                "moves with the nearest body" if surface.path in embedded else "is soft and falls"
            )
            notes.append(
                f"<{surface.path}> is flat and lies under everything else, as a ground does, but it"
                f" {does}: apply PhysicsCollisionAPI to it to make it an obstacle, or bake the"
                f" others alone (--prim) on a floor at its height (--floor {top / unit:.3g})"
            )
    return tuple(notes)
