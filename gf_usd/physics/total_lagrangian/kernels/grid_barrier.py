"""The barrier between the stages of a launch on a GPU.

A launch of a kernel costs some 10 us there, as long as a stage of 10,000 particles.  So a launch
has many substeps, and as many threads as the multiprocessors hold at once: all of them are at work
until the last stage is done, and can wait for each other.  A block that has arrived adds 1 to a
counter and waits until all have:

    block barrier;  fence;  arrived++;  wait until arrived = blocks k, at the k-th barrier;  fence

Taichi compiles each kernel so that a multiprocessor holds two of its blocks (`minctasm` in its code
generator), and no more are started.  Where blocks are missing all the same, the others give up
after TRIES and open all barriers; STUCK says so, and the launch is an error.
"""

import taichi as ti

from gf_usd.physics.total_lagrangian.stages import APART, BLOCK, STUCK

WARP = 32
TRIES = 1 << 21  # a second or two
OPEN = 1 << 29  # more than blocks ever arrive in a launch


@ti.func
def item_of(z, blocks):
    """The first item of thread z: warps of a block are spread, so that few items use them all."""
    warp = z % BLOCK // WARP
    return (warp * blocks + z // BLOCK) * WARP + z % WARP


@ti.func
def wait_for_all(queue: ti.template(), z, target):
    """Until `target` blocks have arrived, each of them once at every barrier."""
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
