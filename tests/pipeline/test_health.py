"""What a bake measures of itself, on motions whose answer is known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from solids import settings

from gf_usd.core.frames.frame import Health
from gf_usd.core.frames.settings import Settings
from gf_usd.pipeline.health.log import HealthLog, merged_health, restitution

G = 9.81
MASS = 2.0  # [kg]
TOUCH = 0.7  # [m] height of the center when the body first touches
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
        center, momentum = np.zeros(3), np.zeros(3)
        center[up], momentum[up] = y, MASS * v
        center[0] += drift * t
        momentum[0] += MASS * drift
        in_contact = t > landing and before < leaving
        out.append(
            Health(
                mass=MASS,
                center=tuple(center),
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
            center=f.center,
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


def log_of(frames: list[Health], s: Settings | None = None, **changes) -> HealthLog:
    log = HealthLog(
        s or scene(), **{"spacing": 0.1, "drop": 1.0, "radius": 0.5, "particles": 10, **changes}
    )
    for frame in frames:
        log.add(frame)
    return log


def test_totals_and_extremes() -> None:
    frames = [
        Health(kinetic=1.0, elastic=2.0, potential=3.0, contact=4.0, mass=1.0),
        Health(
            substeps=10, kinetic=20.0, mass=1.0, min_J=0.4, max_J=1.2, min_stretch=0.3,
            max_stretch=1.5, inverted=2, penetration=0.05, friction_capped=7, rollbacks=1,
            clamped=3, work=4.0,
        ),
        Health(
            substeps=20, elastic=5.0, mass=1.0, min_J=0.6, max_J=1.4, min_stretch=0.5,
            max_stretch=1.1, inverted=3, penetration=0.02, friction_capped=1, rollbacks=2,
            stress_capped=6, work=-1.0, sleeping=2, momentum=(1.0, 2.0, 3.0),
        ),
    ]  # fmt: skip
    skipped = {"frames_without_substeps": 1, "flying_body_frames": 0, "sleeping_body_frames": 2}
    assert log_of(frames).summary() == skipped | {
        "frames": 3,
        "substeps": 30,
        "substeps_max_per_frame": 20,
        "rollbacks": 3,
        "restitution": None,
        "deepest_penetration_m": 0.05,
        "deepest_penetration_spacings": pytest.approx(0.5),
        "deepest_overlap_m": 0.0,
        "deepest_overlap_spacings": 0.0,
        "overlap_pair": None,
        "overlap_names": None,
        "overlap_frame": None,
        "released_max": 0,
        "let_go_max": 0,
        "inside_at_end_share": None,
        "inside_at_end_m": None,
        "inside_max_share": None,
        "inside_max_m": None,
        "outside_mesh_max_share": None,
        "outside_mesh_max_m": None,
        "outside_mesh": None,
        "expanded_volume": None,
        "expanded_body": None,
        "expanded_frame": None,
        "stretched_share": None,
        "stretched_body": None,
        "stretched_frame": None,
        "penetration_at_end_spacings": pytest.approx(0.2),
        "resting_penetration_m": 0.02,
        "resting_penetration_spacings": pytest.approx(0.2),
        "first_contact_frame": 1,
        "falls": True,
        "flesh": False,
        "shift_max_m": 0.0,
        "min_J": 0.4,
        "max_J": 1.4,
        "min_stretch": 0.3,
        "max_stretch": 1.5,
        "inverted_particle_frames": 5,
        "inverted_max": 3,
        "inverted_at_end": 3,
        "first_inverted_frame": 1,
        "clamped_particle_frames": 3,
        "clamped_share": pytest.approx(3 / 30),
        "stress_capped_particle_frames": 6,
        "stress_capped_share": pytest.approx(6 / 30),
        "friction_capped": 8,
        "energy_start_J": 10.0,
        "energy_end_J": 5.0,
        "energy_max_J": 20.0,
        "kinetic_max_J": 20.0,
        "energy_scale_J": 20.0,
        # 20 J after 10 J, 4 J of which the pins did
        "energy_gain_max_J": 6.0,
        "energy_gain_max_share": pytest.approx(0.3),
        "dissipated_J": 10.0 + 3.0 - 5.0,
        "work_of_pins_J": 3.0,
        "injected_J": 0.0,
        "planes_J": 0.0,
        "planes_gain_share": 0.0,
        "momentum_end": [1.0, 2.0, 3.0],
        "angular_momentum_end": [0.0, 0.0, 0.0],
        "free_flight_frames": 0,
        "momentum_drift": None,
        "angular_momentum_drift": None,
    }


def test_what_is_inside_is_that_of_the_frames_looked_at() -> None:
    frames = [
        Health(mass=1.0),
        Health(inside_share=0.3, inside_depth=0.02),
        Health(),
        Health(inside_share=0.1, inside_depth=0.04),
    ]
    out = log_of(frames).summary()
    assert (out["inside_at_end_share"], out["inside_at_end_m"]) == (0.1, 0.04)
    assert (out["inside_max_share"], out["inside_max_m"]) == (0.3, 0.04)


def test_what_is_outside_is_the_most_of_the_frames_looked_at() -> None:
    frames = [
        Health(mass=1.0),
        Health(outside_share=0.3, outside_depth=0.02, outside_mesh="</A>"),
        Health(),
        Health(outside_share=0.1, outside_depth=0.04, outside_mesh="</A>"),
    ]
    out = log_of(frames).summary()
    assert (out["outside_mesh_max_share"], out["outside_mesh_max_m"]) == (0.3, 0.04)
    assert out["outside_mesh"] == "</A>"


def test_the_body_that_expanded_most() -> None:
    frames = [
        Health(mass=1.0),
        Health(max_J=2.1, expanded=1.1, expanded_body="/A"),
        Health(max_J=2.5, expanded=1.3, expanded_body="/B"),
        Health(max_J=4.0, expanded=1.2, expanded_body="/A"),
    ]
    out = log_of(frames).summary()
    found = out["expanded_volume"], out["expanded_body"], out["expanded_frame"]
    assert found == (1.3, "/B", 2)
    merged = merged_health(frames)
    assert (merged.max_J, merged.expanded, merged.expanded_body) == (4.0, 1.3, "/B")


def test_the_body_that_was_stretched_most() -> None:
    frames = [
        Health(mass=1.0),
        Health(max_stretch=9.0, stretched=0.1, stretched_body="/A"),
        Health(max_stretch=4.0, stretched=0.3, stretched_body="/B"),
    ]
    out = log_of(frames).summary()
    found = out["stretched_share"], out["stretched_body"], out["stretched_frame"]
    assert found == (0.3, "/B", 2)
    merged = merged_health(frames)
    assert (merged.max_stretch, merged.stretched, merged.stretched_body) == (9.0, 0.3, "/B")


def test_losses_are_no_gain() -> None:
    frames = [Health(kinetic=e, mass=1.0) for e in (5.0, 4.0, 1.0)]
    out = log_of(frames).summary()
    assert (out["energy_gain_max_J"], out["dissipated_J"]) == (0.0, 4.0)


def test_a_weight_is_the_least_scale_of_energy() -> None:
    # m g0 r of 2 kg and half a meter, where hardly anything moves
    frames = [Health(mass=MASS, kinetic=1e-6)] * 2
    assert log_of(frames).summary()["energy_scale_J"] == pytest.approx(MASS * G * 0.5)


def test_a_body_that_moves_does_not_rest() -> None:
    def at_end(kinetic: float, depth: float) -> float | None:
        frames = [Health(mass=1.0, kinetic=20.0), Health(kinetic=kinetic, penetration=depth)]
        return log_of(frames).summary()["resting_penetration_spacings"]

    assert at_end(0.02, 0.01) == pytest.approx(0.1)
    assert at_end(0.03, 0.01) is None, "more than a thousandth of the energy still moves"
    assert at_end(0.0, 0.0) is None, "it does not touch"


def flight(frames: int, fps: float, spin: float = 0.0, push: float = 0.0) -> list[Health]:
    """A body thrown sideways over the origin, turning at spin [kg m^2/s] about its center.

    push : [kg m/s] that comes out of nothing by the last frame.
    """
    out = []
    for i in range(frames):
        t = i / fps
        center = np.array([3.0 * t, 50.0 - 0.5 * G * t * t, 1.0])
        p = MASS * np.array([3.0, -G * t, 0.0]) + push * i / (frames - 1) * np.eye(3)[2]
        L = np.cross(center, p) + np.array([0.0, 0.0, spin])
        energy = 0.5 * p @ p / MASS
        out.append(
            Health(
                mass=MASS, center=tuple(center), momentum=tuple(p), angular_momentum=tuple(L),
                kinetic=float(energy),
            )
        )  # fmt: skip
    return out


def test_free_flight_drifts_by_nothing() -> None:
    out = log_of(flight(40, 24.0, spin=5.0)).summary()
    assert out["free_flight_frames"] == 39
    # rounding of momenta of a hundred kg m/s, summed over 39 frames
    assert out["momentum_drift"] == pytest.approx(0.0, abs=1e-12)
    assert out["angular_momentum_drift"] == pytest.approx(0.0, abs=1e-12)


def test_time_scale_is_part_of_the_flight() -> None:
    # Frames that show a fifth of the time each.
    out = log_of(flight(40, 120.0), scene(time_scale=0.2)).summary()
    assert out["momentum_drift"] == pytest.approx(0.0, abs=1e-12)
    wrong = log_of(flight(40, 120.0), scene()).summary()
    assert wrong["momentum_drift"] > 0.1


def test_momentum_out_of_nothing_is_seen() -> None:
    frames = flight(25, 24.0, push=0.5)
    out = log_of(frames).summary()
    fastest = math.sqrt(2.0 * out["energy_scale_J"] / MASS)
    assert out["momentum_drift"] == pytest.approx(0.5 / (MASS * fastest))
    touched = [*frames[:13], Health(mass=MASS, penetration=0.1), *frames[13:]]
    until = log_of(touched).summary()
    assert until["free_flight_frames"] == 12
    assert until["momentum_drift"] == pytest.approx(0.25 / (MASS * fastest), rel=1e-9)


def test_what_is_held_or_dragged_flies_not_freely() -> None:
    frames = flight(10, 24.0)
    for log in (log_of(frames, held=True), log_of(frames, scene(drag=1.0))):
        out = log.summary()
        assert (out["momentum_drift"], out["angular_momentum_drift"]) == (None, None)
    assert log_of(bounces(3.0, 0.8), drop=3.0).summary()["restitution"] is not None
    assert log_of(bounces(3.0, 0.8), drop=3.0, held=True).summary()["restitution"] is None


def along(n: tuple[float, float, float], length: float) -> tuple[float, float, float]:
    return (length * n[0], length * n[1], length * n[2])


def test_a_tilted_floor_is_bounced_off_along_its_normal() -> None:
    # The motion of `bounces` turned by the slope: along the normal it is the same with g cos.
    slope = 0.3
    n = (math.sin(slope), math.cos(slope), 0.0)
    gravity = along(n, -G)
    turned = [
        Health(
            mass=MASS,
            center=along(n, f.center[1]),
            momentum=along(n, f.momentum[1]),
            penetration=f.penetration,
        )
        for f in bounces(2.0, 0.7)
    ]
    s = scene(gravity=gravity, floor_normal=n)
    # what falls 2 m along the normal falls 2 m / cos along the up axis before it touches
    drop = 2.0 / math.cos(slope)
    assert restitution(turned, s, drop) == pytest.approx(0.7, rel=1e-9)


def test_every_frame_is_kept_as_plain_values() -> None:
    frames = bounces(3.0, 0.8, frames=5)
    log = log_of(frames, scene(start=101.0, fps=12.0), drop=3.0)
    assert log.summary()["first_contact_frame"] is None
    rows = log.per_frame()
    assert [row["center"] for row in rows] == [f.center for f in frames]
    assert [row["time_code"] for row in rows] == [101.0, 103.0, 105.0, 107.0, 109.0]
    # no law flows, nothing settles, and no frame is looked at for what is inside
    expected = set(Health.__dataclass_fields__) - {
        "plastic_dissipation", "conversion_dissipation", "converted", "settling_dissipation",
        "inside_share", "inside_depth", "outside_share", "outside_depth", "outside_mesh",
        "expanded", "expanded_body", "stretched", "stretched_body",
        "fallen", "fallen_kinetic", "lost", "flow_volume", "flow_per_cell",
        "overlap_pair", "overlap_names", "pierced", "pierced_through", "pierced_pair",
    }  # fmt: skip
    assert set(rows[0]) == {"time_code", *expected, "centre", "energy", "energy_gain"}
    assert [row["centre"] for row in rows] == [f.center for f in frames], "until 1.0"
    energies = log_of(
        [Health(kinetic=1.0), Health(elastic=4.0, work=1.5, injected=1.0)]
    ).per_frame()
    assert [row["energy"] for row in energies] == [1.0, 4.0]
    assert [row["energy_gain"] for row in energies] == [0.0, 0.5]
