"""Step, moduli and sizes are arguments of the kernels: another body compiles nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from solids import preset_material
from strained_ball import made

from gf_usd.physics.total_lagrangian.solver import TotalLagrangian


@pytest.mark.slow
def test_another_step_stiffness_and_count_compile_nothing() -> None:
    first = made(np.float32)
    first.advance(1, 2)
    kernel = first.body.kernels.queued._primal
    before = len(kernel.compiled_kernels)
    assert before >= 1
    p = first.particles
    half = slice(0, len(p) // 2)
    fewer = replace(
        p, X=p.X[half], V0=p.V0[half], material=p.material[half],
        orientation=p.orientation[half], scale=p.scale[half], color=p.color[half],
        opacity=p.opacity[half], surface=p.surface[half],
    )  # fmt: skip
    stiffer = preset_material("rubber", p, damping_time=0.0, youngs_modulus=7.7e5, law="corotated")
    other = TotalLagrangian(fewer, [stiffer], replace(first.settings, fps=31.0), real=np.float32)
    assert other.body.kernels is first.body.kernels
    other.advance(1, 5)
    assert len(kernel.compiled_kernels) == before
