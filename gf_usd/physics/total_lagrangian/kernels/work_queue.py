"""The work queue of a launch on the CPU.

A parallel loop of Taichi's thread pool costs 30 to 65 us, as long as a substep of a thousand
particles, and a substep has several stages that run one after another. A whole frame is therefore
one launch, whose threads take work items from a queue. An item is one piece of one stage; items are
numbered consecutively through the launch.

    item = next++
    wait until done >= the number of items before the item's stage
    process the piece;  done++

An item waits only for items with lower numbers, all of which are already taken by a thread, so
there is no deadlock: a single thread takes all items in order and never waits. Pieces of a stage
are independent, so that the result does not depend on which thread takes which item.
"""

import taichi as ti

from gf_usd.physics.total_lagrangian.stages import APART, GRAIN, GROUP_GRAIN, GROUPS, STUCK

SPAN = 512  # least number of iterations per CPU thread in Taichi: one of them does the work
PIECES = 4  # pieces of a stage per thread: small pieces balance the load


@ti.func
def clear(queue: ti.template()):
    """Reset the queue before a launch."""
    queue[0] = 0
    queue[APART] = 0
    queue[STUCK] = 0


@ti.func
def take(queue: ti.template()):
    """Take the next work item."""
    return ti.atomic_add(queue[0], 1)


@ti.func
def wait(queue: ti.template(), before):
    """Spin until `before` pieces are done and their results are visible.

    The counter is read by an atomic addition of 0: a plain load may be hoisted out of the loop.
    """
    while ti.atomic_add(queue[APART], 0) < before:
        pass


@ti.func
def finish(queue: ti.template()):
    """Count a finished piece."""
    ti.atomic_add(queue[APART], 1)


@ti.func
def pieces_of(part: ti.template(), count, threads):
    """Number of pieces for `count` items; one with a single thread."""
    grain = ti.static(GROUP_GRAIN if part.items == GROUPS else GRAIN)
    most = PIECES * threads
    if threads == 1:
        most = 1
    return ti.max(1, ti.min(most, count // grain))


@ti.func
def piece(count, k, pieces):
    """The range of items of piece k."""
    size = (count + pieces - 1) // pieces
    return k * size, ti.min((k + 1) * size, count)
