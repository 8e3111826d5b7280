"""Contact of the bodies of a scene with themselves: their searches, and what these found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from gf_usd.core.arrays import Floats, Ints, lengths
from gf_usd.physics.contact.detection.narrow_phase import ContactSearch
from gf_usd.physics.contact.planes.contact_planes import NOBODY, ContactPlanes
from gf_usd.physics.contact.planes.persistence import Outlook
from gf_usd.physics.contact.self_contact.search import CLEAR, FACE, SelfContact

STAY = 1.0  # [spacings]
# [spacings] largest motion of a sample relative to the mean of its body, after a search that found
# nothing within FACE, without a new one: two samples approach each other by twice that at most.
STIR = 0.5 * (FACE - CLEAR)


class OwnContacts:
    """Contact of each of some bodies with itself.

    bodies : by number; members : the samples of each of all B bodies; count : n of all samples;
    reach : [m] within which contact is searched; spacing : [m].
    """

    def __init__(
        self, bodies: Mapping[int, SelfContact], members: Sequence[Ints], count: int,
        *, reach: float, spacing: float,
    ) -> None:  # fmt: skip
        self._bodies, self._members = bodies, members
        self._reach, self._spacing = reach, spacing
        # (n,) [m] of the last detection, also of samples whose plane belongs to another body
        self.gap = np.full(count, reach)
        # (B,) [s] time until which a body cannot come near itself
        self.until = np.full(len(members), np.inf)
        # Whether nothing of a body was near itself at its last search in this frame, (B,), and
        # where its samples were then, (n, 3) [m].
        self._clear = np.zeros(len(members), bool)
        self._searched = np.zeros((count, 3))

    def forget(self, rows: Ints) -> None:
        """Set the gaps of samples `rows` (k,) to the reach: nothing is near them."""
        self.gap[rows] = self._reach

    def imminent(
        self, x: Floats, v: Floats, span: float, before: Floats, still: Ints | None
    ) -> bool:
        """Whether a body may touch itself within a span [s]; bodies `still` (B,) do not move.

        x, v : (n, 3) [m], [m/s] of the samples; before : (n, 3) [m] at the last detection.
        """
        return any(
            own.imminent(x[m := self._members[k]], v[m], span, before[m], self.gap[m])
            for k, own in self._bodies.items()
            if still is None or not still[k]
        )

    def search(
        self, search: ContactSearch, outlook: Outlook, kept: Ints, before: Floats, span: float,
        *, every_sample: bool,
    ) -> float:  # fmt: skip
        """Offer each body that is not kept (B,) the places of its own surface that it faces.

        Returns for how long [s] nothing is missing.  before : (n, 3) [m] of the samples at the
        search before; span : [s] after which the search is repeated anyway; every_sample : search
        from all samples of a body, not only from those of patches that may be near each other.
        Once a frame that finds contact between neighboring patches before the surface is folded
        there.
        """
        hold, v = float("inf"), outlook.v
        known = self.gap
        self.gap = np.full(len(known), self._reach)
        self.until = np.full(len(self._members), np.inf)
        if every_sample:
            self._clear[:] = False
        for k, own in self._bodies.items():
            m = self._members[k]
            if kept[k]:
                self.gap[m] = known[m]
                continue
            if self._clear[k] and self._hardly_deformed(k, search.x[m], span * outlook.spread[k]):
                self.until[k] = -np.inf  # beyond the span nothing is known
                continue
            self._searched[m] = search.x[m]
            patch_pairs, until = own.broad_phase(search.x[m], v[m], min(span, hold))
            hold = min(hold, until)
            self.until[k] = outlook.time + until
            self._clear[k] = patch_pairs is None
            if patch_pairs is None:
                continue
            found = own.find(
                search.x[m], v[m], FACE * self._spacing, before[m], known[m],
                None if every_sample else patch_pairs,
            )  # fmt: skip
            self.gap[m[found.rows]] = found.gap
            hold = min(hold, found.hold)
            self.until[k] = outlook.time + min(until, found.hold)
            self._clear[k] = found.nearest >= FACE * self._spacing
            order = np.argsort(-found.weights, axis=1, kind="stable")
            search.offer(
                m[found.rows], found.gap, found.normal,
                found.point + own.offset[found.rows, None] * found.normal,
                m[np.take_along_axis(found.carriers, order, 1)],
                np.take_along_axis(found.weights, order, 1), sure=True,
            )  # fmt: skip
        return hold

    def _hardly_deformed(self, body: int, x: Floats, coming: float) -> bool:
        """Whether samples at x (k, 3) [m] of a body have moved by no more than `STIR` relative to
        its mean since its last search, and will have by `coming` [m] more.
        """
        way = x - self._searched[self._members[body]]
        return lengths(way - way.mean(0)).max() + coming <= STIR * self._spacing

    def keep_unseen(
        self, search: ContactSearch, planes: ContactPlanes, offset: Floats, depth: Floats, of: Ints
    ) -> None:
        """Keep the old planes of samples inside their own body for which the search found none.

        offset : (n,) [m] of the samples from their old planes, see `RestGaps`; depth : (n,) [m]
        under these; of : (n,) their bodies.  Beyond an edge or in a crease there may be no closest
        place; a sample is no longer inside once it is STAY to the side of its old plane.
        """
        f = planes
        unseen = (depth > 0.0) & (search.planes.partner == NOBODY) & (f.partner >= 0)
        rows = np.flatnonzero(unseen[: len(of)] & (of[f.partner[: len(of)]] == of))
        rows, gap = search.keep_planes(rows, f, offset[rows], depth[rows], STAY * self._spacing)
        self.gap[rows] = gap
