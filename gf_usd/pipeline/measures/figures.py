"""Figures of a motion for users: first contact, least height, rebound, rest, strain.

Frames are samples of a continuous motion. Where a figure is the extremum of a curve y(t), or the
time at which it passes a value, the curve is the cubic Hermite interpolant of y and dy/dt at the
frames, whose error is dt^4 / 384 times the fourth derivative (de Boor, A Practical Guide to
Splines, 1978).

The first contact with a floor ends free flight, whose solution is known:

    x_i(t) = c + v t + g t^2 / 2 + R(w t) (x_i - c)

with c the center of mass, v its velocity and w the angular velocity.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gf_usd.core.arrays import Floats

TOUCHING = 1e-4  # of the height: points up to this far above the lowest one are in contact too
NEWTON = 40  # iterations, at most; about five are typical


@dataclass(frozen=True, kw_only=True)
class Landing:
    """The first contact with the floor, after free flight."""

    time: float  # [s]
    place: Floats  # (3,) [m]
    center: Floats  # (3,) [m] center of mass at that time


@dataclass(frozen=True, kw_only=True)
class Series:
    """T frames of a motion, each reduced to a few numbers; heights are above the floor."""

    times: Floats  # (T,) [s] simulated
    centers: Floats  # (T, 3) [m] center of mass
    velocities: Floats  # (T, 3) [m/s] of it
    high: Floats  # (T,) [m] highest point
    high_rate: Floats  # (T,) [m/s] vertical speed of that point
    low: Floats  # (T,) [m] lowest point
    low_rate: Floats  # (T,) [m/s]
    volumes: Floats  # (T,) over that at rest
    strains: Floats  # (T,) largest principal nominal strain |lambda - 1| of all particles
    kinetic: Floats  # (T,) [J]
    touching: tuple[bool, ...]  # (T,) whether there was contact since the previous frame
    inverted: tuple[int, ...]  # (T,) particles with J <= 0
    up: Floats  # (3,) unit, out of the floor
    weight: float | None = None  # [N] of the falling bodies; None: unknown
    grounded: bool = True  # there is a floor; without one heights are above the origin
    landing: Landing | None = None  # None: it does not land on a floor

    def __len__(self) -> int:
        return len(self.times)

    @property
    def height(self) -> float:
        """[m] extent along `up` in the first frame."""
        return float(self.high[0] - self.low[0])

    @property
    def starts(self) -> tuple[int, ...]:
        """The frames in which a contact begins: frames with contact after one without."""
        pairs = zip(self.touching, (False, *self.touching))
        return tuple(i for i, (now, before) in enumerate(pairs) if now and not before)


class Recorder:
    """Reduces frames to a `Series`, one at a time, in order.

    Parameters
    ----------
    up : (3,) unit normal of the floor, or the direction against gravity where there is none.
    floor : [m] distance of the floor from the origin along `up`; None: heights are above the
        origin, and no landing is looked for.
    gravity : (3,) [m/s^2].
    """

    def __init__(self, up: Floats, floor: float | None, gravity: Floats) -> None:
        self._up, self._floor = np.asarray(up, float), floor
        self.weight: float | None = None  # [N], where it is known
        self._gravity = np.asarray(gravity, float)
        self._rows: list[tuple[float, ...]] = []
        self._centers: list[Floats] = []
        self._velocities: list[Floats] = []
        self._touching: list[bool] = []
        self._inverted: list[int] = []
        self._flight: tuple[float, Floats, Floats, Floats, Floats] | None = None
        self._landing: Landing | None = None

    def add(
        self,
        time: float,
        points: Floats,
        velocities: Floats,
        *,
        center: Sequence[float],
        velocity: Sequence[float],
        volume: float = 1.0,
        strain: float = 0.0,
        kinetic: float = 0.0,
        touching: bool = False,
        inverted: int = 0,
    ) -> None:
        """Append a frame.

        points, velocities : (n, 3) [m] and [m/s] of the surface, the same points in every frame.
        center, velocity : (3,) of the center of mass.
        """
        x, v = np.asarray(points, float), np.asarray(velocities, float)
        c, w = np.asarray(center, float), np.asarray(velocity, float)
        heights = x @ self._up - (self._floor or 0.0)
        top, bottom = int(heights.argmax()), int(heights.argmin())
        if self._floor is not None and self._landing is None:
            self._fly(time, x, v, c, w, float(heights[bottom]), touching)
        self._rows.append(
            (
                *(time, heights[top], float(v[top] @ self._up)),
                *(heights[bottom], float(v[bottom] @ self._up)),
                *(volume, strain, kinetic),
            )
        )
        self._centers.append(c)
        self._velocities.append(w)
        self._touching.append(touching)
        self._inverted.append(inverted)

    def _fly(
        self, time: float, x: Floats, v: Floats, c: Floats, w: Floats, low: float, touching: bool
    ) -> None:
        """Store the last frame in free flight; at the first one after it, compute the landing."""
        if low > 0.0 and not touching:
            if self._flight is not None or not self._rows:
                self._flight = (time, x, v, c, w)
            return
        if self._flight is not None:
            found = landing(*self._flight, self._up, self._floor or 0.0, self._gravity)
            # contact far above the floor is contact with something else
            if found.time <= time:
                self._landing = found
        self._flight = None

    def series(self) -> Series:
        """The series of all frames so far."""
        t, high, high_rate, low, low_rate, volume, strain, kinetic = np.array(self._rows).T
        return Series(
            times=t, high=high, high_rate=high_rate, low=low, low_rate=low_rate, volumes=volume,
            strains=strain, kinetic=kinetic, centers=np.array(self._centers),
            velocities=np.array(self._velocities), touching=tuple(self._touching),
            inverted=tuple(self._inverted), up=self._up, grounded=self._floor is not None,
            landing=self._landing, weight=self.weight,
        )  # fmt: skip


def landing(
    time: float,
    points: Floats,
    velocities: Floats,
    center: Floats,
    velocity: Floats,
    up: Floats,
    floor: float,
    gravity: Floats,
) -> Landing:
    """Time, position and center of mass at the first contact of a rigid body with a plane.

    Solves the equation of the module, with w the least squares fit of w x (x_i - c) = v_i - v. The
    position is the mean of the points that are within TOUCHING of the height.

    points, velocities : (n, 3) at `time`; center, velocity : (3,) of the center of mass.
    """
    from scipy.spatial.transform import Rotation  # takes long to import, and most need it never

    r = np.asarray(points, float) - center
    relative = np.asarray(velocities, float) - velocity
    inertia = np.einsum("ij,ij->", r, r) * np.eye(3) - r.T @ r
    spin = np.linalg.lstsq(inertia, np.cross(r, relative).sum(0), rcond=1e-12)[0]

    def at(t: float) -> Floats:
        turned = Rotation.from_rotvec(spin * t).apply(r)
        return center + velocity * t + 0.5 * gravity * t * t + turned

    t = 0.0
    height = float(np.ptp(r @ up))
    for _ in range(NEWTON):
        heights = at(t) @ up - floor
        lowest = int(heights.argmin())
        arm = at(t)[lowest] - (center + velocity * t + 0.5 * gravity * t * t)
        rate = float((velocity + gravity * t + np.cross(spin, arm)) @ up)
        if abs(heights[lowest]) <= 1e-12 * max(height, 1e-300) or rate >= 0.0:
            break
        t -= float(heights[lowest]) / rate
    x = at(t)
    heights = x @ up
    return Landing(
        time=time + t,
        place=x[heights <= heights.min() + TOUCHING * height].mean(0),
        center=center + velocity * t + 0.5 * gravity * t * t,
    )


def figures(
    series: Series, *, held: bool = False, at_rest: bool = False
) -> dict[str, Floats | None]:
    """Figures of a motion by their names in `FIGURES`, (k,) each; None where undefined.

    Heights are of the highest point over the floor, not the extent along `up`: the solver resolves
    contact at sample points only, so the lowest point of the surface is no figure of the motion.
    Without a floor heights are the extent.

    held : pins or bones prescribe a part of the body, which therefore neither lands nor rebounds.
    at_rest : it is at rest in the last frame.
    """
    found: dict[str, Floats | None] = dict.fromkeys(FIGURES)
    found["peak_strain"] = np.array([series.strains.max()])
    worst = int(np.abs(series.volumes - 1.0).argmax())
    found["volume_change"] = np.array([series.volumes[worst] - 1.0])
    if at_rest:
        ground = 0.0 if series.grounded else series.low[-1]
        found["settled_height"] = np.array([series.high[-1] - ground])
        found["settled_center"] = np.array(series.centers[-1])
    if held:
        sag = minimum(series.times, series.low, series.low_rate)[1]
        found["sag"] = np.array([series.low[0] - sag])
        if at_rest:
            found["settled_sag"] = np.array([series.low[0] - series.low[-1]])
        return found
    if series.landing is not None:
        found["first_contact_time"] = np.array([series.landing.time])
        found["first_contact_place"] = np.array(series.landing.place)
    begin, end = first_contact(series)
    if begin is None:
        return found
    part = slice(max(0, begin - 1), end + 1)
    top, rate = _top(series)
    squash = minimum(series.times[part], top[part], rate[part])[1]
    found["least_height"] = np.array([squash])
    if squash < series.height:  # a body that is always higher than at the start has turned over
        found["squash"] = np.array([1.0 - squash / series.height])
    rise = rebound(series)
    found["rebound"] = None if rise is None else np.array([rise])
    return found


@dataclass(frozen=True, kw_only=True)
class Figure:
    """Name and unit of a figure."""

    text: str
    unit: str  # SI; "" for a pure number


FIGURES: Mapping[str, Figure] = {
    "first_contact_time": Figure(text="time of the first contact", unit="s"),
    "first_contact_place": Figure(text="place of the first contact", unit="m"),
    "least_height": Figure(text="least height in the first contact", unit="m"),
    "squash": Figure(text="peak squash", unit=""),
    "rebound": Figure(text="rebound of the center of mass", unit="m"),
    "sag": Figure(text="deepest sag of the lowest point", unit="m"),
    "settled_height": Figure(text="height at rest", unit="m"),
    "settled_center": Figure(text="center of mass at rest", unit="m"),
    "settled_sag": Figure(text="sag at rest", unit="m"),
    "peak_strain": Figure(text="peak strain", unit=""),
    "volume_change": Figure(text="largest change of volume", unit=""),
}


def first_contact(series: Series) -> tuple[int | None, int]:
    """The first and the last frame of the first contact; None: there is no contact.

    The last one is the first frame after it without contact, or the last frame of the motion.
    """
    if not series.starts:
        return None, 0
    begin = series.starts[0]
    after = (i for i in range(begin, len(series)) if not series.touching[i])
    return begin, next(after, len(series) - 1)


def _top(series: Series) -> tuple[Floats, Floats]:
    """(T,) [m] height over the floor, or extent where there is none, and its rate (T,) [m/s]."""
    if series.grounded:
        return series.high, series.high_rate
    return series.high - series.low, series.high_rate - series.low_rate


def reached(series: Series, name: str) -> int:
    """The frame that determines a figure of `figures`; later frames do not change it."""
    last = len(series) - 1
    begin, end = first_contact(series)
    squashed = (begin or 0) + int(_top(series)[0][begin or 0 : end + 1].argmin())
    frames = {
        "first_contact_time": begin or 0,
        "first_contact_place": begin or 0,
        "least_height": min(last, squashed + 1),
        "squash": min(last, squashed + 1),
        "rebound": end,
        "sag": min(last, int(series.low.argmin()) + 1),
        "peak_strain": int(series.strains.argmax()),
        "volume_change": int(np.abs(series.volumes - 1.0).argmax()),
    }
    return frames.get(name, last)


def rebound(series: Series) -> float | None:
    """[m] rise of the center of mass from its height at the first contact to its next maximum.

    None where it never separates, or no landing on a floor is known. Where the body has separated
    by the last frame but not reached its maximum, the maximum is that of free flight, y + v^2 / 2
    g.
    """
    begin, left = first_contact(series)
    if begin is None or series.landing is None or series.touching[left]:
        return None
    y, v = series.centers @ series.up, series.velocities @ series.up
    height = float(series.landing.center @ series.up)
    if v[left] <= 0.0:
        return None
    down = np.flatnonzero(v[left:] <= 0.0)
    if not len(down):
        g = _gravity(series, left)
        return float(y[-1] + v[-1] ** 2 / (2.0 * abs(g)) - height) if g < 0.0 else None
    part = slice(left, left + int(down[0]) + 1)
    return float(-minimum(series.times[part], -y[part], -v[part])[1] - height)


def highest_rebound(series: Series) -> float | None:
    """[m] rebound without energy loss: (E_kin + m g y at the start) / m g - y.

    None where the body does not land, or its weight is unknown.
    """
    if series.landing is None or not series.weight:
        return None
    fall = float((series.centers[0] - series.landing.center) @ series.up)
    return fall + float(series.kinetic[0]) / series.weight


def _gravity(series: Series, left: int) -> float:
    """[m/s^2] acceleration of the center of mass along `up` from a frame on."""
    if left >= len(series) - 1:
        return 0.0
    v = series.velocities @ series.up
    return float((v[-1] - v[left]) / (series.times[-1] - series.times[left]))


def minimum(times: Floats, values: Floats, rates: Floats) -> tuple[float, float]:
    """Time and value of the minimum of a curve through values (T,) with slopes `rates` (T,).

    Cubic Hermite interpolation between the times (T,):

        y = y0 + h m0 u + (3 d - 2 a - b) u^2 + (a + b - 2 d) u^3

    with u in [0, 1], d = y1 - y0, a = h m0, b = h m1; the extrema are the zeros of its derivative.
    """
    t, y, m = (np.asarray(one, float) for one in (times, values, rates))
    best = int(y.argmin())
    found = (float(t[best]), float(y[best]))
    for i in range(max(0, best - 1), min(len(t) - 1, best + 1)):
        h = t[i + 1] - t[i]
        d, a, b = y[i + 1] - y[i], h * m[i], h * m[i + 1]
        square, cube = 3.0 * d - 2.0 * a - b, a + b - 2.0 * d
        roots = np.roots([3.0 * cube, 2.0 * square, a])
        for u in roots[np.abs(roots.imag) < 1e-12].real:
            if 0.0 < u < 1.0:
                value = y[i] + u * (a + u * (square + u * cube))
                if value < found[1]:
                    found = (float(t[i] + u * h), float(value))
    return found
