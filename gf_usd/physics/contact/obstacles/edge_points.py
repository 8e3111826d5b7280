"""Contact of edges and corners of obstacles with bodies, at points of the obstacles.

Contact samples of a body are a spacing apart, and an edge or a corner could pass between them. A
point of a convex edge or corner (`sharp`) near a body is therefore a contact sample of its own,
which moves with the obstacle and whose plane belongs to the body. The kernels treat it as any other
sample (`kernels.pair_contact`), with the stiffness of the surface that it presses on, but its force
acts on no node.

The arrays have places for a limited number of points. Of points that are nearer to each other than
APART one is kept; points in contact come first, then the deepest. A point for which the search no
longer finds a place, for example beyond the side of a body, keeps its plane until it has left the
plane sideways by STAY.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints, lengths, nonzero_rows
from gf_usd.core.stage import Collider
from gf_usd.physics.contact.detection.body_skins import PosedSkin
from gf_usd.physics.contact.detection.narrow_phase import ContactSearch
from gf_usd.physics.contact.obstacles.edge_search import (
    NEAR,
    STAY,
    EdgeContacts,
    EdgeSearch,
    Near,
)
from gf_usd.physics.contact.obstacles.obstacle import Obstacle
from gf_usd.physics.contact.obstacles.piercing import STEP
from gf_usd.physics.contact.obstacles.sharp import SharpFeatures, SharpPoints
from gf_usd.physics.contact.planes.contact_planes import NOBODY, ContactPlanes
from gf_usd.physics.contact.planes.continuity import EASE

APART = 0.5  # [spacings] edge of the cells of which one point in contact with a body is kept
# Least capacity, and samples of the bodies for each point: every pass over the contact samples
# passes over all places for points.
LEAST_CAPACITY, SHARE = 64, 8

SAVED = ("key", "x", "v", "start_gap")


def capacity(colliders: Sequence[Collider], samples: int, spacing: float) -> int:
    """Most points at a time in a simulation of a number of samples a spacing [m] apart.

    At most all of all obstacles, by the lengths of their edges, and a share of the samples: edges
    are lines, on which a body of n samples meets some sqrt(n) points each.
    """
    all_of_them = 0.0
    for one in colliders:
        if one.shape == "plane":
            continue
        p = one.positions(0)
        length = sum(
            lengths(p[one.triangles[:, k]] - p[one.triangles[:, k - 1]]).sum() for k in range(3)
        )
        all_of_them += len(p) + 0.5 * length / (STEP * spacing)
    return int(min(np.ceil(all_of_them), max(LEAST_CAPACITY, samples // SHARE)))


class EdgePoints:
    """The points of obstacles that are in contact with bodies, numbered after the contact samples.

    first : number of the first of `count` places for points; features, rest, spacing : see
    `EdgeSearch`.
    """

    def __init__(
        self, first: int, count: int, obstacles: Sequence[Obstacle],
        features: Callable[[int], SharpFeatures], rest: Callable[[int], PosedSkin], spacing: float,
    ) -> None:  # fmt: skip
        self._first, self._spacing = first, spacing
        self._search = EdgeSearch(obstacles, features, rest, spacing)
        self.key = np.full(count, -1)  # (m,) of the point at each place; -1: none
        self.x, self.v = np.zeros((count, 3)), np.zeros((count, 3))  # [m], [m/s] at a detection
        # (m,) [m] <= 0: depth, negative, in the opposite body at the start
        self.start_gap = np.zeros(count)
        self._held = np.zeros(count, bool)  # places whose points are in contact
        self._found: list[EdgeContacts] = []  # of the present detection
        self.left_out = 0  # points in bodies without a place at the last detection

    def save(self) -> dict[str, Any]:
        """See `Saved`."""
        return {f"contact_edge_{name}": getattr(self, name).copy() for name in SAVED}

    def load(self, saved: Mapping[str, Any]) -> None:
        """See `Saved`."""
        for name in SAVED:
            setattr(self, name, np.array(saved[f"contact_edge_{name}"]))

    def joined(self, x: Floats, v: Floats, elapsed: float) -> tuple[Floats, Floats]:
        """x [m] and v [m/s] of samples (n, 3), and of points, elapsed [s] after a detection."""
        if not len(self.key):
            return x, v
        return np.concatenate([x, self.x + elapsed * self.v]), np.concatenate([v, self.v])

    def with_points(
        self, X: Floats, drift: Floats | None, dt: float, origin: Floats
    ) -> tuple[Floats, Floats | None]:
        """`layout.write_rest` of samples at X (n, 3) [m], and of points, from an origin (3,) [m].

        Both in the middle of the first substep of dt [s].
        """
        if not len(self.key):
            return X, drift
        own = np.zeros_like(X) if drift is None else drift
        place = self.x + 0.5 * dt * self.v - origin
        return np.concatenate([X, place]), np.concatenate([own, self.v])

    def begin(self, elapsed: float, planes: ContactPlanes, depth: Floats, kept: Ints) -> None:
        """A detection begins, elapsed [s] after the last one.

        planes, depth : of it, (n + m,), with the depths [m] now; kept : (n + m,) what is not
        searched for again.
        """
        n = self._first
        self.x = self.x + elapsed * self.v
        self._held = (depth[n:] > 0.0) | kept[n:]
        self._held[nonzero_rows(planes.spring[n:])] = True
        self._held &= planes.partner[n:] != NOBODY
        self._free(planes.partner[n:] == NOBODY)
        self._found = []
        self.left_out = 0

    def _free(self, places: Ints) -> None:
        self.key[places], self.start_gap[places] = -1, 0.0

    def search(
        self, search: ContactSearch, which: int, samples: Mapping[int, Ints],
        near: Callable[[int], Near], before: ContactPlanes, gap: Floats, frame: float, ahead: float,
    ) -> None:  # fmt: skip
        """Find the points of one obstacle in contact with bodies.  A call of `offer` must follow.

        samples : by body, those within ABOUT of the obstacle; before, gap : planes and gaps
        (n + m,) [m] of the last detection; near : of each body, and frame, ahead : see
        `EdgeSearch.contacts`.
        """
        about = [search.x[some] for some in samples.values()]
        for body, found in zip(samples, self._search.near(about, which, frame)):
            if len(found[0]):
                self._note_contacts(body, which, found, near(body), before, gap, frame, ahead)

    def _note_contacts(
        self, body: int, which: int, found: tuple[Ints, SharpPoints, Floats], near: Near,
        before: ContactPlanes, gap: Floats, frame: float, ahead: float,
    ) -> None:  # fmt: skip
        """Note those of the points found that are in contact with a body."""
        place = self._places(found[0])
        row = np.where(place >= 0, self._first + place, 0)
        inside = (place >= 0) & (gap[row] < 0.0) & (before.partner[row] >= 0)
        known = np.where(inside, gap[row] - EASE * self._spacing, 0.0)
        self._found.append(
            self._search.contacts(body, which, found, known, place >= 0, near, frame, ahead)
        )

    def offer(self, search: ContactSearch) -> None:
        """Give places to the points found, and offer them the planes of bodies."""
        if not self._found:
            return
        some = self._chosen(EdgeContacts.joined(self._found))
        place, new = self._placed(some.key)
        row = self._first + place
        self.x[place] = search.x[row] = some.x
        self.v[place], self.start_gap[place] = some.v, some.start_gap
        search.allow(row[new], some.start_gap[new] - NEAR * self._spacing)
        for body, which in np.unique(np.stack([some.body, some.obstacle], 1), axis=0).tolist():
            at = np.flatnonzero((some.body == body) & (some.obstacle == which))
            point = some.point[at] + some.start_gap[at, None] * some.normal[at]
            search.offer_places(
                row[at], -some.depth[at], some.normal[at], point, body, some.rest[at], which
            )

    def _chosen(self, found: EdgeContacts) -> EdgeContacts:
        """Those that get places: one of each cell and body, and one plane for each point."""
        place = self._places(found.key)
        held = (place >= 0) & self._held[np.maximum(place, 0)]
        order = np.lexsort((found.key, -found.depth, ~held))
        cell = np.floor(found.x[order] / (APART * self._spacing)).astype(np.int64)
        rows = np.column_stack([found.body[order], cell])
        first = np.sort(np.unique(rows, axis=0, return_index=True)[1])
        order = order[first]
        order = order[np.sort(np.unique(found.key[order], return_index=True)[1])]
        count = int(held[order].sum())
        most = count + len(self.key) - int(self._held.sum())
        deep = found.depth[order[most:]] + found.start_gap[order[most:]] > EASE * self._spacing
        self.left_out += int(deep.sum())
        return found.of(order[:most])

    def _placed(self, keys: Ints) -> tuple[Ints, Ints]:
        """(k,) places of points, and which of them (l,) are new there; the others are free."""
        place = self._places(keys)
        stays = self._held.copy()
        stays[place[place >= 0]] = True
        self._free(~stays)
        new = np.flatnonzero(place < 0)
        place[new] = np.flatnonzero(~stays)[: len(new)]
        self.key[place[new]] = keys[new]
        return place, new

    def keep_unseen(self, search: ContactSearch, before: ContactPlanes, depth: Floats) -> None:
        """Keep the old planes of points in bodies for which the search found none.

        before, depth : planes and depths (n + m,) [m] so far.
        """
        unseen = (depth > 0.0) & (search.planes.partner == NOBODY) & (before.partner >= 0)
        unseen[: self._first] = False
        rows = np.flatnonzero(unseen)
        far = STAY * self._spacing
        search.keep_planes(rows, before, self.start_gap[rows - self._first], depth[rows], far)

    def _places(self, keys: Ints) -> Ints:
        """(k,) places of points; -1: none yet."""
        order = np.argsort(self.key, kind="stable")
        if not len(order):
            return np.full(len(keys), -1)
        at = order[np.minimum(np.searchsorted(self.key[order], keys), len(order) - 1)]
        return np.where(self.key[at] == keys, at, -1)
