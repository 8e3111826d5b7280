"""Bodies that meet each other and obstacles: when to look, and what a look changes.

A look costs about as much as ten substeps, so it is done only when it has to be: a pair whose boxes
are apart is left alone until they could have come together.  What the planes of a new look store
in their springs more than the old ones is energy that nobody's motion paid for: a new plane is
moved back until that is little, and the rest is counted.  The overlap reported is the true one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.neighbors import kd_tree
from gf_usd.core.stage import Encounters
from gf_usd.physics import taichi_arrays
from gf_usd.physics.contact import narrow_phase
from gf_usd.physics.contact.broad_phase import Box, schedule
from gf_usd.physics.contact.floor import FloorContact, damping_coefficient
from gf_usd.physics.contact.narrow_phase import (
    ARRAYS,
    CLOSER,
    EASE,
    FACING,
    LOOK,
    STIFFER,
    BodySkin,
    Faced,
    Looking,
    eased,
    facing_itself,
    nothing,
    obstacles,
)
from gf_usd.physics.contact.narrow_phase import pair_values as values_of
from gf_usd.physics.grid.embedding import deform_normals
from gf_usd.physics.total_lagrangian.state import constants, node_motion

if TYPE_CHECKING:
    from gf_usd.physics.total_lagrangian.solver import TotalLagrangian


# Springs between bodies, over the floor's: each side faces the other, and two bodies that come at
# each other strain them twice as fast as one that comes at a wall does.
COVER = 1.5  # [spacings] from any place of a surface, strained, to its nearest sample
CROWD = 4.0 * STIFFER


class Meeting:
    """The encounters of a solver's bodies.

    encounters : who meets whom; contact : the samples that feel it, as for the floor.
    """

    def __init__(
        self, encounters: Encounters, contact: FloorContact, solver: TotalLagrangian
    ) -> None:
        self.encounters, self.contact = encounters, contact
        samples = contact.samples
        self._normal = samples.normal
        self._X = samples.X
        body = np.zeros(len(samples.X), np.int64) if samples.body is None else samples.body
        self._members = [np.flatnonzero(body == k) for k in range(len(encounters.skins))]
        self._spacing = solver.particles.spacing
        self._obstacles = obstacles(encounters.colliders, solver.frame_time)
        self._skins = [
            BodySkin(skin, solver.stencil.rows(skin.points, np.full(len(skin.points), k)), m,
                     samples.X[m])
            for k, (skin, m) in enumerate(zip(encounters.skins, self._members))
        ]  # fmt: skip
        self.faced = nothing(len(samples.X))
        self._looked = 0.0  # [s] of the solver's time at the last look
        self._k = contact.stiffness
        self.injected = 0.0  # [J] since `begin`
        self.let_go = 0  # most samples at once, since `begin`
        self._overlap = 0.0  # [m] deepest at a look since `begin`
        # [m] of the last look; what overlaps at the first one may be as deep as it is.
        self._gap = np.full(len(samples.X), -np.inf)

    def arrays(self) -> dict[str, Floats]:
        """The part of the kernels' pack."""
        return narrow_phase.pack_arrays(len(self._X))

    def save(self) -> dict[str, Any]:
        """What `restore` wants."""
        return {
            **{f"facing_{name}": getattr(self.faced, name) for name in ARRAYS},
            "facing_since": self._looked,
            "facing_gap": self._gap,
            "facing_stiffness": self._k,
        }

    def restore(self, saved: dict[str, Any]) -> None:
        """Go back to what `save` returned."""
        self.faced = Faced(**{name: np.asarray(saved[f"facing_{name}"]) for name in ARRAYS})
        self._looked = float(saved["facing_since"])
        self._gap = np.asarray(saved["facing_gap"])
        self._k = np.asarray(saved["facing_stiffness"])

    def begin(self, solver: TotalLagrangian) -> None:
        """Count from zero."""
        self.injected, self.let_go, self._overlap = 0.0, 0, 0.0
        pair = taichi_arrays.values(solver.arrays["pair"]).reshape(-1, narrow_phase.ROW)
        pair[:, narrow_phase.DEPTH] = pair[:, narrow_phase.WORK] = 0.0
        taichi_arrays.put(solver.arrays["pair"], pair.ravel())

    def energy(self, x: Floats, time: float) -> float:
        """[J] in the springs of the last look's planes; x (n, 3) [m]."""
        return self._stored(self.faced.depth(x, time - self._looked))

    def _stored(self, depth: Floats) -> float:
        return float(0.5 * self._k @ depth**2)

    def imminent(self, solver: TotalLagrangian, still: Ints | None = None) -> bool:
        """Whether anything may touch before the next frame; bodies `still` (B,) do not move."""
        span = solver.frame_time
        near, hold = self._schedule(solver, *self.motion(solver), solver.time / span, span, still)
        return bool(near) or hold < span

    def pass_by(self, flying: Ints, time: float) -> None:
        """A frame has passed, up to `time` [s], in which flying bodies (B,) had nothing near."""
        for k in np.flatnonzero(flying):
            self._gap[self._members[k]] = (FACING + LOOK) * self._spacing
            self.faced.forget(self._members[k])
        self._looked = time

    def passage(self, solver: TotalLagrangian) -> tuple[float, float, float]:
        """Work of the obstacles [J], energy given by looks [J] and deepest overlap [m]."""
        pair = (
            taichi_arrays.values(solver.arrays["pair"]).astype(float).reshape(-1, narrow_phase.ROW)
        )
        deepest = max(self._overlap, float(pair[:, narrow_phase.DEPTH].max()))
        return float(pair[:, narrow_phase.WORK].sum()), self.injected, deepest

    def motion(self, solver: TotalLagrangian) -> tuple[Floats, Floats]:
        """x [m] and v [m/s] of the samples, (n, 3)."""
        u, v = solver.state()
        x, rate = self._X + solver.offset + self.contact.rows.W @ u, self.contact.rows.W @ v
        if self.contact.constants is not None:
            c, c_rate = constants(solver)
            x, rate = x + self.contact.constants @ c, rate + self.contact.constants @ c_rate
        return x, rate

    def look(self, solver: TotalLagrangian, index: int, dt: float, done: int, left: int) -> int:
        """Set the planes for the next substeps, and say how many they hold for, at most `left`.

        index : the frame that is marched to; done : substeps of dt [s] since the frame before it.
        """
        elapsed = done * dt
        frame = index - 1 + elapsed / solver.frame_time
        time = solver.time + elapsed
        x, v = self.motion(solver)
        meet, hold = self._schedule(solver, x, v, frame, left * dt)
        old = self.faced.depth(x, time - self._looked)
        before = self._stored(old)
        nodes = node_motion(solver)[0]
        seen = Looking(x, (FACING + LOOK) * self._spacing, self._gap - CLOSER * self._spacing)
        for other in sorted({other for _, other in meet}):
            near = [mine for mine, faced in meet if faced == other]
            if other < 0:
                self._face_obstacle(seen, near, -1 - other, frame, min(hold, left * dt))
                continue
            if other in near:
                self._face_itself(seen, other, nodes)
                near.remove(other)
            if near:
                self._face_body(seen, near, other, nodes, solver.offset)
        deeper = seen.faced.depth(x, 0.0) - old
        deeper[np.isinf(self._gap)] = 0.0
        self.faced = eased(seen.faced, np.maximum(0.0, deeper - EASE * self._spacing))
        self._gap, self._looked = seen.gap, time
        self._overlap = max(self._overlap, -float(seen.gap.min()))
        self.let_go = max(self.let_go, seen.let_go)
        hold = min(hold, LOOK * self._spacing / max(self._sliding(v), 1e-30))
        values = values_of(
            self.faced, self.contact.stiffness, self.contact.mass, self.contact.friction,
            self.contact.restitution,
            [(c.words.friction, c.words.restitution) for c in self.encounters.colliders],
        )  # fmt: skip
        self._k = values["stiffness"]
        self.injected += self.energy(x, time) - before
        self._upload(solver, values, dt)
        return int(np.clip(hold / dt, 1, left))

    def _sliding(self, v: Floats) -> float:
        """[m/s] the fastest of the samples against what they face."""
        f = self.faced
        theirs = np.where((f.partner >= 0)[:, None], v[np.maximum(f.partner, 0)], f.velocity)
        speed = np.linalg.norm(v - theirs, axis=1)[f.partner != narrow_phase.NOBODY]
        return float(speed.max(initial=0.0))

    def _schedule(
        self, solver: TotalLagrangian, x: Floats, v: Floats, frame: float, span: float,
        still: Ints | None = None,
    ) -> tuple[list[tuple[int, int]], float]:  # fmt: skip
        fall = float(np.linalg.norm(solver.settings.gravity)) * span
        return schedule(
            [Box.around(x[m], v[m]) for m in self._members],
            self._obstacles,
            self.encounters,
            frame=frame,
            fall=fall,
            reach=(FACING + LOOK) * self._spacing,
            spacing=self._spacing,
            still=still,
        )

    def _candidates(self, seen: Looking, near: Sequence[int], theirs: Floats) -> Ints:
        """Samples of bodies `near` so close to `theirs` that they may reach that body's surface."""
        low, high = theirs.min(0) - seen.reach, theirs.max(0) + seen.reach
        members = np.concatenate([self._members[k] for k in near])
        x = seen.x[members]
        boxed = members[((x >= low) & (x <= high)).all(1)]
        if len(boxed) == 0:
            return boxed
        far = seen.reach + COVER * self._spacing
        gap = kd_tree(theirs).query(seen.x[boxed], distance_upper_bound=far)[0]
        return boxed[np.isfinite(gap)]

    def _face_body(
        self, seen: Looking, near: Sequence[int], other: int, nodes: Floats, offset: Floats
    ) -> None:
        """All bodies `near` another at once: its surface is made ready only once a look."""
        theirs = seen.x[self._members[other]]
        rows = self._candidates(seen, near, theirs)
        if len(rows) == 0:
            return
        # What was inside at the last look is there still; what begins to be may be at a fold.
        gap = self._gap[rows]
        known = np.where(gap < 0.0, gap - EASE * self._spacing, 0.0)
        found, carrier = self._skins[other].near(
            seen.x[rows], known, theirs, nodes, offset, seen.reach
        )
        seen.plane(rows[found.rows], found.gap, found.normal, found.point, carrier)

    def _face_itself(self, seen: Looking, body: int, nodes: Floats) -> None:
        members = self._members[body]
        G = self.contact.rows.G
        u = nodes[: G[0].shape[1]]
        F = np.eye(3) + np.stack([g[members] @ u for g in G], -1)
        normal = np.zeros_like(seen.x)
        normal[members] = deform_normals(self._normal[members], np.arange(len(members)), F)
        a, b = facing_itself(seen.x, normal, self._X, members, seen.reach, self._spacing)
        gap = np.einsum("na,na->n", seen.x[a] - seen.x[b], normal[b])
        seen.plane(a, gap, normal[b], seen.x[b], b)

    def _face_obstacle(
        self, seen: Looking, near: Sequence[int], which: int, frame: float, span: float
    ) -> None:
        rows = np.concatenate([self._members[k] for k in near])
        plane = self._obstacles[which].planes(seen.x[rows], seen.reach, frame, span)
        found = plane.seen
        seen.plane(
            rows[found.rows], found.gap, found.normal, found.point, None, plane.velocity, which,
        )  # fmt: skip

    def _upload(self, solver: TotalLagrangian, values: dict[str, Floats], dt: float) -> None:
        f, contact = self.faced, self.contact
        pair = (
            taichi_arrays.values(solver.arrays["pair"]).astype(float).reshape(-1, narrow_phase.ROW)
        )
        pair[:, narrow_phase.REST : narrow_phase.RATE] = 0.0
        pair[:, narrow_phase.REST : narrow_phase.DRIFT] = self._X
        if contact.constants is not None:
            c, rate = constants(solver)
            pair[:, narrow_phase.REST : narrow_phase.DRIFT] += contact.constants @ (
                c + 0.5 * dt * rate
            )
            pair[:, narrow_phase.DRIFT : narrow_phase.PLACE] = contact.constants @ rate
        # The forces of a substep are those half of it later.
        point = f.point + 0.5 * dt * f.velocity
        point[f.partner == narrow_phase.OBSTACLE] -= solver.offset
        pair[:, narrow_phase.FORCE : narrow_phase.POINT] = 0.0
        pair[:, narrow_phase.POINT : narrow_phase.STIFFNESS] = np.hstack(
            [point, f.normal, f.velocity]
        )
        damping = damping_coefficient(values["stiffness"], values["mass"], values["restitution"])
        pair[:, narrow_phase.STIFFNESS : narrow_phase.DEPTH] = np.stack(
            [values["stiffness"], damping, values["friction"], values["mass"]], 1
        )
        start, order = f.lists()
        links = np.full((len(start), narrow_phase.LINKS), narrow_phase.NOBODY)
        links[:-1, narrow_phase.PARTNER], links[:, narrow_phase.START] = f.partner, start
        links[: len(order), narrow_phase.PAIR_FACING] = order
        taichi_arrays.put(solver.arrays["pair"], pair.astype(solver.real).ravel())
        taichi_arrays.put(solver.arrays["links"], links.astype(np.int32).ravel())
