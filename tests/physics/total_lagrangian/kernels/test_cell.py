"""The kernels of one thread a cell, as on GPUs, against those of eight cells at once."""

from __future__ import annotations

import numpy as np
import pytest
from solids import ball, preset_material, settings

from gf_usd.core.errors import GfUsdError
from gf_usd.physics.total_lagrangian.launch import Launches
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.physics.total_lagrangian.stages import BLOCK, STUCK
from gf_usd.system.taichi_runtime import resident_blocks

# f64: a rotation is iterated until eight cells are done, or one is: to the same 1e-12 or better.
EXACT = {"rtol": 1e-9, "atol": 1e-10}


def dropped(cells, law="neoHookean", real=np.float32, **changes):
    """A ball that meets the floor, turned and thrown, with viscosity and a filter."""
    body, samples = ball(400, radius=0.1)
    options = {
        "frames": 3, "gravity": (0.0, -9.81, 0.0), "floor": -0.1, "filter_rate": 50.0, "fps": 60.0,
        "threads": 2, "substeps": 40, **changes,
    }  # fmt: skip
    solver = TotalLagrangian(
        body, [preset_material("rubber", body, law=law)], settings(**options), samples=samples,
        velocity=(0.3, -2.0, 0.1), real=real, cells=cells,
    )  # fmt: skip
    if cells:
        solver.launches = Launches(solver.body, solver.state, "resident")
    frames = list(solver.frames())
    now = solver.state.view()
    return np.concatenate([now.u, now.v, [now.offset]]), frames


@pytest.mark.slow
def test_a_thread_a_cell_takes_the_same_sums_to_the_bit() -> None:
    (groups, _), (cells, frames) = dropped(False), dropped(True)
    assert frames[-1].health.penetration > 0.0
    assert np.array_equal(groups, cells)


@pytest.mark.slow  # each compiles kernels of its own
@pytest.mark.parametrize(
    "changes",
    [
        pytest.param({"law": "corotated", "stress": True}, marks=pytest.mark.acceptance),
        pytest.param({"law": "vonMises"}, marks=pytest.mark.acceptance),
        {
            "law": "corotated",
            "stress": True,
            "stress_cap": 3e3,
            "clamp": (0.9, 1.1),
            "wls": True,
            "procrustes": 0.02,
        },
    ],
    ids=["corotated", "plastic", "the paper's options"],
)
def test_laws_and_options_are_the_same_either_way(changes) -> None:
    (groups, ours), (cells, theirs) = (
        dropped(c, real=np.float64, **changes) for c in (False, True)
    )
    np.testing.assert_allclose(cells, groups, **EXACT)
    for a, b in zip(ours, theirs, strict=True):
        assert b.health.elastic == pytest.approx(a.health.elastic, rel=1e-9, abs=1e-12)
        assert (b.health.clamped, b.health.stress_capped) == (
            a.health.clamped,
            a.health.stress_capped,
        )
        if a.stress is not None and b.stress is not None:
            np.testing.assert_allclose(b.stress, a.stress, rtol=1e-8, atol=1e-8 * a.stress.max())


def test_a_launch_that_the_gpu_does_not_hold_at_once_is_an_error() -> None:
    body, _ = ball(100)
    solver = TotalLagrangian(
        body, [preset_material("rubber", body)], settings(frames=2), cells=True
    )
    launches = Launches(solver.body, solver.state, "resident")
    assert resident_blocks() == 0  # on a CPU one thread does it all
    assert launches._blocks((3, 40, 2, 0)) == 0

    def missing(*values: object) -> None:
        queue = solver.state.get("queue")
        queue[STUCK] = 1
        solver.state.put("queue", queue)

    launches._kernel = missing
    with pytest.raises(GfUsdError, match=rf"did not run 0 blocks of {BLOCK} threads") as raised:
        launches.run(solver.state, 4, 1e-4, 0)
    assert "--device cpu" in str(raised.value.hint)
