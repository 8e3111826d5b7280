"""Materials by region: `--material-box metal:x0,y0,z0,x1,y1,z1`, a preset for what is in a box."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gf_usd.errors import InputError, UsageError
from gf_usd.materials import find_preset
from gf_usd.model import Floats, Ints

OPTION = "--material-box"


@dataclass(frozen=True, kw_only=True)
class MaterialBox:
    """A preset for the particles that rest in a box, faces included."""

    text: str  # as asked for
    material: str  # name of a preset
    low: Floats  # (3,) [stage units]
    high: Floats  # (3,) [stage units]
    option = OPTION

    def holds(self, X: Floats, unit: float) -> Floats:
        """(n,) which points (n, 3) [m] lie in it; unit : [m] per stage length."""
        return np.all((self.low * unit <= X) & (self.high * unit >= X), axis=1)


def parse_boxes(texts: Sequence[str]) -> tuple[MaterialBox, ...]:
    """The boxes of "PRESET:x0,y0,z0,x1,y1,z1", two opposite corners in stage units, world axes.

    Raises UsageError for anything else, for an unknown preset and for a box without volume.
    """
    return tuple(_parse(text) for text in texts)


def _parse(text: str) -> MaterialBox:
    name, _, corners = text.partition(":")
    try:
        numbers = np.array([float(word) for word in corners.split(",")])
    except ValueError:
        numbers = np.full(6, np.nan)
    if len(numbers) != 6 or not np.isfinite(numbers).all():
        raise UsageError(
            f"{OPTION} {text} is no preset and box",
            f"give a preset and two corners in stage units: {OPTION} metal:-1,0,-1,1,0.2,1",
        )
    low, high = np.minimum(numbers[:3], numbers[3:]), np.maximum(numbers[:3], numbers[3:])
    if (high - low).min() <= 0.0:
        raise UsageError(
            f"{OPTION} {text} has no volume: its sides are {(high - low).tolist()}",
            "give two opposite corners that differ along every axis",
        )
    preset = find_preset(name.strip())
    return MaterialBox(text=text, material=preset.name, low=low, high=high)


def boxed(boxes: Sequence[MaterialBox], X: Floats, unit: float) -> Ints:
    """(N,) index of the box that each particle X (N, 3) [m] rests in, -1: none.

    Where boxes overlap the later one holds.  Raises InputError for a box that holds no particle.
    """
    out = np.full(len(X), -1)
    for k, box in enumerate(boxes):
        mine = box.holds(X, unit)
        if not mine.any():
            low, high = X.min(0) / unit, X.max(0) / unit
            raise InputError(
                f"{OPTION} {box.text} holds none of the {len(X)} particles, which rest between"
                f" {_triple(low)} and {_triple(high)}",
                "give corners in the asset's units and axes, or use more --particles",
            )
        out[mine] = k
    return out


def _triple(values: Floats) -> str:
    return "(" + ", ".join(f"{v:.4g}" for v in values) + ")"
