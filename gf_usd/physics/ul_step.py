"""How fast waves run through a strained body as the world's grid sees them.

A wave with normal N in the rest body has k = shear mu + U''(J) J^2 |F^-T N|^2 (see `stiffening`),
and its crests lie 1 / |F^-T N| as far apart in the world as at rest.  In the world its speed is
that of rho c^2 = shear mu / |F^-T N|^2 + U''(J) J^2, at most

    k = shear mu s_max^2 + U''(J) J^2,        s_max the largest singular value of F

rho of the rest body.  So stretch shortens the step here, and in the Total Lagrangian solver squash.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gf_usd.model import Floats, Ints
from gf_usd.physics.stiffening import wave_speed

if TYPE_CHECKING:
    from gf_usd.physics.laws import Law


def world_stiffness(law: Law, stretch: Floats, J: Floats, mu: Floats, lam: Floats) -> Floats:
    """k (N,) [Pa] of stretches (N, 3), ascending, and J (N,); mu as `laws.moduli`."""
    bulk = np.maximum(law.bulk(J, mu, lam), 0.0)
    return law.shear(mu) * stretch[:, 2] ** 2 + bulk * J**2


def cells_now(cells: Floats) -> tuple[Ints, Ints]:
    """Particles cell by cell, and where each cell's begin, with the end.

    cells : (N, 3) positions in cells of the grid; a node lies at whole numbers.
    """
    base = np.floor(cells - 0.5).astype(np.int64)
    base -= base.min(0)
    dims = base.max(0) + 1
    key = (base[:, 0] * dims[1] + base[:, 1]) * dims[2] + base[:, 2]
    order = np.argsort(key, kind="stable")
    first = np.flatnonzero(np.diff(key[order], prepend=-1))
    return order, np.append(first, len(key))


def strained_speed(k: Floats, density: Floats, cells: Floats) -> float:
    """Largest over cells of sqrt(mean k / mean density) [m/s]."""
    return wave_speed(k, density, *cells_now(cells))
