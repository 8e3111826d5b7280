"""What a bake measures of itself, on motions whose answer is known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from solids import settings

from gf_usd.model import Health, Settings
from gf_usd.summary import HealthLog, restitution

G = 9.81
MASS = 2.0  # [kg]
TOUCH = 0.7  # [m] height of the centre when the body first touches
HOLD = 0.13  # [s] in contact


def scene(**changes) -> Settings:
    """Gravity along minus Y over a floor."""
    return settings(**{"gravity": (0.0, -G, 0.0), "floor": 0.0, **changes})


def bounces(
    drop: float, e: float, fps: float = 24.0, frames: int = 60, up: int = 1, drift: float = 0.0
) -> list[Health]:
    """A body that falls by drop [m], is held on the floor, and leaves at e times its speed.

    drift : [m/s] along another axis.  A frame is in contact where any of its interval was.
    """
    landing = math.sqrt(2.0 * drop / G)
    leaving = landing + HOLD
    speed = math.sqrt(2.0 * G * drop)
    out = []
    for i in range(frames):
        t, before = i / fps, (i - 1) / fps
        if t <= landing:
            y, v = TOUCH + drop - 0.5 * G * t * t, -G * t
        elif t < leaving:
            y, v = 0.8 * TOUCH, 0.0
        else:
            s = t - leaving
            y, v = TOUCH + e * speed * s - 0.5 * G * s * s, e * speed - G * s
        centre, momentum = np.zeros(3), np.zeros(3)
        centre[up], momentum[up] = y, MASS * v
        centre[0] += drift * t
        momentum[0] += MASS * drift
        in_contact = t > landing and before < leaving
        out.append(
            Health(
                mass=MASS,
                centre=tuple(centre),
                momentum=tuple(momentum),
                penetration=0.01 if in_contact else 0.0,
            )
        )
    return out


@pytest.mark.parametrize("e", [1.0, 0.85, 0.5])
@pytest.mark.parametrize("fps", [24.0, 23.976, 60.0, 240.0])
def test_rebound_speed_over_impact_speed(e: float, fps: float) -> None:
    # Whatever part of the flight the frames show: the formula is exact, rounding is left.
    frames = bounces(3.0, e, fps, frames=int(2.0 * fps))
    assert restitution(frames, scene(), 3.0) == pytest.approx(e, rel=1e-9)


@pytest.mark.parametrize("drop", [0.05, 1.0, 20.0])
def test_height_of_the_fall_makes_no_difference(drop: float) -> None:
    frames = bounces(drop, 0.6, fps=120.0, frames=400)
    assert restitution(frames, scene(), drop) == pytest.approx(0.6, rel=1e-9)


def test_only_the_motion_along_the_up_axis_counts() -> None:
    frames = bounces(2.0, 0.7, up=2, drift=4.0)
    s = scene(up=(0.0, 0.0, 1.0), gravity=(0.0, 0.0, -G))
    assert restitution(frames, s, 2.0) == pytest.approx(0.7, rel=1e-9)


def test_other_gravity_has_other_speeds_and_the_same_rebound() -> None:
    # Half the gravity seen in slow motion: speeds scale by 1/sqrt(2), their ratio does not.
    frames = bounces(2.0, 0.7)
    slow = [
        Health(
            mass=f.mass,
            centre=f.centre,
            momentum=tuple(p / math.sqrt(2.0) for p in f.momentum),
            penetration=f.penetration,
        )
        for f in frames
    ]
    s = scene(gravity=(0.0, -0.5 * G, 0.0))
    assert restitution(slow, s, 2.0) == pytest.approx(0.7, rel=1e-9)


def test_a_body_that_sticks_has_no_rebound() -> None:
    frames = bounces(3.0, 0.0)
    assert restitution(frames, scene(), 3.0) == pytest.approx(0.0, abs=1e-9)


def test_where_there_is_no_bounce_there_is_no_number() -> None:
    frames = bounces(3.0, 0.8)
    touched = next(i for i, f in enumerate(frames) if f.penetration > 0.0)
    left = next(i for i in range(touched, len(frames)) if frames[i].penetration == 0.0)
    assert restitution(frames[:touched], scene(), 3.0) is None, "it never touched"
    assert restitution(frames[:left], scene(), 3.0) is None, "it never left"
    assert restitution(frames[touched:], scene(), 3.0) is None, "it lay there from the start"
    assert restitution(frames, scene(gravity=(0.0, 0.0, 0.0)), 3.0) is None, "nothing fell"
    assert restitution(frames, scene(gravity=(0.0, G, 0.0)), 3.0) is None, "it fell upward"
    assert restitution(frames[: left + 1], scene(), 3.0) is not None


def test_totals_and_extremes() -> None:
    log = HealthLog(scene(), spacing=0.1, drop=1.0)
    log.add(Health(kinetic=1.0, elastic=2.0, potential=3.0, contact=4.0, mass=1.0))
    log.add(
        Health(
            substeps=10, kinetic=20.0, mass=1.0, min_J=0.4, max_J=1.2, min_stretch=0.3,
            max_stretch=1.5, inverted=2, penetration=0.05, friction_capped=7, rollbacks=1,
        )
    )  # fmt: skip
    log.add(
        Health(
            substeps=20, elastic=5.0, mass=1.0, min_J=0.6, max_J=1.4, min_stretch=0.5,
            max_stretch=1.1, inverted=3, penetration=0.02, friction_capped=1, rollbacks=2,
        )
    )  # fmt: skip
    assert log.summary() == {
        "frames": 3,
        "substeps": 30,
        "restitution": None,
        "deepest_penetration_m": 0.05,
        "deepest_penetration_spacings": pytest.approx(0.5),
        "penetration_at_end_spacings": pytest.approx(0.2),
        "first_contact_frame": 1,
        "min_J": 0.4,
        "max_J": 1.4,
        "min_stretch": 0.3,
        "max_stretch": 1.5,
        "inverted_particle_frames": 5,
        "rollbacks": 3,
        "friction_capped": 8,
        "energy_start_J": 10.0,
        "energy_end_J": 5.0,
        "energy_max_J": 20.0,
    }


def test_every_frame_is_kept_as_plain_values() -> None:
    log = HealthLog(scene(), spacing=0.1, drop=3.0)
    frames = bounces(3.0, 0.8, frames=5)
    for frame in frames:
        log.add(frame)
    assert log.summary()["first_contact_frame"] is None
    rows = log.per_frame()
    assert [row["centre"] for row in rows] == [f.centre for f in frames]
    assert set(rows[0]) == set(Health.__dataclass_fields__)
