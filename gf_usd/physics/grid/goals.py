"""Goals: where springs draw the nodes, and how stiff the springs are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats
from gf_usd.core.stage import Goals

STIFFEST = 1.0  # [1/dt] of w: as stiff as the grid's own highest frequency
# The kernels have GOAL numbers of a node: G, dG/dt from RATE on, k and c from SPRING on, and WORK.
GOAL, RATE, SPRING, WORK = 9, 3, 6, 8


class NodeGoals:
    """The goals of free nodes at X (n, 3) [m]; dt : [s] the stable step."""

    def __init__(self, goals: Goals, X: Floats, dt: float) -> None:
        self._X, self._pose = X, goals.pose(X)
        self.moving = goals.moving
        w = np.minimum(goals.rate(X), STIFFEST / dt)
        self.springs = np.stack([w**2, 2.0 * goals.damping * w], 1)  # (n, 2) k and c

    def between(self, index: int, frame_time: float) -> NDArray[np.float64]:
        """(n GOAL,) the kernels' numbers for the way from frame `index` - 1 to `index`.

        frame_time : [s] between them.
        """
        start, end = self._pose(index - 1), self._pose(index)
        out = np.zeros((len(self._X), GOAL))
        out[:, :RATE] = start - self._X
        out[:, RATE:SPRING] = (end - start) / frame_time
        out[:, SPRING:WORK] = self.springs
        return out.ravel()


def work_of(numbers: Floats) -> float:
    """[J] that goals did, of the kernels' numbers."""
    return float(numbers.reshape(-1, GOAL)[:, WORK].astype(float).sum())
