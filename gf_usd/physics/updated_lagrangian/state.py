"""The state of the Updated Lagrangian solver: particles, and the arrays of the grid."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.units import length_text
from gf_usd.physics import taichi_arrays
from gf_usd.physics.contact.floor import move_springs, spring_energy
from gf_usd.physics.frame_loop import first_not_finite
from gf_usd.physics.laws.registry import GRADIENT, take_dissipated
from gf_usd.physics.taichi_arrays import DeviceState
from gf_usd.physics.total_lagrangian.setup.contact import floor_height
from gf_usd.physics.updated_lagrangian.setup import Body, arrays, grid_arrays
from gf_usd.physics.updated_lagrangian.walls import NOWHERE, Planes

LARGEST_GRID = 1 << 25  # nodes: 5 GB
PARTICLES = ("x", "v", "C", "F", "L")
FAULT = 4  # of `grid`: see `kernels.sorting`
OVERFLOW = 2
FEW = 64  # empty cells that are kept in addition to half the number of filled ones
SPARE = 1.75  # capacity of the arrays relative to the cells and nodes in use


class State(DeviceState):
    """x (without the offset), v, C, F and L of the particles, and their history."""

    def __init__(self, body: Body) -> None:
        import taichi as ti

        lift = np.asarray(body.settings.lift, float)
        saved = (*PARTICLES, "sample_spring")
        saved = (*saved, "history") if body.law.set.flows else saved
        super().__init__(arrays(body), body.real, saved, lift + body.center)
        self._body = body
        self._start = self.offset.copy()
        self.wall_impulse = np.zeros(3)  # [N s] total impulse of walls on particles
        self._single = body.embedding is not None and body.embedding.single
        self.node_capacity = self.cell_capacity = 0
        self._most_nodes = max(LARGEST_GRID, 64 * self._occupied()[1])
        self.extend_grid()
        # one value per particle, written by kernels
        self.value = ti.ndarray(ti.f64 if body.real is np.float64 else ti.f32, len(body.m))

    def _occupied(self) -> tuple[int, int]:
        """Number of cells that contain particles now, and of their nodes."""
        base = np.floor(self.rows("x") / self._body.h - self._body.phase - 0.5).astype(np.int64)
        key = np.array([1 << 42, 1 << 21, 1])  # indices are below 2^20
        nodes = cells = np.unique(base @ key)
        for step in key:
            nodes = np.unique(np.concatenate([nodes, nodes + step, nodes + 2 * step]))
        return len(cells), len(nodes)

    def extend_grid(self) -> bool:
        """Allocate arrays for more cells than are in use; False where these would be too large."""
        cells, nodes = (int(SPARE * n) for n in self._occupied())
        nodes = 1 << (nodes + 27 * 2 * FEW).bit_length()
        cells += 2 * FEW
        if nodes <= self.node_capacity and cells <= self.cell_capacity:
            nodes, cells = 2 * self.node_capacity, 2 * self.cell_capacity
        if nodes > self._most_nodes:
            return False
        self.node_capacity = max(nodes, self.node_capacity)
        self.cell_capacity = max(cells, self.cell_capacity)
        walled = self._body.walls is not None
        grid = grid_arrays(self.node_capacity, self.cell_capacity, walled)
        self.arrays |= taichi_arrays.to_device(grid, self.real)
        self.pack = self._body.pack_type(**self.arrays)
        return True

    @property
    def grid_overflowed(self) -> bool:
        """Whether the last launch ended because the grid's arrays were too small."""
        return self.get("grid")[FAULT] == OVERFLOW

    def not_finite(self) -> tuple[int, str]:
        """See `Solver`."""
        for name in (*PARTICLES, "history") if self._body.law.set.flows else PARTICLES:
            bad = first_not_finite(self.get(name).reshape(len(self._body.m), -1))
            if bad >= 0:
                X = self._body.particles.X[bad].round(4).tolist()
                return bad, f"{name} of particle {bad} at rest position {X} m is no longer finite"
        if not self.get("grid")[FAULT]:
            return -1, ""
        x = self.rows("x")
        far = np.linalg.norm(x - np.median(x, axis=0), axis=1)
        return int(far.argmax()), (
            f"the particles occupy more than {self._most_nodes:.3g} nodes of the grid, or are"
            f" more than a million cells apart: one is {length_text(far.max())} away from the"
            " others"
        )

    @property
    def planes(self) -> Planes:
        """The walls relative to the moving frame."""
        if self._body.walls is None:
            nowhere = np.full(3, NOWHERE)
            return Planes(first=-nowhere, last=nowhere, stuck=0 * nowhere)
        cells = np.round((self.offset - self._start) / self._body.h).astype(np.int64)
        return self._body.walls.moved(cells)

    def take_wall_impulse(self) -> None:
        """Add the impulse of the walls in a frame."""
        if self._body.walls is not None:
            self.wall_impulse = self.wall_impulse + self.rows("wall_impulse").sum(0)

    def save(self) -> dict[str, Any]:
        """See `DeviceState`."""
        return {**super().save(), "wall_impulse_sum": self.wall_impulse.copy()}

    def load(self, saved: Mapping[str, Any]) -> None:
        """See `DeviceState`."""
        super().load(saved)
        self.wall_impulse = np.asarray(saved["wall_impulse_sum"], float).copy()

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
        """x without the offset, v (N, 3), F and L (N, 3, 3), as float64."""
        F, L = (self.rows(name, 9).reshape(-1, 3, 3) for name in "FL")
        return self.rows("x"), self.rows("v"), F, L

    @property
    def elastic(self) -> Floats:
        """(N, 3, 3) the gradients from which the stress is computed, float64."""
        laws = self._body.law.set
        if not laws.flows:
            return self.rows("F", 9).reshape(-1, 3, 3)
        return self.rows("history", laws.history)[:, :GRADIENT].reshape(-1, 3, 3)

    def take_dissipated(self) -> float | None:
        """[J] dissipated by plastic flow since the last call; None without plastic flow."""
        laws = self._body.law.set
        return take_dissipated(laws, self.arrays["history"]) if laws.flows else None

    def near_floor(self, lift: float) -> Ints:
        """The samples that the floor may reach in a frame; resets the samples' depth and friction
        counts.

        lift : [m] height of the moving frame above the floor.
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
        """List the samples for which kernels compute contact: near the floor, and (k,) of planes;
        their count.

        Both ascending; plane k is that of the k-th of `planes`.
        """
        active = near
        if self._body.pair_contact:
            active = np.union1d(near, planes)
            self.clear("sample_force")
            of = np.full(len(self._body.contact.mass) if self._body.contact else 1, -1)
            of[planes] = np.arange(len(planes))
            self.put("sample_plane", of)
        if self._body.embedding is not None:
            self.put_padded("sample_active", active)
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
