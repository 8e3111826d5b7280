"""Edges and corners of obstacles in bodies, and through them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from contact_scenes import contact_solver, obstacle
from solids import cube, settings

from gf_usd.core.frames.frame import Health
from gf_usd.physics.contact.obstacles.piercing import EVERY, Pierced
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.pipeline.health.log import HealthLog

LAST = 4  # frame, which is always measured
POST = 0.3  # [m] half the width of an obstacle
FALL = np.array([0.0, -9.81, 0.0])


def slab(thick: float, height: float) -> Any:
    """A meter wide, its underside at a height [m]."""
    box = cube(path="/Slab")
    points = np.asarray(box.points, float)
    points = (points - points.min(0)) / np.ptp(points, axis=0) - [0.5, 0.0, 0.5]
    return replace(box, points=points * [1.0, thick, 1.0] + [0.0, height, 0.0])


def post(top: float, half: float = POST, **options: Any) -> Any:
    """A box below a height [m]."""
    box = cube()
    points = np.asarray(box.points, float)
    points = 2.0 * (points - points.min(0)) / np.ptp(points, axis=0) - 1.0
    return obstacle(points * half + [0.0, top - half, 0.0], box.triangles, **options)


def still(thick: float, top: float, **options: Any) -> TotalLagrangian:
    """A slab at height 0.5 m over a post that ends below it, and is moved into it."""
    way = [(0.0, 0.0, 0.0)] * LAST + [(0.0, top - 0.4, 0.0)]
    return contact_solver(
        slab(thick, 0.5),
        colliders=(post(0.4, offset=way, **options),),
        particles=400,
        frames=LAST + 1,
    )


@pytest.mark.slow
@pytest.mark.parametrize("top", [0.58, 0.65], ids=["in", "deep"])
def test_how_deep_corners_are_in_a_body(top: float) -> None:
    """The lines from the corners leave the body at its underside: sqrt(3) times the way down."""
    found, spacing = pierced(0.3, top)
    assert found["pierced"] == pytest.approx(np.sqrt(3.0) * (top - 0.5), abs=0.3 * spacing)
    assert found["pierced_through"] is False
    assert found["pierced_pair"] == "the obstacle </Obstacle> is in <>"


@pytest.mark.parametrize("top", [0.6, 0.7])
def test_how_far_corners_come_out_of_a_body(top: float) -> None:
    """No vertex of the obstacle is in the slab, which is 0.05 m thick."""
    found, spacing = pierced(0.05, top)
    assert found["pierced"] == pytest.approx(np.sqrt(3.0) * (top - 0.5), abs=0.3 * spacing)
    assert found["pierced_through"] is True


def pierced(thick: float, top: float) -> tuple[dict[str, Any], float]:
    """What is measured of a post in a slab, and the spacing [m]."""
    solver = still(thick, top)
    assert solver.pairs is not None
    return solver.pairs.pierced(solver.state.view(), LAST), solver.particles.spacing


def test_what_is_below_a_body_is_not_in_it() -> None:
    solver = still(0.3, 0.49)
    assert solver.pairs is not None
    assert solver.pairs.pierced(solver.state.view(), LAST) == {"pierced": 0.0}


def test_what_is_in_the_body_at_the_start_does_not_count() -> None:
    solver = contact_solver(
        slab(0.3, 0.5),
        colliders=(post(0.65, offset=[(0.0, 0.0, 0.0)]),),
        particles=400,
        frames=LAST + 1,
    )
    assert solver.pairs is not None
    assert solver.pairs.pierced(solver.state.view(), LAST) == {"pierced": 0.0}


def test_pairs_without_contact_are_not_measured() -> None:
    way = [(0.0, 0.0, 0.0)] * LAST + [(0.0, 0.3, 0.0)]
    solver = contact_solver(
        slab(0.3, 0.5), colliders=(post(0.4, offset=way),), particles=400, frames=LAST + 1,
        through_colliders=frozenset([(0, 0)]),
    )  # fmt: skip
    assert solver.pairs is not None
    assert solver.pairs.pierced(solver.state.view(), LAST) == {"pierced": 0.0}


@pytest.mark.slow
def test_an_edge_that_comes_through_a_cloth_counts_as_overlap() -> None:
    """The post jumps through the cloth in the last frame. Contact pushes the samples of the cloth
    out of it, and the overlap of these was reported, a sixth of what is seen."""
    last = EVERY + 2
    way = [(0.0, 0.0, 0.0)] * last + [(0.0, 0.41, 0.0)]
    solver = contact_solver(
        slab(0.05, 0.5), colliders=(post(0.49, offset=way),), particles=400, material="jelly",
        frames=last + 1, fps=24.0,
    )  # fmt: skip
    frames = list(solver.frames())
    measured = [k for k, frame in enumerate(frames) if frame.health.pierced is not None]
    assert measured == [EVERY, last]
    found = frames[last].health
    assert found.pierced_through
    # from the top of the post, at 0.9 m, to the underside of the cloth, which stays at 0.5 m
    assert found.pierced == pytest.approx(0.4, abs=0.5 * solver.particles.spacing)
    assert found.overlap == found.pierced
    assert found.overlap_pair == "the obstacle </Obstacle> is in <>"
    assert found.overlap_names is None


def test_depths_in_a_frame_and_over_frames_are_compared_alike() -> None:
    found = [Pierced(depth=0.5), Pierced(depth=0.3, through=True), Pierced(depth=0.2)]
    frames = [Health(pierced=one.depth, pierced_through=one.through) for one in found]
    deepest = max(range(3), key=lambda k: found[k].weight)
    log = HealthLog(settings(), spacing=1.0, drop=0.0, radius=1.0, particles=1)
    for frame in frames:
        log.add(frame)
    assert log.summary()["pierced_frame"] == deepest == 1
