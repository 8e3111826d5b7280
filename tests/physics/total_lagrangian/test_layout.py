"""Values of particles go into the kernels' lanes and come back."""

from __future__ import annotations

import numpy as np
import pytest
from solids import ball

from gf_usd.physics.grid.reference.build import build_stencil
from gf_usd.physics.total_lagrangian import layout


@pytest.mark.parametrize("lay_out", [layout.batch_particles, layout.single_particles])
def test_what_is_put_into_lanes_comes_back(lay_out) -> None:
    particles, _ = ball(123)
    X = particles.X[np.arange(len(particles)) % 5 > 0][1:]  # cells of unequal number
    stencil = build_stencil(X, np.ones(len(X)), 2.0 * particles.lattice, particles.corner)
    batches = lay_out(stencil)
    values = np.random.default_rng(0).normal(size=(len(X), 9))
    lanes = layout.lanes(batches, values, fill=True)
    assert lanes.size > values.size, "some lanes are fillers"
    np.testing.assert_array_equal(layout.from_lanes(batches, lanes), values)
