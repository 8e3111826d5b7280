"""Faces that enclose nothing: collapsed, without area, or there twice."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gf_usd.geometry.edges import Edges
from gf_usd.model import Floats, Ints
from gf_usd.topology import WELD_FRACTION, shells

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


def doubled(triangles: Ints) -> Flags:
    """(T,) triangles that another one makes superfluous, as the fill sees it.

    Of equal triangles one stays.  Back to back they cancel (a flap without thickness encloses
    nothing), unless their whole shell is made so: then it is a surface modelled twice, and one
    side of it stays.
    """
    order = np.argsort(triangles, axis=1)
    odd = (order[:, 1] - order[:, 0]) % 3 != 1
    _, group = np.unique(np.sort(triangles, axis=1), axis=0, return_inverse=True)
    group = group.reshape(-1)
    ahead, back = np.bincount(group, ~odd), np.bincount(group, odd)
    alone = (ahead + back == 1)[group]
    if alone.all():
        return np.zeros(len(triangles), bool)
    balanced = (ahead == back)[group]
    shell = shells(triangles)
    # In a surface that is there twice every triangle is balanced, and one side of it stays.
    twice = (np.bincount(shell, ~balanced) == 0)[shell]
    wanted = balanced | ((back > ahead)[group] == odd)
    first = np.zeros(len(triangles), bool)
    mine = np.flatnonzero(wanted)
    first[mine[np.unique(group[mine], return_index=True)[1]]] = True
    return ~(first & (alone | ~balanced | twice))
