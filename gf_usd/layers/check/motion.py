"""The rule that authored velocities match the motion of the points, per second.

With five samples around a time, let ``v2`` be the central difference of the inner three, ``v4`` the
derivative of the polynomial through all five, and ``k`` a quarter of their fourth difference, per
step.  Where the motion is smooth on the scale of the samples, ``v2`` agrees with ``v4``.  At a
contact, or with a vibration that the samples do not resolve, they disagree, and the velocity is
not checked.  A point that stops at the middle sample is an exception: both are the mean of its
velocities before and after, and only ``k``, half their difference, shows the jump.  Wherever in the
window a velocity jumps, the error of ``v4`` is at most twice ``|v2 - v4| + |k|``.

The rule checks one number per window, ``a = sum v . v4 / sum v4 . v4`` over its smooth points: the
factor by which the authored velocities ``v`` stretch the motion.  A vibration too fast for the
samples is in ``v`` but not in ``v4``; its direction is random, so it averages out of ``a`` although
it can exceed ``v4`` at every single point.  It also averages out of the error bound of ``a`` where
a body jumps, ``2 (|sum (v2 - v4) . v4| + |sum k . v4|) / sum v4 . v4``: a window whose factor is
nearer to 1 than that is no evidence against the velocities.  A window counts where most of the
moving points move smoothly: in the others they do so coincidentally, and a small body that vibrates
at twice the rate of the samples then appears to move at part of its speed (observed on a duck of
10 cm at 24 samples a second: 0.6).  The result is the median over the windows, weighted by their
smooth points, if the windows agree on it.  A wrong unit scales all windows alike; bounces at a
third of the rate of the samples scale each window differently (observed on the same duck, stiff:
0.29 to 1.41).

Velocities that equal ``v2`` at nearly all moving points need no more proof: those of an animation
that is linear between its keys jump at each of them, and are the mean of both sides there.

Positions and velocities are compared in world space: in the space of a prim that a transform
shears, an invisible vibration can be the larger part of the motion.

A vibration close to the rate of the samples, or to a multiple of it, is aliased to a slow, smooth
motion.  Its velocities would move the point out of its range within a sample, either the range of
the whole motion or that of the window; so would velocities in some wrong units, which are
recognized by their factor.

Also the rule that extents contain their points.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from hashlib import sha256
from math import factorial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom, UsdVol

from gf_usd.core.arrays import columns
from gf_usd.core.errors import counted
from gf_usd.layers.check.base import Finding, Verdict, about, first_problem, rule
from gf_usd.layers.check.read import (
    Array,
    authored,
    numbers,
    position_attribute,
    prims,
    times,
    vectors,
    vectors_of,
)

# v4 is trusted where v2 is within 5 % of it.
SMOOTH = 0.05
# 24 taken for 30 samples a second gives a factor of 0.8 or 1.25.  Lattices of springs dropped and
# bouncing at 24 and 60 samples a second, radius 0.025 to 5, soft to stiff, undamped (so that every
# vibration lasts), gave 0.98 to 1.01 for their own velocities: 0.12 lies between.
WRONG = 0.12
# Fewer windows than FEWEST_WINDOWS cover one event only, and cannot confirm each other: a block
# that lands on sand in five samples gave 1.14 for its own velocities, 1.00 at eight times the
# samples.  They are accepted as evidence of a wrong unit, not of a rate that is near the right one.
FEWEST_WINDOWS, COARSE = 3, 0.5
# Below a thousandth of the body's size per sample, motion blur is invisible and jitter dominates.
STILL = 1e-3
# Random motion is coincidentally smooth in about SMOOTH^3 of its places, motion that the samples
# resolve in far more.
FEWEST_SHARE = 0.05
FEWEST = 8
# A window counts where this share of its moving points is smooth.
MAJORITY = 0.5
WINDOW = 5
MIDDLE = WINDOW // 2
# With more windows than this, a subset spread over the motion gives the same result.
MOST = 64
# A factor is wrong where windows of this share of the smooth places agree with it.
AGREE = 0.9
SCATTER = 0.5  # of the factor's distance from 1: windows within it agree
# And of the factor itself: a wrong unit stretches all windows alike.  A ball that two plates
# squeeze, which rings faster than the samples, has factors of -4.6 to -11.
RELATIVE_SCATTER = 0.25
# Factors of wrong units of time and length, besides the rate of the stage itself.
UNITS = (10.0, 12.0, 24.0, 30.0, 39.37, 60.0, 100.0, 1000.0)
UNIT_SCATTER = 0.01
TOO_FAST = "the motion is too fast for the samples"

Vectors = NDArray[np.floating]


class Sample(NamedTuple):
    """Positions at one time, in the space of the prim."""

    code: float
    x: Vectors  # (3 n,) float64, by columns
    finite: bool
    rounding: float  # of the numbers as they were read, relative


@dataclass
class Tally:
    """Statistics of one prim: counts, and two numbers per window."""

    moving: int = 0  # places (points in windows) that move, by position or velocity
    smooth: int = 0  # of these, where v4 is trusted
    central: int = 0  # of those that move, where the velocity is v2
    frozen: int = 0  # of these, where the positions stand still and the velocities do not
    factors: list[float] = field(default_factory=list)  # a of each window
    bounds: list[float] = field(default_factory=list)  # of its error where all jump at once
    weights: list[int] = field(default_factory=list)  # and its smooth places
    low: Vectors | None = None  # (3, n) of the places of all windows
    high: Vectors | None = None
    travel: float = 0.0  # of a point in a sample at its velocity: the largest mean of a window
    leaps: list[bool] = field(default_factory=list)  # whether it leaves the range of each window so

    def reach(self, low: Vectors, high: Vectors, rated: Vectors, step: float) -> None:
        """Record the range of the points in a window, (3, n), and how far their velocities, of
        lengths `rated` (n,), would move them.
        """
        self.low = low if self.low is None else np.minimum(self.low, low)
        self.high = high if self.high is None else np.maximum(self.high, high)
        self.travel = max(self.travel, step * float(rated.mean()))

    def add(
        self,
        v: Vectors,
        rated: Vectors,
        motion: Vectors,
        floor: float,
        noise: float,
        range_: Vectors,
    ) -> None:
        """Count the points of one window; v is (3, n) of lengths `rated`, motion (3, 3, n) is v2,
        v4 and k.

        range_ : (n,) of each point in the window, over the time of a sample.  Nothing counts as
        moving below the speed ``floor``; positions whose range is less than ``noise``, their
        rounding per sample, stand still.
        """
        v2, v4, k = motion
        squares = (v4 * v4).sum(0)
        speed, error = np.sqrt(squares), v2 - v4
        moving = np.maximum(speed, rated) > floor
        off = np.sqrt((error * error).sum(0))
        smooth = np.flatnonzero(moving & (off <= SMOOTH * np.maximum(speed, floor)))
        count = np.count_nonzero(moving)
        self.moving += count
        apart = np.sqrt(((v - v2) ** 2).sum(0))
        close = apart <= SMOOTH * np.maximum(np.sqrt((v2 * v2).sum(0)), floor)
        self.central += np.count_nonzero(moving & close)
        if len(smooth) < MAJORITY * count:
            return
        self.smooth += len(smooth)
        range_ = range_[smooth]
        # What swings between two places from sample to sample has no speed by them, but moves.
        self.frozen += np.count_nonzero(range_ <= noise)
        square = float(squares[smooth].sum())
        if square > 0.0:
            self.factors.append(float((v * v4).sum(0)[smooth].sum()) / square)
            odd, even = (abs(float((part * v4).sum(0)[smooth].sum())) for part in (error, k))
            self.bounds.append(2.0 * (odd + even) / square)
            self.weights.append(len(smooth))
            self.leaps.append(bool(rated[smooth].mean() > range_.mean()))

    @property
    def differenced(self) -> bool:
        """Whether the velocities are the central differences of the positions, as those of an
        animation that is linear between keys, however these jump.
        """
        return self.central >= AGREE * self.moving

    @property
    def decided(self) -> bool:
        return self.smooth >= max(FEWEST, FEWEST_SHARE * self.moving)

    @property
    def agreed(self) -> float:
        """Share of the smooth points whose window agrees with the factor and excludes 1.

        Windows that agree but do not exclude 1 are left out; 0 where these are the majority.
        """
        off = np.abs(np.array(self.factors) - self.factor)
        most = max(RELATIVE_SCATTER * abs(self.factor), WRONG)  # of velocities near 0, some noise
        most = min(SCATTER * abs(self.factor - 1.0), most)
        alike = off <= most
        sure = alike & (np.abs(np.array(self.factors) - 1.0) > self.bounds)
        weights = np.array(self.weights)
        for_it, unsure = weights[sure].sum(), weights[alike & ~sure].sum()
        return 0.0 if for_it < unsure else float(for_it / (weights.sum() - unsure))

    def jitters(self, rate: float) -> bool:
        """Whether the velocities would move the points out of their range in a sample, in any
        likely unit.
        """
        if self.low is None or self.high is None:
            return False
        span = float(np.sqrt(((self.high - self.low) ** 2).sum(0)).mean())
        leaps = np.array(self.weights)[self.leaps].sum() > 0.5 * sum(self.weights)
        known = np.abs(abs(self.factor) / np.array([*UNITS, rate]) - 1.0) <= UNIT_SCATTER
        return bool(self.travel > span or leaps) and not known.any()

    @property
    def off(self) -> bool:
        """Whether the factor differs from 1 by more than its uncertainty with this number of
        windows.
        """
        few = len(self.factors) < FEWEST_WINDOWS
        return abs(self.factor - 1.0) > (COARSE if few else WRONG)

    @property
    def factor(self) -> float:
        """Authored velocities over those of the motion: the weighted median over the windows."""
        order = np.argsort(self.factors)
        reached = np.cumsum(np.array(self.weights)[order])
        return self.factors[order[np.searchsorted(reached, 0.5 * reached[-1])]]


@rule("velocities", "velocities match the motion of the points, in units per second")
def velocities(stage: Usd.Stage) -> Iterator[Verdict]:
    rate = stage.GetTimeCodesPerSecond()
    judged: dict[Key, list[tuple[Usd.Attribute, Usd.Attribute, Tally]]] = {}
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
            yield speak.skip("positions in half precision are too coarse for this check")
            continue
        if count < WINDOW:
            yield speak.skip(f"{count} samples of motion; this check needs {WINDOW}")
            continue
        near = judged.setdefault(_key(position), [])
        alike = (seen for *both, seen in near if _is_twin(both, (position, velocity)))
        tally = next(alike, None) or tally_of(position, velocity, rate)
        near.append((position, velocity, tally))
        if not tally.moving or tally.differenced:
            continue
        fix = f"author stage units per second; this stage has {rate:g} time codes per second"
        if not tally.decided:
            yield speak.skip(
                f"the motion is smooth in only {tally.smooth} of {tally.moving} places,"
                " too few for this check"
            )
        elif tally.frozen > 0.5 * tally.smooth:
            yield speak.error(
                f"{name} is not zero in {tally.frozen} of {tally.smooth} places where "
                f"{position.GetName()} does not move",
                fix,
            )
        elif not tally.factors:
            yield speak.skip(
                f"{TOO_FAST}: {position.GetName()} is at the same places in every other one"
            )
        elif not tally.off and abs(tally.factor - 1.0) > WRONG:
            yield speak.skip(
                f"they are {tally.factor:.3g} times the motion in only"
                f" {counted(len(tally.factors), 'window')} of {WINDOW} samples, too few for this"
                " check"
            )
        elif tally.off and tally.agreed < AGREE:
            yield speak.skip(f"{TOO_FAST}: the points turn between two of them")
        elif tally.off and tally.jitters(rate):
            yield speak.skip(f"{TOO_FAST}: the points vibrate between them")
        elif tally.off:
            yield speak.error(
                f"{name} is {tally.factor:.3g} times the motion of {position.GetName()} per second "
                f"(over {tally.smooth} places)",
                fix,
            )


Key = tuple[float | int | bytes | str, ...]


def _key(position: Usd.Attribute) -> Key:
    """A key of positions that differs between prims, unless they differ in precision only."""
    codes = position.GetTimeSamples()
    x = vectors(position, Usd.TimeCode(codes[0]))
    first = (b"", "") if x is None else (sha256(x.tobytes()).digest(), x.dtype.str)
    return (
        len(codes),
        codes[0],
        codes[-1],
        *first,
        _to_world(position.GetPrim(), codes[0]).tobytes(),
    )


def _is_twin(one: Sequence[Usd.Attribute], other: Sequence[Usd.Attribute]) -> bool:
    """Whether positions and velocities equal those of another prim that moves with it, such as
    Gaussians and their points.
    """
    codes = one[0].GetTimeSamples()
    if any(a.GetTimeSamples() != codes for a in (one[1], *other)):
        return False
    values = [(Usd.AttributeQuery(a).Get, Usd.AttributeQuery(b).Get) for a, b in zip(one, other)]
    for code in codes:
        for first_at, second_at in values:
            x, y = vectors_of(first_at(code)), vectors_of(second_at(code))
            if x is None or y is None or x.dtype != y.dtype or not np.array_equal(x, y):
                return False
        here, there = (_to_world(a.GetPrim(), code) for a in (one[0], other[0]))
        if not np.array_equal(here, there):
            return False
    return True


def tally_of(position: Usd.Attribute, velocity: Usd.Attribute, rate: float) -> Tally:
    """Compare a prim's velocities with its positions, five samples in memory at a time."""
    tally = Tally()
    window: deque[Sample] = deque(maxlen=WINDOW)
    codes = position.GetTimeSamples()
    windows = len(codes) - WINDOW + 1
    judged = set(np.linspace(0, windows - 1, max(min(windows, MOST), 0)).astype(int) + WINDOW - 1)
    x_at = Usd.AttributeQuery(position).Get
    for number, code in enumerate(codes):
        x = vectors_of(x_at(code))
        if x is None or (window and len(window[-1].x) != x.size):
            window.clear()
        if x is None or not len(x):
            continue
        finite = bool(np.isfinite(x).all())
        own = columns(x).astype(np.float64).ravel()
        window.append(Sample(code, own, finite, np.finfo(x.dtype).eps))
        if len(window) == WINDOW and number in judged:
            middle = window[MIDDLE].code
            to_world = _to_world(position.GetPrim(), middle)
            _judge(tally, window, vectors(velocity, Usd.TimeCode(middle)), rate, to_world)
    return tally


