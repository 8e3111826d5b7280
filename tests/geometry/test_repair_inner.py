"""Shells inside others: those that bound nothing are dropped, the others stay."""

from __future__ import annotations

import numpy as np
import pytest
from solids import CUBE_POINTS, CUBE_TRIANGLES, asset, surface

from gf_usd.core.asset import Surface
from gf_usd.geometry.diagnosis import diagnose, tolerated_defects
from gf_usd.geometry.repair import repair_surface
from gf_usd.geometry.solid import build_solid


def nested(*sizes: float) -> Surface:
    """Cubes about one middle; a negative size faces inward."""
    points = [0.5 + abs(s) * (CUBE_POINTS - 0.5) for s in sizes]
    faces = [8 * k + CUBE_TRIANGLES[:, :: 1 if s > 0 else -1] for k, s in enumerate(sizes)]
    return surface(np.concatenate(points), np.concatenate(faces))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sizes", "inner", "volume"),
    [
        ((1.0, 0.5), 1, 1.0),
        pytest.param((1.0, 0.6, 0.3), 2, 1.0, marks=pytest.mark.slow),
        ((1.0, -0.5), 0, 1.0 - 0.125),  # a cavity
        ((1.0, -0.5, 0.25), 0, 1.0 - 0.125 + 0.25**3),  # something loose in it
        pytest.param(
            (1.0, 0.6, -0.3), 0, 1.0, marks=pytest.mark.slow
        ),  # winding 1 in the innermost: flesh, while the 0.6 is there
    ],
)
def test_inner_shells_are_dropped_and_the_solid_stays(sizes, inner: int, volume: float) -> None:
    body = nested(*sizes)
    seen = diagnose(body)
    assert sum(shell.inner for shell in seen.shells) == inner
    assert ("bound no volume" in "".join(tolerated_defects([seen]))) == (inner > 0)
    mended, done = repair_surface(body)
    assert done.inner == inner
    assert ("inside others that bound no volume" in " ".join(done.messages())) == (inner > 0)
    assert len(mended.triangles) == 12 * (len(sizes) - inner)
    X = np.random.default_rng(0).uniform(-0.1, 1.1, (400, 3))
    before, after = (build_solid(asset(one)).inside(X) for one in (body, mended))
    assert np.array_equal(before, after)
    # 400 points in 1.2^3 m^3 measure 1 m^3 with a standard deviation of 0.043
    assert 1.2**3 * after.mean() == pytest.approx(volume, abs=0.15)


def test_shells_that_poke_out_stay() -> None:
    both = nested(1.0, 0.8)
    points = both.points.copy()
    points[8:] += (0.5, 0.0, 0.0)
    assert repair_surface(surface(points, both.triangles))[1].inner == 0
