"""The kernels of the substeps, composed for the laws, the options and the precision of a body.

Per substep of length dt, with all quantities but u and v constant (docs/physics.md):

    v <- v + alpha M~^-1 (B v - m v)         every `every` substeps: B v is eq. 1 applied to the
                                             velocities of eq. 3 (APIC filter)
    F_p = I + sum_i u_i (x) G_ip             eq. 4, integrated exactly; F0 for I: `shape_correction`
    f_i = -sum_p V0_p P(F_p) G_ip            eq. 2
    v_i <- (v_i + dt ((M~^-1 f)_i + g + b_i)) exp(-drag dt)
    u_i <- u_i + dt v_i                      half of it before the first and after the last substep

The half steps make a frame position Verlet: second order, and exact under gravity alone.

`groups` is the number of groups of eight cells or, with the option `plain`, of particles.
"""

from functools import cache
from types import SimpleNamespace

import taichi as ti

from gf_usd.physics.contact.kernels import pair_contact, pair_total, sample_contact, sample_motion
from gf_usd.physics.laws.simd3x3 import LANES
from gf_usd.physics.total_lagrangian.kernels.cell import (
    cell_energy,
    cell_von_mises,
    filter_cell,
    stress_cell,
)
from gf_usd.physics.total_lagrangian.kernels.grid_barrier import item_of, wait_for_all
from gf_usd.physics.total_lagrangian.kernels.nodes import (
    dependent_share,
    drift_goal,
    drift_node,
    follow,
    force,
    goal_share,
    move_node,
    store_acceleration,
)
from gf_usd.physics.total_lagrangian.kernels.rigid import (
    filter_region,
    move_region,
    open_region,
)
from gf_usd.physics.total_lagrangian.kernels.scalar import (
    node_force,
    node_momentum,
    particle_energy,
    particle_stress,
    particle_velocity,
    particle_von_mises,
)
from gf_usd.physics.total_lagrangian.kernels.simd import (
    filter_group,
    group_energy,
    group_von_mises,
    stress_group,
)
from gf_usd.physics.total_lagrangian.kernels.work_queue import (
    SPAN,
    clear,
    finish,
    piece,
    pieces_of,
    take,
    wait,
)
from gf_usd.physics.total_lagrangian.limits import (
    CONVERGED,
    DEFAULT,
    NO_GOALS,
    PER_H,
    Options,
)
from gf_usd.physics.total_lagrangian.stages import (
    BLOCK,
    CLOSES,
    DEPENDENT,
    FILTERING,
    FREE,
    GROUPS,
    NODES,
    OPENING,
    OPENS,
    PAIRED,
    REGIONS,
    TOUCHING,
    distinct_works,
    stages,
)

STRIDE = 32  # a CPU thread of Taichi has at least 512 iterations: use every 32nd


@cache
def pack_type(real, epoch: int):
    """The type of the kernels' argument pack: with one pack, the cost of a launch does not depend
    on the number of arrays.

    epoch : `runtime.epoch()`; the type is invalid after Taichi is initialized again.
    """
    lanes = (*("fx", "V0", "m", "constants", "history", "viscosity", "block", "F0", "clip_buffer"),)
    reals = (
        *("u", "v", "node_mass"),
        *("acceleration", "anchor", "rigid"),
        *("sample_given", "sample_constants", "sample_spring"),
        *("sample_weight", "sample_force", "sample_depth", "node_sample_weight"),
        *("share", "leader_weight", "follow_weight", "slide", "springs"),
        *("numbers", "pair"),
        "goal",
    )
    ints = (
        *("group_batch", "group_nodes", "node_slot_start", "node_slot"),
        *("sample_start", "sample_node", "sample_active", "sample_capped"),
        *("node_sample_start", "node_sample"),
        *("leader_start", "leader_dependent", "follow_start", "follow_node"),
        *("touched", "links", "queue", "rigid_nodes"),
    )
    vector = ti.types.vector(LANES, real)
    members = {name: ti.types.ndarray(dtype=vector, ndim=1) for name in lanes}
    members |= {name: ti.types.ndarray(dtype=real, ndim=1) for name in reals}
    members |= {name: ti.types.ndarray(dtype=ti.i32, ndim=1) for name in ints}
    return ti.types.argpack(**members)