def _judge(
    tally: Tally, window: deque[Sample], v: Vectors | None, rate: float, to_world: Vectors
) -> None:
    """Count the points of a window; to_world (3, 3) is for columns."""
    codes = [sample.code for sample in window]
    if v is None or 3 * len(v) != len(window[MIDDLE].x):
        return
    if not (all(sample.finite for sample in window) and np.isfinite(v).all()):
        return
    x, v = np.array([sample.x for sample in window]), columns(v).astype(np.float64)
    local = x[MIDDLE].reshape(3, -1)
    reach = float(max(local.max(), -local.min()) * np.linalg.norm(to_world, 2))
    if (to_world != np.eye(3)).any():
        x, v = (to_world @ x.reshape(WINDOW, 3, -1)).reshape(WINDOW, -1), to_world @ v
    middle = x[MIDDLE].reshape(3, -1)
    size = float(np.linalg.norm(middle.max(1) - middle.min(1)))
    step = (codes[-1] - codes[0]) / (rate * (WINDOW - 1))
    noise = 100.0 * window[MIDDLE].rounding * reach / step
    weights = rate * _derivatives(tuple(code - codes[MIDDLE] for code in codes))
    motion = (weights @ x).reshape(3, 3, -1)
    low, high = x.min(0).reshape(3, -1), x.max(0).reshape(3, -1)
    rated = np.sqrt((v * v).sum(0))
    tally.reach(low, high, rated, step)
    range_ = np.sqrt(((high - low) ** 2).sum(0)) / step
    tally.add(v, rated, motion, max(STILL * size / step, noise), noise, range_)


