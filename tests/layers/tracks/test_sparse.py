"""Samples are left out where straight lines give them back, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest
from pxr import Sdf, Vt

from gf_usd.layers.tracks.accuracy import Allowed
from gf_usd.layers.tracks.sparse import Saved, Sparse, Tally

PATH = Sdf.Path("/p.points")
OFF = 0.01


def allowed(length: float = OFF) -> Allowed:
    each = np.asarray(length)
    return Allowed(length=each, shape=each, angle=0.1, share=0.1, shutter=0.02)


def sparse(window: int = 8, tally: Tally | None = None) -> Sparse:
    return Sparse(allowed(), window, lambda time: np.eye(3), tally)


def kept(
    curve: np.ndarray, window: int = 8, last: set[int] = frozenset()
) -> dict[float, np.ndarray]:
    """Times and rows that are kept of a motion (T, n, 3)."""
    one, found = sparse(window), {}
    for time, x in enumerate(curve):
        values = {PATH: Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(x, np.float32))}
        for code, mine in one.take(float(time), values, last=time in last):
            found[code] = np.array(mine[PATH])
    found.update({code: np.array(mine[PATH]) for code, mine in one.close()})
    assert one.tally.samples == len(curve)
    assert one.tally.kept == len(found)
    return found


def error(curve: np.ndarray, found: dict[float, np.ndarray]) -> float:
    """Largest distance of the motion from the lines, after the last sample from that."""
    times = sorted(found)
    flat = np.array([found[time].ravel() for time in times])
    lines = [np.interp(np.arange(len(curve)), times, column) for column in flat.T]
    return float(np.linalg.norm(np.array(lines).T.reshape(curve.shape) - curve, axis=2).max())


def line(count: int) -> np.ndarray:
    return np.arange(count)[:, None, None] * np.array([[[1.0, 2.0, 3.0], [0.0, 0.5, 0.0]]])


def test_of_a_straight_line_the_ends_of_windows_are_kept() -> None:
    found = kept(line(20), window=8)
    assert sorted(found) == [0, 8, 16, 19]
    assert error(line(20), found) < 1e-5


def test_a_corner_is_kept() -> None:
    there = line(5)
    curve = np.concatenate([there, there[::-1][1:]])
    assert sorted(kept(curve, window=20)) == [0, 4, 8]


def test_what_never_moves_has_one_sample() -> None:
    curve = np.zeros((30, 4, 3)) + np.random.default_rng(0).normal(size=(4, 3))
    assert sorted(kept(curve)) == [0]


def test_what_rests_and_moves_again_has_its_sample_repeated() -> None:
    still = np.ones((21, 2, 3)) * 0.5
    curve = np.concatenate([still, 0.5 + line(6)[1:]])
    found = kept(curve, window=4)
    assert sorted(found) == [0, 20, 24, 25]
    assert np.array_equal(found[0], found[20])
    assert error(curve, found) < 1e-5


def test_what_comes_to_rest_is_not_repeated_to_the_end() -> None:
    curve = np.concatenate([line(4), np.repeat(line(4)[-1:], 40, axis=0)])
    assert sorted(kept(curve)) == [0, 3]


def test_what_creeps_less_than_is_allowed_rests() -> None:
    curve = np.zeros((40, 1, 3))
    curve[:, 0, 0] = np.linspace(0.0, 0.9 * OFF, 40)
    found = kept(curve, window=5)
    assert sorted(found) == [0]
    assert error(curve, found) <= OFF


def test_a_sample_that_must_be_kept_is() -> None:
    found = kept(line(20), window=50, last={7, 8})
    assert sorted(found) == [0, 7, 8, 19]
    rest = kept(np.zeros((20, 1, 3)), last={7})
    assert sorted(rest) == [0, 7]


def kept_from(rest: np.ndarray, curve: np.ndarray, last: int = -1) -> list[float]:
    """Times that are kept of a motion (T, n, 3) whose asset says that it is at `rest`."""
    at_rest, *frames = (
        {PATH: Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(x, np.float32))} for x in (rest, *curve)
    )
    one = Sparse(allowed(), 8, lambda time: np.eye(3), rest=at_rest)
    found = [
        code
        for time, values in enumerate(frames)
        for code, _ in one.take(float(time), values, last=time == last)
    ]
    found += [code for code, _ in one.close()]
    assert (one.tally.samples, one.tally.kept) == (len(curve), len(found))
    return found


def test_what_stays_as_the_asset_says_has_no_sample() -> None:
    still = np.random.default_rng(0).normal(size=(4, 3))
    curve = np.repeat(still[None], 30, axis=0)
    assert kept_from(still, curve) == []
    assert kept_from(still + 0.9 * OFF / np.sqrt(3.0), curve) == []
    assert kept_from(still + 1.1 * OFF / np.sqrt(3.0), curve) == [0]
    assert kept_from(still[:2], curve) == [0]  # the asset has other points
    assert kept_from(still, curve, last=0) == [0]  # a clip says everything at its start


def test_what_moves_later_has_its_first_sample_where_it_begins() -> None:
    rest = np.full((2, 3), 0.5)
    curve = np.concatenate([np.repeat(rest[None], 21, axis=0), 0.5 + line(6)[1:]])
    assert kept_from(rest, curve) == [20, 25]


@pytest.mark.parametrize("window", [2, 5, 24])
@pytest.mark.parametrize("seed", range(8))
def test_no_motion_is_off_by_more_than_is_allowed(seed: int, window: int) -> None:
    rng = np.random.default_rng(seed)
    rates, phases = rng.uniform(0.0, 0.6, (2, 3)), rng.uniform(0, 6, (2, 3))
    t = np.arange(90.0)[:, None, None]
    sizes = rng.choice([0.0, 0.02, 0.3])
    curve = sizes * np.sin(rates * t + phases) + 0.1 * rng.normal(size=(2, 3)) * np.maximum(
        t - 30, 0
    )
    curve[60:] = curve[60]
    found = kept(curve, window)
    assert error(curve, found) <= OFF
    assert len(found) < len(curve)
    assert found.keys() == kept(curve, window).keys()


def test_it_continues_after_the_end_of_a_clip_as_if_it_had_not_ended() -> None:
    rng = np.random.default_rng(4)
    curve = np.cumsum(0.004 * rng.normal(size=(40, 3, 3)), axis=0)
    frames = [{PATH: Vt.Vec3fArray.FromNumpy(x.astype(np.float32))} for x in curve]
    whole, before, found = sparse(), sparse(), []
    for time, values in enumerate(frames):
        found += [(code, time) for code, _ in whole.take(time, values, last=time == 19)]
    found += [(code, 40) for code, _ in whole.close()]
    border = {}
    for time, values in enumerate(frames[:20]):
        for code, mine in before.take(time, values, last=time == 19):
            border[code] = mine
    after = sparse(tally=Tally(**vars(before.tally)))
    after.begin(19.0, border[19.0])
    again = [(code, time) for time in range(20, 40) for code, _ in after.take(time, frames[time])]
    again += [(code, 40) for code, _ in after.close()]
    assert again == [pair for pair in found if pair[1] >= 20]
    assert after.tally == whole.tally


def test_equal_arrays_count_once() -> None:
    tally, saved = sparse(), Saved()
    array = Vt.Vec3fArray.FromNumpy(np.ones((10, 3), np.float32))
    twin = Sdf.Path("/q.points")
    for time in range(6):
        list(tally.take(float(time), {PATH: array, twin: array}))
        saved.count(np.asarray(array), 7)
    assert tally.tally.bytes == 120
    assert saved.bytes == 7
