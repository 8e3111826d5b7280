"""Meshes that look like the ground of a scene, but are baked like all others."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.asset import Surface

FLAT = 0.05  # its height, as a share of its smaller width
SUNK = 0.05  # how far others are below its top, as a share of their height


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
        beyond = (low <= lows.min(0))[across].all() and (high >= highs.max(0))[across].all()
        if flat and under and beyond:
            does = (
                "moves with the nearest body" if surface.path in embedded else "is soft and falls"
            )
            notes.append(
                f"<{surface.path}> is flat and lies under everything else, as a ground does, but it"
                f" {does}: apply PhysicsCollisionAPI to it to make it an obstacle, or bake the"
                f" others alone (--prim) on a floor at its height (--floor {top / unit:.3g})"
            )
    return tuple(notes)