@cache
def build(
    laws, damped: bool, real, epoch: int, options: Options = DEFAULT, held: int = 0
) -> SimpleNamespace:
    """The kernels for a set of laws, with or without viscosity, and the options.

    laws : `registry.LawSet`; real : f32 or f64.
    held : number of thread blocks that are resident on a GPU at once, 0 on a CPU, where `resident`
    has one thread.
    """
    Body = pack_type(real, epoch)
    table = stages(options.plain, options.pair_contact, options.coupled, options.rigid > 0)
    plan, act = _plan(table, options), _item(laws, damped, options)
    return SimpleNamespace(
        queued=_queued(Body, real, plan, act),
        resident=_resident(Body, real, plan, act, held),
        energy=_energy(Body, real, laws, options),
        stress=_stress(Body, real, laws, options),
        held=held,
    )


def _plan(table, options: Options) -> SimpleNamespace:
    """Which stages run in a substep, and on how many items; table : of `stages.stages`."""

    @ti.func
    def size(part: ti.template(), groups, free, dependent, active, paired):
        """Number of items of a part; paired samples are the first of the active ones."""
        count = active
        if ti.static(part.items == FREE):
            count = free
        elif ti.static(part.items == DEPENDENT):
            count = dependent
        elif ti.static(part.items == NODES):
            count = free + dependent
        elif ti.static(part.items == GROUPS and options.cells):
            count = groups * LANES
        elif ti.static(part.items == GROUPS):
            count = groups
        elif ti.static(part.items == PAIRED):
            count = paired
        elif ti.static(part.items == REGIONS):
            count = options.rigid
        return count

    @ti.func
    def due(stage: ti.template(), s, ends, every, phase, paired):
        """1 where a stage runs in substep s of a launch, else 0."""
        on = 1
        if ti.static(stage.when == OPENING):
            on = int(s == 0 and ends & OPENS > 0)
        if ti.static(stage.when == FILTERING):
            on = int(every > 0 and (s + phase) % every == 0)
        if ti.static(stage.when == TOUCHING):
            on = int(paired > 0)
        return on

    @ti.func
    def way_of(stage: ti.template(), dt, drift):
        """[s] drift time of dependent nodes in a stage."""
        way = drift
        if ti.static(stage.parts[0].name == "open dependent nodes"):
            way = 0.5 * dt
        elif ti.static(stage.parts[0].name == "filtered dependent nodes"):
            way = 0.0 * dt
        return way

    @ti.func
    def is_in(step, steps: ti.template()):
        """Whether a stage is among `steps`."""
        found = step == steps[0]
        for other in ti.static(steps[1:]):
            found = found or step == other
        return found

    return SimpleNamespace(
        stages=len(table),
        numbered=tuple(enumerate(table)),
        work=distinct_works(table),
        size=size,
        due=due,
        way_of=way_of,
        is_in=is_in,
    )


