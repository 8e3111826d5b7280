"""The work queue of a launch.

A loop over Taichi's thread pool costs 30 to 65 us, as long as a substep of a thousand particles,
and a substep is a handful of stages that must follow each other.  So a frame is one launch, whose
threads take work items from a queue: one for each piece of each stage, numbered through the launch.

    item = next++
    wait until done >= the number of items before the item's stage
    do the piece;  done++

An item waits only for items with lower numbers, all of which a thread has taken, so there is no
deadlock: a single thread takes them all and never waits.  Pieces do not race, so the result does
not depend on which thread takes which item.
"""

import taichi as ti

from gf_usd.physics.total_lagrangian.stages import APART, GRAIN, GROUP_GRAIN, GROUPS, STUCK

SPAN = 512  # Taichi gives a CPU thread at least so many iterations: one of them does all
PIECES = 4  # of a stage for each thread: small enough that the last one is soon done


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
    """Until so many pieces are done, and what they wrote can be read.

    The counter is read by adding nothing to it: a plain load may be taken out of the loop.
    """
    while ti.atomic_add(queue[APART], 0) < before:
        pass


@ti.func
def finish(queue: ti.template()):
    """A piece is done."""
    ti.atomic_add(queue[APART], 1)


@ti.func
def pieces_of(part: ti.template(), count, threads):
    """How many pieces so many items make; one where a thread is alone."""
    grain = ti.static(GROUP_GRAIN if part.items == GROUPS else GRAIN)
    most = PIECES * threads
    if threads == 1:
        most = 1
    return ti.max(1, ti.min(most, count // grain))


@ti.func
def piece(count, k, pieces):
    """The first item of piece k, and the one behind its last."""
    size = (count + pieces - 1) // pieces
    return k * size, ti.min((k + 1) * size, count)
