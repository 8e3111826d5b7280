"""Material values over time: moduli, damping and friction of particles at some time codes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.materials.material import lame

# What may change: mass, and so density, is conserved.
KEYED: tuple[str, ...] = ("youngs_modulus", "poissons_ratio", "damping_time", "friction")


@dataclass(frozen=True, kw_only=True)
class ValueKeys:
    """The values of particles at key times, in groups of particles with equal values.

    Values are linear between two keys, and constant before the first and after the last.
    """

    times: Floats  # (K,) time codes, ascending
    values: Mapping[str, Floats]  # (K, G) of each of KEYED, in SI
    of: Ints  # (N,) column of each particle

    def at(self, code: float) -> dict[str, NDArray[np.float64]]:
        """(N,) of each of KEYED at a time code, and mu and lam [Pa] by `lame`."""
        t = np.asarray(self.times, float)
        after = int(np.clip(np.searchsorted(t, code), 1, max(len(t) - 1, 1)))
        last = min(after, len(t) - 1)
        way = t[last] - t[after - 1]
        share = float(np.clip((code - t[after - 1]) / way, 0.0, 1.0)) if way > 0.0 else 0.0
        now = {name: v[after - 1] + share * (v[last] - v[after - 1]) for name, v in self._arrays()}
        mu, lam = lame(now["youngs_modulus"], now["poissons_ratio"])
        return {name: np.asarray(v)[self.of] for name, v in {**now, "mu": mu, "lam": lam}.items()}

    def most(self, codes: Iterable[float]) -> dict[str, NDArray[np.float64]]:
        """(N,) the largest of each value at any of these time codes."""
        every = [self.at(code) for code in codes]
        return {name: np.max([one[name] for one in every], axis=0) for name in every[0]}

    def changes(self, name: str) -> bool:
        """Whether a value differs between keys."""
        values = np.asarray(self.values[name])
        return bool((values != values[:1]).any())

    def _arrays(self) -> list[tuple[str, Floats]]:
        return [(name, np.asarray(self.values[name], float)) for name in KEYED]
