"""Inequality constraints of flesh: distance to the bone, and to the skinned pose.

The bone of a point X is the one whose axis is nearest, with nearest axis point P.  The bone's
rigid or affine motion takes X to B = A X + b, in the direction n = A (X - P) / |A (X - P)| from
its axis.  With r = max(|X - P|, edge of a cell) at rest,

    squish q    n . (x - B) >= -(1 - q) r      the distance to the axis is at least q r
    stretch s   |x - G| <= s r                 G the skinned pose

q and s are relative to r, so that one value suits thin and thick limbs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.stage import FleshLimits, Skeleton
from gf_usd.geometry.flesh.cores import Cores
from gf_usd.geometry.flesh.linear_blend import bone_transforms


def flesh_limits(
    cores: Cores,
    skeleton: Skeleton,
    *,
    squish: float | None,
    stretch: float | None,
    cell: float,
) -> FleshLimits:
    """The constraints of flesh around bones.

    squish, stretch : q and s; None: no such constraint.  cell : [m] edge of a cell.
    """
    linear, offset = bone_transforms(skeleton)
    bones = _Bones(cores=cores, linear=linear, offset=offset, cell=cell)
    return FleshLimits(
        carried=bones.carried,
        toward=partial(bones.ways, None if squish is None else 1.0 - squish),
        away=partial(bones.ways, stretch),
    )


@dataclass(frozen=True, kw_only=True)
class _Bones:
    """The functions of `FleshLimits`; a class, because plans with closures cannot be pickled."""

    cores: Cores
    linear: Floats  # (F, bones, 3, 3) as in `bone_transforms`
    offset: Floats  # (F, bones, 3) [m]
    cell: float  # [m]

    def carried(self, X: Floats) -> Callable[[float], tuple[Floats, Floats]]:
        """See `FleshLimits`."""
        bone, way = nearest_bone(self.cores, X)
        # no division by 0: a point on the axis is in a core, whose motion is prescribed
        way = np.where((way != 0.0).any(1, keepdims=True), way, np.eye(3)[0])

        def at(frame: float) -> tuple[Floats, Floats]:
            k = int(np.clip(round(frame), 0, len(self.linear) - 1))
            A = self.linear[k][bone]
            n = np.einsum("nab,nb->na", A, way)
            place = np.einsum("nab,nb->na", A, X) + self.offset[k][bone]
            return place, n / np.linalg.norm(n, axis=1, keepdims=True)

        return at

    def ways(self, share: float | None, X: Floats) -> Floats:
        """(n,) [m] the share of r at points X (n, 3) [m]; None: inf."""
        if share is None:
            return np.full(len(X), np.inf)
        r = np.linalg.norm(nearest_bone(self.cores, X)[1], axis=1)
        return np.asarray(share * np.maximum(r, self.cell))


def nearest_bone(cores: Cores, X: Floats) -> tuple[Ints, Floats]:
    """(n,) the bone with the axis nearest to each point X (n, 3) [m], and X - P (n, 3) [m]."""
    best = np.full(len(X), np.inf)
    bone, way = np.zeros(len(X), np.int64), np.zeros((len(X), 3))
    for core in cores.cores:
        away = core.away(X)
        distance = np.linalg.norm(away, axis=1)
        closer = distance < best
        best[closer], bone[closer], way[closer] = distance[closer], core.bone, away[closer]
    return bone, way
