"""The active set of floor contact: the samples that may reach the floor before the next frame."""

from __future__ import annotations

from typing import Any
from weakref import ref

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.physics.contact.floor import DRIFT, GIVEN_ROW, HEIGHT, WORK, move_springs
from gf_usd.physics.total_lagrangian.limits import CLEARANCE, FALL
from gf_usd.physics.total_lagrangian.setup.body import Body
from gf_usd.physics.total_lagrangian.setup.contact import floor_height
from gf_usd.physics.total_lagrangian.state import State, StateView

SURPLUS = 1.25  # ratio of evaluated to needed samples at which the set is rebuilt


class ActiveSamples:
    """The contact samples that the kernels of a body evaluate."""

    def __init__(self, body: Body) -> None:
        self._body = body
        self._active: tuple[Ints, Ints] | None = None  # the set on the device
        self._height = np.zeros(0)  # [m] of the samples above the floor, without u and the offset
        self._seen: tuple[ref[StateView], Floats, float] | None = None  # `_above_floor` of a view
        self._drift = 0.0  # [m/s] largest velocity toward the floor prescribed by pins
        self._fall = 0.0  # [m/s] bound of the falling speed
        self._held: tuple[Ints, Any] = np.zeros(0, np.int64), None  # samples, rows of W: by springs
        self.pushed = 0.0  # [m/s] bound of the speed gained from a flow

    def near_floor(self, state: State, *, everywhere: bool = False) -> Ints:
        """The samples within reach of the floor; resets the results of all samples.

        everywhere : all samples, where the impulses on them within the frame are not known.
        """
        body, contact = self._body, self._body.contact
        if contact is None:
            return np.zeros(0, np.int64)
        now, normal, span = state.view(), body.settings.normal, body.settings.frame_time
        self._height = contact.rows.X @ normal - floor_height(body.settings)
        self._seen = None
        if contact.constants is not None:
            c, rate = now.constants
            self._height += contact.constants @ ((c + 0.5 * span * rate) @ normal)
            self._drift = float(np.abs(contact.constants @ (rate @ normal)).max(initial=0.0))
        state.clear("sample_force", "sample_depth", "sample_capped")
        if everywhere and body.settings.floor is not None:
            return np.arange(len(self._height))
        return self._within(state, span)

    def nearer(self, state: State, near: Ints, span: float) -> Ints:
        """Those of the samples `near` that may reach the floor within a span [s] from now."""
        if not len(near) or self._body.contact is None or self._body.contact.constants is not None:
            return near  # the motion of pins is set for the whole frame
        return np.intersect1d(near, self._within(state, span), assume_unique=True)

    def _within(self, state: State, span: float) -> Ints:
        """Samples that may reach the floor within a span [s]."""
        body, normal = self._body, self._body.settings.normal
        height, fastest = self._above_floor(state)
        speed = fastest + self._drift + self.pushed
        g = abs(float(np.dot(body.settings.gravity, normal))) + body.settings.pushes
        self._fall = 2.0 * (speed + g * span)
        reach = span * self._fall + body.particles.spacing
        return np.flatnonzero(height < reach)

    def _above_floor(self, state: State) -> tuple[Floats, float]:
        """Heights (n,) [m] of the samples, and the largest vertical speed [m/s] of the nodes."""
        body, now = self._body, state.view()
        if self._seen is None or self._seen[0]() is not now:
            normal = body.settings.normal
            height = float(state.offset @ normal) + now.rise
            self._seen = ref(now), self._height + height, float(np.abs(now.v @ normal).max())
        return self._seen[1:]

    def move_springs(self, state: State, time: float) -> None:
        """See `floor.move_springs`."""
        body, contact = self._body, self._body.contact
        if contact is None or body.settings.floor is None:
            return

        def velocity(samples: Ints) -> Floats:
            now = state.view()
            if not np.array_equal(self._held[0], samples):
                self._held = samples, contact.rows.W[samples]
            v = self._held[1] @ now.v
            return (
                v
                if contact.constants is None
                else v + contact.constants[samples] @ now.constants[1]
            )

        move_springs(state, velocity, body.settings.normal, time)

    def select(self, state: State, near: Ints, paired: Ints, dt: float) -> int:
        """Restrict the kernels to these samples; returns their number.

        near, paired : (k,) ascending, those that the floor may reach and those of contact pairs,
        with a body or an obstacle. Nodal sums are W^T of these only; the others have no force.
        dt : [s] of the following substeps.
        """
        if self._body.contact is None:
            return 0
        state.clear("sample_force")
        numbers = state.get("numbers")[: CLEARANCE + 1]
        numbers[FALL], numbers[CLEARANCE] = self._fall, self._body.particles.spacing
        state.put_padded("numbers", numbers)  # every slack is 0: all samples are tested at first
        if self._body.options.driven and self._body.settings.floor is not None:
            self._drive(state, dt)
        samples = np.union1d(near, paired) if len(paired) else near
        if self._serves(samples, paired):
            assert self._active is not None
            return len(self._active[0])
        if self._active is None or not _same(self._active, (samples, paired)):
            self._active = samples, paired
            held, weight, start = self._of_nodes(samples)
            others = np.setdiff1d(samples, paired, assume_unique=True) if len(paired) else samples
            state.put_first("sample_active", np.concatenate([[len(paired)], paired, others]))
            state.put_first("node_sample", held)
            state.put_first("node_sample_weight", weight)
            state.put("node_sample_start", start)
        return len(samples)

    def _of_nodes(self, samples: Ints) -> tuple[Ints, Floats, Ints]:
        """Those of the samples that each node moves, ascending, their weights, and the ranges of
        the nodes.
        """
        assert self._body.contact is not None
        by_node = self._body.contact.nodes[samples].tocsc()  # sorted by counting
        return samples[by_node.indices], by_node.data, by_node.indptr

    def _serves(self, samples: Ints, paired: Ints) -> bool:
        """Whether the set on the device contains these samples, and few others, which have no
        contact.

        A sample without contact contributes 0 to a nodal force; a few of them cost less than a new
        set.
        """
        if self._active is None or not np.array_equal(self._active[1], paired):
            return False
        held = self._active[0]
        few = 0 < len(samples) <= len(held) <= SURPLUS * len(samples)
        return few and bool(np.isin(samples, held, assume_unique=True).all())

    def _drive(self, state: State, dt: float) -> None:
        """Set the positions that pins give the samples in the middle of the first substep."""
        body, contact, normal = self._body, self._body.contact, self._body.settings.normal
        assert contact is not None
        assert contact.driven is not None
        c, rate = state.view().constants
        height = contact.rows.X @ normal - floor_height(body.settings)
        height += contact.driven @ ((c + 0.5 * dt * rate) @ normal)
        given = state.rows("sample_given", GIVEN_ROW)
        given[: len(height), HEIGHT] = height
        given[: len(height), DRIFT:WORK] = contact.driven @ rate
        state.put("sample_given", given)


def _same(a: tuple[Ints, Ints], b: tuple[Ints, Ints]) -> bool:
    return all(np.array_equal(x, y) for x, y in zip(a, b))
