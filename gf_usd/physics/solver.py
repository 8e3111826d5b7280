"""Total Lagrangian APIC: the production solver.

The state is a displacement u and a velocity v on the nodes of a grid that never moves
(physics.md section 1).  Everything that rides on the body, particles included, is read off them:
x = X + offset + W u, F = I + G u.  `offset` is a rigid translation taken out of u once a frame, so
that a long fall costs the strain no digits.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from gf_usd.errors import BakeError
from gf_usd.materials import G0
from gf_usd.model import (
    Floats,
    Frame,
    Health,
    Material,
    Particles,
    Pose,
    Settings,
    SurfaceSamples,
)  # fmt: skip
from gf_usd.physics import setup
from gf_usd.physics.body import batch_particles
from gf_usd.physics.embedding import pose
from gf_usd.physics.guard import RETRIES, Guard
from gf_usd.physics.health import measure
from gf_usd.physics.stencil import FREE_MASS, build_stencil

CELL_PER_LATTICE = 2.0  # h over the lattice's edge: eight strata, so eight particles, a full cell
SERIAL_BELOW = 12_000  # particles; smaller bodies run a whole frame in one launch
FILTER_STEP = 0.2  # the filter acts once r dt has added up to this


class TotalLagrangian:
    """One asset in motion.

    Parameters
    ----------
    particles, materials, settings : see `model`; every material must have the same law.
    samples : surface points that feel the floor; None or no floor: no contact.
    riders : named points (n, 3) [m] that ride along; their poses come with every frame.
    velocity : (3,) [m/s] or a callable X (n, 3) -> (n, 3) [m/s]: the motion at the start.
    real : numpy dtype of the kernels.
    """

    def __init__(
        self,
        particles: Particles,
        materials: Sequence[Material],
        settings: Settings,
        *,
        samples: SurfaceSamples | None = None,
        riders: Mapping[str, Floats] | None = None,
        velocity: Any = (0.0, 0.0, 0.0),
        h: float | None = None,
        real: type = np.float32,
    ) -> None:
        from gf_usd.runtime import init_taichi

        init_taichi(settings.device, settings.threads, f64=real is np.float64)
        self.particles, self.settings, self.real = particles, settings, real
        per = setup.per_particle(particles, materials)
        self.m = per["density"] * particles.V0
        self.h = h or settings.cell or CELL_PER_LATTICE * particles.lattice
        self.stencil = build_stencil(
            particles.X,
            self.m,
            self.h,
            particles.corner,
            free_mass=FREE_MASS if settings.followers else 0.0,
        )
        self.rows = self.stencil.rows(particles.X)
        self.riders = {name: self.stencil.rows(X) for name, X in (riders or {}).items()}
        self.up = np.asarray(settings.up, float)
        self.offset = np.asarray(settings.lift, float)
        self.contact = setup.floor_contact(samples, particles, self.stencil, settings, per)
        self.step = setup.largest_step(particles, self.h, self.contact, settings, per)
        self.coarse = settings.substeps or max(1, int(np.ceil(self.frame_time / self.step.dt)))
        self.guard = Guard(float(self.m.sum()) * G0 * particles.radius)
        self.time = 0.0
        self.done = 0  # substeps since the start
        v = velocity(self.stencil.node_X) if callable(velocity) else velocity
        v = np.broadcast_to(np.asarray(v, float), (self.stencil.node_count, 3))
        self._batches = batch_particles(self.stencil)
        self.arrays = setup.to_device(
            setup.arrays(particles, self.stencil, self._batches, self.contact, settings, per, v),
            real,
        )
        self._start_kernels(materials[0].law, bool((per["damping_time"] > 0).any()))

    def _start_kernels(self, law: str, damped: bool) -> None:
        import taichi as ti

        from gf_usd.physics.kernels import build, pack_type
        from gf_usd.physics.laws import LAWS
        from gf_usd.runtime import epoch

        kind = ti.f64 if self.real is np.float64 else ti.f32
        self.pack = pack_type(kind, epoch())(**self.arrays)
        self.kernels = build(LAWS[law], damped, kind, epoch())
        self._vec = ti.types.vector(3, kind)
        self._cell_energy = ti.ndarray(kind, len(self.stencil.cell_nodes))
        self._lane_stress = ti.ndarray(kind, self._batches.source.size)

    @property
    def frame_time(self) -> float:
        """[s] of simulated time between frames."""
        return self.settings.time_scale / self.settings.fps

    def frames(self) -> Iterator[Frame]:
        """Yield `settings.frames` frames, the first at rest where the body was put."""
        frame = self._frame(0, 0, 0.0, 0)
        yield frame
        for index in range(1, self.settings.frames):
            frame = self._next(index, frame.health)
            yield frame

    @property
    def substeps(self) -> int:
        """Substeps of the next frame."""
        return self.coarse << self.guard.halvings

    @property
    def dt(self) -> float:
        """[s] length of the next frame's substeps."""
        return self.frame_time / self.substeps

    def _next(self, index: int, last: Health) -> Frame:
        """Move by a frame; where it fails, roll back and redo it with half the step."""
        saved = [self.arrays[name].to_numpy() for name in "uv"], self.offset, self.time, self.done
        for attempt in range(RETRIES + 1):
            capped, depth = self._advance(self.substeps)
            fault = self._not_finite()
            if not fault:
                frame = self._frame(index, capped, depth, attempt)
                fault = self.guard.judge(last, frame.health)
                if not fault:
                    self.guard.passed()
                    return frame
            if attempt == RETRIES:
                break
            (u, v), self.offset, self.time, self.done = saved
            self.arrays["u"].from_numpy(u)
            self.arrays["v"].from_numpy(v)
            self.guard.refine()
        raise BakeError(
            f"frame {index}: {fault}, with {self.coarse} substeps and still after {RETRIES}"
            f" halvings of the step to {self.dt:.3g} s",
            "lower the impact (--drop), use a stiffer material or --law neoHookean;"
            f" frames up to {index - 1} are in the partial cache",
        )

    def _not_finite(self) -> str:
        """Where the state is not a number, in words; "" where all is well."""
        u, v = self.state()
        bad = ~(np.isfinite(u).all(1) & np.isfinite(v).all(1))
        if not bad.any():
            return ""
        gap = np.linalg.norm(self.particles.X - self.stencil.free_X[np.argmax(bad)], axis=1)
        worst = int(gap.argmin())
        return (
            f"{int(bad.sum())} of {len(u)} grid nodes are no longer finite, first near particle"
            f" {worst} at rest position {self.particles.X[worst].round(4).tolist()} m"
        )

    def _advance(self, substeps: int) -> tuple[int, float]:
        """Move by a frame; returns friction caps and the deepest penetration [m] on the way."""
        s = self.settings
        lift = float(self.offset @ self.up)
        active = self._activate(lift)
        every, alpha = self._filter()
        keep = float(np.exp(-s.drag * self.dt))
        g, up = self._vec(list(s.gravity)), self._vec(list(self.up))
        free = self.stencil.free_count
        counts = (len(self.stencil.cell_nodes), free, self.stencil.node_count - free, active)
        tail = (g, up, lift, self.dt, keep, 1.0 / self.h, self._converged)
        if len(self.particles) < SERIAL_BELOW:
            phase = self.done % every if every else 0
            self.kernels.serial(self.pack, *counts, substeps, every, phase, alpha, *tail)
        else:
            self.kernels.start(self.pack, *counts[1:3], 0.5 * self.dt)
            for k in range(substeps):
                drift = self.dt if k < substeps - 1 else 0.5 * self.dt
                due = int(every > 0 and (self.done + k) % every == 0)
                self.kernels.parallel(self.pack, *counts, due, alpha, *tail, drift)
        self.done += substeps
        self.time += substeps * self.dt
        self._recentre()
        if not active:
            return 0, 0.0
        return (
            int(self.arrays["sample_capped"].to_numpy().sum()),
            float(self.arrays["sample_depth"].to_numpy().max()),
        )

    @property
    def _converged(self) -> float:
        return 1e-7 if self.real is np.float32 else 1e-15

    def _filter(self) -> tuple[int, float]:
        """Substeps between filters and the strength of one: alpha = 1 - exp(-r k dt)."""
        r = self.settings.filter_rate
        if r <= 0.0:
            return 0, 0.0
        if np.isinf(r):
            return 1, 1.0
        every = max(1, int(FILTER_STEP / (r * self.dt)))
        return every, float(1.0 - np.exp(-r * every * self.dt))

    def _activate(self, lift: float) -> int:
        """List the samples that may meet the floor before the next frame; returns how many."""
        if self.contact is None:
            return 0
        rows = self.contact.rows
        u, v = self.state()
        speed = float(np.abs(v @ self.up).max())
        g = abs(float(np.dot(self.settings.gravity, self.up)))
        reach = 2.0 * self.frame_time * (speed + g * self.frame_time) + self.particles.spacing
        height = self.arrays["sample_height"].to_numpy() + lift + rows.W @ (u @ self.up)
        near = np.flatnonzero(height < reach)
        active = np.zeros(len(height), np.int32)
        active[: len(near)] = near
        self.arrays["sample_active"].from_numpy(active)
        for name in ("sample_force", "sample_depth", "sample_capped"):
            self.arrays[name].fill(0)
        return len(near)

    def _recentre(self) -> None:
        """Move the mean displacement from u to the offset."""
        u = self.arrays["u"].to_numpy().astype(float).reshape(-1, 3)
        mean = self.stencil.mass @ u[: self.stencil.free_count] / self.stencil.mass.sum()
        self.offset = self.offset + mean
        self.arrays["u"].from_numpy((u - mean).astype(self.real).ravel())

    def state(self) -> tuple[Floats, Floats]:
        """Displacement (without the offset) and velocity of the free nodes, (free, 3), float64."""
        u, v = (self.arrays[name].to_numpy().astype(float).reshape(-1, 3) for name in "uv")
        return u[: self.stencil.free_count], v[: self.stencil.free_count]

    def _frame(self, index: int, capped: int, depth: float, rollbacks: int) -> Frame:
        u, v = self.state()
        particles = pose(self.rows, u, v, self.offset)
        health = replace(
            measure(self, particles, u, v),
            substeps=self.substeps if index else 0,
            penetration=depth,
            friction_capped=capped,
            rollbacks=rollbacks,
        )
        riders: dict[str, Pose] = {
            name: pose(rows, u, v, self.offset) for name, rows in self.riders.items()
        }
        return Frame(
            index=index,
            time=self.time,
            particles=particles,
            riders=riders,
            stress=self.von_mises() if self.settings.stress else None,
            health=health,
        )

    def elastic_energy(self) -> float:
        """sum_p V0 psi(F_p) [J]."""
        self.kernels.energy(
            self.pack,
            len(self.stencil.cell_nodes),
            self._cell_energy,
            1.0 / self.h,
            self._converged,
        )
        return float(self._cell_energy.to_numpy().astype(float).sum())

    def von_mises(self) -> Floats:
        """sqrt(3/2 s:s) [Pa] of each particle, s the deviator of sigma = P F^T / J; (N,)."""
        cells = len(self.stencil.cell_nodes)
        self.kernels.stress(self.pack, cells, self._lane_stress, 1.0 / self.h, self._converged)
        out = np.empty(len(self.particles))
        lanes = self._lane_stress.to_numpy().astype(float)
        filled = self._batches.filled.ravel() > 0.0
        out[self._batches.source.ravel()[filled]] = lanes[filled]
        return out

    def contact_energy(self, u: Floats) -> float:
        """sum_s k d^2 / 2 [J] stored in the floor's springs; u (M, 3) without the offset."""
        if self.contact is None:
            return 0.0
        rows = self.contact.rows
        height = (rows.X + self.offset + rows.W @ u) @ self.up - (self.settings.floor or 0.0)
        depth = np.maximum(0.0, -height)
        return float(0.5 * self.contact.stiffness @ depth**2)
