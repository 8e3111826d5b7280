"""Health of a whole bake: totals and extremes of the frames' values.

The keys of `HealthLog.summary` are documented in docs/guide/report.md, and those that are
attributes of GaussianFleshHealthAPI in docs/schema.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from itertools import pairwise
from typing import Any

from gf_usd.core.frames.frame import Health, pierced_weight
from gf_usd.core.frames.settings import Settings, shortened
from gf_usd.core.materials.dimensionless import G0

REST = 1e-3  # of the energy scale: a body with less kinetic energy is at rest


class HealthLog:
    """Collects the health of frames, a few hundred bytes per frame.

    Parameters
    ----------
    settings : of the bake.
    spacing : [m] mean distance of particles.
    drop : [m] height of fall of the body along the up axis.
    radius : [m] of a ball of the body's volume; with the weight it gives the scale of energy.
    particles : number; counts over frames are also reported as shares of it.
    held : the body is pinned, so that it neither falls freely nor bounces.
    bodies : number of bodies.
    flesh : the body is flesh around bones.
    """

    def __init__(
        self,
        settings: Settings,
        *,
        spacing: float,
        drop: float,
        radius: float,
        particles: int,
        held: bool = False,
        bodies: int = 1,
        obstacles: bool = False,
        flesh: bool = False,
    ) -> None:
        self._settings, self._spacing, self._drop = settings, spacing, drop
        self._radius, self._particles, self._held = radius, particles, held
        self._bodies, self._obstacles, self._flesh = bodies, obstacles, flesh
        self.frames: list[Health] = []
        self._passing: list[Health] = []  # samples since the last frame

    def add(self, health: Health) -> None:
        """Append the health of the next sample; `samples_per_frame` samples make a frame."""
        self._passing.append(health)
        if not self.frames or len(self._passing) == self._settings.samples_per_frame:
            self.frames.append(merged_health(self._passing))
            self._passing = []

    def skip_frames(self, frames: int) -> None:
        """Record that so many frames before the written ones were not simulated; see
        `shortened`.
        """
        self._settings = shortened(self._settings, frames)

    def state(self) -> dict[str, Any]:
        """The samples so far as plain values."""
        return {
            "frames": [asdict(health) for health in self.frames],
            "passing": [asdict(health) for health in self._passing],
        }

    def load(self, state: Mapping[str, Any]) -> None:
        """Restore `state`."""
        self.frames = [health_of(row) for row in state["frames"]]
        self._passing = [health_of(row) for row in state["passing"]]

    def summary(self) -> dict[str, Any]:
        """Totals and extremes over the frames so far; None for values that are not defined."""
        h = self.frames
        many = self._particles * len(h)
        # the coefficient of restitution is defined for one body that touches nothing but the floor
        crowd = self._held or self._bodies > 1
        crowd |= self._obstacles and any(f.overlap > 0.0 for f in h)
        return {
            "frames": len(h),
            "substeps": sum(f.substeps for f in h),
            "substeps_max_per_frame": max(f.substeps for f in h),
            "rollbacks": sum(f.rollbacks for f in h),
            "frames_without_substeps": sum(1 for f in h if f.flying or f.sleeping),
            "flying_body_frames": sum(f.flying for f in h),
            "sleeping_body_frames": sum(f.sleeping for f in h),
            "restitution": None if crowd else restitution(h, self._settings, self._drop),
            "deepest_penetration_m": max(f.penetration for f in h),
            "deepest_penetration_spacings": max(f.penetration for f in h) / self._spacing,
            "penetration_at_end_spacings": h[-1].penetration / self._spacing,
            **self._resting(),
            **self._fallen(),
            **self._flow(),
            **self._conversion(),
            "deepest_overlap_m": max(f.overlap for f in h),
            "deepest_overlap_spacings": max(f.overlap for f in h) / self._spacing,
            **self._overlap(),
            **self._pierced(),
            "released_max": max(f.let_go for f in h),
            "let_go_max": max(f.let_go for f in h),  # its name before; until 1.0
            **self._inside(),
            "first_contact_frame": next((i for i, f in enumerate(h) if touches(f)), None),
            "min_J": min(f.min_J for f in h),
            "max_J": max(f.max_J for f in h),
            **self._expanded(),
            **self._stretched(),
            "min_stretch": min(f.min_stretch for f in h),
            "max_stretch": max(f.max_stretch for f in h),
            "inverted_particle_frames": sum(f.inverted for f in h),
            "inverted_max": max(f.inverted for f in h),
            "inverted_at_end": h[-1].inverted,
            "first_inverted_frame": next((i for i, f in enumerate(h) if f.inverted), None),
            "clamped_particle_frames": sum(f.clamped for f in h),
            "clamped_share": sum(f.clamped for f in h) / many,
            "stress_capped_particle_frames": sum(f.stress_capped for f in h),
            "stress_capped_share": sum(f.stress_capped for f in h) / many,
            "friction_capped": sum(f.friction_capped for f in h),
            "falls": self._falls,
            "flesh": self._flesh,
            "shift_max_m": max(math.dist(f.center, h[0].center) for f in h),
            **self._energies(),
            **self._momenta(),
        }

    @property
    def _falls(self) -> bool:
        """Whether gravity pulls the body toward a floor or an obstacle."""
        to_floor = self._settings.floor is not None or self._obstacles
        return to_floor and not self._held and any(self._settings.gravity)

    def per_frame(self) -> list[dict[str, Any]]:
        """Every frame's health as plain values, with the total energy and its gain."""
        total = [f.energy for f in self.frames]
        gains = [0.0, *gain_of_frames(self.frames)]
        return [
            {
                "time_code": self._settings.time_code(i),
                **{name: value for name, value in vars(f).items() if value is not None},
                "centre": f.center,  # until 1.0
                "energy": total[i],
                "energy_gain": gains[i],
            }
            for i, f in enumerate(self.frames)
        ]

    @property
    def _scale(self) -> float:
        """[J] scale of energy: the largest kinetic or elastic energy, at least m g0 r."""
        weight = self.frames[0].mass * G0 * self._radius
        return max([weight, *(f.kinetic + f.elastic for f in self.frames)])

    def _energies(self) -> dict[str, Any]:
        h, total = self.frames, [f.energy for f in self.frames]
        gain = max([0.0, *gain_of_frames(h)])
        work, injected = sum(f.work for f in h), sum(f.injected for f in h)
        flow = [f.plastic_dissipation for f in h if f.plastic_dissipation is not None]
        settled = [f.settling_dissipation for f in h if f.settling_dissipation is not None]
        return {
            "energy_start_J": total[0],
            "energy_end_J": total[-1],
            "energy_max_J": max(total),
            "kinetic_max_J": max(f.kinetic for f in h),
            "energy_scale_J": self._scale,
            "energy_gain_max_J": gain,
            "energy_gain_max_share": gain / self._scale if self._scale else 0.0,
            "dissipated_J": total[0] + work + injected - total[-1],
            "work_of_pins_J": work,
            "injected_J": injected,
            "planes_J": sum(f.planes for f in h),
            "planes_gain_share": sum(max(0.0, f.planes) for f in h) / self._scale
            if self._scale
            else 0.0,
            **({"plastic_dissipation_J": sum(flow)} if flow else {}),
            **({"settling_dissipation_J": sum(settled)} if settled else {}),
        }

    def _fallen(self) -> dict[str, Any]:
        """Number of bodies that fell past every obstacle, where this is measured."""
        last, count = self.frames[-1], self._bodies
        if not last.fallen:
            return {} if last.fallen is None else {"fallen_bodies": 0}
        first = next(i for i, f in enumerate(self.frames) if f.fallen)
        return {"fallen_bodies": last.fallen, "fallen_of": count, "first_fallen_frame": first}

    def _flow(self) -> dict[str, Any]:
        """Of particles of flowing bodies: how many were lost, and the range of their volume."""
        last = self.frames[-1].lost
        if last is None:
            return {}
        volumes = [f.flow_volume for f in self.frames if f.flow_volume is not None]
        return {
            "lost_particles": last,
            "lost_share": last / self._particles,
            "first_lost_frame": next((i for i, f in enumerate(self.frames) if f.lost), None),
            "flow_volume_min": min(volumes, default=None),
            "flow_volume_max": max(volumes, default=None),
            "flow_per_cell_at_end": self.frames[-1].flow_per_cell,
        }

    def _conversion(self) -> dict[str, Any]:
        """Of converted particles, where conversion is possible."""
        last = self.frames[-1].converted
        if last is None:
            return {}
        lost = [f.conversion_dissipation or 0.0 for f in self.frames]
        return {
            "converted_particles": last,
            "converted_share": last / self._particles,
            "first_converted_frame": next(
                (i for i, f in enumerate(self.frames) if f.converted), None
            ),
            "conversion_dissipation_J": sum(lost),
        }

    def _resting(self) -> dict[str, float | None]:
        """Penetration depth in the last frame, where the body is at rest on the floor."""
        last = self.frames[-1]
        rests = last.penetration > 0.0 and last.kinetic <= REST * self._scale
        return {
            "resting_penetration_m": last.penetration if rests else None,
            "resting_penetration_spacings": last.penetration / self._spacing if rests else None,
        }

    def _overlap(self) -> dict[str, Any]:
        """What overlapped most, and when; None where nothing did."""
        frame = max(range(len(self.frames)), key=lambda i: self.frames[i].overlap)
        worst = self.frames[frame]
        return {
            "overlap_pair": worst.overlap_pair if worst.overlap > 0.0 else None,
            "overlap_names": worst.overlap_names if worst.overlap > 0.0 else None,
            "overlap_frame": frame if worst.overlap > 0.0 else None,
        }

    def _pierced(self) -> dict[str, Any]:
        """The deepest edge or corner of an obstacle in a body, where there are obstacles."""
        measured = [i for i, f in enumerate(self.frames) if f.pierced is not None]
        if not measured:
            return {}
        frame = max(measured, key=lambda i: _pierced_weight(self.frames[i]))
        worst = self.frames[frame]
        depth = worst.pierced or 0.0
        return {
            "pierced_max_m": depth,
            "pierced_max_spacings": depth / self._spacing,
            "pierced_through": bool(worst.pierced_through),
            "pierced_pair": worst.pierced_pair,
            "pierced_frame": frame if depth else None,
        }

    def _expanded(self) -> dict[str, Any]:
        """The body that expanded most; None where no particle had twice its volume."""
        i, f = max(enumerate(self.frames), key=lambda one: one[1].expanded or 0.0)
        known = f.expanded is not None
        return {
            "expanded_volume": f.expanded,
            "expanded_body": f.expanded_body,
            "expanded_frame": i if known else None,
        }

    def _stretched(self) -> dict[str, Any]:
        """The body with the largest stretched share; None where no particle was stretched so."""
        i, f = max(enumerate(self.frames), key=lambda one: one[1].stretched or 0.0)
        return {
            "stretched_share": f.stretched,
            "stretched_body": f.stretched_body,
            "stretched_frame": None if f.stretched is None else i,
        }

    def _inside(self) -> dict[str, Any]:
        """Penetration of the surface; None where it was not measured."""
        looked = [(f.inside_share, f.inside_depth or 0.0) for f in self.frames
                  if f.inside_share is not None]  # fmt: skip
        end = self.frames[-1].inside_share
        return {
            "inside_at_end_share": end,
            "inside_at_end_m": None if end is None else self.frames[-1].inside_depth,
            "inside_max_share": max((share for share, _ in looked), default=None),
            "inside_max_m": max((depth for _, depth in looked), default=None),
            **self._outside(),
        }

    def _outside(self) -> dict[str, Any]:
        """Particles outside their mesh; None where every mesh is fine enough."""
        looked = [f for f in self.frames if f.outside_share is not None]
        return {
            "outside_mesh_max_share": max((f.outside_share or 0.0 for f in looked), default=None),
            "outside_mesh_max_m": max((f.outside_depth or 0.0 for f in looked), default=None),
            "outside_mesh": looked[-1].outside_mesh if looked else None,
        }

    def _momenta(self) -> dict[str, Any]:
        """Deviation of the momenta from free flight, over m v and m r v, m v^2 / 2 the energy
        scale.
        """
        flight = [] if self._held or self._settings.drag else free_flight(self.frames)
        m = self.frames[0].mass
        out: dict[str, Any] = {
            "momentum_end": list(self.frames[-1].momentum),
            "angular_momentum_end": list(self.frames[-1].angular_momentum),
            "free_flight_frames": max(0, len(flight) - 1),
            "momentum_drift": None,
            "angular_momentum_drift": None,
        }
        if len(flight) < 2 or m <= 0.0 or self._scale <= 0.0:
            return out
        interval = self._settings.time_scale / self._settings.fps
        speed = math.sqrt(2.0 * self._scale / m)
        linear, spin = flight_drift(flight, self._settings.gravity, interval)
        out["momentum_drift"] = linear / (m * speed)
        out["angular_momentum_drift"] = spin / (m * self._radius * speed)
        return out


