"""A paste in the Updated Lagrangian solver is a fluid of Herschel and Bulkley."""

from __future__ import annotations

import numpy as np
import pytest

from gf_usd.core.materials.material import Material
from gf_usd.core.materials.presets import presets
from gf_usd.physics.updated_lagrangian.solver import UpdatedLagrangian
from gf_usd.verify.bodies import block, settings

RATE = 2.0  # [1/s] of simple shear
END, SUBSTEPS = 2e-3, 1000  # [s]: a strain of 0.004


@pytest.mark.slow
@pytest.mark.parametrize("name", ["honey", "toothpaste"])
def test_sheared_at_a_rate_it_bears_its_yield_stress_and_its_viscosity(name: str) -> None:
    """sigma = Y + eta (da/dt)^n with da/dt = rate / sqrt(3), once the start is forgotten.

    It is forgotten in some 2e-4 s; elastic strains before that are less than those of the path.
    """
    preset = presets()[name].material(1.0)
    # so heavy that its stress does not move it: its strain follows its velocity
    made = Material(**{**preset.__dict__, "density": 1e12})
    body = block((-0.5, -0.5, -0.5), (2, 2, 2), 0.5)
    chosen = settings(
        "cpu",
        frames=2,
        fps=1.0 / END,
        substeps=SUBSTEPS,
        followers=False,
        solver="ul",
        stress=True,
    )
    shear = RATE * np.eye(3)[[1]].T @ np.eye(3)[[0]]
    run = UpdatedLagrangian(body, [made], chosen, velocity=lambda X: X @ shear)
    *_, last = run.frames()
    own = made.parameters
    n, rate = own["flow_exponent"], RATE / np.sqrt(3.0)
    expected = own["yield_stress"] + own["flow_viscosity"] * rate**n
    # of the stress, by the slope of the flow curve at the rate
    slope = n * own["flow_viscosity"] * rate ** (n - 1.0)
    left = np.exp(-END / (slope / (3.0 * made.mu)))
    assert left < 2e-3
    assert last.stress is not None
    # The last half of a substep strains without a return.
    half = np.sqrt(3.0) * made.mu * RATE * 0.5 * END / SUBSTEPS
    np.testing.assert_allclose(last.stress, expected, rtol=2e-3 + RATE * END, atol=half)
    assert (last.health.plastic_dissipation or 0.0) > 0.0
