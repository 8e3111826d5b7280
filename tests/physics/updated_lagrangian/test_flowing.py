"""What flows without limit: each particle meets the floor where it is."""

from __future__ import annotations

import numpy as np
import pytest
from slow_parameters import slow_but

from gf_usd.core.frames.particles import SurfaceSamples
from gf_usd.core.materials.physical import PHYSICAL
from gf_usd.core.materials.presets import find_preset
from gf_usd.physics.updated_lagrangian.solver import UpdatedLagrangian
from gf_usd.verify.bodies import block, settings


def solver(name: str = "dry-sand", **changes) -> UpdatedLagrangian:
    """A block of 64 particles of a preset over a floor, each of which is a contact sample."""
    body = block((0.0, 0.05, 0.0), (2, 2, 2), 0.1)
    return UpdatedLagrangian(
        body, [PHYSICAL[name].material(1.0)],
        settings("cpu", **{"floor": 0.0, "gravity": (0.0, -9.81, 0.0), "solver": "ul", **changes}),
        samples=SurfaceSamples(X=body.X, area=body.V0 / body.spacing),
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", slow_but(["dry-sand", "honey", "water"], "dry-sand"))
def test_the_points_of_a_mesh_have_the_velocities_that_they_move_at(name: str) -> None:
    """In a flow that turns and shears: what of it is plastic does not carry the points along."""
    body = block((-0.1, -0.1, -0.1), (2, 2, 2), 0.1)
    points = 0.14 * np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), -1).reshape(-1, 3)
    gradient = np.array([[0.0, 4.0, 0.0], [-2.0, 0.0, 1.0], [0.0, 3.0, 0.0]])
    run = UpdatedLagrangian(
        body, [find_preset(name).material(1.0, None)],
        settings("cpu", solver="ul", frames=5, fps=480.0, time_codes_per_second=480.0),
        embedded={"a": points}, velocity=lambda X: X @ gradient.T,
    )  # fmt: skip
    before, now, after = (f.embedded["a"] for f in list(run.frames())[2:5])
    moved = 240.0 * (after.x - before.x)
    speed = np.linalg.norm(moved, axis=1).mean()
    # 0.33 with the whole gradient; what is left, .001, is elastic
    assert np.linalg.norm(now.v - moved, axis=1).mean() < 0.01 * speed


@pytest.mark.parametrize("name", ["dry-sand", "wet-snow", "honey"])
def test_particles_feel_the_floor_where_they_are_however_far_they_have_come(name: str) -> None:
    """Not at the mean of where those have gone to that were their neighbors at rest."""
    run = solver(name)
    state, embedding = run.state, run.body.embedding
    assert embedding is not None
    n = len(run.particles)
    moved = np.random.default_rng(0).uniform(-1.0, 1.0, (n, 3)).astype(np.float32)
    state.put("x", moved)
    state.put("F", np.tile(np.diag([3.0, 0.2, 5.0]).ravel(), n))
    assert np.array_equal(embedding.pose(*state.motion()).x, moved.astype(float))