def health_of(row: Mapping[str, Any]) -> Health:
    """`Health` from its fields, whose vectors may be lists, as in JSON."""
    fields: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in row.items()}
    return Health(**fields)


def gain_of_frames(frames: Sequence[Health]) -> list[float]:
    """E_i - E_(i-1) - W_i [J] of every frame but the first: energy without a source.

    W_i is the work of pins and of shape correction, less the dissipation of plastic flow and
    settling.  Damping, friction, drag and the filter only remove energy, so a gain above rounding
    and the integrator's error is spurious.
    """
    return [b.energy - a.energy - b.work - b.injected + b.dissipation for a, b in pairwise(frames)]


def free_flight(frames: Sequence[Health]) -> Sequence[Health]:
    """The frames before the first contact."""
    touched = next((i for i, f in enumerate(frames) if touches(f)), len(frames))
    return frames[:touched]


def touches(f: Health) -> bool:
    """Whether the body is in contact with the floor, an obstacle or another body."""
    return f.penetration > 0.0 or f.overlap > 0.0


def _pierced_weight(f: Health) -> float:
    return pierced_weight(f.pierced or 0.0, bool(f.pierced_through))


def flight_drift(
    flight: Sequence[Health], gravity: Sequence[float], interval: float
) -> tuple[float, float]:
    """Largest |p - p0 - m g t| [kg m/s] and |L - L0| [kg m^2/s] of a body in free flight.

    L is the angular momentum about the center of mass, L_o - c x p, on which uniform gravity exerts
    no torque. interval : [s] between frames.
    """
    first = flight[0]
    linear, spin = 0.0, 0.0
    for i, f in enumerate(flight):
        fallen = [p + f.mass * g * i * interval for p, g in zip(first.momentum, gravity)]
        linear = max(linear, math.dist(f.momentum, fallen))
        spin = max(spin, math.dist(_about_center(f), _about_center(first)))
    return linear, spin


