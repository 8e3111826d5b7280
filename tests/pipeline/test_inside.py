"""The share of a surface that lies inside a body, against shapes whose share is known."""

from __future__ import annotations

import numpy as np
import pytest
from solids import cube, sphere, surface

from gf_usd.core.frames import Pose
from gf_usd.pipeline.inside import LOOKS, InsideMeasure, directions


def pose(points) -> Pose:
    n = len(points)
    return Pose(x=np.asarray(points, float), v=np.zeros((n, 3)), F=np.tile(np.eye(3), (n, 1, 1)))


@pytest.mark.parametrize("flip", [False, True])
def test_a_ball_that_sinks_into_another(flip):
    left = sphere(center=(-3.0, 0.0, 0.0), subdivisions=4, path="/Left")
    right = sphere(center=(3.0, 0.0, 0.0), subdivisions=4, path="/Right")
    if flip:
        right = surface(right.points, right.triangles[:, ::-1], path="/Right")
    measure = InsideMeasure([left, right], 0.1, 10)
    apart = {"/Left": pose(left.points), "/Right": pose(right.points)}
    assert measure.measure(9, apart) == measure.measure(9, apart)
    assert (measure.measure(9, apart).share, measure.measure(9, apart).depth) == (0.0, 0.0)
    # Unit balls whose centers are 1.6 apart: caps of height 0.2, a tenth of the area of each.
    sunk = {"/Left": pose(left.points + [2.2, 0, 0]), "/Right": pose(right.points - [2.2, 0, 0])}
    found = measure.measure(9, sunk)
    # 0.005: points are looked at 7e-3 off the surface, the triangles are 0.06 wide.
    assert found.share == pytest.approx(0.1, abs=0.005)
    # The cap's top is 0.4 deep; the next step is 0.5.
    assert 0.3 <= found.depth <= 0.5


def test_what_overlaps_at_rest_is_the_asset():
    one, other = cube((0.0, 0.0, 0.0), path="/One"), cube((0.5, 0.5, 0.5), path="/Two")
    measure = InsideMeasure([one, other], 0.1, 10)
    rest = {"/One": pose(one.points), "/Two": pose(other.points)}
    assert measure.measure(9, rest).share == 0.0


def test_a_few_frames_and_the_last_are_looked_at():
    ball = sphere(path="/Ball")
    asked = [i for i in range(50) if InsideMeasure([ball], 0.1, 50).asked(i)]
    assert asked[-1] == 49
    assert 0 not in asked
    assert LOOKS - 1 <= len(asked) <= LOOKS + 1
    assert [i for i in range(2) if InsideMeasure([ball], 0.1, 2).asked(i)] == [1]


def test_directions_are_spread_over_the_half_space():
    n = np.random.default_rng(0).normal(size=(20, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    for least in (0.0, 0.5):
        ways = np.stack(list(directions(n, least)))
        np.testing.assert_allclose(np.linalg.norm(ways, axis=2), 1.0, rtol=1e-12)
        assert ((ways * n).sum(2) > least).all()
        # Even: heights over a sphere's axis are spread evenly (Archimedes).
        np.testing.assert_allclose((ways.mean(0) * n).sum(1), 0.5 * (1.0 + least), atol=1e-9)