def _to_world(prim: Usd.Prim, code: float) -> Vectors:
    """(3, 3) linear part of the prim's transform, for columns; of no use where it is not finite."""
    matrix = UsdGeom.XformCache(Usd.TimeCode(code)).GetLocalToWorldTransform(prim)
    linear = np.array(matrix, np.float64)[:3, :3].T
    return linear if np.isfinite(linear).all() and linear.any() else np.eye(3)


@cache
def _derivatives(offsets: tuple[float, ...]) -> Vectors:
    """(3, WINDOW) weights of samples at these times from the middle one, for v2, v4 and k.

    The m-th derivative at the middle is that of the polynomial through some of the samples: its
    weights w solve sum_j w_j t_j^n = m! [n = m] for n below their number.  m is 1 for a velocity;
    k is the fourth derivative times a quarter of the cube of the mean step.
    """
    step = (offsets[-1] - offsets[0]) / (WINDOW - 1)
    inner = slice(MIDDLE - 1, MIDDLE + 2)
    out = np.zeros((3, WINDOW))
    for row, some, m, factor in (
        (out[0], inner, 1, 1.0),
        (out[1], slice(WINDOW), 1, 1.0),
        (out[2], slice(WINDOW), 4, 0.25 * factorial(4) * step**3),
    ):
        times = np.array(offsets[some])
        scale = float(np.abs(times).max())
        powers = np.vander(times / scale, increasing=True).T
        row[some] = factor * np.linalg.solve(powers, np.eye(len(times))[m]) / scale**m
    return out


