"""What the paper's options do to the motion of a body, at the paper's 0.45 particles a cell."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from solids import preset_material, settings, solid, sphere

from gf_usd.core.frames.particles import SurfaceSamples
from gf_usd.core.neighbors import slopes
from gf_usd.geometry.sampling.particles import sample_solid
from gf_usd.physics.frame_loop import GAIN
from gf_usd.physics.total_lagrangian.shape_correction import wls_gradient
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.prepare.paper import PAPER_CAP, PAPER_CLAMP

ALL = {"wls": True, "procrustes": 0.02, "clamp": PAPER_CLAMP, "stress_cap": PAPER_CAP * 1100 * 9.81}


@cache
def cloud(seed: int = 0):
    """The paper's ball: 120 particles by rejection."""
    return sample_solid(solid(sphere()), particles=120, spacing=None, seed=seed, uniform=True)


def run(name="rubber", seed=0, velocity=(0.0, 0.0, 0.0), drop=False, **options):
    """The frames of the paper's set-up; a drop has its floor and contact at the particles."""
    body = cloud(seed)
    values = {
        "frames": 60, "fps": 60.0, "substeps": 10, "cell": body.radius / 4.0, "followers": False,
        "filter_rate": np.inf, "contact_rate": 2000.0, "mass": "lumped", **options,
    }  # fmt: skip
    samples = None
    if drop:
        values |= {
            "gravity": (0.0, -9.81, 0.0),
            "floor": 0.0,
            "lift": (0.0, 1.05, 0.0),
            "drag": 0.5,
        }
        samples = SurfaceSamples(X=body.X, area=body.V0 / body.spacing)
    material = preset_material(name, body, damping_time=0.0, law="corotated")
    solver = TotalLagrangian(
        body, [material], settings(**values), samples=samples, velocity=velocity
    )
    return list(solver.frames())


@pytest.mark.slow
def test_free_fall_stays_exact_with_all_of_them():
    # The mean is what neither moves, and without strain there is nothing to clip or to cut: only
    # single precision is left, as in test_free_flight.
    g = np.array([1.0, -9.81, 0.0])
    for frame in run(frames=13, gravity=tuple(g), **ALL):
        fallen = 0.5 * g * frame.time**2
        scale = max(1.0, float(np.linalg.norm(fallen)))
        moved = frame.particles.x - cloud().X
        np.testing.assert_allclose(moved, np.broadcast_to(fallen, moved.shape), atol=4e-6 * scale)
        assert abs(frame.health.injected) < 1e-6 * frame.health.mass * 9.81
        assert frame.health.clamped == frame.health.stress_capped == frame.health.rollbacks == 0


@pytest.mark.acceptance
@pytest.mark.slow  # compiles kernels of its own
def test_wls_gives_energy_to_a_free_body_and_its_absence_does_not():
    # docs/physics.md: the grid's force is not the adjoint of WLS.  In the Lagrangian limit
    # nothing takes what it gives.
    def flight(wls):
        # A breath of 0.1 radii a second, fastest at the surface.
        frames = run(velocity=lambda X: 0.1 * X, filter_rate=0.0, wls=wls, frames=61)
        return [f.health for f in frames]

    plain, fed = flight(False), flight(True)
    start = plain[0].energy
    for h in plain:
        assert h.energy == pytest.approx(start, rel=0.01)
        assert h.injected == 0.0
    assert fed[-1].energy > 5.0 * start
    assert sum(h.injected for h in fed) == pytest.approx(fed[-1].energy - start, rel=0.02)
    # Not a step of it is the integrator's: no frame was redone, and each is accounted for.
    scale = max(h.energy for h in fed)
    for before, after in pairwise(fed):
        assert after.rollbacks == 0
        assert abs(after.energy - before.energy - after.injected) < GAIN * scale


def spread(frames) -> float:
    """Largest over the frames of max U_yy - min U_yy, U of F = R U, F by WLS: Table 2's."""
    D = wls_gradient(cloud().X, 0.2 * cloud().radius)
    most = 0.0
    for frame in frames:
        F = slopes(D, frame.particles.x)
        _, s, Vt = np.linalg.svd(F)
        most = max(most, float(np.ptp(np.einsum("nji,nj,njk->nik", Vt, s, Vt)[:, 1, 1])))
    return most


@pytest.mark.slow
def test_a_stronger_shape_correction_leaves_less_of_the_shape_to_correct():
    # Rubber at rest in midair, thrown apart: the farther back each frame, the less strain is left.
    left = []
    for alpha in (0.0, 0.02, 0.04, 0.2):
        frames = run(velocity=lambda X: X * [-1.0, 2.0, -1.0], procrustes=alpha, frames=12)
        left.append(spread(frames))
        assert (frames[-1].health.injected < 0.0) == (alpha > 0.0)
    assert left == sorted(left, reverse=True)
    assert left[3] < 0.9 * left[0]


@pytest.mark.slow
def test_the_papers_drop_counts_what_is_clipped_and_cut():
    # Jelly is clipped and metal is cut, as in the paper's Table 1 and docs/physics.md; rubber
    # is neither.
    speed = (0.0, -7.0, 0.0)
    counts = {}
    for name, density in (("rubber", 1100.0), ("metal", 7800.0), ("jelly", 1000.0)):
        options = {**ALL, "procrustes": 0.0, "stress_cap": PAPER_CAP * density * 9.81}
        frames = run(name, drop=True, velocity=speed, frames=30, **options)
        health = [f.health for f in frames]
        assert all(h.rollbacks == 0 for h in health)
        assert all(h.min_stretch > 0.2 - 1e-5 for h in health), "F is clipped where frames end"
        assert max(h.penetration for h in health) > 0.0
        counts[name] = [max(getattr(h, c) for h in health) for c in ("clamped", "stress_capped")]
    assert counts["jelly"][0] > 0
    assert counts["metal"][1] > 0
    assert counts["rubber"][0] == 0
    assert all(n <= 120 for pair in counts.values() for n in pair)
