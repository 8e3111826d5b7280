"""Updated Lagrangian MLS-MPM: the usual way, to compare with (GaussianFlesh section 4.4).

The state is x, v, C, F and L = grad v on the particles.  The grid is built anew in every substep
around where they are now, fixed in the world, and forgotten: `ul_kernel`.  Whatever rides on the
body, contact samples and mesh vertices, is carried by its particles: `ul_riding`.  APIC acts in
every substep, so there is no filter rate.

Positions are kept relative to `offset`, which moves with the body by whole cells, so that a long
fall costs them no digits and the grid stays where it is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.frames import Frame, Particles, Pose, Settings, SurfaceSamples
from gf_usd.core.materials import G0, Material
from gf_usd.core.stage import Pin
from gf_usd.physics import taichi_arrays, time_step
from gf_usd.physics.frame_loop import Guard, Marcher, Passage, first_bad
from gf_usd.physics.grid.reference import build_stencil
from gf_usd.physics.time_step import strained_step
from gf_usd.physics.total_lagrangian.setup import largest_step, per_particle, to_device
from gf_usd.physics.updated_lagrangian import setup
from gf_usd.physics.updated_lagrangian.energies import measure, strained_speed, world_stiffness
from gf_usd.physics.updated_lagrangian.riding import board, contact_energy, watch

SERIAL_BELOW = 12_000  # particles; smaller bodies run all substeps in one launch
CELL_PER_LATTICE = 2.0  # h over the lattice's edge, as for the Total Lagrangian solver
LARGEST_BOX = 1 << 23  # nodes, or eight times the box at rest where that is more
STATE = ("x", "v", "C", "F", "L")
NO_ROOM = 2  # see `ul_sort_kernel`


class UpdatedLagrangian(Marcher):
    """One asset in motion; parameters as for `TotalLagrangian`.

    Raises UsageError for what only the other solver can do: pins, WLS and the shape correction.
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
        pins: Sequence[Pin] = (),
        h: float | None = None,
        real: type = np.float32,
    ) -> None:
        from gf_usd.system.taichi_runtime import init_taichi

        setup.refuse(settings, pins)
        init_taichi(settings.device, settings.threads, f64=real is np.float64)
        self.particles, self.settings, self.real = particles, settings, real
        self.per = per = per_particle(particles, materials)
        self.m = per["density"] * per["V0"]
        self.h = h or settings.cell or CELL_PER_LATTICE * particles.lattice
        at_rest = build_stencil(particles.X, self.m, self.h, particles.corner, free_mass=0.0)
        rows = at_rest.rows(particles.X)
        self.riders = {name: board(X, particles.X) for name, X in (riders or {}).items()}
        self.contact, self.ride = setup.floor_contact(
            samples, particles, at_rest, rows, settings, per
        )
        self.step = largest_step(particles, self.h, self.contact, settings, per)
        self.coarse = settings.substeps or max(1, int(np.ceil(self.frame_time / self.step.dt)))
        extent = float(np.linalg.norm(np.ptp(particles.X, axis=0)))
        self.guard = Guard(float(self.m.sum()) * G0 * particles.radius, extent)
        self.time = 0.0
        self.done = 0  # substeps since the start
        centre = self.m @ particles.X / self.m.sum()
        self.offset = np.asarray(settings.lift, float) + centre
        self.phase = (at_rest.origin - centre) / self.h  # [cells] where the grid's node 0 lies
        motion = setup.start_motion(velocity, rows, at_rest)
        self.arrays = to_device(
            setup.arrays(particles.X - centre, motion, per, self.contact, self.ride), real
        )
        self._start_kernels(materials, bool((per["damping_time"] > 0).any()))
        self.most_nodes = max(LARGEST_BOX, 8 * self._box_nodes())
        self.node_room = self.cell_room = 0
        self._make_room()

    def _start_kernels(self, materials: Sequence[Material], damped: bool) -> None:
        import taichi as ti

        from gf_usd.physics.laws.registry import law_of
        from gf_usd.physics.updated_lagrangian.kernels import build, pack_type
        from gf_usd.system.taichi_runtime import epoch

        kind = ti.f64 if self.real is np.float64 else ti.f32
        self.pack_of = pack_type(kind, epoch())
        clamp, cap = self.settings.clamp is not None, self.settings.stress_cap is not None
        self.law = law_of(materials)
        self.kernels = build(self.law, damped, clamp, cap, kind, epoch())
        self._vec = ti.types.vector(3, kind)
        self.value = ti.ndarray(kind, len(self.particles))

    def _box_nodes(self) -> float:
        """Nodes of the box around the particles now, at twice its cells."""
        cells = self.array("x").reshape(-1, 3) / self.h
        return float(np.prod(np.ptp(cells, axis=0) + 4.0))

    def _make_room(self) -> bool:
        """Arrays for twice the box that the body fills now; False where that is too large."""
        nodes = self._box_nodes()
        if not nodes <= self.most_nodes:
            return False
        self.node_room = max(2 * int(nodes), 2 * self.node_room)
        self.cell_room = min(len(self.particles), self.node_room)
        self.arrays |= to_device(setup.grid_arrays(self.node_room, self.cell_room), self.real)
        self.pack = self.pack_of(**self.arrays)
        return True

    def array(self, name: str) -> Floats:
        """One of the kernels' arrays, in float64."""
        return self.arrays[name].to_numpy().astype(float)

    def save(self) -> dict[str, Any]:
        """Every particle's x, v, C, F and L, the offset, the time and the count of substeps."""
        state = {name: self.arrays[name].to_numpy() for name in STATE}
        return {**state, "offset": self.offset.copy(), "time": self.time, "done": self.done}

    def restore(self, saved: dict[str, Any]) -> None:
        """Go back to what `save` returned."""
        for name in STATE:
            self.arrays[name].from_numpy(saved[name])
        self.offset = np.asarray(saved["offset"], float).copy()
        self.time, self.done = float(saved["time"]), int(saved["done"])

    def not_finite(self) -> tuple[int, str]:
        """See `Marcher`."""
        for name in STATE:
            bad = first_bad(self.arrays[name].to_numpy().reshape(len(self.particles), -1))
            if bad >= 0:
                X = self.particles.X[bad].round(4).tolist()
                return bad, f"{name} of particle {bad} at rest position {X} m is no longer finite"
        fault = int(self.arrays["box"].to_numpy()[8])
        if not fault:
            return -1, ""
        x = self.array("x").reshape(-1, 3)
        far = np.linalg.norm(x - np.median(x, axis=0), axis=1)
        return int(far.argmax()), (
            f"the body no longer fits a grid of {self.most_nodes:.3g} nodes: a particle is"
            f" {far.max():.4g} m from the others"
        )

    def advance(self, index: int, substeps: int) -> Passage:
        """Move by a frame; `index` is the frame that this leads to."""
        before = self.save()
        active = self._launch(substeps)
        while self.arrays["box"].to_numpy()[8] == NO_ROOM and self._make_room():
            self.restore(before)
            active = self._launch(substeps)
        self.done += substeps
        self.time += substeps * (self.frame_time / substeps)
        self._recentre()
        count = {
            name: int(self.arrays[name].to_numpy().sum()) for name in ("clamped", "stress_capped")
        }
        if not active:
            return Passage(**count)
        return Passage(
            friction_capped=int(self.arrays["sample_capped"].to_numpy().sum()),
            penetration=float(self.arrays["sample_depth"].to_numpy().max()),
            **count,
        )

    def _launch(self, substeps: int) -> int:
        """Run the kernels for a frame; how many samples were watched for contact."""
        s, n = self.settings, len(self.particles)
        dt = self.frame_time / substeps
        for name in ("box", "clamped", "stress_capped"):
            taichi_arrays.clear(self.arrays[name])
        lift = float(self.offset @ s.normal) - (s.floor or 0.0)
        active = watch(self, lift)
        low, high = s.clamp or (0.0, 0.0)
        rooms = (self.node_room, self.cell_room)
        tail = (
            *(self._vec(list(a)) for a in (s.gravity, s.normal, self.phase)),
            lift, dt, float(np.exp(-s.drag * dt)), 1.0 / self.h,
            s.stress_cap or 0.0, low, high, self.converged,
        )  # fmt: skip
        if n < SERIAL_BELOW:
            self.kernels.serial(self.pack, n, active, *rooms, substeps, *tail)
        else:
            self.kernels.start(self.pack, n, 0.5 * dt)
            for k in range(substeps):
                drift = dt if k < substeps - 1 else 0.5 * dt
                self.kernels.parallel(self.pack, n, active, *rooms, *tail, drift)
        return active

    @property
    def converged(self) -> float:
        return 1e-7 if self.real is np.float32 else 1e-15

    def _recentre(self) -> None:
        """Move whole cells of the mean position from x to the offset."""
        x = self.array("x").reshape(-1, 3)
        if not np.isfinite(x).all():
            return
        shift = self.h * np.round(self.m @ x / self.m.sum() / self.h)
        if shift.any():
            self.offset = self.offset + shift
            self.arrays["x"].from_numpy((x - shift).astype(self.real).ravel())

    def state(self) -> tuple[Floats, Floats, Floats, Floats]:
        """x without the offset, v (N, 3), F and L (N, 3, 3), float64."""
        x, v = (self.array(name).reshape(-1, 3) for name in "xv")
        F, L = (self.array(name).reshape(-1, 3, 3) for name in "FL")
        return x, v, F, L

    def read(self, index: int) -> Frame:
        """See `Marcher`."""
        from gf_usd.physics.per_particle import strains

        x, v, F, L = self.state()
        cells = x / self.h - self.phase
        x = x + self.offset
        pose = Pose(x=x, v=v, F=F)
        stretch, J = strains(pose.F)
        self.strained = self._strained(stretch, J, cells)
        C = self.array("C").reshape(-1, 3, 3)
        self.kernels.energy(self.pack, len(x), self.value, self.converged)
        elastic = float(self.value.to_numpy().astype(float).sum())
        s, contact = self.settings, contact_energy(self)
        return Frame(
            index=index,
            time=self.time,
            particles=pose,
            riders={name: ride.pose(x, v, F, L) for name, ride in self.riders.items()},
            stress=self.von_mises() if s.stress else None,
            health=measure(
                pose, (stretch, J), C, self.m, self.h, s, elastic=elastic, contact=contact
            ),
        )

    def _strained(self, stretch: Floats, J: Floats, cells: Floats) -> int:
        """Substeps a frame that the body as strained now asks for; none where they are given."""
        if self.settings.substeps:
            return 1
        k = world_stiffness(self.law, stretch, J, self.per["signed_mu"], self.per["lam"])
        speed = strained_speed(k, self.per["density"], cells)
        dt = strained_step(self.step, speed, self.h, time_step.per_cell(self.particles, self.h))
        return int(np.ceil(self.frame_time / dt))

    def von_mises(self) -> Floats:
        """sqrt(3/2 s:s) [Pa] of each particle, s the deviator of sigma = P F^T / J; (N,)."""
        cap = self.settings.stress_cap or 0.0
        self.kernels.stress(self.pack, len(self.particles), self.value, cap, self.converged)
        return self.value.to_numpy().astype(float)
