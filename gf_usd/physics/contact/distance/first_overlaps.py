"""Samples of bodies that are inside each other when contact between bodies begins.

Characters may overlap in the first pose of their animation.  Springs would push each sample out by
the shortest path, also through thin parts such as hands, which would stay entangled.  Samples that
are inside another body, and those near them, such as a finger tip behind a hand, therefore have no
contact with this body until none of their group is inside it (Baraff et al. 2003 find intersections
in groups, too).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints
from gf_usd.physics.contact.distance.closest import Closest

LINK = 2.0  # [spacings] distance of samples that are in one group
SAMPLE, OTHER, GROUP = range(3)  # columns


class Surface(Protocol):
    """A surface in one pose: see `body_skins.PosedSkin`."""

    @property
    def box(self) -> tuple[Floats, Floats]: ...

    def closest(self, X: Floats, reach: float) -> Closest: ...

    def corrected(self, seen: Closest, inside: Ints, X: Floats) -> Closest: ...


class FirstOverlaps:
    """The samples without contact with another body, in groups.

    members : the samples of each body; meet_from : frame at which contact between bodies begins,
    0: contact is with what is as deep as at rest, see `RestGaps`; spacing : [m].
    """

    def __init__(self, members: Sequence[Ints], meet_from: int, spacing: float) -> None:
        self._members, self._spacing = members, spacing
        self._begin: float = meet_from if meet_from > 0 else np.inf
        self._rows = np.zeros((0, 3), np.int64)

    def save(self) -> dict[str, Any]:
        """See `Saved`."""
        return {"contact_first_overlaps": self._rows, "contact_begins": self._begin}

    def load(self, saved: Mapping[str, Any]) -> None:
        """See `Saved`."""
        self._rows = np.asarray(saved["contact_first_overlaps"])
        self._begin = float(saved["contact_begins"])

    def update(
        self, frame: float, pairs: Sequence[tuple[int, int]], x: Floats,
        posed: Callable[[int], Surface],
    ) -> Ints:  # fmt: skip
        """Find the groups once contact begins, and release those that are outside.

        pairs : bodies that are near each other, with the second below 0 for an obstacle; x : (n, 3)
        [m] samples; posed : the surface of a body.  Returns the bodies of released samples.
        """
        bodies = [(a, b) for a, b in pairs if b >= 0]
        if frame >= self._begin:
            self._begin = np.inf
            self._rows = self._found(bodies, x, posed)
            return self._rows[:0, 0]
        if not len(self._rows):
            return self._rows[:0, 0]
        inside = np.zeros(len(self._rows), bool)
        for body, other in bodies:
            mine = np.flatnonzero(
                (self._rows[:, OTHER] == other)
                & np.isin(self._rows[:, SAMPLE], self._members[body])
            )
            inside[mine] = depths(x[self._rows[mine, SAMPLE]], posed(other)) > 0.0
        stays = np.isin(self._rows[:, GROUP], self._rows[inside, GROUP])
        left, self._rows = self._rows[~stays], self._rows[stays]
        return np.array(
            [k for k, m in enumerate(self._members) if np.isin(left[:, SAMPLE], m).any()], np.int64
        )

    def apart(self, rows: Ints, others: Ints) -> NDArray[np.bool_]:
        """(k,) whether samples `rows` (k,) may be in contact with bodies `others` (k,)."""
        if not len(self._rows):
            return np.ones(len(rows), bool)
        count = len(self._members)
        left = self._rows[:, SAMPLE] * count + self._rows[:, OTHER]
        return ~np.isin(rows * count + others, left)

    def _found(
        self, pairs: Sequence[tuple[int, int]], x: Floats, posed: Callable[[int], Surface]
    ) -> Ints:
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components
        from scipy.spatial import KDTree

        out, groups = [np.zeros((0, 3), np.int64)], 0
        for a, b in sorted({(min(p), max(p)) for p in pairs}):
            both = np.concatenate([self._members[a], self._members[b]])
            other = np.repeat([b, a], [len(self._members[a]), len(self._members[b])])
            depth = np.concatenate(
                [depths(x[self._members[a]], posed(b)), depths(x[self._members[b]], posed(a))]
            )
            inside = depth > 0.0
            if not inside.any():
                continue
            far = LINK * self._spacing + float(depth.max())
            near = KDTree(x[both[inside]]).query(x[both], distance_upper_bound=far)[0] < np.inf
            both, other = both[near], other[near]
            one, two = KDTree(x[both]).query_pairs(LINK * self._spacing, output_type="ndarray").T
            links = coo_array((np.ones(len(one)), (one, two)), shape=(len(both), len(both)))
            count, group = connected_components(links, directed=False)
            out.append(np.stack([both, other, groups + group], axis=1))
            groups += count
        return np.concatenate(out)


def depths(X: Floats, surface: Surface) -> NDArray[np.float64]:
    """(n,) [m] how deep points X (n, 3) [m] are inside a surface; 0 outside."""
    low, high = surface.box
    there = np.flatnonzero(((low < X) & (high > X)).all(1))
    out = np.zeros(len(X))
    if len(there):
        seen = surface.closest(X[there], float(np.linalg.norm(high - low)))
        inside = np.flatnonzero(seen.gap < 0.0)
        if len(inside):
            seen = surface.corrected(seen, inside, X[there])
        out[there[seen.rows]] = np.maximum(-seen.gap, 0.0)
    return out
