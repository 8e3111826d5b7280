"""The barrier between the stages of a launch on a GPU.

A kernel launch costs some 10 us there, as long as a stage of 10,000 particles. A launch therefore
contains many substeps, with only as many thread blocks as can be resident at the same time, which
can then wait for each other. Each block adds 1 to a counter and waits until all have done so:

    block barrier;  fence;  arrived++;  wait until arrived = blocks k, at the k-th barrier;  fence

Taichi compiles each kernel such that two of its blocks are resident on a multiprocessor (`minctasm`
in its code generator), and no more are started. If some blocks are not resident nevertheless, the
others stop waiting after TRIES and open all barriers; the flag STUCK is set, and the launch raises
an error.
"""

import taichi as ti

from gf_usd.physics.total_lagrangian.stages import APART, BLOCK, STUCK

WARP = 32
TRIES = 1 << 21  # a second or two
OPEN = 1 << 29  # above any count of arrivals in a launch


@ti.func
def item_of(z, blocks):
    """The first item of thread z; consecutive items go to warps of different blocks, to spread the
    load.
    """
    warp = z % BLOCK // WARP
    return (warp * blocks + z // BLOCK) * WARP + z % WARP


@ti.func
def wait_for_all(queue: ti.template(), z, target):
    """Wait until `target` arrivals are counted, one per block and barrier."""
    ti.simt.block.sync()
    if z % BLOCK == 0:
        ti.simt.grid.memfence()
        arrived = ti.atomic_add(queue[APART], 1) + 1
        tries = 0
        while arrived < target and tries < TRIES:
            arrived = ti.atomic_add(queue[APART], 0)
            tries += 1
        if arrived < target:
            queue[STUCK] = 1
            ti.atomic_max(queue[APART], OPEN)
        ti.simt.grid.memfence()
    ti.simt.block.sync()
