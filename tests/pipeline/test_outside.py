"""Particles outside a mesh that is too coarse to follow them, against shares that are known."""

from __future__ import annotations

import numpy as np
import pytest
from solids import cube, resting_pose

from gf_usd.pipeline.measures.outside import OutsideMeasure

SPACING = 0.1
MIDDLES = (np.arange(10) + 0.5) * SPACING
X = np.stack(np.meshgrid(MIDDLES, MIDDLES, MIDDLES), -1).reshape(-1, 3)  # in the unit cube


def test_particles_above_a_lowered_top_are_outside():
    box = cube((0.0, 0.0, 0.0), path="/Box")
    measure = OutsideMeasure([box], X, SPACING)
    still = measure.measure({"/Box": resting_pose(box.points)}, X)
    assert (still.share, still.depth) == (0.0, 0.0)
    low = np.minimum(box.points, [np.inf, 0.6, np.inf])
    found = measure.measure({"/Box": resting_pose(low)}, X)
    # Layers at 0.65, 0.75, 0.85 and 0.95, of which the first is less than a spacing off.
    assert found.share == pytest.approx(0.3)
    assert found.depth == pytest.approx(0.35)


def test_particles_without_a_mesh_at_rest_do_not_count():
    box = cube((0.0, 0.0, 0.0), path="/Box")
    apart = X + [3.0, 0.0, 0.0]
    measure = OutsideMeasure([box], np.concatenate([X, apart]), SPACING)
    low = {"/Box": resting_pose(np.minimum(box.points, [np.inf, 0.6, np.inf]))}
    assert measure.measure(low, np.concatenate([X, apart])).share == pytest.approx(0.3)
    none = OutsideMeasure([box], apart, SPACING).measure(low, apart)
    assert (none.share, none.depth) == (0.0, 0.0)
