"""The kernels of the Updated Lagrangian substeps, composed for the laws and the precision of a
body.

Per substep of length dt (GaussianFlesh section 4.4; Hu et al. 2018), with `kernels.transfer`:

    sort the particles by cell                           `kernels.sorting`
    forces of the floor on the embedded samples          `kernels.particles`
    P2G: mass and momentum, with the stress              `kernels.transfer`
    v_i <- (p_i / m_i + dt g) exp(-drag dt)
    G2P: v, C, L;  x, F advance by dt

Half of the first drift precedes the first substep of a frame and half of the last is left out,
which makes a frame position Verlet, as in the Total Lagrangian solver: second order, and exact
under gravity alone.

On a GPU the thread blocks that it runs at once take many substeps in one launch, with a barrier
between stages: `total_lagrangian.kernels.grid_barrier`.
"""

from functools import cache
from types import SimpleNamespace

import taichi as ti

from gf_usd.physics.laws.simd3x3 import LANES, von_mises
from gf_usd.physics.laws.stress import energy as energy_density
from gf_usd.physics.total_lagrangian.kernels.grid_barrier import item_of, wait_for_all
from gf_usd.physics.total_lagrangian.kernels.work_queue import clear
from gf_usd.physics.total_lagrangian.stages import BLOCK, CLOSES, OPENS
from gf_usd.physics.updated_lagrangian.kernels.particles import (
    clamp_particle,
    drift_particle,
    move_node,
    push_particle,
    sample_force,
)
from gf_usd.physics.updated_lagrangian.kernels.sorting import (
    CELLS,
    CLEARED,
    MISSING,
    NODES,
    begin_ranges,
    begin_substep,
    claim_range,
    count_particle,
    number_particles,
    place_particle,
    sort_cell,
)
from gf_usd.physics.updated_lagrangian.kernels.transfer import (
    admissible,
    current,
    gather_cell,
    in_order,
    pick,
    piola,
    scatter_cell,
    trial,
)
from gf_usd.physics.updated_lagrangian.kernels.walls import move_walled_node, sum_wall_impulses
from gf_usd.physics.updated_lagrangian.walls import PARTS
from gf_usd.system.taichi_runtime import without_common_subexpressions

# particles whose cells one thread of a GPU numbers between two barriers: others wait for a second
NUMBERED = 16_384
STRIDE = 32  # a CPU thread of Taichi has at least 512 iterations: use every 32nd

REALS = (
    *("x", "v", "C", "L", "F", "m", "V0", "constants", "history", "viscosity"),
    *("push", "block", "node_v", "support_weight", "support_arm"),
    *("sample_constants", "sample_spring"),
    *("sample_force", "sample_depth", "plane"),
    *("node_given", "wall_impulse"),
)
WHOLE = (
    *("queue", "grid", "key", "rank", "order", "clamped", "stress_capped"),
    *("node_of", "node_at", "node_cells", "cell_at", "cell_nodes", "cell_count", "cell_start"),
    *(
        "support_particle",
        "particle_support_start",
        "particle_support",
        "sample_active",
        "sample_capped",
        "sample_plane",
    ),
)


@cache
def pack_type(real, epoch: int):
    """The type of the kernels' argument pack; epoch as for
    `total_lagrangian.kernels.substep.pack_type`.
    """
    members = {name: ti.types.ndarray(dtype=real, ndim=1) for name in REALS}
    members |= {name: ti.types.ndarray(dtype=ti.i32, ndim=1) for name in WHOLE}
    return ti.types.argpack(**members)


