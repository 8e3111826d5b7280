"""What a whole bake says of itself: one line per question a person asks of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from gf_usd.model import Health, Settings


class HealthLog:
    """Collects the health of frames; a few hundred bytes a frame."""

    def __init__(self, settings: Settings, spacing: float, drop: float) -> None:
        self._settings, self._spacing, self._drop = settings, spacing, drop
        self.frames: list[Health] = []

    def add(self, health: Health) -> None:
        """Append the next frame's health."""
        self.frames.append(health)

    def summary(self) -> dict[str, Any]:
        """Totals and extremes over the frames so far; documented in docs/guide.md."""
        h = self.frames
        energy = [f.kinetic + f.elastic + f.potential + f.contact for f in h]
        return {
            "frames": len(h),
            "substeps": sum(f.substeps for f in h),
            "restitution": restitution(h, self._settings, self._drop),
            "deepest_penetration_m": max(f.penetration for f in h),
            "deepest_penetration_spacings": max(f.penetration for f in h) / self._spacing,
            "penetration_at_end_spacings": h[-1].penetration / self._spacing,
            "first_contact_frame": next((i for i, f in enumerate(h) if f.penetration > 0.0), None),
            "min_J": min(f.min_J for f in h),
            "max_J": max(f.max_J for f in h),
            "min_stretch": min(f.min_stretch for f in h),
            "max_stretch": max(f.max_stretch for f in h),
            "inverted_particle_frames": sum(f.inverted for f in h),
            "rollbacks": sum(f.rollbacks for f in h),
            "friction_capped": sum(f.friction_capped for f in h),
            "energy_start_J": energy[0],
            "energy_end_J": energy[-1],
            "energy_max_J": max(energy),
        }

    def per_frame(self) -> list[dict[str, Any]]:
        """Every frame's health as plain values."""
        return [asdict(f) for f in self.frames]


def restitution(frames: Sequence[Health], settings: Settings, drop: float) -> float | None:
    """Rebound over impact speed of the first bounce, v' / v, or None where there was none.

    Speeds are those of the centre of mass at the height where it first touched, found from the
    frames in free flight on either side: v_c^2 = v^2 + 2 g (y - y_c), which holds whatever part of
    the flight a frame shows.  drop : [m] that the asset fell before touching.
    """
    up, g = settings.up, -_dot(settings.gravity, settings.up)
    touched = next((i for i, f in enumerate(frames) if f.penetration > 0.0), None)
    if touched is None or touched == 0 or g <= 0.0:
        return None
    left = next((i for i in range(touched, len(frames)) if frames[i].penetration == 0.0), None)
    if left is None:
        return None
    y_c = _dot(frames[0].centre, up) - drop

    def squared_speed(f: Health) -> float:
        return (_dot(f.momentum, up) / f.mass) ** 2 + 2.0 * g * (_dot(f.centre, up) - y_c)

    before, after = squared_speed(frames[touched - 1]), squared_speed(frames[left])
    if before <= 0.0:
        return None
    return math.sqrt(max(0.0, after) / before)


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return sum(x * y for x, y in zip(a, b))
