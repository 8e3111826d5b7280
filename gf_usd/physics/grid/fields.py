"""Fields: body forces on the nodes besides gravity, per unit mass.

A field is constant over a frame, evaluated at the nodes' positions at its start and at the time of
its middle. A body force b of the nodes is equivalent to the forces M~ b, so that its work in a
frame is (M~ b) . (u' - u) for any number of substeps.

Noise is a sum of transverse, and so divergence-free, plane waves of one wavelength,

    b = a sqrt(2 / N) sum_n e_n cos(k_n . x + w_n t + p_n)        e_n . k_n = 0, |k_n| = 2 pi / L

with the spatial mean square a^2; directions, phases and the signs of w_n = +-2 pi rate are random
by the seed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats
from gf_usd.core.frames.settings import Field, Settings

WAVES = 32  # N of the noise


class Fields:
    """The fields of a bake."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._waves = [_waves(f, settings.seed, k) for k, f in enumerate(settings.fields)]

    def __bool__(self) -> bool:
        return bool(self._waves)

    def at(self, x: Floats, index: int) -> NDArray[np.float64]:
        """b (n, 3) [m/s^2] at points (n, 3) [m], between frames `index` - 1 and `index`."""
        s, middle = self._settings, index - 0.5
        code, time = s.time_code(middle), middle * s.frame_time
        out = np.zeros_like(x, dtype=float)
        for field, waves in zip(s.fields, self._waves, strict=True):
            out += _strength(field, waves, x, code, time, np.asarray(s.gravity)) * _near(field, x)
        return out


def _near(field: Field, x: Floats) -> Floats | float:
    """(n, 1) attenuation factor by the distance from the field's center."""
    if field.radius is None:
        return 1.0
    away = ((x - np.asarray(field.center)) ** 2).sum(1, keepdims=True)
    return np.asarray(np.exp(-away / field.radius**2))


def _strength(
    field: Field, waves: Floats, x: Floats, code: float, time: float, gravity: Floats
) -> Floats:
    """(n, 3) or (3,) [m/s^2] before attenuation."""
    if field.kind == "wind":
        return np.asarray(field.vector)
    if field.kind == "gravity":
        values = np.asarray(field.values)
        return np.array([np.interp(code, field.times, values[:, a]) for a in range(3)]) - gravity
    if field.kind == "radial":
        way = x - np.asarray(field.center)
        length = np.linalg.norm(way, axis=1, keepdims=True)
        return np.asarray(field.strength * way / np.where(length > 0.0, length, 1.0))
    k, e, phase, turn = waves[:, :3], waves[:, 3:6], waves[:, 6], waves[:, 7]
    swing = np.cos(x @ k.T + turn * time + phase)
    return np.asarray(field.strength * np.sqrt(2.0 / len(waves)) * swing @ e)


def _waves(field: Field, seed: int, number: int) -> NDArray[np.float64]:
    """(N, 8) k, e, phase and w of a noise; empty for another field."""
    if field.kind != "noise":
        return np.zeros((0, 8))
    dice = np.random.default_rng([seed, number])
    n = dice.normal(size=(WAVES, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    e = np.cross(n, dice.normal(size=(WAVES, 3)))
    e /= np.linalg.norm(e, axis=1, keepdims=True)
    phase = dice.uniform(0.0, 2.0 * np.pi, WAVES)
    turn = 2.0 * np.pi * field.rate * dice.choice([-1.0, 1.0], WAVES)
    return np.column_stack([2.0 * np.pi / field.length * n, e, phase, turn])
