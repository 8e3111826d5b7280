"""Faces without area, and which of them hold nothing together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gf_usd.geometry.edges import Edges
from gf_usd.model import Floats, Ints
from gf_usd.topology import WELD_FRACTION

Flags = NDArray[np.bool_]


def slivers(points: Floats, triangles: Ints) -> Flags:
    """(T,) True where three different vertices lie in one line, within the welding tolerance.

    The height over the longest edge, 2 A / L, is what is measured.
    """
    corners = points[triangles]
    sides = np.roll(corners, -1, axis=1) - corners
    longest = np.linalg.norm(sides, axis=2).max(1)
    twice_area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    return twice_area <= WELD_FRACTION * float(np.linalg.norm(np.ptp(points, axis=0))) * longest


def idle(sliver: Flags, edges: Edges) -> Flags:
    """(T,) slivers whose loss opens no seam.

    A sliver between two triangles and one (a T-junction) holds a closed surface together.
    """
    uses = edges.uses[edges.id].reshape(-1, 3)
    return sliver & ((uses == 2).sum(1) <= (uses == 1).sum(1))