def restitution(frames: Sequence[Health], settings: Settings, drop: float) -> float | None:
    """Rebound over impact speed of the first bounce, v' / v, or None where there was none.

    Speeds are of the center of mass along the floor's normal at its height at first contact. They
    follow from the frames in free flight on either side by v_c^2 = v^2 + 2 g (y - y_c),
    independently of the time of those frames. drop : [m] height of fall of the asset along the up
    axis.
    """
    normal = [float(n) for n in settings.normal]
    g = -_dot(settings.gravity, normal)
    touched = next((i for i, f in enumerate(frames) if f.penetration > 0.0), None)
    if touched is None or touched == 0 or g <= 0.0:
        return None
    left = next((i for i in range(touched, len(frames)) if frames[i].penetration == 0.0), None)
    if left is None:
        return None
    y_c = _dot(frames[0].center, normal) - drop * _dot(normal, settings.up)

    def squared_speed(f: Health) -> float:
        return (_dot(f.momentum, normal) / f.mass) ** 2 + 2.0 * g * (_dot(f.center, normal) - y_c)

    before, after = squared_speed(frames[touched - 1]), squared_speed(frames[left])
    if before <= 0.0:
        return None
    return math.sqrt(max(0.0, after) / before)


def _about_center(f: Health) -> tuple[float, float, float]:
    (a, b, c), (p, q, r) = f.center, f.momentum
    carried = (b * r - c * q, c * p - a * r, a * q - b * p)
    x, y, z = (whole - part for whole, part in zip(f.angular_momentum, carried))
    return x, y, z


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return sum(x * y for x, y in zip(a, b))


