"""Solid bodies and flowing ones in contact: what is conserved, and what is carried."""

from __future__ import annotations

import numpy as np
import pytest
from mixed_scenes import mixed_solver
from solids import cube, sphere

RADIUS, SPEED, FRAMES = 0.1, 2.0, 12


def crash(flowing: str, real: type, particles: int = 600):
    """A ball of rubber that runs off center into a block that flows, in free space."""
    return mixed_solver(
        sphere(RADIUS, (0.0, 0.02, 0.0), 3, path="/Ball"),
        cube((0.12, -0.1, -0.1), 0.2, path="/Block"),
        materials=("rubber", flowing), particles=particles,
        velocity=[(SPEED, 0.0, 0.0), (0.0, 0.0, 0.0)],
        frames=FRAMES, fps=120.0, real=real, filter_rate=0.0,
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    ("flowing", "real"),
    [
        pytest.param("dry-sand", np.float64, marks=pytest.mark.acceptance),
        pytest.param("water", np.float64, marks=pytest.mark.acceptance),
        ("powder-snow", np.float32),
    ],
)
def test_momentum_and_angular_momentum_are_kept(flowing: str, real: type) -> None:
    """Both to rounding: no step of the exchange has another error.

    Each of n steps rounds the momentum of each particle or node by eps / 2 of it at most, and the
    moment of a kick is found from positions that are rounded to eps: a substep, and two kicks.
    """
    run = crash(flowing, real)
    seen = [f.health for f in run.frames()]
    p = np.array([h.momentum for h in seen])
    L = np.array([h.angular_momentum for h in seen])
    start = np.linalg.norm(p[0])
    steps = 3 * sum(h.substeps for h in seen)
    eps = float(np.finfo(real).eps)
    assert steps > 300
    assert np.abs(p - p[0]).max() < 0.5 * steps * eps * start
    # its arms are as long as the scene, .4 m
    assert np.abs(L - L[0]).max() < 0.5 * steps * eps * start * 0.4
    # it is a crash: the ball gave the block a sixth of its momentum and more (snow is light)
    ball = run.solid.state.view().momentum.sum(0)
    assert ball[0] < start * 5.0 / 6.0
    assert sum(h.rollbacks for h in seen) == 0
    assert max(h.overlap for h in seen) < 0.5 * run.particles.spacing
    # nothing is gained: what new planes give is reported, and little
    energy = np.array([h.kinetic + h.elastic + h.contact for h in seen])
    given = np.array([h.injected for h in seen])
    assert (np.diff(energy) < given[1:] + 2e-3 * energy[0]).all()
    assert np.abs(given).sum() < 0.01 * energy[0]


@pytest.mark.slow
@pytest.mark.acceptance
def test_a_block_on_sand_presses_the_floor_with_the_weight_of_both() -> None:
    """At rest the springs of the floor under the sand carry the weights of sand and block, and the
    planes of the block's underside carry that of the block."""
    run = mixed_solver(
        cube((-0.15, 0.0, -0.15), (0.3, 0.1, 0.3), path="/Sand"),
        cube((-0.06, 0.101, -0.06), 0.12, path="/Block"),
        materials=("wet-sand", "rubber"), particles=500,
        gravity=(0.0, -9.81, 0.0), floor=0.0, frames=30, fps=24.0, filter_rate=30.0, drag=2.0,
    )  # fmt: skip
    *_, last = run.frames()
    flow, contact = run.flow, run.flow.body.contact
    assert contact is not None
    planes = flow.planes
    assert planes is not None
    x = flow.state.sample_motion()[0] + flow.state.offset
    depth = np.maximum(0.0, -x[:, 1])
    deeper = np.maximum(0.0, depth - contact.linear)
    floor = float(contact.stiffness @ (depth + contact.hardening * deeper**3))
    weight = 9.81 * last.health.mass
    solid = 9.81 * float(run.solid.body.m.sum())
    assert last.health.kinetic < 1e-4 * weight * 0.1
    assert floor == pytest.approx(weight, rel=0.03)
    planes.locate(x)
    q, n = planes.places()
    d = np.maximum(0.0, ((q - x[planes.rows]) * n).sum(1))
    force = planes.values[:, 0] * d * (1.0 + planes.hardening * d**2)
    # the planes push the sand down by what they carry
    assert float(-(force * n[:, 1]).sum()) == pytest.approx(solid, rel=0.05)
