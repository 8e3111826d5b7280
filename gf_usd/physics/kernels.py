"""The substeps, put together for a law and a precision.

Per substep of length dt, with everything but u and v constant (docs/physics.md):

    v <- v + alpha (B v - m v) / m           every `every` substeps: B v is what eq. 1 makes of
                                             the velocities that eq. 3 gathers
    F_p = I + sum_i u_i (x) G_ip             eq. 4, integrated exactly; F0 for I: `reanchor`
    f_i = -sum_p V0_p P(F_p) G_ip            eq. 2
    v_i <- (v_i + dt (f_i / m_i + g + b_i)) exp(-drag dt)
    u_i <- u_i + dt v_i                      half of it before the first and after the last substep

`groups` counts groups of eight cells or, where the options say plain, particles.

The half steps make a frame position Verlet: second order, and exact under gravity alone.
"""

from functools import cache
from types import SimpleNamespace

import taichi as ti

from gf_usd.physics.cell_kernel import (
    filter_group,
    group_energy,
    group_von_mises,
    stress_group,
)
from gf_usd.physics.contact_kernel import sample_contact
from gf_usd.physics.lanes import LANES
from gf_usd.physics.node_kernel import (
    drift_node,
    filter_node,
    follow,
    follower_loss,
    follower_share,
    move_node,
)  # fmt: skip
from gf_usd.physics.options import PLAIN, Options
from gf_usd.physics.pair_kernel import pair_contact, pair_total, sample_motion
from gf_usd.physics.plain_kernel import (
    node_force,
    node_momentum,
    particle_energy,
    particle_stress,
    particle_velocity,
    particle_von_mises,
)

# Taichi gives a CPU thread at least 512 iterations, and calls a function for each: groups, which
# are few, act on every 32nd, and nodes go 32 in a row, so that addresses are fetched once for all.
STRIDE = 32


@cache
def pack_type(real, epoch: int):
    """The arguments of a body, one pack: a launch then costs the same however many arrays.

    epoch : `runtime.epoch()`; Taichi forgets the type of a pack when it is started again.
    """
    lanes = ("fx", "V0", "m", "mu", "lam", "viscosity", "block", "F0", "clip_room")
    reals = (
        *("u", "v", "inverse_mass", "node_mass"),
        *("acceleration", "anchor", "anchor_rate", "work"),
        *("sample_height", "sample_stiffness", "sample_damping", "sample_friction"),
        *("sample_mass", "sample_weight", "sample_force", "sample_depth", "node_sample_weight"),
        *("share", "leader_weight", "follow_weight"),
        *("limits", "pair"),
    )
    ints = (
        *("group_batch", "group_nodes", "node_slot_start", "node_slot"),
        *("sample_start", "sample_node", "sample_active", "sample_capped"),
        *("node_sample_start", "node_sample"),
        *("leader_start", "leader_follower", "follow_start", "follow_node"),
        *("clamped", "stress_capped", "links"),
    )
    vector = ti.types.vector(LANES, real)
    members = {name: ti.types.ndarray(dtype=vector, ndim=1) for name in lanes}
    members |= {name: ti.types.ndarray(dtype=real, ndim=1) for name in reals}
    members |= {name: ti.types.ndarray(dtype=ti.i32, ndim=1) for name in ints}
    return ti.types.argpack(**members)


