"""The state of the Updated Lagrangian solver: particles, and memory for the grid around them."""

from __future__ import annotations

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.physics import taichi_arrays
from gf_usd.physics.contact.floor import move_springs, spring_energy
from gf_usd.physics.frame_loop import first_bad
from gf_usd.physics.laws.registry import GRADIENT, take_dissipated
from gf_usd.physics.taichi_arrays import DeviceState
from gf_usd.physics.total_lagrangian.setup import floor_height
from gf_usd.physics.updated_lagrangian.setup import Body, arrays, grid_arrays

LARGEST_BOX = 1 << 23  # nodes, or eight times the box at rest where that is more
PARTICLES = ("x", "v", "C", "F", "L")
FAULT = 8  # of `box`: see `sort_kernels`
OVERFLOW = 2


class State(DeviceState):
    """x (without the offset), v, C, F and L of the particles, and their history."""

    def __init__(self, body: Body) -> None:
        import taichi as ti

        lift = np.asarray(body.settings.lift, float)
        saved = (*PARTICLES, "sample_spring")
        saved = (*saved, "history") if body.law.set.flows else saved
        super().__init__(arrays(body), body.real, saved, lift + body.center)
        self._body = body
        self._single = body.embedding is not None and body.embedding.single
        self._most_nodes = max(LARGEST_BOX, 8 * self._box_nodes())
        self.node_capacity = self.cell_capacity = 0
        self.make_room()
        # a number of each particle, that kernels write
        self.value = ti.ndarray(ti.f64 if body.real is np.float64 else ti.f32, len(body.m))

    def _box_nodes(self) -> float:
        """Nodes of the box around the particles now, at twice its cells."""
        cells = self.rows("x") / self._body.h
        return float(np.prod(np.ptp(cells, axis=0) + 4.0))

    def make_room(self) -> bool:
        """Arrays for twice the box that the body fills now; False where that is too large."""
        nodes = self._box_nodes()
        if not nodes <= self._most_nodes:
            return False
        self.node_capacity = max(2 * int(nodes), 2 * self.node_capacity)
        self.cell_capacity = min(len(self._body.particles), self.node_capacity)
        grid = grid_arrays(self.node_capacity, self.cell_capacity)
        self.arrays |= taichi_arrays.to_device(grid, self.real)
        self.pack = self._body.pack_type(**self.arrays)
        return True

    @property
    def lacks_room(self) -> bool:
        """Whether the last launch ended because the grid was too small."""
        return self.get("box")[FAULT] == OVERFLOW

    def not_finite(self) -> tuple[int, str]:
        """See `Solver`."""
        for name in (*PARTICLES, "history") if self._body.law.set.flows else PARTICLES:
            bad = first_bad(self.get(name).reshape(len(self._body.m), -1))
            if bad >= 0:
                X = self._body.particles.X[bad].round(4).tolist()
                return bad, f"{name} of particle {bad} at rest position {X} m is no longer finite"
        if not self.get("box")[FAULT]:
            return -1, ""
        x = self.rows("x")
        far = np.linalg.norm(x - np.median(x, axis=0), axis=1)
        return int(far.argmax()), (
            f"the body no longer fits a grid of {self._most_nodes:.3g} nodes: a particle is"
            f" {far.max():.4g} m from the others"
        )

    def recenter(self) -> None:
        """Move whole cells of the mean position from x to the offset."""
        x, m, h = self.rows("x"), self._body.m, self._body.h
        if not np.isfinite(x).all():
            return
        shift = h * np.round(m @ x / m.sum() / h)
        if shift.any():
            self.offset = self.offset + shift
            self.put("x", x - shift)

    def motion(self) -> tuple[Floats, Floats, Floats, Floats]:
        """x without the offset, v (N, 3), F and L (N, 3, 3), float64."""
        F, L = (self.rows(name, 9).reshape(-1, 3, 3) for name in "FL")
        return self.rows("x"), self.rows("v"), F, L

    @property
    def elastic(self) -> Floats:
        """(N, 3, 3) the gradients that the stress is taken of, float64."""
        laws = self._body.law.set
        if not laws.flows:
            return self.rows("F", 9).reshape(-1, 3, 3)
        return self.rows("history", laws.history)[:, :GRADIENT].reshape(-1, 3, 3)

    def take_dissipated(self) -> float | None:
        """[J] that flow dissipated since this was last asked; None where no law flows."""
        laws = self._body.law.set
        return take_dissipated(laws, self.arrays["history"]) if laws.flows else None

    def near_floor(self, lift: float) -> Ints:
        """The samples that may meet the floor in a frame; clears what samples noticed.

        lift : [m] of the moving frame of x above the floor.
        """
        s = self._body.settings
        if self._body.embedding is None:
            return np.zeros(0, np.int64)
        x, v = self.sample_motion()
        span = s.frame_time
        speed = float(np.abs(v @ s.normal).max())
        g = abs(float(np.dot(s.gravity, s.normal)))
        reach = 2.0 * span * (speed + g * span) + self._body.particles.spacing
        near = np.flatnonzero(lift + x @ s.normal < reach)
        self.clear("sample_force", "sample_depth", "sample_capped")
        return near

    def watch(self, near: Ints, planes: Ints) -> int:
        """List the samples that kernels ask: near the floor, and (k,) of planes; how many.

        Both ascending; plane k is that of the k-th of `planes`.
        """
        active = near
        if self._body.meets:
            active = np.union1d(near, planes)
            self.clear("sample_force")
            of = np.full(len(self._body.contact.mass) if self._body.contact else 1, -1)
            of[planes] = np.arange(len(planes))
            self.put("sample_plane", of)
        if self._body.embedding is not None:
            self.put_first("sample_active", active)
        return len(active)

    def sample_motion(self) -> tuple[Floats, Floats]:
        """x without the offset [m] and v [m/s] of the contact samples, (n, 3)."""
        embedding = self._body.embedding
        assert embedding is not None
        if self._single:
            at = embedding.particle[:, 0]
            return self.rows("x")[at], self.rows("v")[at]
        pose = embedding.pose(*self.motion())
        return pose.x, pose.v

    def move_springs(self, time: float) -> None:
        """See `floor.move_springs`."""
        if self._body.embedding is not None and time:
            move_springs(
                self, lambda held: self.sample_motion()[1][held], self._body.settings.normal, time
            )

    def contact_energy(self) -> float:
        """[J] stored in the floor's springs: see `floor`, and k_t xi^2 / 2 of friction."""
        s, embedding, contact = self._body.settings, self._body.embedding, self._body.contact
        if embedding is None or contact is None:
            return 0.0
        x = self.sample_motion()[0] + self.offset
        height = x @ s.normal - floor_height(s)
        held = spring_energy(contact.tangential, self.rows("sample_spring"))
        return held + contact.normal_energy(np.maximum(0.0, -height))
