"""Contact between bodies and with obstacles: when pairs are detected, and what that changes.

A detection pass costs about as much as ten substeps.  It is made when the last one no longer holds:
once a pair whose boxes were apart could have come together (`broad_phase`), once a body could have
come near itself (`self_contact`), or once a sample has slid too far along its plane
(`planes.intervals`).  New planes would store another energy in their springs than the old ones,
which is not work of any motion: they are moved until the difference is small (`planes.continuity`),
and the rest is counted as `injected`.  The overlap reported is that with the true surfaces.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints, Segments
from gf_usd.core.frames.particles import SurfaceSamples
from gf_usd.physics.contact.detection.body_skins import BodySkin, BodySkins, PosedSkin
from gf_usd.physics.contact.detection.broad_phase import BroadPhase
from gf_usd.physics.contact.detection.narrow_phase import CLOSER, FACING, TRAVEL, ContactSearch
from gf_usd.physics.contact.detection.pair_search import PairSearch
from gf_usd.physics.contact.detection.pair_values import pair_values
from gf_usd.physics.contact.distance.closest import Closest
from gf_usd.physics.contact.distance.first_overlaps import FirstOverlaps
from gf_usd.physics.contact.floor import HARD, FloorContact
from gf_usd.physics.contact.obstacles.edge_points import EdgePoints
from gf_usd.physics.contact.obstacles.obstacle import obstacles
from gf_usd.physics.contact.obstacles.piercing import Piercing
from gf_usd.physics.contact.planes import layout
from gf_usd.physics.contact.planes.contact_planes import (
    ARRAYS,
    NOBODY,
    ContactPlanes,
    moved,
    nothing,
)
from gf_usd.physics.contact.planes.continuity import (
    EASE,
    EnergyBudget,
    PairNumbers,
    Stored,
    continued,
)
from gf_usd.physics.contact.planes.intervals import (
    Lateness,
    until_contact,
    until_slid,
    until_stopped,
)
from gf_usd.physics.contact.planes.persistence import Outlook, Persistence
from gf_usd.physics.contact.planes.rest_gaps import RestGaps
from gf_usd.physics.contact.samples import MovingSamples
from gf_usd.physics.contact.self_contact.bodies import OwnContacts
from gf_usd.physics.contact.self_contact.search import AHEAD, NEARLY, SelfContact
from gf_usd.physics.contact.stability import CALM, PairSprings
from gf_usd.physics.grid.bodies import bodies_of
from gf_usd.physics.total_lagrangian.setup.body import Body
from gf_usd.physics.total_lagrangian.setup.contact import floor_height
from gf_usd.physics.total_lagrangian.state import State, StateView

# Of its gap, that a sample may slide in addition to TRAVEL: at CLOSER / TRAVEL times the speeds it
# becomes no deeper than one that touches already.
WAIT = TRAVEL / CLOSER
FEWEST = 4  # substeps that are worth a detection of their own before something touches


@dataclass(frozen=True, kw_only=True)
class _Found:
    """What a search found."""

    outlook: Outlook
    x: Floats  # (n + m, 3) [m] of samples and points of obstacles, new ones too
    hold: float  # [s] for which it is all
    values: Mapping[str, Floats] | None = None  # `pair_values` of the planes; None: there are none


class BodyContact:
    """Contact of the samples of a solver's bodies, and the planes they face.

    Created once for a body; what changes during a bake is saved and loaded (`save`, `load`).
    """

    def __init__(self, body: Body) -> None:
        assert body.contact_setup is not None
        assert body.contact is not None
        self._body, self.contact_setup, self.contact = body, body.contact_setup, body.contact
        samples, skins = body.contact.samples, body.contact_setup.skins
        self._samples = MovingSamples(body.contact, len(skins))
        self._X, self._of = self._samples.X, self._samples.of
        self.members = self._samples.members  # the contact samples of each body
        self.motion = self._samples.motion
        self._spacing = body.particles.spacing
        self._reach = (FACING + TRAVEL) * self._spacing  # [m] from where something is faced
        self._obstacles = obstacles(self.contact_setup.colliders, body.settings.frame_time)
        self._broad_phase = BroadPhase(
            samples=Segments(self.members), obstacles=self._obstacles,
            contact_setup=self.contact_setup, reach=self._reach, spacing=self._spacing,
        )  # fmt: skip
        self._skins = BodySkins(self._make_skin, len(samples.X))
        self._pair_numbers = PairNumbers(obstacles=len(self._obstacles), bodies=len(skins))
        self._budget = self._make_budget()
        meets = [k for k in sorted(self.contact_setup.self_contact) if len(self.members[k])]
        own = {k: self._make_own(k, samples) for k in meets}
        self._own = OwnContacts(
            own, self.members, len(samples.X), reach=self._reach, spacing=self._spacing
        )
        lift = np.asarray(body.settings.lift, float)
        self._piercing = Piercing(
            self.contact_setup, self._obstacles, self.members, self._spacing,
            lambda k: self._skins[k].posed(lift), body.settings.frames - 1,
        )  # fmt: skip
        n, points = len(samples.X), body.contact.points
        self._edges = EdgePoints(
            n, points, self._obstacles, self._piercing.sharp,
            lambda k: self._skins[k].posed(lift), self._spacing,
        )  # fmt: skip
        self._rest_gaps = RestGaps(
            self._X, self._of, self.contact_setup, self._obstacles, own, spacing=self._spacing,
            reach=self._reach, lift=lift, edges=self._edges,
        )  # fmt: skip
        self._persistence = Persistence(
            self.members, len(self._obstacles), np.pad(samples.X, ((0, points), (0, 0))),
            reach=self._reach, spacing=self._spacing,
        )  # fmt: skip
        self._overlaps = FirstOverlaps(self.members, self.contact_setup.meet_from, self._spacing)
        self._pair_search = PairSearch(
            self._samples, self._skins, self._obstacles, self._edges if points else None,
            self._rest_gaps, self._overlaps, spacing=self._spacing,
            frame_time=body.settings.frame_time,
        )  # fmt: skip
        self._kept = np.zeros(len(skins), bool)  # bodies not searched from at the last detection
        self._x = samples.X  # [m] at the last detection
        # Of samples and points of obstacles, as they were when the kernels last ended.
        self.planes = nothing(n + points)
        self.watched = np.zeros(0, np.int64)  # samples whose planes the kernels have
        self._span = 0.0  # [s] for which they have them
        self._detected = 0.0  # [s] time of the last detection
        self._frame = 0.0  # of the obstacles, then
        self.lateness = Lateness()
        self._k = np.pad(self.contact.stiffness, (0, points))
        self._hardening = (HARD * self._spacing) ** -2
        self.injected = 0.0  # [J] since `begin`
        self.released = 0  # most samples at once, since `begin`
        self._overlap = 0.0  # [m] deepest at a detection since `begin`
        self._deepest_pair = -1  # its number, see `PairNumbers`; -1: none
        # [m] of the last detection; what overlaps at the first one may be as deep as it is.
        self._gap = np.full(n + points, -np.inf)

    def _make_skin(self, body: int) -> BodySkin:
        skin, m = self.contact_setup.skins[body], self.members[body]
        return BodySkin(skin, body, self._body.stencil, m, self._X[m])

    def _make_budget(self) -> EnergyBudget:
        bodies = bodies_of(self._body.particles, self._body.per["density"])
        assert bodies.count == len(self.members)
        g = float(np.linalg.norm(self._body.settings.gravity))
        return EnergyBudget.of_bodies(bodies.mass, bodies.radius, len(self._obstacles), g)

    def _make_own(self, body: int, samples: SurfaceSamples) -> SelfContact:
        m = self.members[body]
        assert samples.normal is not None
        skin = self.contact_setup.skins[body]
        return SelfContact(skin, samples.X[m], samples.normal[m], self._spacing)

    def save(self) -> dict[str, Any]:
        """See `Saved`."""
        return {
            **{f"contact_{name}": getattr(self.planes, name) for name in ARRAYS},
            "contact_detected": self._detected,
            "contact_gap": self._gap,
            "contact_own_gap": self._own.gap,
            "contact_x": self._x,
            "contact_is_watched": np.isin(np.arange(len(self._gap)), self.watched),
            "contact_stiffness": self._k,
            "contact_given": self._budget.given.copy(),
            **self._persistence.save(),
            **self._overlaps.save(),
            **self._edges.save(),
        }

    def load(self, saved: Mapping[str, Any]) -> None:
        """See `Saved`."""
        planes = {name: np.asarray(saved[f"contact_{name}"]) for name in ARRAYS}
        self.planes = ContactPlanes(**planes)
        self._detected = float(saved["contact_detected"])
        self._gap = np.asarray(saved["contact_gap"])
        self._own.gap = np.array(saved["contact_own_gap"])
        self._x = np.asarray(saved["contact_x"])
        self.watched = np.flatnonzero(saved["contact_is_watched"])
        self._k = np.asarray(saved["contact_stiffness"])
        self._budget.given = np.array(saved["contact_given"])
        self._persistence.load(saved)
        self._overlaps.load(saved)
        self._edges.load(saved)

    def begin(self, state: State) -> None:
        """Count from zero."""
        self.injected, self.released, self._overlap, self._deepest_pair = 0.0, 0, 0.0, -1
        self.lateness.begin()
        with state.written("pair", layout.ROW) as pair:
            pair[:, layout.DEPTH] = pair[:, layout.WORK] = 0.0

    def energy(self, now: StateView, time: float) -> float:
        """[J] in the springs of the planes last detected, at a time [s]."""
        return self._stored(self._joined(now, time)[0], time).energy

    def _stored(self, x: Floats, time: float) -> Stored:
        depth = np.zeros(len(x))  # the kernels have no springs of the others
        depth[self.watched] = self.planes.depth(x, time - self._detected)[self.watched]
        return Stored(
            planes=self.planes, depth=depth, stiffness=self._k, hardening=self._hardening,
            pair=self._pairs(self.planes),
        )  # fmt: skip

    def _pairs(self, planes: ContactPlanes) -> Ints:
        """(n + m,) index of the pair of bodies of each sample and its opposite surface; -1: none.

        A point of an obstacle has that of the body that it faces and the obstacle.
        """
        of_body = (planes.partner >= 0) & (planes.obstacle < 0)
        others = self._of[planes.partner] + len(self._obstacles)
        theirs = np.where(of_body, others, planes.obstacle)
        mine = self._pair_numbers.of(planes.bodies(self._of), theirs)
        return np.where(planes.partner == NOBODY, -1, mine)

    def imminent(self, now: StateView, time: float, still: Ints | None = None) -> bool:
        """Whether anything may touch before the next frame; bodies `still` (B,) do not move.

        time : [s] of the state.
        """
        span = self._body.settings.frame_time
        x, v = self.motion(now)
        boxes = self._broad_phase.boxes(x, v)
        near, hold = self._broad_phase.pairs(boxes, time / span, self._pull, still)
        if near or hold < span:
            return True
        return self._own.imminent(x, v, span, self._x_before(x), still)

    def _x_before(self, x: Floats) -> Floats:
        """(n, 3) [m] samples at the last search from each; before the first one, as in x."""
        n = len(self._X)
        return np.where(np.isinf(self._gap[:n])[:, None], x[:n], self._persistence.x[:n])

    def pass_by(self, flying: Ints, time: float) -> None:
        """A frame has passed, up to `time` [s], in which flying bodies (B,) had nothing near."""
        of = self.planes.bodies(self._of)
        for k in np.flatnonzero(flying):
            self._gap[of == k] = self._reach
            self._own.forget(self.members[k])
            self.planes.forget(np.flatnonzero(of == k))
            self._rest_gaps.forget_planes()
        self._persistence.forget(np.flatnonzero(flying))
        self._detected = time

    def _note_overlap(self, state: State) -> float:
        """Count how deep samples were under the present planes; returns the deepest so far [m]."""
        depth = state.part("pair", layout.ROW, layout.DEPTH, layout.DEPTH + 1)[:, 0]
        self._deepen(depth - self._rest_gaps.of_planes(self.planes), self.planes)
        return self._overlap

    def _deepen(self, depth: Floats, planes: ContactPlanes) -> None:
        """Remember the deepest of the samples, depth [m] under their planes, and its pair."""
        deepest = int(np.argmax(depth))
        if depth[deepest] > self._overlap:
            self._overlap = float(depth[deepest])
            self._deepest_pair = int(self._pairs(planes)[deepest])

    def deepest_pair(self) -> tuple[str, str] | None:
        """The body that was deepest since `begin`, and what it was in, by their prim paths."""
        pair = self._pair_numbers.split(self._deepest_pair)
        return self.contact_setup.pair_names(*pair) if self._deepest_pair >= 0 else None

    def totals(self, state: State) -> tuple[float, float, float]:
        """Work of the obstacles [J], energy given by detections [J] and deepest overlap [m]."""
        work = state.part("pair", layout.ROW, layout.WORK, layout.WORK + 1)
        return float(work.sum()), self.injected, self._note_overlap(state)

    def pierced(self, now: StateView, frame: int) -> dict[str, Any]:
        """The fields `pierced...` of `Health`, of a state at a frame."""
        return self._piercing.measured(self.motion(now)[0], frame, partial(self._posed, now))

    def _posed(self, now: StateView, body: int) -> PosedSkin:
        return self._skins[body].posed(now.offset, now.nodes[0])

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
        skin = self._skins[body]
        seen, rest = skin.near(X, known, u, offset, reach)
        return seen, *skin.carriers(rest)

    def _joined(self, now: StateView, time: float) -> tuple[Floats, Floats]:
        """x [m] and v [m/s] of samples and points of obstacles (n + m, 3), at a time [s]."""
        return self._edges.joined(*self.motion(now), time - self._detected)

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
        floor: Callable[[float], Ints] | None = None,
        shorter: float = 1.0,
        stable: float | None = None,
        strained: float = np.inf,
    ) -> tuple[int, int]:
        """Set the planes for the next substeps.

        Returns for how many substeps of dt they hold, at most `left`, and into how many shorter
        ones these are divided where something touches: dt is the stable step of the body alone, and
        too long for springs between samples.

        index : the frame that is simulated; done : substeps of dt [s] since the frame before it.
        floor : samples that may reach the floor within a span [s]; None: all.
        shorter : least number of substeps for each of dt, by what else pushes the samples.
        stable : [s] stable step of the body alone; dt is shorter where a failed frame is repeated,
            and so are the substeps then.  None: dt.
        strained : [s] limit of the body alone in its strain.
        """
        now, elapsed = state.view(), done * dt
        time = state.time + elapsed
        if done:
            self.note_way(now, time, dt)
        frame = index - 1 + elapsed / self._body.settings.frame_time
        found = self._renew(state, now, time, frame, left * dt, frame_begins=done == 0)
        x, v, values = found.x, found.outlook.v, found.values
        landed = self._until_landed(x, v, floor(left * dt) if floor else None)
        hold = min(found.hold, landed, self.lateness.bound(time))
        if values is None:
            self.watched = self.watched[:0]
            return (chunk := int(np.clip(hold / dt, 1, left))), int(np.ceil(chunk * shorter))
        slide = self._persistence.slide - self._persistence.slid(self.planes, x)
        hold = min(hold, until_slid(self.planes, slide, v))
        chunk = int(np.clip(hold / dt, 1, left))
        span = chunk * dt
        calm = self._kept & found.outlook.hardly_moving(CALM * self._spacing)
        springs = PairSprings(
            planes=self.planes, k=self._k, values=values, hardening=self._hardening,
            spacing=self._spacing, x=x, v=v, span=span,
            fall=self._pull * span, calm=calm[self.planes.bodies(self._of)],
        )  # fmt: skip
        near = floor(span) if floor else np.arange(len(self._X))
        by = springs.step_ratio(self._body, self.contact, near, stable or dt, strained)
        gap = self._gap - self._rest_gaps.of_planes(self.planes) - NEARLY * self._spacing
        free = until_contact(self.planes, gap, v, AHEAD) / dt
        if free >= min(chunk, FEWEST) and (by - 1.0) * min(chunk, free) >= FEWEST:
            chunk, by = min(chunk, int(min(free, left))), 1.0
        # Frequencies of springs on the same samples add up as squares.
        parts = int(np.ceil(chunk * np.sqrt(max(1.0, shorter**2 + by**2 - 1.0))))
        dt = chunk * dt / parts
        # A substep moves the planes on before it takes its forces, those half of it later: bodies
        # are there already but at the start of a frame.
        self.watched, self._span = springs.watched, parts * dt
        planes = moved(self.planes.only(self.watched), x, v, -dt if done else -0.5 * dt)
        self._upload(state, now, values, dt, planes)
        return chunk, parts

    def faced_springs(self, state: State, span: float) -> PairSprings | None:
        """The springs to all of other bodies and obstacles that samples face at the begin of the
        first frame, as if everything were in contact and at rest; None where nothing is faced.

        span : [s] for which they are searched.  A detection as by `detect`, which sets `planes`,
        but gives the kernels nothing: for contact of its own, next to that of a solver.
        """
        found = self._renew(state, state.view(), state.time, 0.0, span, frame_begins=True)
        if found.values is None:
            return None
        of, faced, faces = self.planes.bodies(self._of), self.planes.partner, self.planes.facing
        others = (self.planes.obstacle[faces] >= 0) | (of[faces] != self._of[faced[faces]])
        return PairSprings(
            planes=self.planes.only(faces[others]), k=self._k, values=found.values,
            hardening=self._hardening, spacing=self._spacing, x=found.x,
            v=np.zeros_like(found.outlook.v), span=0.0, fall=0.0,
            calm=np.zeros(len(found.x), bool), nearly=np.inf,
        )  # fmt: skip

    def _renew(
        self, state: State, now: StateView, time: float, frame: float, span: float, *,
        frame_begins: bool,
    ) -> _Found:  # fmt: skip
        """Search what samples face at a time [s] of the state, and take these planes.

        frame : where the obstacles are; span : [s] until the next detection, at most.
        """
        x, v = self._joined(now, time)
        self._frame = frame
        old = self._stored(x, time)
        boxes = self._broad_phase.boxes(x, v)
        pairs, hold = self._broad_phase.pairs(boxes, frame, self._pull)
        if frame_begins:
            released = self._overlaps.update(frame, pairs, x, partial(self._posed, now))
            self._persistence.forget(released)
        outlook = Outlook.of(
            x, v, boxes, pairs, [one.speed(frame) > 0.0 for one in self._obstacles],
            pull=self._pull, time=time, span=span,
        )  # fmt: skip
        self._persistence.follow(x)
        self._kept[:] = not self.lateness.repeats and self._persistence.kept(old.planes, outlook)
        search, hold = self._search(
            now, outlook, pairs, old.depth, hold, frame, frame_begins=frame_begins
        )
        if not old.planes.any_planes and not search.planes.any_planes:
            self._gap, self._detected, self._x = search.gap, time, x[: len(self._X)]
            self._note_search(outlook, np.zeros(len(x)))
            return _Found(outlook=outlook, x=x, hold=hold)
        offset = self._rest_gaps.of_planes(self.planes)
        self._own.keep_unseen(search, self.planes, offset, old.depth, self._of)
        self._edges.keep_unseen(search, self.planes, old.depth)
        self._note_overlap(state)
        values = self._replace_planes(search, old, outlook)
        return _Found(outlook=outlook, x=search.x, hold=hold, values=values)

    @property
    def active(self) -> Ints:
        """Samples that the kernels process: those that may touch a plane, and what carries it."""
        return self.planes.only(self.watched).active if self.planes.any_planes else self.watched

    def _search(
        self, now: StateView, outlook: Outlook, pairs: Sequence[tuple[int, int]], depth: Floats,
        hold: float, frame: float, *, frame_begins: bool,
    ) -> tuple[ContactSearch, float]:  # fmt: skip
        """What samples face, and for how long [s] that is all.

        pairs, hold : of the broad phase; depth : (n + m,) [m] under the present planes; frame :
        where the obstacles are.
        """
        x, span, kept = outlook.x, outlook.span, self._kept
        of = self.planes.bodies(self._of)
        mine = kept[of] & (of >= 0)
        self._edges.begin(outlook.time - self._detected, self.planes, depth, mine)
        shrunk = CLOSER * (self._spacing + WAIT / TRAVEL * np.maximum(self._gap, 0.0))
        search = ContactSearch(x, self._reach, self._gap - shrunk)
        if kept.any():
            search.keep(np.flatnonzero(mine), self.planes, self._persistence.gaps(self.planes, x))
        searched: dict[int, list[int]] = {}
        for body, other in pairs:
            if not kept[body]:
                searched.setdefault(other, []).append(body)
        for other in sorted(k for k in searched if k < 0):
            bodies = searched.pop(other)
            self._pair_search.obstacle(
                search, bodies, -1 - other, now, self.planes, self._gap, frame, min(hold, span)
            )
        self._pair_search.bodies(search, searched, now, self.planes, self._gap)
        if self.contact.points:
            self._edges.offer(search)
            outlook.v[len(self._X) :] = self._edges.v
        own_hold = self._own.search(
            search, outlook, kept, self._x_before(x), min(hold, span), every_sample=frame_begins
        )
        search.carry(self._skins, self._X)
        return search, min(hold, own_hold)

    def note_way(self, now: StateView, time: float, dt: float) -> None:
        """Note whether a detection at a time [s] of the state is late, with substeps of dt [s]."""
        took = time - self._detected
        way = self.motion(now)[0] - self._x
        if np.isfinite(way).all():  # else the frame fails
            boxes = self._broad_phase.boxes(self._x, way / took)
            held = self._broad_phase.pairs(boxes, self._frame, 0.0)[1]
            self.lateness.note(self._detected, took, held, dt)
            if self._kept.any():
                x = self._x + way
                self._persistence.follow(x)
                approach = self._persistence.approaches(x)[self._kept].max()
                if approach > self._reach:
                    self.lateness.note(self._detected, took, took * self._reach / approach, dt)

    def _until_landed(self, x: Floats, v: Floats, floor: Ints | None) -> float:
        """[s] until the floor has stopped samples for long enough that others may reach them.

        floor : (k,) samples that may be stopped until then; None: all.
        """
        s = self._body.settings
        if s.floor is None:
            return float("inf")
        near = slice(len(self._X)) if floor is None else floor
        height = x[near] @ s.normal - floor_height(s)
        pull = abs(float(np.dot(s.gravity, s.normal))) + s.pushes
        return until_stopped(height, -(v[near] @ s.normal), pull, TRAVEL * self._spacing)

    def _note_search(self, outlook: Outlook, shift: Floats) -> None:
        """Note what bodies that are not kept were found to face; shift : see `Persistence.note`."""
        slide = TRAVEL * self._spacing + WAIT * np.maximum(self._gap, 0.0)
        self._persistence.note(
            np.flatnonzero(~self._kept), self.planes, self._gap, outlook,
            slide=slide, shift=shift, own_until=self._own.until,
        )  # fmt: skip

    def _replace_planes(
        self, search: ContactSearch, old: Stored, outlook: Outlook
    ) -> dict[str, Floats]:
        """Take the planes of a search in place of the old ones, with the energy of these.

        Returns the `pair_values` of the new ones.
        """
        x, time = outlook.x, outlook.time
        walls = [(c.spec.friction, c.spec.restitution) for c in self.contact_setup.colliders]
        values = pair_values(search.planes, self.contact, walls)
        true = Stored(
            planes=search.planes,
            depth=search.planes.depth(x, 0.0),
            stiffness=values["stiffness"],
            hardening=self._hardening,
            pair=self._pairs(search.planes),
        )
        new = continued(
            old, true, ease=EASE * self._spacing, budget=self._budget,
            elapsed=time - self._detected,
        )  # fmt: skip
        self.planes, self._k = new.planes, new.stiffness
        self.injected += new.energy - old.energy
        self._gap, self._detected, self._x = search.gap, time, x[: len(self._X)]
        self._deepen(-search.gap, search.planes)
        self._note_search(outlook, np.abs(true.depth - new.depth))
        lost = (old.depth > EASE * self._spacing) & (self.planes.partner == NOBODY)
        self.released = max(self.released, search.released + self._edges.left_out, int(lost.sum()))
        return values

    @property
    def _pull(self) -> float:
        """[m/s^2] bound of the acceleration by gravity and fields."""
        s = self._body.settings
        return float(np.linalg.norm(s.gravity)) + s.pushes

    def _upload(
        self,
        state: State,
        now: StateView,
        values: Mapping[str, Floats],
        dt: float,
        f: ContactPlanes,
    ) -> None:
        origin = now.offset + self._samples.origin
        X, drift = self._samples.without_nodes(now, dt)
        X, drift = self._edges.with_points(X, drift, dt, origin)
        layout.upload(state, f, values, self._hardening, X=X, drift=drift, origin=origin, dt=dt)

    def follow(self, state: State, dt: float, closed: bool) -> bool:
        """Read the planes back after substeps of dt [s]; closed : these ended a frame.

        Returns False if positions or velocities are not finite.
        """
        now = state.view()
        if now.not_finite()[1]:
            return False  # the next detection would miss contacts of this body
        if not self.planes.any_planes:
            return True
        x, v = self._joined(now, self._detected + self._span)
        f = self.planes
        who = self.watched[f.partner[self.watched] >= 0]
        normal, point = f.normal.copy(), f.point.copy()
        places = state.part("pair", layout.ROW, layout.POINT, layout.VELOCITY)
        point[who], normal[who] = places[who, :3], places[who, 3:]
        spring = state.part("pair", layout.ROW, layout.SPRING, layout.WEIGHT)
        # By what the bodies moved since their last forces.
        new = moved(
            replace(f, normal=normal, point=point, spring=spring),
            x,
            v,
            0.5 * dt if closed else dt,
        )
        others = np.setdiff1d(f.on_bodies, who, assume_unique=True)
        new.normal[others], new.point[others] = f.turned(others, self._x, x)
        self.planes = new
        missed = new.depth(x, self._span) > 0.0
        missed[self.watched] = False
        if missed.any():
            self.lateness.note(self._detected, self._span, 0.5 * self._span, dt)
        return True
