"""Stiffness over time: Young's modulus at some time codes, as a share of what it is at rest."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints


@dataclass(frozen=True, kw_only=True)
class StiffnessKeys:
    """What mu and lam of particles are multiplied by; Poisson's ratio stays.

    The factor is straight between two keys, and the same before the first and after the last.
    """

    times: Floats  # (K,) time codes, ascending
    factors: Floats  # (K, G) above 0
    of: Ints  # (N,) column of each particle

    def at(self, code: float) -> NDArray[np.float64]:
        """(N,) factors at a time code."""
        t = np.asarray(self.times, float)
        after = int(np.clip(np.searchsorted(t, code), 1, max(len(t) - 1, 1)))
        first, last = self.factors[after - 1], self.factors[min(after, len(t) - 1)]
        way = t[min(after, len(t) - 1)] - t[after - 1]
        share = float(np.clip((code - t[after - 1]) / way, 0.0, 1.0)) if way > 0.0 else 0.0
        return np.asarray(first + share * (last - first))[self.of]

    def most(self, codes: Iterable[float]) -> NDArray[np.float64]:
        """(N,) the largest factors at any of these time codes."""
        return np.max([self.at(code) for code in codes], axis=0)
