"""Materials of two laws in one bake: each particle is simulated by its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gf_usd.core.arrays import Floats
from gf_usd.core.errors import UsageError
from gf_usd.core.frames.frame import Frame
from gf_usd.core.frames.particles import Particles
from gf_usd.core.materials.material import Material
from gf_usd.physics.solvers import make_solver
from gf_usd.verify.bodies import block, elastic, settings

LAWS = ("corotated", "neoHookean")
RATE = np.array([[4.0, 2.0, 0.0], [0.0, -3.0, 1.0], [2.0, 0.0, -1.0]])  # [1/s]


def twins() -> Particles:
    """Two equal blocks, bodies of their own, five cells apart."""
    one = block((0.0, 0.0, 0.0), (4, 3, 3), 0.25)
    n, both = len(one), {}
    for name, value in vars(one).items():
        whole = isinstance(value, np.ndarray) and len(value) == n
        both[name] = np.concatenate([value, value]) if whole else value
    shift = np.repeat([[0.0, 0.0, 0.0], [2.25, 0.0, 0.0]], n, axis=0)
    body = np.repeat([0, 1], n)
    both |= {"X": both["X"] + shift, "body": body, "volume": 2.0 * one.volume}
    return Particles(**both)


def frames(body: Particles, materials: tuple[Material, ...], solver: str) -> list[Frame]:
    chosen = settings("cpu", frames=5, substeps=60, solver=solver, stress=True)
    made = make_solver(chosen, body, materials, velocity=lambda X: X @ RATE.T)
    assert len(made.body.law.set.laws) == len({m.law for m in materials})
    return list(made.frames())


def each(law: str) -> Material:
    return elastic(E=1e4, nu=0.3, density=1000.0, law=law)


def close(a: Floats, b: Floats) -> None:
    """Kernels compiled apart round apart: 240 substeps by some 1e-7 each, of values of order 1."""
    np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-5 * np.abs(b).max())


@pytest.mark.slow
@pytest.mark.acceptance  # of three laws it is in test_plastic_flow
@pytest.mark.parametrize("solver", ["tl", "ul"])
def test_each_body_moves_as_in_a_bake_of_its_own_law(solver: str) -> None:
    body = twins()
    if solver == "ul":
        body = replace(body, body=None)
    mine = np.arange(len(body)) >= len(body) // 2
    both = replace(body, material=mine.astype(np.int64))
    alone = [frames(body, (each(law),), solver)[-1] for law in LAWS]
    mixed = frames(both, (each(LAWS[0]), each(LAWS[1])), solver)[-1]
    assert np.abs(alone[0].particles.F - alone[1].particles.F).max() > 0.01  # the laws differ
    for which, one in ((~mine, alone[0]), (mine, alone[1])):
        close(mixed.particles.x[which], one.particles.x[which])
        close(mixed.particles.F[which], one.particles.F[which])
        close(mixed.stress[which], one.stress[which])


@pytest.mark.slow
def test_energy_is_kept_and_a_border_inside_a_body_holds() -> None:
    """One body, half of each law: with the wrong energy for a half it would not be kept.

    Symplectic steps keep it to about (omega dt)^2, here 1e-3 of what is stored.
    """
    body = block((0.0, 0.0, 0.0), (4, 3, 3), 0.25)
    body = replace(body, material=(body.X[:, 0] > 0.5).astype(np.int64))
    seen = [f.health for f in frames(body, (each(LAWS[0]), each(LAWS[1])), "tl")]
    total = np.array([h.kinetic + h.elastic for h in seen])
    stored = max(h.elastic for h in seen)
    assert stored > 0.1 * total[0]
    assert np.abs(total - total[0]).max() < 2e-3 * stored


def test_a_law_that_there_is_none_of_is_refused() -> None:
    body = block((0.0, 0.0, 0.0), (2, 2, 2), 0.5)
    made = (each("corotated"), replace(each("corotated"), law="other"))
    with pytest.raises(UsageError, match="there is no law 'other'"):
        make_solver(settings("cpu"), body, made)
