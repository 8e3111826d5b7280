"""A launch shared out among threads by tickets.

A loop over Taichi's thread pool costs 30 to 65 us, what a substep of a thousand particles takes,
and a substep is a handful of stages that must follow each other.  So a frame is one launch: its
threads draw tickets, one for each piece of each stage, numbered through the launch.

    ticket = next++
    wait until done >= the number of tickets before the ticket's stage
    do the piece;  done++

A ticket waits only for lower ones, and whoever holds one works at it, so nothing locks up: a single
thread draws them all and never waits.  Pieces do not race; who drew what changes no bit.
"""

import taichi as ti

from gf_usd.physics.total_lagrangian.stages import APART, GRAIN, GROUP_GRAIN, GROUPS

SPAN = 512  # Taichi gives a CPU thread at least so many iterations: one of them does all
PIECES = 4  # of a stage for each thread: small enough that the last one is soon done


@ti.func
def clear(gate: ti.template()):
    """Before a launch draws its first ticket."""
    gate[0] = 0
    gate[APART] = 0


@ti.func
def take(gate: ti.template()):
    """The next ticket."""
    return ti.atomic_add(gate[0], 1)


@ti.func
def wait(gate: ti.template(), before):
    """Until so many pieces are done, and what they wrote can be read.

    The counter is read by adding nothing to it: a plain load may be taken out of the loop.
    """
    while ti.atomic_add(gate[APART], 0) < before:
        pass


@ti.func
def finish(gate: ti.template()):
    """A piece is done."""
    ti.atomic_add(gate[APART], 1)


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
