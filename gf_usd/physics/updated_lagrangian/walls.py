"""Planes along the axes that what flows does not pass: side walls, symmetry planes, rigid floors.

A plane goes through nodes of the grid or halfway between them, where cells of particles meet, and
the motion beyond it is the mirror image of that before it.  With R the reflection, diag(-1, 1, 1)
for a normal along x, of a node i and its image i'

    m_i v_i = sum over i and i' of the momenta that particles bring, those of i' times R
    v_i' = R v_i,   and on the plane the normal velocity is 0

as if mirrored particles were there, so that a plane is as accurate as the grid is inside: velocity,
stress and mass have no layer that lacks neighbors.  A plane that sticks has R = -1: all of the
velocity is 0 on it.  Two planes a cell apart make plane strain.

What particles bring to nodes is theirs alone, so that what a plane gives them is counted by node,

    impulse = sum_i m_i v_i exp(drag dt) - (p_i + m_i dt g)     m_i, p_i of the true particles
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.errors import UsageError

NOWHERE = 1 << 28  # of a plane that is not there
NEAR = 1e-4  # [half cells] a plane may be off: f32 holds positions no better


@dataclass(frozen=True, kw_only=True)
class Wall:
    """A plane, and the side of it that particles are on."""

    axis: int  # along which its normal is
    at: float  # [m] coordinate along the axis
    above: bool = True  # particles are where the coordinate is greater
    sticks: bool = False  # what is at the plane stays where it is; else it slides freely


@dataclass(frozen=True, kw_only=True)
class Planes:
    """Walls as the kernels have them: twice the index of a node, along each axis."""

    first: Ints  # (3,) below which all is mirrored
    last: Ints  # (3,) above which it is
    stuck: Ints  # (3,) 1: the first sticks, 2: the last does, 3: both

    def moved(self, cells: Ints) -> Planes:
        """As seen from a grid that was moved by whole cells (3,)."""
        return Planes(
            first=self.first - 2 * cells, last=self.last - 2 * cells, stuck=self.stuck
        )  # fmt: skip


def planes(walls: Sequence[Wall], X: Floats, origin: Floats, h: float) -> Planes:
    """The walls of particles that begin at X (N, 3) [m].

    origin : (3,) [m] of node 0; h : [m] edge of a cell.
    Raises UsageError for a wall that does not fit the grid, for particles behind one, and for a
    second wall on the same side.
    """
    first, last = np.full(3, -NOWHERE), np.full(3, NOWHERE)
    stuck = np.zeros(3, np.int64)
    for wall in walls:
        index = 2.0 * (wall.at - origin[wall.axis]) / h
        side = first if wall.above else last
        name = "xyz"[wall.axis]
        if abs(index - np.round(index)) > NEAR:
            raise UsageError(
                f"the wall at {name} = {wall.at:.6g} m does not fit the grid with cells of "
                f"{h:.6g} m"
                f" from {origin[wall.axis]:.6g} m",
                "place it an integer number of half cells from there",
            )
        if abs(side[wall.axis]) != NOWHERE:
            raise UsageError(
                f"there are two walls {'below' if wall.above else 'above'} along {name}",
                "leave one out",
            )
        behind = int(((X[:, wall.axis] < wall.at) == wall.above).sum())
        if behind:
            raise UsageError(
                f"{behind} of {len(X)} particles are behind the wall at {name} = {wall.at:.6g} m",
                "flip the wall with above=, or move it",
            )
        side[wall.axis] = round(index)
        stuck[wall.axis] |= (1 if wall.above else 2) * wall.sticks
    return Planes(first=first, last=last, stuck=stuck)
