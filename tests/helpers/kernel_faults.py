"""Faults in kernels, put there by name; as a program it runs `gf-usd` with one of them.

    python kernel_faults.py "gravity upward" verify --case free-fall

A function that kernels call, or a value that they are built with, is replaced before any is built,
so that the fault is in what Taichi compiles, and in this process alone.
"""

import sys
from dataclasses import dataclass
from typing import Any

import taichi as ti

from gf_usd.physics.contact import kernels as contact
from gf_usd.physics.contact.kernels import floor_force
from gf_usd.physics.grid import dependent_nodes
from gf_usd.physics.grid.dependent_nodes import mirrored
from gf_usd.physics.laws import corotated, neo_hookean
from gf_usd.physics.laws.corotated import pk1 as corotated_pk1
from gf_usd.physics.laws.neo_hookean import pk1 as neo_hookean_pk1
from gf_usd.physics.laws.simd3x3 import let, put, unrolled
from gf_usd.physics.total_lagrangian.kernels import nodes, simd, substep
from gf_usd.physics.total_lagrangian.kernels.nodes import block_sum, move_node
from gf_usd.physics.total_lagrangian.kernels.simd import (
    LINES,
    affine,
    affine_transposed,
    differences,
    filter_batch,
)


@unrolled
def turned_differences(q):
    """b = q0 - q2 for q2 - q0, along each axis."""
    differences(q)
    for lines in LINES:
        for _, j, _ in lines:
            put(q[j], 0.0 - q[j])


@unrolled
def half_of_apic(q, s, h, m, out):
    """2/h^2 for 4/h^2 in the column of C_p along axis 1."""
    filter_batch(q, s, h, m, out)
    x, y, z = let([(s[a], h[a], (3.0 - 4.0 * s[a] * s[a]) * s[a]) for a in range(3)])
    slopes = []
    for i in range(0, 27, 9):
        rows = [affine(q[j : j + 3], *z)[0] for j in range(i, i + 9, 3)]
        slopes.append(affine(rows, *y)[1])
    half = affine_transposed((0.0 - 2.0 / 64.0) * m * affine(slopes, *x)[0], None, *x)
    for i in range(3):
        for j, along in enumerate(affine_transposed(0.0 * half[i], half[i], *y)):
            for n, one in enumerate(affine_transposed(along, None, *z), 9 * i + 3 * j):
                put(out[n], out[n] + one)


@ti.func
def neo_hookean_without_lambda(F, q, converged):
    return neo_hookean_pk1(F, [q[0], 0.0 * q[1]], converged)


@ti.func
def corotated_with_half_mu(F, q, converged):
    return corotated_pk1(F, [0.5 * q[0], q[1]], converged)


@ti.func
def move_upward(
    body: ti.template(), node, contact, g, dt, drift, keep, alpha, filtering, options: ti.template()
):
    move_node(body, node, contact, 0.0 - g, dt, drift, keep, alpha, filtering, options)


@ti.func
def move_without_body_force(
    body: ti.template(), node, contact, g, dt, drift, keep, alpha, filtering, options: ti.template()
):
    b = ti.Vector([body.acceleration[3 * node + d] for d in range(3)])
    move_node(body, node, contact, g - b, dt, drift, keep, alpha, filtering, options)


@ti.func
def floor_without_damping(body: ti.template(), s, d, v, up, dt):
    floor_force(body, s, d, v - v.dot(up) * up, up, dt)


@ti.func
def sum_of_free_nodes(body: ti.template(), node, filtering, options: ti.template()):
    return block_sum(body, node, options)


@dataclass(frozen=True)
class Fault:
    """What a module has by a name, what takes its place, and which module reads it."""

    home: Any
    name: str
    wrong: Any
    case: str  # of `gf-usd verify`

    def put(self) -> None:
        """Do the harm.  Raises KeyError where there is nothing of that name."""
        held = vars(self.home)
        if self.name not in held:
            raise KeyError(self.name)
        held[self.name] = self.wrong


FAULTS = {
    "slope of the spline turned round": Fault(simd, "differences", turned_differences, "patch"),
    "2/h^2 for 4/h^2 in APIC": Fault(simd, "filter_batch", half_of_apic, "spin-apic"),
    "no lambda in the Neo-Hookean stress": Fault(
        neo_hookean, "pk1", neo_hookean_without_lambda, "law-neoHookean"
    ),
    "half the shear modulus in the corotated stress": Fault(
        corotated, "pk1", corotated_with_half_mu, "law-corotated"
    ),
    "gravity upward": Fault(substep, "move_node", move_upward, "free-fall"),
    # no launch ends a frame
    "a whole drift at the end of a frame": Fault(substep, "CLOSES", 0, "free-fall"),
    "no damping in the floor": Fault(contact, "floor_force", floor_without_damping, "bounce"),
    "pins mirror without the sign": Fault(
        dependent_nodes, "mirrored", lambda *given: -mirrored(*given), "bar"
    ),
    "dependent nodes keep their forces": Fault(nodes, "node_sum", sum_of_free_nodes, "spin"),
    "no body force": Fault(substep, "move_node", move_without_body_force, "cantilever"),
}

if __name__ == "__main__":
    from gf_usd.cli.main import run
    from gf_usd.system.taichi_runtime import MERGE_OPTIONS

    MERGE_OPTIONS[True] = MERGE_OPTIONS[False]  # to compile quickly, as in tests/conftest.py
    FAULTS[sys.argv.pop(1)].put()
    run()
