"""How much of a bake is contact of bodies with themselves, from their shapes alone.

What folds a body onto itself is only known at the end.  Bodies with limbs do it more than others,
and fill less of their convex hull: a duck 0.87, an animal about half, a chair a tenth.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.frames.particles import Particles, SurfaceSamples
from gf_usd.prepare.bodies.convexity import SupportPoints

# Of the volume of its convex hull that a body fills: from COMPACT on it hardly touches itself, and
# FOLDED below that it does so as much as any.  Fitted together with `budget.LIMBS` and
# `budget.LIMB_SECONDS` (docs/performance.md, Contact of bodies with themselves).
COMPACT, FOLDED = 0.85, 0.25


@dataclass(frozen=True, kw_only=True)
class Limbs:
    """Limbs of the bodies that can touch themselves."""

    share: float = 0.0  # 0 to 1, of the body that touches itself most: 1 as a chair does
    samples: float = 0.0  # contact samples of each body times its share, all together


def limbs_of(samples: SurfaceSamples, particles: Particles, bodies: Iterable[int]) -> Limbs:
    """Limbs of some of the bodies, those with self-contact; X in [m]."""
    of = np.zeros(len(samples.X), np.int64) if samples.body is None else np.asarray(samples.body)
    volumes = np.bincount(particles.body_of, np.asarray(particles.V0, float))
    shares, weighted = [0.0], 0.0
    for body in bodies:
        X = samples.X[of == body]
        if len(X):
            shares.append(limb_share(hull_fill(X, float(volumes[body]))))
            weighted += shares[-1] * len(X)
    return Limbs(share=max(shares), samples=weighted)


def hull_fill(X: Floats, volume: float) -> float:
    """Volume [m^3] of a body over that of the convex hull of its samples X (n, 3) [m], at most 1.

    The hull is that of the points that are farthest in 146 directions, which is at most 4 % too
    small (measured with a ball).  1 for a flat body, which has no such hull.  A body that fills
    so little that `limb_share` is 1 may fill even less.
    """
    supports = SupportPoints(X)
    bound = supports.hull_lower_bound()  # 0, or too small, where its center is not well inside
    fill = min(1.0, volume / bound) if bound > 0.0 else 1.0
    if bound > 0.0 and limb_share(fill) in (0.0, 1.0):
        return fill
    from scipy.spatial import ConvexHull, QhullError  # takes longer to import than all of this

    try:
        return min(1.0, volume / ConvexHull(supports.points).volume)
    except QhullError:  # flat to rounding
        return 1.0


def limb_share(fill: float) -> float:
    """0 to 1: how much a body that fills so much of its convex hull touches itself."""
    return min(1.0, max(0.0, (COMPACT - fill) / FOLDED))