def _item(laws, damped: bool, options: Options):
    """The function that applies a part of a stage to one of its items."""

    @ti.func
    def act(
        part: ti.template(), body: ti.template(), n, free, nodes, active, alpha, g, up, lift, dt,
        drift, way, keep, filtering,
    ):  # fmt: skip
        """Apply one part to its item n.

        way : of `way_of`; filtering : 1 in stages of the filter.
        """
        ih = body.numbers[PER_H]
        converged = body.numbers[CONVERGED]
        if ti.static(part.name == "open"):
            drift_node(body, n, 0.5 * dt)
            if ti.static(options.goals > NO_GOALS):
                drift_goal(body, n, 0.5 * dt, options.goals)
        elif ti.static(part.name == "open dependent nodes"):
            follow(body, n, free, way, True, options)
        elif ti.static(part.work == "follow"):
            follow(body, n, free, way, False, options)
        elif ti.static(part.name == "momentum" and options.plain):
            particle_velocity(body, n, nodes)
        elif ti.static(part.name == "momentum" and options.cells):
            filter_cell(body, n)
        elif ti.static(part.name == "momentum"):
            filter_group(body, n)
        elif ti.static(part.name == "node momentum"):
            node_momentum(body, n, nodes)
        elif ti.static(part.name == "stress" and options.plain):
            particle_stress(body, n, nodes, laws, damped, dt, ih, converged, options)
        elif ti.static(part.name == "stress" and options.cells):
            stress_cell(body, n, laws, damped, dt, ih, converged, options)
        elif ti.static(part.name == "stress"):
            stress_group(body, n, laws, damped, dt, ih, converged, options)
        elif ti.static(part.name == "node force"):
            node_force(body, n, nodes, ih)
        elif ti.static(part.name == "sample motion"):
            sample_motion(body, body.sample_active[1 + n], dt)
        elif ti.static(part.name == "contact"):
            sample_contact(body, body.sample_active[1 + n], up, lift, dt, options.driven)
        elif ti.static(part.name == "pair contact"):
            pair_contact(body, body.sample_active[1 + n], dt)
        elif ti.static(part.name == "pair total"):
            pair_total(body, body.sample_active[1 + n], dt)
        elif ti.static(part.work == "share"):
            dependent_share(body, n, free, dt, alpha, filtering, options)
        elif ti.static(part.work == "move"):
            move_node(body, n, active, g, dt, drift, keep, alpha, filtering, options)
        elif ti.static(part.work == "move lumped"):
            f = force(body, n, active, dt, filtering, options)
            store_acceleration(body, n, f, goal_share(body, n, dt, filtering, options.goals))
        elif ti.static(part.name == "open rigid"):
            open_region(body, n, 0.5 * dt, options.rigid)
        elif ti.static(part.name == "filter rigid"):
            filter_region(body, n, free, alpha, options)
        elif ti.static(part.name == "move rigid"):
            move_region(body, n, free, active, g, dt, drift, keep, options)

    return act


def _queued(Body, real, plan: SimpleNamespace, act):
    """The kernel of substeps for CPUs."""
    vec = ti.types.vector(3, real)
    size, due, way_of, is_in = plan.size, plan.due, plan.way_of, plan.is_in
    numbered, work, last = plan.numbered, plan.work, plan.stages

    @ti.kernel
    def queued(
        body: Body, groups: ti.i32, free: ti.i32, dependent: ti.i32, active: ti.i32,
        threads: ti.i32, substeps: ti.i32, ends: ti.i32, every: ti.i32, phase: ti.i32, alpha: real,
        g: vec, up: vec, lift: real, dt: real, keep: real,
    ):  # fmt: skip
        """Substeps in one launch, whose threads take work items from a queue: see
        `kernels.work_queue`.

        every, phase : the filter acts where s + phase is a multiple of every; 0: never.
        """
        clear(body.queue)
        for z in range(threads * SPAN):
            if z % SPAN == 0:
                before = 0
                paired = body.sample_active[0]
                work_item = take(body.queue)
                for s in range(substeps):
                    drift = dt
                    if s == substeps - 1 and ends & CLOSES > 0:
                        drift = 0.5 * dt
                    for step in range(ti.static(last)):
                        pieces = 0
                        way = drift
                        filtering = 0
                        for number, stage in ti.static(numbered):
                            if step == number:
                                count = size(
                                    stage.parts[0], groups, free, dependent, active, paired
                                )
                                pieces = pieces_of(stage.parts[0], count, threads)
                                pieces *= due(stage, s, ends, every, phase, paired)
                                way = way_of(stage, dt, drift)
                                if ti.static(stage.when == FILTERING):
                                    filtering = 1
                        while work_item < before + pieces:
                            wait(body.queue, before)
                            for part, steps in ti.static(work):
                                if is_in(step, steps):
                                    many = size(part, groups, free, dependent, active, paired)
                                    first, behind = piece(many, work_item - before, pieces)
                                    for n in range(first, behind):
                                        act(
                                            part, body, n, free, free + dependent, active, alpha,
                                            g, up, lift, dt, drift, way, keep, filtering,
                                        )  # fmt: skip
                            finish(body.queue)
                            work_item = take(body.queue)
                        before += pieces

    return queued


