"""The share of a surface that lies inside a body, against shapes whose share is known."""

from __future__ import annotations

import numpy as np
import pytest
from solids import cube, resting_pose, sphere, surface

from gf_usd.pipeline.measures.inside import MEASURES, InsideMeasure, directions


@pytest.mark.slow
@pytest.mark.parametrize("flip", [False, True])
def test_a_ball_that_sinks_into_another(flip):
    left = sphere(center=(-3.0, 0.0, 0.0), subdivisions=4, path="/Left")
    right = sphere(center=(3.0, 0.0, 0.0), subdivisions=4, path="/Right")
    if flip:
        right = surface(right.points, right.triangles[:, ::-1], path="/Right")
    measure = InsideMeasure([left, right], 0.1, 10)
    apart = {"/Left": resting_pose(left.points), "/Right": resting_pose(right.points)}
    assert measure.measure(9, apart) == measure.measure(9, apart)
    assert (measure.measure(9, apart).share, measure.measure(9, apart).depth) == (0.0, 0.0)
    # Unit balls whose centers are d = 1.6 apart.  What of one is more than 0.05 inside the other is
    # no farther than 0.95 from its center: a cap of the height 1 - (1 + d^2 - 0.95^2) / 2 d.
    cap = 1.0 - (1.0 + 1.6**2 - 0.95**2) / 3.2
    sunk = {
        "/Left": resting_pose(left.points + [2.2, 0, 0]),
        "/Right": resting_pose(right.points - [2.2, 0, 0]),
    }
    found = measure.measure(9, sunk)
    # 0.005: points are looked at 7e-3 off the surface, the triangles are 0.06 wide.
    assert found.share == pytest.approx(0.5 * cap, abs=0.005)
    # The cap's top is 0.4 deep; the next step is 0.5.
    assert 0.3 <= found.depth <= 0.5


@pytest.mark.parametrize(("by", "share"), [(0.3, 0.0), (0.7, 1.0)])
def test_what_is_pressed_into_a_neighbor_counts_from_half_a_spacing(by, share):
    """Two boxes with as much of the upper one in the lower as contact leaves, and with more."""
    lower, upper = cube((0.0, 0.0, 0.0), path="/Lower"), cube((0.2, 2.0, 0.2), path="/Upper")
    lower = surface(lower.points * [1.4, 1.0, 1.4], lower.triangles, path="/Lower")
    spacing = 0.1
    measure = InsideMeasure([lower, upper], spacing, 10)
    sunk = upper.points - [0.0, 1.0 + spacing * by, 0.0]
    found = measure.measure(9, {"/Lower": resting_pose(lower.points), "/Upper": resting_pose(sunk)})
    # Of the upper box its underside; of the top of the lower one, two triangles, what lies under
    # it.  Pieces count whole: those at the rim are a spacing wide.  So do those of the sides of the
    # upper one that reach down below the top by less than a spacing.
    area = 6.0 + 2.0 * 1.4**2 + 4.0 * 1.4
    assert found.share == pytest.approx(share * 2.0 / area, abs=2.0 * 4.0 * spacing / area)
    assert (found.share == 0.0) == (share == 0.0)
    assert found.depth >= spacing * by - 1e-9, "the depth is reported even if it does not count"


@pytest.mark.parametrize("gap", [1e-4, 1e-2])
def test_what_touches_is_not_inside(gap):
    """Two boxes of one mesh that are 1e-3 and 0.1 spacings apart."""
    lower, upper = cube((0.0, 0.0, 0.0)), cube((0.0, 3.0, 0.0))
    points = np.concatenate([lower.points, upper.points])
    both = surface(points, np.concatenate([lower.triangles, upper.triangles + 8]), path="/Both")
    down = np.repeat([[0.0, 0.0, 0.0], [0.0, 2.0 - gap, 0.0]], 8, axis=0)
    found = InsideMeasure([both], 0.1, 10).measure(9, {"/Both": resting_pose(points - down)})
    assert (found.share, found.depth) == (0.0, 0.0)


def test_a_thin_plate_in_a_ball_is_inside():
    """Behind its face it is out of the plate, but not out of the ball."""
    ball = sphere(subdivisions=4, path="/Ball")
    plate = cube((-0.3, -0.01, -0.3), path="/Plate")
    flat = (plate.points - [-0.3, -0.01, -0.3]) * [0.6, 0.02, 0.6] - [0.3, 0.01, 0.3]
    plate = surface(flat + [0.0, 5.0, 0.0], plate.triangles, path="/Plate")
    measure = InsideMeasure([ball, plate], 0.1, 10)
    found = measure.measure(9, {"/Ball": resting_pose(ball.points), "/Plate": resting_pose(flat)})
    mine = 2.0 * 0.6 * 0.6 + 4.0 * 0.6 * 0.02
    assert found.share == pytest.approx(mine / (mine + 4.0 * np.pi), rel=0.01)


def test_what_overlaps_at_rest_is_the_asset():
    one, other = cube((0.0, 0.0, 0.0), path="/One"), cube((0.5, 0.5, 0.5), path="/Two")
    measure = InsideMeasure([one, other], 0.1, 10)
    rest = {"/One": resting_pose(one.points), "/Two": resting_pose(other.points)}
    assert measure.measure(9, rest).share == 0.0


def test_a_few_frames_and_the_last_are_looked_at():
    ball = sphere(path="/Ball")
    measured = [i for i in range(50) if InsideMeasure([ball], 0.1, 50).is_measured(i)]
    assert measured[-1] == 49
    assert 0 not in measured
    assert MEASURES - 1 <= len(measured) <= MEASURES + 1
    assert [i for i in range(2) if InsideMeasure([ball], 0.1, 2).is_measured(i)] == [1]
    open_end = InsideMeasure([ball], 0.1, 50, open_end=True)
    assert [i for i in range(50) if open_end.is_measured(i)] == [8, 16, 32, 49]


def test_directions_are_spread_over_the_half_space():
    n = np.random.default_rng(0).normal(size=(20, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    for least in (0.0, 0.5):
        ways = np.stack(list(directions(n, least)))
        np.testing.assert_allclose(np.linalg.norm(ways, axis=2), 1.0, rtol=1e-12)
        assert ((ways * n).sum(2) > least).all()
        # Even: heights over a sphere's axis are spread evenly (Archimedes).
        np.testing.assert_allclose((ways.mean(0) * n).sum(1), 0.5 * (1.0 + least), atol=1e-9)
