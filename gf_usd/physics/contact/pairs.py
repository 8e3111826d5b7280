"""Contact between bodies and with obstacles: when it is detected, and what a detection changes.

A detection costs about as much as ten substeps, so it is made only when it has to be: a pair whose
boxes are apart is left alone until they could have come together.  What the planes of a detection
store in their springs more than the old ones is energy that nobody's motion paid for: a new plane
is moved back until that is little, and the rest is counted.  The overlap reported is the true one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any
from weakref import ref

import numpy as np

from gf_usd.core.arrays import Floats, Ints, corners, lengths, row_dots
from gf_usd.core.frames import SurfaceSamples
from gf_usd.core.materials.dimensionless import time_scale
from gf_usd.physics.contact import narrow_phase
from gf_usd.physics.contact.broad_phase import Box, schedule
from gf_usd.physics.contact.continuity import EASE, Stored, continued
from gf_usd.physics.contact.distance.closest import Closest, closest
from gf_usd.physics.contact.floor import HARD, FloorContact
from gf_usd.physics.contact.narrow_phase import (
    ARRAYS,
    CLOSER,
    FACING,
    TRAVEL,
    BodySkin,
    ContactPlanes,
    ContactSearch,
    moved,
    nothing,
    obstacles,
    pair_values,
)
from gf_usd.physics.contact.self_contact import AHEAD, FACE, NEARLY, SelfContact
from gf_usd.physics.contact.stability import PairSprings
from gf_usd.physics.grid.embedding import placed
from gf_usd.physics.total_lagrangian.setup import Body
from gf_usd.physics.total_lagrangian.state import State, StateView

# [spacings] before it touches from where a body pushes another: as much as springs yield under what
# rests on them, so that surfaces that are pressed together do not stand in each other.
APART = 0.15
WAIT = 0.5  # of its gap that a sample may slide besides TRAVEL: it does not touch before
STAY = 1.0  # [spacings]
FEWEST = 4  # substeps that are worth a detection of their own before something touches
# Of a body with rigid regions, springs that a sample may feel, over the one on the floor: its own,
# those of planes it carries, and each of the two strained by both bodies.
CROWD = 4.0
# Of m g r in T: what planes may give to a pair so that its samples come to be as deep as they truly
# are, which lifts what rests on them.  In a whole bake of ten T it is a thousandth.
BUDGET = 1e-4


class BodyContact:
    """The contact samples of a body that meets others, and the planes they face.

    It lasts as long as its body: what of it is state is saved and loaded.
    """

    def __init__(self, body: Body) -> None:
        assert body.contact_setup is not None
        assert body.contact is not None
        self._body, self.contact_setup, self.contact = body, body.contact_setup, body.contact
        samples, skins = body.contact.samples, body.contact_setup.skins
        self._X = samples.X
        of = np.zeros(len(samples.X), np.int64) if samples.body is None else samples.body
        self._of, self._members = of, [np.flatnonzero(of == k) for k in range(len(skins))]
        self._spacing = body.particles.spacing
        self._obstacles = obstacles(self.contact_setup.colliders, body.settings.frame_time)
        self._skins: dict[int, BodySkin] = {}  # see `_skin`, of bodies that others came near
        g, r = float(np.linalg.norm(body.settings.gravity)), body.particles.radius
        self._budget = BUDGET * g * r * float(body.m.sum()) / time_scale(r)  # [W]
        self._apart: dict[tuple[int, int], Floats] = {}  # see `_offsets`, of bodies that met
        self._sunk: dict[int, Floats] = {}  # see `_sunk_in`, of obstacles
        self._placed: tuple[ref[StateView], Floats, Floats] | None = None  # `motion` of a view
        self._found_offset: tuple[Ints, Floats] | None = None  # `_offset` of planes that face so
        self._own = {k: self._itself(k, samples) for k in range(len(skins)) if self._meets(k)}
        self._x = samples.X  # [m] at the last detection
        self.planes = nothing(len(samples.X))  # as they were when the kernels last ended
        self._detected = 0.0  # [s] time of the last detection
        self._k = self.contact.stiffness
        crowd = CROWD * float(
            (self.contact.pair_stiffness / self.contact.stiffness).max(initial=1.0)
        )
        self._crowd = crowd
        self._hardening = (HARD * self._spacing) ** -2
        self.injected = 0.0  # [J] since `begin`
        self.released = 0  # most samples at once, since `begin`
        self._overlap = 0.0  # [m] deepest at a detection since `begin`
        # [m] of the last detection; what overlaps at the first one may be as deep as it is.
        self._gap = np.full(len(samples.X), -np.inf)
        # [m] then, of what each sample saw of its own body, whatever else it faced.
        self._own_gap = np.full(len(samples.X), (FACING + TRAVEL) * self._spacing)

    def _meets(self, body: int) -> bool:
        """Whether a body meets itself; one without samples, or all of which is held, does not."""
        return body in self.contact_setup.self_contact and len(self._members[body]) > 0

    def _skin(self, body: int) -> BodySkin:
        """Made once something comes near: most bodies that are alone never need it."""
        if body not in self._skins:
            skin, m = self.contact_setup.skins[body], self._members[body]
            of = np.full(len(skin.points), body)
            rows = self._body.stencil.rows(skin.points, of, skin.cell_copy, gradients=False)
            self._skins[body] = BodySkin(skin, rows, m, self._X[m])
        return self._skins[body]

    def _itself(self, body: int, samples: SurfaceSamples) -> SelfContact:
        m = self._members[body]
        assert samples.normal is not None
        skin = self.contact_setup.skins[body]
        return SelfContact(skin, samples.X[m], samples.normal[m], self._spacing)

    def save(self) -> dict[str, Any]:
        """See `Saved`."""
        return {
            **{f"contact_{name}": getattr(self.planes, name) for name in ARRAYS},
            "contact_detected": self._detected,
            "contact_gap": self._gap,
            "contact_own_gap": self._own_gap,
            "contact_x": self._x,
            "contact_stiffness": self._k,
        }

    def load(self, saved: Mapping[str, Any]) -> None:
        """See `Saved`."""
        planes = {name: np.asarray(saved[f"contact_{name}"]) for name in ARRAYS}
        self.planes = ContactPlanes(**planes)
        self._detected = float(saved["contact_detected"])
        self._gap = np.asarray(saved["contact_gap"])
        self._own_gap = np.asarray(saved["contact_own_gap"])
        self._x = np.asarray(saved["contact_x"])
        self._k = np.asarray(saved["contact_stiffness"])

    def begin(self, state: State) -> None:
        """Count from zero."""
        self.injected, self.released, self._overlap = 0.0, 0, 0.0
        with state.written("pair", narrow_phase.ROW) as pair:
            pair[:, narrow_phase.DEPTH] = pair[:, narrow_phase.WORK] = 0.0

    def energy(self, now: StateView, time: float) -> float:
        """[J] in the springs of the planes last detected, at a time [s]."""
        return self._stored(self.motion(now)[0], time).energy

    def _stored(self, x: Floats, time: float) -> Stored:
        depth = self.planes.depth(x, time - self._detected)
        return Stored(
            planes=self.planes, depth=depth, stiffness=self._k, hardening=self._hardening,
            pair=self._pairs(self.planes),
        )  # fmt: skip

    def _pairs(self, planes: ContactPlanes) -> Ints:
        """(n,) which body of each sample and what it faces, as one number; -1: nothing."""
        theirs = np.where(planes.partner >= 0, self._of[planes.partner], planes.obstacle)
        theirs = theirs + np.where(planes.partner >= 0, len(self._obstacles), 0)
        number = self._of * (len(self._obstacles) + len(self._members)) + theirs
        return np.where(planes.partner == narrow_phase.NOBODY, -1, number)

    def imminent(self, now: StateView, time: float, still: Ints | None = None) -> bool:
        """Whether anything may touch before the next frame; bodies `still` (B,) do not move.

        time : [s] of the state.
        """
        span = self._body.settings.frame_time
        x, v = self.motion(now)
        near, hold = self._schedule(x, v, time / span, span, still)
        if near or hold < span:
            return True
        return any(
            own.imminent(x[m := self._members[k]], v[m], span, self._before(k, x), self._own_gap[m])
            for k, own in self._own.items()
            if still is None or not still[k]
        )

    def pass_by(self, flying: Ints, time: float) -> None:
        """A frame has passed, up to `time` [s], in which flying bodies (B,) had nothing near."""
        for k in np.flatnonzero(flying):
            away = (FACING + TRAVEL) * self._spacing
            self._gap[self._members[k]] = self._own_gap[self._members[k]] = away
            self.planes.forget(self._members[k])
            self._found_offset = None
        self._detected = time

    @property
    def _offset(self) -> Floats:
        """(n,) [m] from the body it faces at which each sample begins to be pushed."""
        partner, at = self.planes.partner, self.planes.obstacle
        if self._found_offset is not None and self._found_offset[0] is partner:
            return self._found_offset[1]
        out = np.zeros(len(self._of))
        facing = self.planes.carried
        theirs = self._of[partner[facing]]
        for other in np.unique(theirs):
            rows = facing[theirs == other]
            out[rows] = self._offset_from(rows, int(other))
        for which in np.unique(at[at >= 0]):
            rows = np.flatnonzero(at == which)
            out[rows] = self._sunk_in(int(which))[rows]
        self._found_offset = partner, out  # planes that move keep what they face
        return out

    def _sunk_in(self, which: int) -> Floats:
        """(n,) [m] <= 0 where samples are in an obstacle at the start: they are pushed when deeper.

        A spring that begins deep would throw out what the asset has there.
        """
        if which not in self._sunk:
            X = self._X + np.asarray(self._body.settings.lift)
            reach = (FACING + TRAVEL) * self._spacing
            seen = self._obstacles[which].planes(X, reach, 0.0, 0.0).seen
            found = self._sunk[which] = np.zeros(len(X))
            found[seen.rows] = np.minimum(seen.gap, 0.0)
        return self._sunk[which]

    def _offset_from(self, rows: Ints, other: int) -> Floats:
        """(k,) [m] of samples `rows` from a body: less than a share where they are nearer at rest.

        So a body at rest stays so: what touches then has none, and what overlaps is pushed when it
        is deeper.
        """
        out = np.zeros(len(rows))
        for k in map(int, np.unique(self._of[rows])):
            mine = self._of[rows] == k
            out[mine] = self._offsets(k, other)[np.searchsorted(self._members[k], rows[mine])]
        return out

    def _offsets(self, body: int, other: int) -> Floats:
        """(n,) [m] of all samples of a body from another, or from itself."""
        if body == other:
            return self._own[body].offset
        if (body, other) not in self._apart:
            X, skin, most = self._X[self._members[body]], self.contact_setup.skins[other], APART
            apart = np.full(len(X), most * self._spacing)
            if not self.contact_setup.meet_from:
                seen = closest(X, skin.points, skin.triangles, (FACING + TRAVEL) * self._spacing)
                apart[seen.rows] = np.minimum(seen.gap, most * self._spacing)
            self._apart[body, other] = apart
        return self._apart[body, other]

    def _note_overlap(self, state: State) -> float:
        """Count how deep samples were under the present planes; returns the deepest so far [m]."""
        depth = _column(state, narrow_phase.DEPTH)
        self._overlap = max(self._overlap, float((depth - self._offset).max()))
        return self._overlap

    def totals(self, state: State) -> tuple[float, float, float]:
        """Work of the obstacles [J], energy given by detections [J] and deepest overlap [m]."""
        work = _column(state, narrow_phase.WORK)
        return float(work.sum()), self.injected, self._note_overlap(state)

    @property
    def members(self) -> list[Ints]:
        """The contact samples of each body."""
        return self._members

    def surface(
        self,
        body: int,
        X: Floats,
        known: Floats,
        u: Floats,
        offset: Floats,
        reach: float,
    ) -> tuple[Closest, Ints, Floats]:
        """What points see of a body: `BodySkin.near`, and the contact samples (k, 3) that carry the
        places seen, with weights (k, 3)."""
        skin = self._skin(body)
        seen, rest = skin.near(X, known, u, offset, reach)
        return seen, *skin.carriers(rest)

    def motion(self, now: StateView) -> tuple[Floats, Floats]:
        """x [m] and v [m/s] of the samples, (n, 3), not to be changed."""
        if self._placed is not None and self._placed[0]() is now:
            return self._placed[1:]
        constants = self.contact.constants
        x, rate = placed(self.contact.rows, now.u, now.v)
        x += self._X + now.offset
        if constants is not None:
            c, c_rate = now.constants
            x, rate = x + constants @ c, rate + constants @ c_rate
        x.flags.writeable = rate.flags.writeable = False
        self._placed = ref(now), x, rate
        return x, rate

    def set_friction(self, contact: FloorContact) -> None:
        """Take the friction of the samples from here on; all else of them stays."""
        self.contact = contact

    def detect(
        self,
        state: State,
        index: int,
        dt: float,
        done: int,
        left: int,
        *,
        floor: Ints | None = None,
        shorter: float = 1.0,
    ) -> tuple[int, int]:
        """Set the planes for the next substeps, and say how many they hold for, at most `left`.

        And into how many shorter ones these are divided where something touches: the step of the
        body alone is too long for springs between samples.
        index : the frame that is marched to; done : substeps of dt [s] since the frame before it.
        floor : samples that may reach the floor; None: all.
        shorter : as many as each is divided into at least, for what else pushes the samples.
        """
        now, elapsed = state.view(), done * dt
        frame = index - 1 + elapsed / self._body.settings.frame_time
        time = state.time + elapsed
        x, v = self.motion(now)
        meet, hold = self._schedule(x, v, frame, left * dt)
        old = self._stored(x, time)
        closer = CLOSER * (self._spacing + WAIT / TRAVEL * np.maximum(self._gap, 0.0))
        search = ContactSearch(x, (FACING + TRAVEL) * self._spacing, self._gap - closer)
        for other in sorted({other for _, other in meet}):
            near = [mine for mine, faced in meet if faced == other]
            if other < 0:
                self._face_obstacle(search, near, -1 - other, frame, min(hold, left * dt))
                continue
            self._face_body(search, near, other, now.nodes[0], now.offset)
        hold = min(hold, self._face_themselves(search, v, left * dt, whole=done == 0))
        search.carry(self._skins, self._X)
        if not len(old.planes.active) and not len(search.planes.active):
            self._gap, self._detected, self._x = search.gap, time, x
            chunk = int(np.clip(hold / dt, 1, left))
            return chunk, int(np.ceil(chunk * shorter))
        self._keep(search, old.depth)
        values = pair_values(
            search.planes, self.contact,
            [(c.spec.friction, c.spec.restitution) for c in self.contact_setup.colliders],
        )  # fmt: skip
        new = Stored(
            planes=search.planes,
            depth=search.planes.depth(x, 0.0),
            stiffness=values["stiffness"],
            hardening=self._hardening,
            pair=self._pairs(search.planes),
        )
        budget = self._budget * (time - self._detected)
        new = continued(old, new, ease=EASE * self._spacing, budget=budget)
        self._note_overlap(state)
        self.planes, self._k = new.planes, new.stiffness
        self.injected += new.energy - old.energy
        self._gap, self._detected, self._x = search.gap, time, x
        self._overlap = max(self._overlap, -float(search.gap.min()))
        lost = (old.depth > EASE * self._spacing) & (self.planes.partner == narrow_phase.NOBODY)
        self.released = max(self.released, search.released, int(lost.sum()))
        hold = min(hold, self._sliding(v))
        chunk = int(np.clip(hold / dt, 1, left))
        by = self._shorter(x, v, chunk * dt, values, floor)
        free = self._untouched(v) / dt
        if free >= min(chunk, FEWEST) and (by - 1.0) * min(chunk, free) >= FEWEST:
            chunk, by = min(chunk, int(min(free, left))), 1.0
        # Frequencies of springs on the same samples add up as squares.
        parts = int(np.ceil(chunk * np.sqrt(max(1.0, shorter**2 + by**2 - 1.0))))
        dt = chunk * dt / parts
        # A substep moves the planes on before it takes its forces, those half of it later: bodies
        # are there already but at the start of a frame.
        self._upload(state, now, values, dt, moved(self.planes, x, v, -dt if done else -0.5 * dt))
        return chunk, parts

    def _untouched(self, v: Floats) -> float:
        """[s] for which no sample touches what it faces, at the speeds v (n, 3) [m/s] and more."""
        faces = self.planes.facing
        gap = (self._gap - self._offset)[faces] - NEARLY * self._spacing
        if (gap <= 0.0).any():
            return 0.0
        f = self.planes.of(faces)
        closing = -row_dots(v[faces] - f.interpolated(v) - f.velocity, f.normal)
        comes = closing > 0.0
        return float((gap[comes] / (AHEAD * closing[comes])).min(initial=np.inf))

    def _shorter(
        self, x: Floats, v: Floats, span: float, values: Mapping[str, Floats], floor: Ints | None
    ) -> float:
        """Substeps with the springs of these planes over those where nothing touches.

        x, v : (n, 3) [m], [m/s] now; span : [s] for which the planes stay; values : of
        `pair_values`; floor : see `detect`.  1 where the number of substeps is given.
        """
        body = self._body
        if body.settings.substeps:
            return 1.0
        near = np.arange(len(x)) if floor is None else floor
        if body.settings.floor is None:
            near = near[:0]
        springs = PairSprings(
            planes=self.planes, k=self._k, values=values, hardening=self._hardening,
            spacing=self._spacing,
        )  # fmt: skip
        fall = self._fall(span)
        if body.regions:
            stable = springs.crowded_step(self.contact, body.step, x, v, span, fall, self._crowd)
        else:
            stable = springs.step(self.contact, body.mass, body.step, x, v, span, fall, near)
        return max(1.0, body.step.dt / stable.dt)

    def _sliding(self, v: Floats) -> float:
        """[s] until a sample has slid too far along what it faces; what is off may go farther."""
        near = self.planes.facing
        f = self.planes.of(near)
        speed = lengths(v[near] - f.interpolated(v) - f.velocity)
        way = TRAVEL * self._spacing + WAIT * np.maximum(self._gap[near], 0.0)
        return float((way / np.maximum(speed, 1e-30)).min(initial=np.inf))

    def _fall(self, span: float) -> float:
        """[m/s] that gravity and fields may add to a speed within a span [s]."""
        s = self._body.settings
        return (float(np.linalg.norm(s.gravity)) + s.pushes) * span

    def _schedule(
        self, x: Floats, v: Floats, frame: float, span: float, still: Ints | None = None
    ) -> tuple[list[tuple[int, int]], float]:
        if len(self._members) == 1 and not self._obstacles:
            return [], float("inf")
        return schedule(
            [Box.around(x[m], v[m]) for m in self._members],
            self._obstacles,
            self.contact_setup,
            frame=frame,
            fall=self._fall(span),
            reach=(FACING + TRAVEL) * self._spacing,
            spacing=self._spacing,
            still=still,
        )

    def _candidates(self, search: ContactSearch, near: Sequence[int], theirs: Floats) -> Ints:
        """Samples of bodies `near` so close to `theirs` that they may reach that body's surface."""
        low, high = corners(theirs)
        low, high = low - search.reach, high + search.reach
        members = np.concatenate([self._members[k] for k in near])
        there = np.ones(len(members), bool)
        for axis in range(3):
            x = search.x[members, axis]
            there &= (x >= low[axis]) & (x <= high[axis])
        return members[there]

    def _face_body(
        self, search: ContactSearch, near: Sequence[int], other: int, nodes: Floats, offset: Floats
    ) -> None:
        """All bodies `near` another at once: its surface is made ready only once."""
        theirs = search.x[self._members[other]]
        rows = self._candidates(search, near, theirs)
        if len(rows) == 0:
            return
        # What was inside it at the last detection is there still; what begins to be may be at a
        # fold, and so may what was inside something else.
        gap, faced = self._gap[rows], self.planes.partner[rows]
        was = (gap < 0.0) & (faced >= 0) & (self._of[faced] == other)
        known = np.where(was, gap - EASE * self._spacing, 0.0)
        found, rest = self._skin(other).near(search.x[rows], known, nodes, offset, search.reach)
        mine = rows[found.rows]
        point = found.point + self._offset_from(mine, other)[:, None] * found.normal
        search.offer_places(mine, found.gap, found.normal, point, other, rest)

    def _face_themselves(
        self, search: ContactSearch, v: Floats, span: float, *, whole: bool
    ) -> float:
        """Offer what bodies have near of themselves; returns for how long [s] that is all.

        span : [s] after which it is asked again; whole : where something may be near, all samples
        look ahead, and not those of the patches that may be: once a frame that finds what neighbors
        face before they are folded.
        """
        hold = float("inf")
        known = self._own_gap
        self._own_gap = np.full(len(known), (FACING + TRAVEL) * self._spacing)
        for k, own in self._own.items():
            m = self._members[k]
            judged, until = own.judge(search.x[m], v[m], min(span, hold))
            hold = min(hold, until)
            if judged is None:
                continue
            before = self._before(k, search.x)
            found = own.find(
                search.x[m], v[m], FACE * self._spacing, before, known[m],
                None if whole else judged,
            )  # fmt: skip
            self._own_gap[m[found.rows]] = found.gap
            hold = min(hold, found.hold)
            order = np.argsort(-found.weights, axis=1, kind="stable")
            search.offer(
                m[found.rows], found.gap, found.normal,
                found.point + own.offset[found.rows, None] * found.normal,
                m[np.take_along_axis(found.carriers, order, 1)],
                np.take_along_axis(found.weights, order, 1), sure=True,
            )  # fmt: skip
        return hold

    def _keep(self, search: ContactSearch, depth: Floats) -> None:
        """Have samples inside their own body that see no place of it keep the plane they had.

        depth : (n,) [m] under the planes until now.  Where a place ends, at an edge or at a crease,
        none may be found; a sample is no longer inside once it is STAY to the side of what it
        faced.
        """
        f, offset = self.planes, self._offset
        unseen = (depth > 0.0) & (search.planes.partner == narrow_phase.NOBODY) & (f.partner >= 0)
        rows = np.flatnonzero(unseen & (self._of[f.partner] == self._of))
        point = f.of(rows).interpolated(search.x) + f.point[rows]
        away = search.x[rows] - point
        aside = away + depth[rows, None] * f.normal[rows]
        near = np.linalg.norm(aside, axis=1) < STAY * self._spacing
        rows, point = rows[near], point[near]
        gap = offset[rows] - depth[rows]
        self._own_gap[rows] = gap
        search.offer(rows, gap, f.normal[rows], point, f.carriers[rows], f.weights[rows], sure=True)

    def _before(self, body: int, x: Floats) -> Floats:
        """Where the samples of a body were at the last detection.

        Before the first one they were where they are, x (n, 3) [m] of all.
        """
        m = self._members[body]
        return np.where(np.isinf(self._gap[m])[:, None], x[m], self._x[m])

    def _face_obstacle(
        self, search: ContactSearch, near: Sequence[int], which: int, frame: float, span: float
    ) -> None:
        rows = np.concatenate([self._members[k] for k in near])
        sunk = self._sunk_in(which)
        plane = self._obstacles[which].planes(search.x[rows], search.reach, frame, span)
        found, mine = plane.seen, rows[plane.seen.rows]
        point = found.point + sunk[mine, None] * found.normal
        search.offer(mine, found.gap, found.normal, point, velocity=plane.velocity, obstacle=which)

    def _upload(
        self,
        state: State,
        now: StateView,
        values: Mapping[str, Floats],
        dt: float,
        f: ContactPlanes,
    ) -> None:
        constants = self.contact.driven
        point = f.point - 0.5 * dt * f.velocity
        point[f.partner == narrow_phase.OBSTACLE] -= now.offset
        with state.written("pair", narrow_phase.ROW) as pair:
            pair[:, narrow_phase.DRIFT : narrow_phase.RATE] = 0.0
            pair[:, narrow_phase.REST : narrow_phase.DRIFT] = self._X
            if constants is not None:
                c, rate = now.constants
                rest = self._X + constants @ (c + 0.5 * dt * rate)
                pair[:, narrow_phase.REST : narrow_phase.DRIFT] = rest
                pair[:, narrow_phase.DRIFT : narrow_phase.PLACE] = constants @ rate
            pair[:, narrow_phase.FORCE : narrow_phase.POINT] = 0.0
            pair[:, narrow_phase.DEPTH] = 0.0
            pair[:, narrow_phase.SPRING : narrow_phase.WEIGHT] = f.spring
            pair[:, narrow_phase.WEIGHT : narrow_phase.REACTION] = f.weights
            pair[:, narrow_phase.REACTION : narrow_phase.HARDENING] = 0.0
            pair[:, narrow_phase.POINT : narrow_phase.NORMAL] = point
            pair[:, narrow_phase.NORMAL : narrow_phase.VELOCITY] = f.normal
            pair[:, narrow_phase.VELOCITY : narrow_phase.STIFFNESS] = f.velocity
            pair[:, narrow_phase.HARDENING] = self._hardening
            pair[:, narrow_phase.STIFFNESS] = values["stiffness"]
            pair[:, narrow_phase.DAMPING] = values["damping"]
            pair[:, narrow_phase.FRICTION] = values["friction"]
        state.put("links", narrow_phase.links(f))

    def follow(self, state: State, dt: float, closed: bool) -> bool:
        """Take the planes as substeps of dt [s] left them; closed : they ended a frame.

        False where the samples are no longer anywhere: nothing can follow them.
        """
        if not len(self.planes.active):
            return True
        x, v = self.motion(state.view())
        if not (np.isfinite(x).all() and np.isfinite(v).all()):
            return False
        f, who = self.planes, self.planes.carried
        normal, point = f.normal.copy(), f.point.copy()
        places = state.part("pair", narrow_phase.ROW, narrow_phase.POINT, narrow_phase.VELOCITY)
        point[who], normal[who] = places[who, :3], places[who, 3:]
        spring = state.part("pair", narrow_phase.ROW, narrow_phase.SPRING, narrow_phase.WEIGHT)
        # By what the bodies moved since their last forces.
        self.planes = moved(
            replace(f, normal=normal, point=point, spring=spring),
            x,
            v,
            0.5 * dt if closed else dt,
        )
        return True


def _column(state: State, column: int) -> Floats:
    """(n,) one number of each sample."""
    return state.part("pair", narrow_phase.ROW, column, column + 1)[:, 0]