@cache
def build(law, damped: bool, real, epoch: int, options: Options = PLAIN) -> SimpleNamespace:
    """The kernels for one law, with or without viscosity and the paper's options, in f32 or f64."""
    Body = pack_type(real, epoch)
    vec = ti.types.vector(3, real)
    row = 1 if options.plain else STRIDE  # of nodes or contact samples that one thread takes

    @ti.kernel
    def serial(
        body: Body, groups: ti.i32, free: ti.i32, followers: ti.i32, active: ti.i32,
        substeps: ti.i32, every: ti.i32, phase: ti.i32, alpha: real, g: vec, up: vec, lift: real,
        dt: real, keep: real, ih: real, converged: real,
    ):  # fmt: skip
        """All substeps of a frame in one launch on one thread: small bodies are all launch cost."""
        ti.loop_config(serialize=True)
        for s in range(substeps):
            if s == 0:
                for n in range(free):
                    drift_node(body, n, 0.5 * dt)
                for n in range(followers):
                    follow(body, n, free, 0.5 * dt)
            drift = dt
            if s == substeps - 1:
                drift = 0.5 * dt
            if every > 0 and (s + phase) % every == 0:
                if ti.static(options.plain):
                    for p in range(groups):
                        particle_velocity(body, p, free + followers)
                    for n in range(free + followers):
                        node_momentum(body, n, free + followers)
                else:
                    for k in range(groups):
                        filter_group(body, k)
                for n in range(followers):
                    follower_loss(body, n, free, options.plain)
                for n in range(free):
                    filter_node(body, n, alpha, options.plain)
                for n in range(followers):
                    follow(body, n, free, 0.0 * dt)
            if ti.static(options.plain):
                for p in range(groups):
                    particle_stress(body, p, free + followers, law, damped, ih, converged, options)
                for n in range(free + followers):
                    node_force(body, n, free + followers, ih)
            else:
                for k in range(groups):
                    stress_group(body, k, law, damped, ih, converged, options)
            if ti.static(options.meets):
                for k in range(active):
                    sample_motion(body, body.sample_active[k], dt)
            for k in range(active):
                sample_contact(body, body.sample_active[k], up, lift, dt)
            if ti.static(options.meets):
                for k in range(active):
                    pair_contact(body, body.sample_active[k], dt)
                for k in range(active):
                    pair_total(body, body.sample_active[k])
            for n in range(followers):
                follower_share(body, n, free, dt, options.plain)
            for n in range(free):
                move_node(body, n, active, g, dt, drift, keep, options.plain)
            for n in range(followers):
                follow(body, n, free, drift)

    @ti.kernel
    def parallel(
        body: Body, groups: ti.i32, free: ti.i32, followers: ti.i32, active: ti.i32,
        filtered: ti.i32, alpha: real, g: vec, up: vec, lift: real,
        dt: real, keep: real, ih: real, converged: real, drift: real,
    ):  # fmt: skip
        """One substep over all threads."""
        if ti.static(options.plain):
            for p in range(groups * filtered):
                particle_velocity(body, p, free + followers)
            for n in range((free + followers) * filtered):
                node_momentum(body, n, free + followers)
        else:
            for z in range(groups * STRIDE * filtered):
                if z % STRIDE == 0:
                    filter_group(body, z // STRIDE)
        for n in range(followers * filtered):
            follower_loss(body, n, free, options.plain)
        for z in range(free * filtered):
            if z % row == 0:
                for n in range(z, ti.min(z + row, free)):
                    filter_node(body, n, alpha, options.plain)
        for n in range(followers * filtered):
            follow(body, n, free, 0.0 * dt)
        if ti.static(options.plain):
            for p in range(groups):
                particle_stress(body, p, free + followers, law, damped, ih, converged, options)
            for n in range(free + followers):
                node_force(body, n, free + followers, ih)
        else:
            for z in range(groups * STRIDE):
                if z % STRIDE == 0:
                    stress_group(body, z // STRIDE, law, damped, ih, converged, options)
        if ti.static(options.meets):
            for k in range(active):
                sample_motion(body, body.sample_active[k], dt)
        for z in range(active):
            if z % row == 0:
                for k in range(z, ti.min(z + row, active)):
                    sample_contact(body, body.sample_active[k], up, lift, dt)
        if ti.static(options.meets):
            for k in range(active):
                pair_contact(body, body.sample_active[k], dt)
            for k in range(active):
                pair_total(body, body.sample_active[k])
        for n in range(followers):
            follower_share(body, n, free, dt, options.plain)
        for z in range(free):
            if z % row == 0:
                for n in range(z, ti.min(z + row, free)):
                    move_node(body, n, active, g, dt, drift, keep, options.plain)
        for n in range(followers):
            follow(body, n, free, drift)

    @ti.kernel
    def start(body: Body, free: ti.i32, followers: ti.i32, drift: real):
        """u += drift v: the half step that opens a frame of `parallel` substeps."""
        for n in range(free):
            drift_node(body, n, drift)
        for n in range(followers):
            follow(body, n, free, drift)

    @ti.kernel
    def energy(
        body: Body, groups: ti.i32, out: ti.types.ndarray(dtype=real, ndim=1), ih: real,
        converged: real,
    ):  # fmt: skip
        """out[cell] = sum_p V0 psi(F_p); of each particle where they are plain."""
        if ti.static(options.plain):
            for p in range(groups):
                out[p] = particle_energy(body, p, law, ih, converged, options)
        else:
            for z in range(groups * STRIDE):
                if z % STRIDE == 0:
                    group_energy(body, z // STRIDE, out, law, ih, converged, options)

    @ti.kernel
    def stress(
        body: Body, groups: ti.i32, out: ti.types.ndarray(dtype=real, ndim=1), ih: real,
        converged: real,
    ):  # fmt: skip
        """out[lane] = von Mises of the Cauchy stress P F^T / J, viscosity left out."""
        if ti.static(options.plain):
            for p in range(groups):
                out[p] = particle_von_mises(body, p, law, ih, converged, options)
        else:
            for z in range(groups * STRIDE):
                if z % STRIDE == 0:
                    group_von_mises(body, z // STRIDE, out, law, ih, converged, options)

    return SimpleNamespace(
        serial=serial, parallel=parallel, start=start, energy=energy, stress=stress
    )
