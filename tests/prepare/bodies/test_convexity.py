"""Which bodies cannot touch themselves, and the bounds of their convex hulls."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterator

import numpy as np
import pytest
from contact_scenes import bricks
from scipy.spatial import ConvexHull
from trimesh.creation import icosphere

from gf_usd.core.arrays import Floats, lengths
from gf_usd.core.stage import Skin
from gf_usd.prepare.bodies import convexity
from gf_usd.prepare.bodies.convexity import (
    SupportPoints,
    cannot_touch_itself,
    star_hull_upper_bound,
)


def lumps(*size: int, without: tuple[slice, ...] | None = None) -> Skin:
    """The skin of a box of cubes of a tenth of a meter, some of which are missing."""
    filled = np.ones(size, bool)
    if without:
        filled[without] = False
    made = bricks(filled, 0.1)
    return Skin(points=made.points, triangles=made.triangles)


def test_which_bodies_cannot_touch_themselves() -> None:
    assert cannot_touch_itself(lumps(10, 10, 10))
    assert cannot_touch_itself(lumps(4, 4, 12))
    assert not cannot_touch_itself(lumps(4, 4, 13)), "a rod can be bent into a ring"
    assert not cannot_touch_itself(lumps(10, 10, 3)), "a sheet can be folded"
    assert not cannot_touch_itself(lumps(6, 6, 6, without=np.s_[2:4, 2:, :])), "a U"
    assert not cannot_touch_itself(lumps(6, 6, 6, without=np.s_[3:4, :, :])), (
        "two lumps of one body"
    )


def test_a_hull_has_no_more_than_its_bound() -> None:
    body = icosphere(3)
    points, triangles = np.asarray(body.vertices), np.asarray(body.faces)
    assert star_hull_upper_bound(points, triangles) == pytest.approx(
        ConvexHull(points).volume, rel=1e-12
    )
    rough = points * np.random.default_rng(0).uniform(0.9, 1.1, (len(points), 1))
    assert (
        ConvexHull(rough).volume
        < star_hull_upper_bound(rough, triangles)
        < 2.5 * ConvexHull(rough).volume
    )
    assert star_hull_upper_bound(points, triangles[1:]) == np.inf, "it is open"
    assert star_hull_upper_bound(points, triangles[:, ::-1]) == np.inf, "it is inside out"
    fin = np.concatenate([triangles, triangles[:1, ::-1], triangles[:1]])
    assert star_hull_upper_bound(points, fin) == np.inf, "more than two triangles meet at an edge"


def clouds() -> Iterator[Floats]:
    """Points of any shape, stretched, within a corner, on a sphere, and few."""
    random = np.random.default_rng(0)
    for count, stretch in itertools.product((4, 9, 400), ((1, 1, 1), (3, 1, 0.5), (1, 1, 0.02))):
        normal = random.normal(size=(count, 3))
        for X in (normal, np.abs(normal), normal / lengths(normal)[:, None]):
            yield X * stretch


def test_the_bound_of_a_hull_from_below() -> None:
    """It never exceeds Qhull's volume, and holds nearly all of what is round or a box."""
    for X in clouds():
        assert SupportPoints(X).hull_lower_bound() <= ConvexHull(X).volume * (1.0 + 1e-12)
    box = np.indices((2, 2, 2)).reshape(3, -1).T.astype(float)
    assert SupportPoints(box).hull_lower_bound() == pytest.approx(1.0)
    ball = np.random.default_rng(0).normal(size=(4000, 3))
    ball /= lengths(ball)[:, None]
    # directions are up to 0.226 from the middles of triangles: cos^3 of that is left
    assert SupportPoints(ball).hull_lower_bound() > 0.92 * ConvexHull(ball).volume
    assert SupportPoints(box * [1, 1, 0]).hull_lower_bound() == 0.0, "flat"
    assert SupportPoints(box[:1]).hull_lower_bound() == 0.0


def test_the_bound_of_a_hull_from_above() -> None:
    """It is never less than Qhull's volume, and hardly more than a box or what is round."""
    for X in clouds():
        assert SupportPoints(X).hull_upper_bound() >= ConvexHull(X).volume * (1.0 - 1e-12)
    box = np.indices((2, 2, 2)).reshape(3, -1).T.astype(float)
    assert SupportPoints(box).hull_upper_bound() == pytest.approx(1.0)
    ball = np.random.default_rng(0).normal(size=(4000, 3))
    ball /= lengths(ball)[:, None]
    # the corners of its faces are up to 0.226 from the directions, and 1 / cos of that away
    assert SupportPoints(ball).hull_upper_bound() < 1.08 * ConvexHull(ball).volume
    corner = np.concatenate([np.zeros((1, 3)), np.eye(3)])
    assert SupportPoints(corner).hull_upper_bound() == np.inf, "the center is outside"
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    assert cannot_touch_itself(Skin(points=corner, triangles=faces)), "by the hull itself"


@pytest.mark.slow
@pytest.mark.parametrize("without", [None, np.s_[7:13, 2:, :]], ids=["whole", "notched"])
def test_a_fine_mesh_needs_no_hull_where_its_bounds_decide(
    monkeypatch: pytest.MonkeyPatch, without
) -> None:
    """With more triangles than `MANY` allows the bound by their planes."""
    monkeypatch.setattr(convexity, "MANY", 0)
    monkeypatch.setattr(SupportPoints, "hull_lower_bound", lambda self: 0.0)
    asked: list[int] = []
    import scipy.spatial

    def counted(points: Floats) -> ConvexHull:
        asked.append(len(points))
        return ConvexHull(points)

    monkeypatch.setattr(scipy.spatial, "ConvexHull", counted)
    body = lumps(20, 20, 20, without=without)
    assert cannot_touch_itself(body) == (without is None)
    assert (len(body.points) in asked) == (without is not None)


def test_what_is_clearly_not_convex_needs_no_hull(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "scipy.spatial", None)  # imports of it fail
    assert not cannot_touch_itself(lumps(6, 6, 6, without=np.s_[2:4, 2:, :])), "a U"
    assert cannot_touch_itself(lumps(10, 10, 10))
