"""The rule that velocities are the velocities of the points, per second.

With five samples around a time, let ``v2`` be the central difference of the inner three and ``v4``
the derivative of the polynomial through all five.  Where the motion is smooth on the scale of the
samples, both agree, and ``|v2 - v4|`` bounds the error of ``v4``.  Around a contact, or where a
vibration is faster than the samples, they disagree, and nothing can be said there.  So only smooth
places are judged, by the median: authored velocities per time code instead of per second, in
another unit, or of another frame rate are wrong everywhere.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdVol

from gf_usd.usd.rules.base import Verdict, about, rule
from gf_usd.usd.rules.read import authored, position_attribute, prims, vectors

# v4 is trusted where v2 is within 5 % of it.  24 taken for 30 samples a second is wrong by 20 or
# 25 %; a limit of 12 % lies between that and what a trusted v4 leaves open.
SMOOTH = 0.05
WRONG = 0.12
# Slower than a thousandth of the body per sample, blur cannot be seen and jitter rules.
STILL = 1e-3
# Random motion passes the test for smoothness by chance (about SMOOTH^3 of it in three dimensions);
# real motion that is well sampled passes for far more.
FEWEST_SHARE = 0.05
FEWEST = 8
WINDOW = 5

Vectors = NDArray[np.floating]
Sample = tuple[float, Vectors, Vectors | None]


@dataclass
class Tally:
    """What was seen of one prim; sums only, so that memory does not grow with the animation."""

    moving: int = 0
    smooth: int = 0
    wrong: int = 0
    along: float = 0.0  # sum of v . v4 over the smooth places
    square: float = 0.0  # sum of v4 . v4
    first: float | None = None  # time code of the first wrong place

    def add(self, time: float, v: Vectors, v2: Vectors, v4: Vectors, floor: float) -> None:
        """Count the points of one window; ``floor`` is the speed below which nothing moves."""
        speed, said = np.linalg.norm(v4, axis=1), np.linalg.norm(v, axis=1)
        moving = np.maximum(speed, said) > floor
        # the motion itself may stand still while the velocities claim otherwise
        smooth = moving & (np.linalg.norm(v2 - v4, axis=1) <= SMOOTH * np.maximum(speed, floor))
        off = np.linalg.norm(v - v4, axis=1) > WRONG * np.maximum(speed, said)
        wrong = int((smooth & off).sum())
        self.moving += int(moving.sum())
        self.smooth += int(smooth.sum())
        self.wrong += wrong
        self.along += float((v[smooth] * v4[smooth]).sum())
        self.square += float((v4[smooth] ** 2).sum())
        if wrong and self.first is None:
            self.first = time


@rule("velocities", "velocities are the motion of the points in units per second")
def velocities(stage: Usd.Stage) -> Iterator[Verdict]:
    rate = stage.GetTimeCodesPerSecond()
    for prim in prims(stage):
        position = position_attribute(prim)
        if position is None:
            continue
        name = "gaussianFlesh:velocities" if prim.IsA(UsdVol.ParticleField) else "velocities"
        velocity = authored(prim, name)
        count = position.GetNumTimeSamples()
        if velocity is None or count < 2:
            continue
        speak = about("velocities", prim)
        if position.GetName() == "positionsh":
            yield speak.skip(f"{name}: positions in half precision are too coarse to judge by")
            continue
        if count < WINDOW:
            yield speak.skip(f"{name}: {count} samples of motion, {WINDOW} are wanted to judge")
            continue
        tally = tally_of(position, velocity, rate)
        if not tally.moving:
            continue
        if tally.smooth < max(FEWEST, FEWEST_SHARE * tally.moving):
            yield speak.skip(
                f"{name}: the motion is smooth in {tally.smooth} of {tally.moving} places only, "
                "too few to judge"
            )
        elif tally.wrong > 0.5 * tally.smooth:
            factor = tally.along / tally.square if tally.square else float("inf")
            yield speak.error(
                f"{name} disagrees with the motion of {position.GetName()} in {tally.wrong} of "
                f"{tally.smooth} places, from time {tally.first:g} on; on the whole it is "
                f"{factor:.3g} times the motion per second",
                f"author stage units per second; this stage has {rate:g} time codes in a second",
            )


def tally_of(position: Usd.Attribute, velocity: Usd.Attribute, rate: float) -> Tally:
    """Compare a prim's velocities with its positions, five samples in memory at a time."""
    tally = Tally()
    window: deque[Sample] = deque(maxlen=WINDOW)
    for code in position.GetTimeSamples():
        time = Usd.TimeCode(code)
        x = vectors(position, time)
        if x is None or (window and len(window[-1][1]) != len(x)):
            window.clear()
        if x is None or not len(x):
            continue
        window.append((code / rate, x, vectors(velocity, time)))
        if len(window) == WINDOW:
            _judge(tally, window, rate)
    return tally


def _judge(tally: Tally, window: deque[Sample], rate: float) -> None:
    seconds = np.array([sample[0] for sample in window])
    middle = WINDOW // 2
    x, v = window[middle][1], window[middle][2]
    if v is None or len(v) != len(x):
        return
    size = float(np.linalg.norm(np.ptp(x, axis=0)))
    reach = float(np.abs(x).max())
    if not np.isfinite(size + reach) or not np.isfinite(v).all():
        return
    step = (seconds[-1] - seconds[0]) / (WINDOW - 1)
    noise = 100.0 * np.finfo(x.dtype).eps * reach
    inner = range(middle - 1, middle + 2)
    v2 = _derivative(window, seconds, inner)
    v4 = _derivative(window, seconds, range(WINDOW))
    tally.add(seconds[middle] * rate, v, v2, v4, max(STILL * size, noise) / step)


def _derivative(window: deque[Sample], seconds: Vectors, rows: range) -> Vectors:
    """Derivative at the middle sample of the polynomial through the samples in ``rows``.

    The weights w solve sum_k w_k (t_k - t)^n = [n = 1] for n below the number of samples.
    """
    offset = seconds[list(rows)] - seconds[WINDOW // 2]
    scale = float(np.abs(offset).max())
    powers = np.vander(offset / scale, increasing=True).T
    weights = np.linalg.solve(powers, np.eye(len(offset))[1]) / scale
    total = np.zeros(window[0][1].shape)
    for weight, row in zip(weights, rows):
        total += weight * window[row][1]
    return total
