"""Whether obstacles hide a body from a camera."""

from __future__ import annotations

import numpy as np
import pytest

from gf_usd.core.scene import Camera
from gf_usd.view.visibility import Occluded, best_view, mostly_hidden

FRONT = Camera(eye=(0.0, 0.0, 10.0), target=(0.0, 0.0, 0.0), up=(0.0, 1.0, 0.0), fov=40.0)
BACK = Camera(eye=(0.0, 0.0, -10.0), target=(0.0, 0.0, 0.0), up=(0.0, 1.0, 0.0), fov=40.0)
AWAY = Camera(eye=(0.0, 0.0, 10.0), target=(0.0, 0.0, 20.0), up=(0.0, 1.0, 0.0), fov=40.0)
CLOUD = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, 8)] * 3), axis=-1).reshape(-1, 3)


def frame(*walls: tuple[float, float]) -> Occluded:
    """The cloud, and walls 20 wide at a depth z that reach to a height."""
    corners = [[(-10, -10, z), (10, -10, z), (10, top, z), (-10, top, z)] for z, top in walls]
    quad = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    triangles = [quad + 4 * i for i in range(len(walls))]
    return Occluded(
        points=CLOUD,
        corners=np.array(corners, float).reshape(-1, 3),
        triangles=np.concatenate([np.zeros((0, 3), np.int32), *triangles]),
    )


def test_a_wall_hides_what_is_behind_it_and_nothing_else():
    assert frame().seen_share(FRONT, 1.5) == 1.0
    assert frame((2.0, 10.0)).seen_share(FRONT, 1.5) == 0.0
    assert frame((2.0, 10.0)).seen_share(BACK, 1.5) == 1.0
    # to the middle of the cloud, of which every row has the same number of points
    assert frame((2.0, 0.0)).seen_share(FRONT, 1.5) == pytest.approx(0.5)
    # points on a wall are in front of it
    assert frame((-1.0, 10.0)).seen_share(FRONT, 1.5) == 1.0
    assert np.isnan(frame().seen_share(AWAY, 1.5))


def test_another_view_is_taken_only_where_the_first_is_blocked():
    before, open_, both = frame((2.0, 10.0)), frame(), frame((2.0, 10.0), (-2.0, 10.0))
    assert best_view([before, before, open_], [FRONT, BACK], 1.5) == (1, [1.0, 1.0, 1.0])
    assert best_view([before, open_, open_], [FRONT, BACK], 1.5) == (0, [0.0, 1.0, 1.0])
    chosen, shares = best_view([both, both], [FRONT, BACK], 1.5)
    assert (chosen, shares) == (0, [0.0, 0.0])
    assert mostly_hidden(shares)


def test_frames_without_a_body_in_the_picture_do_not_count():
    assert best_view([frame()], [AWAY, FRONT], 1.5) == (0, [])