@cache
def build(
    laws, damped: bool, clamp: bool, capped: bool, walled: bool, real, epoch: int,
    pair_contact: bool = False, held: int = 0,
) -> SimpleNamespace:  # fmt: skip
    """The kernels for a set of laws, with or without viscosity, clamp, stress cap and walls.

    laws : `registry.LawSet`; real : f32 or f64; pair_contact : samples may have contact planes.
    held : number of thread blocks that are resident on a GPU at once, 0 on a CPU, where `resident`
    has one thread.
    """
    Body = pack_type(real, epoch)
    vec = ti.types.vector(3, real)
    ivec = ti.types.vector(3, ti.i32)

    @ti.kernel
    def serial(
        body: Body, n: ti.i32, active: ti.i32, node_capacity: ti.i32, cell_capacity: ti.i32,
        substeps: ti.i32, g: vec, up: vec, phase: vec, lift: real, dt: real, keep: real, ih: real,
        cap: real, low: real, high: real, converged: real, first: ivec, last: ivec, stuck: ivec,
    ):  # fmt: skip
        """All substeps of a frame in one launch on one thread: for small bodies launches dominate
        the time.
        """
        ti.loop_config(serialize=True)
        for s in range(substeps):
            if s == 0:
                for p in range(n):
                    drift_particle(body, p, laws, 0.5 * dt)
            drift = dt
            if s == substeps - 1:
                drift = 0.5 * dt
            begin_substep(body, node_capacity)
            for place in range(body.grid[CLEARED]):
                body.node_of[place] = -1
            for cell in range(body.grid[CELLS]):
                body.cell_count[cell] = 0
            for p in range(n):
                count_particle(body, p, ih, phase, node_capacity, cell_capacity, True)
            number_particles(body)
            for p in range(n):
                place_particle(body, p)
            for k in range(active):
                sample_force(body, body.sample_active[k], up, lift, dt, pair_contact)
            if active > 0:
                for p in range(n):
                    push_particle(body, p)
            # The `if` keeps Taichi from hoisting loop invariants one by one.
            for cell in range(body.grid[CELLS]):
                if body.cell_count[cell] > 0:
                    scatter_cell(
                        body, cell, laws, damped, capped, cap, active, dt, ih, phase, converged
                    )
            for node in range(body.grid[NODES]):
                if ti.static(walled):
                    move_walled_node(
                        body, node, g, dt, keep, first, last, stuck, 2 * node_capacity - 1
                    )
                else:
                    move_node(body, node, g, dt, keep)
            if ti.static(walled):
                sum_wall_impulses(body, 0, 1)
            for cell in range(body.grid[CELLS]):
                if body.cell_count[cell] > 0:
                    gather_cell(body, cell, laws, drift, ih, phase)
            if ti.static(clamp):
                for p in range(n):
                    clamp_particle(body, p, laws, low, high)

    @ti.kernel
    def parallel(
        body: Body, n: ti.i32, active: ti.i32, node_capacity: ti.i32, cell_capacity: ti.i32,
        g: vec, up: vec, phase: vec, lift: real, dt: real, keep: real, ih: real,
        cap: real, low: real, high: real, converged: real, first: ivec, last: ivec, stuck: ivec,
        drift: real,
    ):  # fmt: skip
        """One substep on all threads of a CPU."""
        ti.loop_config(serialize=True)
        for _ in range(1):
            begin_substep(body, node_capacity)
        for place in range(body.grid[CLEARED]):
            body.node_of[place] = -1
        for cell in range(body.grid[CELLS]):
            body.cell_count[cell] = 0
        for p in range(n):
            count_particle(body, p, ih, phase, node_capacity, cell_capacity, False)
        ti.loop_config(serialize=True)
        for _ in range(1):
            if body.grid[MISSING] > 0:
                for p in range(n):
                    if body.key[p] < 0:
                        count_particle(body, p, ih, phase, node_capacity, cell_capacity, True)
            number_particles(body)
        for p in range(n):
            place_particle(body, p)
        for cell in range(body.grid[CELLS]):
            sort_cell(body, cell)
        for k in range(active):
            sample_force(body, body.sample_active[k], up, lift, dt, pair_contact)
        for p in range(n * ti.min(active, 1)):
            push_particle(body, p)
        for z in range(body.grid[CELLS] * STRIDE):
            if z % STRIDE == 0:
                scatter_cell(
                    body, z // STRIDE, laws, damped, capped, cap, active, dt, ih, phase, converged
                )
        for node in range(body.grid[NODES]):
            if ti.static(walled):
                move_walled_node(body, node, g, dt, keep, first, last, stuck, 2 * node_capacity - 1)
            else:
                move_node(body, node, g, dt, keep)
        ti.loop_config(serialize=True)
        for _ in range(1):
            if ti.static(walled):
                sum_wall_impulses(body, 0, 1)
        for z in range(body.grid[CELLS] * STRIDE):
            if z % STRIDE == 0:
                gather_cell(body, z // STRIDE, laws, drift, ih, phase)
        for p in range(n):
            if ti.static(clamp):
                clamp_particle(body, p, laws, low, high)

    @ti.func
    def turns(z, blocks, many):
        """Number of items of a stage for thread z."""
        return (many - item_of(z, blocks) + ti.max(1, blocks * BLOCK) - 1) // ti.max(
            1, blocks * BLOCK
        )

    @ti.func
    def item(z, blocks, turn):
        """The item of thread z in a turn."""
        return item_of(z, blocks) + turn * ti.max(1, blocks * BLOCK)

    @ti.func
    def barrier(body: ti.template(), z, blocks, before):
        """Wait for all threads; the number of barriers so far."""
        if ti.static(held > 0):
            wait_for_all(body.queue, z, (before + 1) * blocks)
        return before + 1

    @ti.kernel
    def resident(
        body: Body, n: ti.i32, active: ti.i32, node_capacity: ti.i32, cell_capacity: ti.i32,
        blocks: ti.i32, substeps: ti.i32, ends: ti.i32, g: vec, up: vec, phase: vec, lift: real,
        dt: real, keep: real, ih: real, cap: real, low: real, high: real, converged: real,
        first: ivec, last: ivec, stuck: ivec,
    ):  # fmt: skip
        """Substeps in one launch of resident thread blocks: for GPUs.

        blocks : number of thread blocks, 0 on a CPU; ends : bits of `stages`.
        """
        clear(body.queue)
        ti.loop_config(block_dim=BLOCK)
        for z in range(ti.static(max(1, held * BLOCK))):
            if z < ti.max(1, blocks * BLOCK):
                done = 0
                if ends & OPENS > 0:
                    for turn in range(turns(z, blocks, n)):
                        drift_particle(body, item(z, blocks, turn), laws, 0.5 * dt)
                for s in range(substeps):
                    drift = dt
                    if s == substeps - 1 and ends & CLOSES > 0:
                        drift = 0.5 * dt
                    if z == 0:
                        begin_substep(body, node_capacity)
                        begin_ranges(body)
                    done = barrier(body, z, blocks, done)
                    for turn in range(turns(z, blocks, body.grid[CLEARED])):
                        body.node_of[item(z, blocks, turn)] = -1
                    for turn in range(turns(z, blocks, body.grid[CELLS])):
                        body.cell_count[item(z, blocks, turn)] = 0
                    done = barrier(body, z, blocks, done)
                    for turn in range(turns(z, blocks, n)):
                        p = item(z, blocks, turn)
                        count_particle(body, p, ih, phase, node_capacity, cell_capacity, False)
                    done = barrier(body, z, blocks, done)
                    if body.grid[MISSING] > 0:
                        for part in range((n + NUMBERED - 1) // NUMBERED):
                            if z == 0:
                                for p in range(part * NUMBERED, ti.min((part + 1) * NUMBERED, n)):
                                    if body.key[p] < 0:
                                        count_particle(
                                            body, p, ih, phase, node_capacity, cell_capacity, True
                                        )
                            done = barrier(body, z, blocks, done)
                    for turn in range(turns(z, blocks, body.grid[CELLS])):
                        claim_range(body, item(z, blocks, turn))
                    done = barrier(body, z, blocks, done)
                    for turn in range(turns(z, blocks, n)):
                        place_particle(body, item(z, blocks, turn))
                    for turn in range(turns(z, blocks, active)):
                        k = body.sample_active[item(z, blocks, turn)]
                        sample_force(body, k, up, lift, dt, pair_contact)
                    done = barrier(body, z, blocks, done)
                    for turn in range(turns(z, blocks, body.grid[CELLS])):
                        sort_cell(body, item(z, blocks, turn))
                    for turn in range(turns(z, blocks, n * ti.min(active, 1))):
                        push_particle(body, item(z, blocks, turn))
                    done = barrier(body, z, blocks, done)
                    for turn in range(turns(z, blocks, body.grid[CELLS])):
                        scatter_cell(
                            body, item(z, blocks, turn), laws, damped, capped, cap, active, dt, ih,
                            phase, converged,
                        )  # fmt: skip
                    done = barrier(body, z, blocks, done)
                    for turn in range(turns(z, blocks, body.grid[NODES])):
                        node = item(z, blocks, turn)
                        if ti.static(walled):
                            move_walled_node(
                                body, node, g, dt, keep, first, last, stuck, 2 * node_capacity - 1
                            )
                        else:
                            move_node(body, node, g, dt, keep)
                    done = barrier(body, z, blocks, done)
                    if ti.static(walled):
                        for turn in range(turns(z, blocks, PARTS)):
                            sum_wall_impulses(body, item(z, blocks, turn), PARTS)
                    for turn in range(turns(z, blocks, body.grid[CELLS])):
                        gather_cell(body, item(z, blocks, turn), laws, drift, ih, phase)
                    done = barrier(body, z, blocks, done)
                    if ti.static(clamp):
                        for turn in range(turns(z, blocks, n)):
                            clamp_particle(body, item(z, blocks, turn), laws, low, high)
                        done = barrier(body, z, blocks, done)

    @ti.kernel
    def start(body: Body, n: ti.i32, drift: real):
        """The initial half drift of a frame of `parallel` substeps."""
        for p in range(n):
            drift_particle(body, p, laws, drift)

    @ti.kernel
    def energy(body: Body, n: ti.i32, out: ti.types.ndarray(dtype=real, ndim=1), converged: real):
        """out[p] = V0 psi(F_p)."""
        for b in range((n + LANES - 1) // LANES):
            ids = in_order(b, n)
            q, which = current(body, ids, laws)
            psi = energy_density(laws, which, trial(body, ids, laws), q, converged)
            psi = psi * pick(body.V0, ids, 0)
            for lane in ti.static(range(LANES)):
                out[ids[lane]] = psi[lane]

    @ti.kernel
    def stress(
        body: Body, n: ti.i32, out: ti.types.ndarray(dtype=real, ndim=1), cap: real, converged: real
    ):
        """out[p] = von Mises stress of the Cauchy stress P F^T / J, without viscosity."""
        for b in range((n + LANES - 1) // LANES):
            ids = in_order(b, n)
            strain = admissible(body, ids, laws, 0.0 * converged, converged, False)
            P = piola(body, ids, strain, laws, False, capped, cap, 0.0 * cap, converged)
            value = von_mises(P, strain)
            for lane in ti.static(range(LANES)):
                out[ids[lane]] = value[lane]

    kernels = {
        "serial": serial, "parallel": parallel, "resident": resident, "start": start,
        "energy": energy, "stress": stress,
    }  # fmt: skip
    return SimpleNamespace(
        **{name: without_common_subexpressions(one) for name, one in kernels.items()}, held=held
    )
