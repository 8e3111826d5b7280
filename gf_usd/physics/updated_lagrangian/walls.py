"""Axis-aligned mirror planes of a flow: side walls, symmetry planes, rigid floors.

A plane lies on nodes of the grid or halfway between them, on cell boundaries; the motion beyond it
is the mirror image of that before it. With R the reflection, diag(-1, 1, 1) for a normal along x, a
node i and its image i' have

    m_i v_i = sum over i and i' of the particles' momenta, those of i' multiplied by R
    v_i' = R v_i,   and zero normal velocity on the plane

as with mirrored particles. A plane is therefore as accurate as the interior of the grid: velocity,
stress and mass have no boundary layer. A no-slip plane has R = -1, so that the velocity on it is
zero. Two planes at a distance of one cell impose plane strain.

Only the particles before a plane contribute to a node, and the impulse of the plane is summed over
nodes,

    impulse = sum_i m_i v_i exp(drag dt) - (p_i + m_i dt g)     m_i, p_i without images
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.errors import UsageError
from gf_usd.core.units import length_text

PARTS = 64  # of the nodes, whose impulses as many threads of a GPU sum
NOWHERE = 1 << 28  # index of an absent plane
NEAR = 1e-4  # [half cells] tolerance of a plane's position: the accuracy of f32 positions


@dataclass(frozen=True, kw_only=True)
class Wall:
    """A plane, and its side that contains the particles."""

    axis: int  # of its normal
    at: float  # [m] coordinate along the axis
    above: bool = True  # particles are where the coordinate is greater
    sticks: bool = False  # no slip; otherwise free slip


@dataclass(frozen=True, kw_only=True)
class Planes:
    """The walls in the kernels' form: twice the index of a node, along each axis."""

    first: Ints  # (3,) lower planes
    last: Ints  # (3,) upper planes
    stuck: Ints  # (3,) no slip at: 1 the lower plane, 2 the upper one, 3 both

    def moved(self, cells: Ints) -> Planes:
        """The planes relative to a grid that is shifted by whole cells (3,)."""
        return Planes(
            first=self.first - 2 * cells, last=self.last - 2 * cells, stuck=self.stuck
        )  # fmt: skip


def planes(walls: Sequence[Wall], X: Floats, origin: Floats, h: float) -> Planes:
    """The walls for particles at X (N, 3) [m] at the start.

    origin : (3,) [m] of node 0; h : [m] edge of a cell.

    Raises UsageError for a wall that does not fit the grid, for particles behind one, and for a
    second wall on the same side.
    """
    first, last = np.full(3, -NOWHERE), np.full(3, NOWHERE)
    stuck = np.zeros(3, np.int64)
    for wall in walls:
        index = _half_cells(wall.at, origin[wall.axis], h)
        side = first if wall.above else last
        name = "xyz"[wall.axis]
        way = 0.5 * h * float(index - np.round(index))  # [m] from the nearest half cell
        if abs(index - np.round(index)) > NEAR:
            raise UsageError(
                f"the wall at {name} = {wall.at:.6g} m does not fit the grid with cells of"
                f" {length_text(h)}: the nearest half cell is {length_text(abs(way))} away",
                f"place it at {name} = {_shortest(wall.at - way, origin[wall.axis], h)} m, or an"
                " integer number of half cells from there",
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


def _half_cells(at: float, origin: float, h: float) -> float:
    """Half cells from node 0 at `origin` [m] to a plane at `at` [m], of cells of edge h [m]."""
    return 2.0 * (at - origin) / h


def _shortest(at: float, origin: float, h: float) -> str:
    """The coordinate [m] of a half cell with as few digits as a wall there needs; see `planes`."""
    texts = (f"{at:.{digits}g}" for digits in range(6, 17))
    offsets = ((text, _half_cells(float(text), origin, h)) for text in texts)
    return next((text for text, i in offsets if abs(i - np.round(i)) <= NEAR), f"{at:.17g}")
