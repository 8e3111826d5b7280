"""Contact of flesh on a core that moves: what is pressed, and who pays for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from contact_scenes import contact_solver, half_space
from solids import cube

from gf_usd.core.frames.frame import Frame
from gf_usd.core.stage import Pin
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import clamp

FRAMES, GAP, DEEP = 9, 0.1, 0.16  # [m] over the ground at the start, and that the core goes down
CORE = 0.1  # [m] over the bottom of the body: its samples hang on held nodes, too


def pressed(on: str, **changes: float) -> tuple[TotalLagrangian, list[Frame]]:
    """A cube of 1 m with a core almost to its bottom, driven down on a floor or an obstacle."""
    body = cube((0.0, GAP, 0.0), (1.0, 1.0, 1.0))
    core = clamp(1, 0.0)  # its anchors are a tetrahedron at the origin
    way = np.append(np.linspace(0.0, DEEP, FRAMES), DEEP)
    path = core.anchors - way[:, None, None] * np.eye(3)[1]
    pin: Pin = replace(core, inside=lambda X: X[:, 1] > GAP + CORE, path=path, sharp=False)
    solver = contact_solver(
        body, particles=250, frames=FRAMES, pins=[pin], filter_rate=0.0,
        floor=0.0 if on == "floor" else None,
        colliders=() if on == "floor" else (half_space(),),
        changes={"friction": 0.0, "restitution": 1.0, "damping_time": 0.0, **changes},
    )  # fmt: skip
    return solver, list(solver.frames())


@pytest.mark.slow
@pytest.mark.parametrize("on", ["floor", pytest.param("obstacle", marks=pytest.mark.slow)])
def test_the_pin_pays_for_what_contact_stores(on: str) -> None:
    """Nothing is lost: E - W stays, to (w dt)^2 of what vibrates, of which contact is a part."""
    solver, frames = pressed(on)
    h = [f.health for f in frames]
    E = np.array([f.kinetic + f.elastic + f.contact for f in h])
    W = np.cumsum([f.work + f.injected for f in h])
    assert max(f.contact for f in h) > 1e-3 * E.max(), "it was pressed"
    np.testing.assert_allclose(E - W, 0.0, atol=5e-3 * E.max())
    assert solver.body.contact is not None