# Extents are floats, often computed in doubles or printed with six digits: what sticks out by less
# than 1e-5 of the largest coordinate is rounding, not a point outside.
ROUNDING = 1e-5


@rule("extent", "extent encloses the points in every sample")
def extent(stage: Usd.Stage) -> Iterator[Finding]:
    """Required: min and max of the points, for Points those of their balls (width / 2 around).

    For particle fields the centers must be inside; the size of the kernels is up to the author.
    Without an extent USD computes one for meshes and points (slowly), and uses an empty box for
    particle fields. Curves and patches are not checked, because they deviate from their points.
    """
    for prim in prims(stage):
        position = position_attribute(prim)
        curved = prim.IsA(UsdGeom.PointBased) and not (
            prim.IsA(UsdGeom.Mesh) or prim.IsA(UsdGeom.Points)
        )
        if position is None or curved:
            continue
        speak = about("extent", prim)
        box = authored(prim, "extent")
        if box is None:
            if prim.GetTypeName():
                yield speak.warning(
                    f"no extent is authored around {position.GetName()}",
                    "author extent at every time sample of the points",
                )
            continue
        if problem := first_problem(_outside(prim, position, box)):
            yield speak.error(
                f"extent {problem}", "compute extent from the points at every time sample"
            )


def _outside(
    prim: Usd.Prim, position: Usd.Attribute, box: Usd.Attribute
) -> Iterator[tuple[Usd.TimeCode, str]]:
    points_at, ends_at = Usd.AttributeQuery(position).Get, Usd.AttributeQuery(box).Get
    widths = authored(prim, "primvars:widths", "widths") if prim.IsA(UsdGeom.Points) else None
    for time in times(position, box):
        points, ends = vectors_of(points_at(time)), vectors_of(ends_at(time))
        if points is None or ends is None or not len(points):
            continue
        if len(ends) != 2:
            yield time, f"has {len(ends)} corners instead of 2"
            continue
        radius = _radius(widths, time, len(points))
        of = columns(points)
        low, high = (of - radius).min(1), (of + radius).max(1)
        # NaN is named by the rule ``finite``
        slack = ROUNDING * max(np.abs(low).max(), np.abs(high).max())
        box_low, box_high = ends.astype(np.float64)
        out = np.maximum(box_low - low, high - box_high).max()
        if out > slack:
            yield time, f"leaves points up to {out:.3g} outside"


def _radius(widths: Usd.Attribute | None, time: Usd.TimeCode, count: int) -> Array | float:
    """Radius of the ball around each of `count` points: (N,), (1,), or one number."""
    values = numbers(widths, time)
    if values is None or values.ndim != 1 or len(values) not in (1, count):
        return 0.0
    return values * 0.5
