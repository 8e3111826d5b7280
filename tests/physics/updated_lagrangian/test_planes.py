"""What flows against obstacles."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from contact_scenes import half_space, obstacle
from solids import cube

from gf_usd.core.frames.particles import SurfaceSamples
from gf_usd.core.materials.physical import PHYSICAL
from gf_usd.core.stage import Collider, ContactSetup
from gf_usd.physics.updated_lagrangian.solver import UpdatedLagrangian
from gf_usd.verify.bodies import block, settings

G = 9.81


def flow(
    *colliders: Collider, name: str = "dry-sand", through: bool = False,
    changes: dict[str, Any] | None = None, **options: Any,
) -> UpdatedLagrangian:  # fmt: skip
    """A block of 64 particles of .2 m a side, whose lowest are .025 m over the origin."""
    body = block((-0.1, 0.0, -0.1), (2, 2, 2), 0.1)
    made = replace(PHYSICAL[name].material(1.0), **(changes or {}))
    setup = ContactSetup(
        skins=(), colliders=colliders,
        through_colliders=frozenset({(0, 0)} if through else ()),
    )  # fmt: skip
    return UpdatedLagrangian(
        body, [made],
        settings("cpu", **{"gravity": (0.0, -G, 0.0), "solver": "ul", "floor": None, **options}),
        samples=SurfaceSamples(X=body.X, area=body.V0 / body.spacing), contact_setup=setup,
    )  # fmt: skip


@pytest.mark.slow
def test_sand_slides_down_a_frictionless_obstacle_as_a_body_does() -> None:
    """s = g sin(a) t^2 / 2 from where it has landed; before, it falls through a gap alone."""
    run = flow(half_space(20.0, -0.06, friction=0.0), frames=13, fps=24.0)
    down = -np.array([np.cos(np.radians(20.0)), np.sin(np.radians(20.0)), 0.0])
    frames = list(run.frames())
    s = np.array([f.particles.x.mean(0) @ down for f in frames])
    t = np.array([f.time for f in frames])
    # gravity along the slope acts in the air as well: nothing else has that direction
    assert s - s[0] == pytest.approx(0.5 * G * np.sin(np.radians(20.0)) * t**2, rel=1e-3, abs=1e-5)
    up = np.array([-np.sin(np.radians(20.0)), np.cos(np.radians(20.0)), 0.0])
    lowest = min(float((f.particles.x @ up).min()) for f in frames)
    assert lowest > -0.06 - 0.5 * run.particles.spacing


@pytest.mark.slow
def test_a_rising_obstacle_carries_what_lies_on_it_and_its_work_is_counted() -> None:
    """In the end everything moves at the obstacle's speed, and energy is what its work gave less
    what sand lost."""
    frames, fps, speed = 25, 24.0, 0.3
    way = np.zeros((frames, 3))
    way[:, 1] = speed * np.arange(frames) / fps - 0.05
    tray = cube((-1.0, -1.0, -1.0), (2.0, 1.0, 2.0))
    run = flow(
        obstacle(tray.points, tray.triangles, offset=way, friction=0.5), frames=frames, fps=fps
    )
    seen = list(run.frames())
    v = seen[-1].particles.v[:, 1]
    assert v.mean() == pytest.approx(speed, rel=0.02)
    energy = [h.energy for h in (f.health for f in seen)]
    work = sum(f.health.work for f in seen)
    lost = sum(f.health.plastic_dissipation or 0.0 for f in seen)
    given = sum(f.health.injected for f in seen)
    gain = energy[-1] - energy[0]
    assert work > 0.5 * seen[0].health.mass * speed**2
    # damped contact and the transfers take the rest; nothing is gained
    assert gain <= work + given - lost + 1e-3 * abs(energy[0])
    assert abs(given) < 0.01 * work


@pytest.mark.slow
def test_no_sample_faces_what_it_passes_through() -> None:
    tray = cube((-1.0, -1.0, -1.0), (2.0, 1.0, 2.0))
    run = flow(obstacle(tray.points, tray.triangles), through=True)
    run.begin(1)
    run.detect(0.0, run.frame_time)
    assert run.planes is not None
    assert not len(run.planes.rows)
    other = flow(obstacle(tray.points, tray.triangles))
    other.begin(1)
    other.detect(0.0, other.frame_time)
    assert other.planes is not None
    assert len(other.planes.rows) == 32, "the two lower layers are nearer than two spacings"