def _resident(Body, real, plan: SimpleNamespace, act, held: int):
    """The kernel of substeps for GPUs."""
    vec = ti.types.vector(3, real)
    size, due, way_of, is_in = plan.size, plan.due, plan.way_of, plan.is_in
    numbered, work, last = plan.numbered, plan.work, plan.stages

    @ti.kernel
    def resident(
        body: Body, groups: ti.i32, free: ti.i32, dependent: ti.i32, active: ti.i32,
        blocks: ti.i32, substeps: ti.i32, ends: ti.i32, every: ti.i32, phase: ti.i32, alpha: real,
        g: vec, up: vec, lift: real, dt: real, keep: real,
    ):  # fmt: skip
        """Substeps in one launch of resident thread blocks: for GPUs; see `kernels.grid_barrier`.

        blocks : number of thread blocks, 0 on a CPU; every, phase : see `queued`.
        """
        clear(body.queue)
        ti.loop_config(block_dim=BLOCK)
        for z in range(ti.static(max(1, held * BLOCK))):
            if z < ti.max(1, blocks * BLOCK):
                paired = body.sample_active[0]
                barriers = 0
                for s in range(substeps):
                    drift = dt
                    if s == substeps - 1 and ends & CLOSES > 0:
                        drift = 0.5 * dt
                    for step in range(ti.static(last)):
                        some = 0
                        way = drift
                        filtering = 0
                        for number, stage in ti.static(numbered):
                            if step == number:
                                for part in ti.static(stage.parts):
                                    some += size(part, groups, free, dependent, active, paired)
                                some *= due(stage, s, ends, every, phase, paired)
                                way = way_of(stage, dt, drift)
                                if ti.static(stage.when == FILTERING):
                                    filtering = 1
                        if some > 0:
                            for part, steps in ti.static(work):
                                if is_in(step, steps):
                                    n = item_of(z, blocks)
                                    while n < size(part, groups, free, dependent, active, paired):
                                        act(
                                            part, body, n, free, free + dependent, active, alpha,
                                            g, up, lift, dt, drift, way, keep, filtering,
                                        )  # fmt: skip
                                        n += ti.max(1, blocks * BLOCK)
                            if ti.static(held > 0):
                                barriers += 1
                                wait_for_all(body.queue, z, barriers * blocks)

    return resident


def _energy(Body, real, laws, options: Options):
    """The kernel of elastic energies."""

    @ti.kernel
    def energy(body: Body, groups: ti.i32, out: ti.types.ndarray(dtype=real, ndim=1)):
        """out[cell] = sum_p V0 psi(F_p); out[particle] in the plain layout."""
        ih = body.numbers[PER_H]
        converged = body.numbers[CONVERGED]
        if ti.static(options.plain):
            for p in range(groups):
                out[p] = particle_energy(body, p, laws, ih, converged, options)
        elif ti.static(options.cells):
            for z in range(groups * LANES):
                out[z] = cell_energy(body, z, laws, ih, converged, options)
        else:
            for z in range(groups * STRIDE):
                if z % STRIDE == 0:
                    group_energy(body, z // STRIDE, out, laws, ih, converged, options)

    return energy


def _stress(Body, real, laws, options: Options):
    """The kernel of stresses."""

    @ti.kernel
    def stress(body: Body, groups: ti.i32, out: ti.types.ndarray(dtype=real, ndim=1)):
        """out[lane] = von Mises stress of the Cauchy stress P F^T / J, without viscosity."""
        ih = body.numbers[PER_H]
        converged = body.numbers[CONVERGED]
        if ti.static(options.plain):
            for p in range(groups):
                out[p] = particle_von_mises(body, p, laws, ih, converged, options)
        elif ti.static(options.cells):
            for z in range(groups * LANES):
                cell_von_mises(body, z, out, laws, ih, converged, options)
        else:
            for z in range(groups * STRIDE):
                if z % STRIDE == 0:
                    group_von_mises(body, z // STRIDE, out, laws, ih, converged, options)

    return stress