SUMS = (
    *("substeps", "friction_capped", "rollbacks", "work", "injected", "planes"),
    "plastic_dissipation",
    "conversion_dissipation",
    "settling_dissipation",
)
MOSTS = (
    *("penetration", "overlap", "let_go", "max_J", "max_stretch", "inverted", "clamped"),
    "stress_capped",
    "flying",
    "sleeping",
)
LEASTS = ("min_J", "min_stretch")


def merged_health(samples: Sequence[Health]) -> Health:
    """The health of a frame from that of its samples, the last of which is at the time of the
    frame.

    Counts and work are summed, extremes are over all samples, and other values are of the last
    sample.
    """
    rows = ((SUMS, sum), (MOSTS, max), (LEASTS, min))
    values = {
        name: how(getattr(sample, name) for sample in samples)
        for names, how in rows
        for name in names
        if getattr(samples[-1], name) is not None
    }
    for name in ("inside_share", "inside_depth", "outside_share", "outside_depth"):
        known = [getattr(sample, name) for sample in samples if getattr(sample, name) is not None]
        values[name] = known[-1] if known else None
    worst = max(samples, key=_pierced_weight)
    for name in ("pierced", "pierced_through", "pierced_pair"):
        values[name] = getattr(worst if worst.pierced else samples[-1], name)
    deepest = max(samples, key=lambda sample: sample.overlap)
    values |= {"overlap_pair": deepest.overlap_pair, "overlap_names": deepest.overlap_names}
    most = max(samples, key=lambda sample: sample.expanded or 0.0)
    values |= {"expanded": most.expanded, "expanded_body": most.expanded_body}
    longest = max(samples, key=lambda sample: sample.stretched or 0.0)
    values |= {"stretched": longest.stretched, "stretched_body": longest.stretched_body}
    return replace(samples[-1], **values)
