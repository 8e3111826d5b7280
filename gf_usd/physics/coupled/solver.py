"""Solid bodies in the Total Lagrangian solver and flowing ones in the Updated Lagrangian solver.

The laws of its particles determine the solver of a body.  Both solvers have the same substeps per
frame; `contact` exchanges the forces between them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.errors import UsageError
from gf_usd.core.frames.frame import Frame, Health, Pose
from gf_usd.core.frames.particles import Particles, SurfaceSamples
from gf_usd.core.frames.settings import Settings
from gf_usd.core.materials.dimensionless import G0
from gf_usd.core.materials.material import Material
from gf_usd.core.stage import ContactSetup, Goals, Pin
from gf_usd.physics.contact.planes.intervals import Lateness
from gf_usd.physics.coupled.contact import Exchange, SolidBodies
from gf_usd.physics.coupled.parts import (
    Part,
    flowing_bodies,
    part_of,
    passes,
    solid_setup,
    used_materials,
)
from gf_usd.physics.frame_loop import FrameStats, Guard, Solver
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.physics.updated_lagrangian.solver import UpdatedLagrangian


class Coupled(Solver):
    """Solid and flowing bodies; parameters as for `TotalLagrangian`.

    flows : (B,) which bodies flow; None: those that flow in part, or can be converted.

    Raises UsageError for options that only one of the two solvers supports, InputError for a pin
    of a body that flows.
    """

    def __init__(
        self,
        particles: Particles,
        materials: Sequence[Material],
        settings: Settings,
        *,
        samples: SurfaceSamples | None = None,
        embedded: Mapping[str, Floats] | None = None,
        velocity: Any = (0.0, 0.0, 0.0),
        pins: Sequence[Pin] = (),
        contact_setup: ContactSetup | None = None,
        goals: Goals | None = None,
        embedded_body: Mapping[str, int] | None = None,
        embedded_copy: Mapping[str, Ints] | None = None,
        h: float | None = None,
        real: type = np.float32,
        flows: Ints | None = None,
    ) -> None:
        refuse(settings, pins, goals)
        if samples is None or contact_setup is None:
            raise ValueError("bodies that meet need contact samples and a contact setup")
        self.particles, self.settings = particles, settings
        flows = flowing_bodies(particles, materials) if flows is None else flows
        if flows.all() or not flows.any():
            raise UsageError(
                "either all bodies flow or none does, so there is nothing to couple",
                "use --solver tl or ul",
            )

        def part(which: Ints, *, copied: bool) -> Part:
            return part_of(
                which, particles, samples, embedded or {}, embedded_body or {},
                embedded_copy or {}, copied=copied,
            )  # fmt: skip

        self._solid, self._flow = part(~flows, copied=True), part(flows, copied=False)
        self.flowing_at = self._flow.at  # (n,) indices of the flowing particles
        own = replace(settings, shortcuts=False, settling=False, rolling=0.0)
        made, of_solid = used_materials(self._solid.particles, materials)
        self.solid = TotalLagrangian(
            made, of_solid, own, samples=self._solid.samples,
            embedded=self._solid.embedded, velocity=self._solid.velocity(velocity),
            pins=self._solid.pins(pins),
            contact_setup=solid_setup(contact_setup, self._solid, self._solid.copies),
            embedded_body=self._solid.embedded_body, embedded_copy=self._solid.embedded_copy,
            h=h, real=real,
        )  # fmt: skip
        walls = ContactSetup(skins=(), colliders=contact_setup.colliders, flows=True)
        made, of_flow = used_materials(self._flow.particles, materials)
        self.flow = UpdatedLagrangian(
            made, of_flow, own, samples=self._flow.samples,
            embedded=self._flow.embedded, velocity=self._flow.velocity(velocity),
            contact_setup=walls, h=h, real=real,
        )  # fmt: skip
        self.flow.face(
            walls, SolidBodies(self.solid), passes(contact_setup, self._solid, self._flow)
        )
        self.exchange = Exchange(self.solid, self.flow)
        self.solid.partner = self.exchange
        self.coarse = max(self.solid.coarse, self.flow.coarse)
        extent = float(np.linalg.norm(np.ptp(particles.X, axis=0)))
        mass = float(self.solid.body.m.sum() + self.flow.body.m.sum())
        self.guard = Guard(mass * G0 * particles.radius, extent, particles.body)
        self.state = BothStates(self.solid, self.flow)

    @property
    def damping_ratio(self) -> float:
        """See `Solver`; the larger of the two."""
        return max(self.solid.damping_ratio, self.flow.damping_ratio)

    @property
    def contact_factor(self) -> float:
        """See `Solver`; the larger of the two."""
        return max(self.solid.contact_factor, self.flow.contact_factor)

    def pressed(self, depth: float) -> int:
        """See `Solver`."""
        return max(self.solid.pressed(depth), self.flow.pressed(depth))

    def places(self) -> Floats:
        """See `Solver`: those of the solid bodies, then those of the flow."""
        return np.concatenate([self.solid.places(), self.flow.places()])

    def throw(self, velocities: Floats) -> None:
        """See `Solver`."""
        solid = len(self.solid.places())
        self.solid.throw(velocities[:solid])
        self.flow.throw(velocities[solid:])

    def not_finite(self) -> tuple[int, str]:
        """See `Solver`."""
        for one, part in ((self.solid, self._solid), (self.flow, self._flow)):
            particle, fault = one.not_finite()
            if fault:
                return int(part.at[particle]), fault
        return -1, ""

    @property
    def lateness(self) -> Lateness | None:
        """See `Solver`."""
        return self.solid.lateness

    def advance(self, index: int, substeps: int) -> FrameStats:
        """Advance to frame `index`."""
        self.solid.on_launch = self.flow.on_launch = self.on_launch
        before = self.state.save()
        solid = self._frame(index, substeps)
        while self.exchange.full and self.flow.state.extend_grid():
            self.state.load(before)
            solid = self._frame(index, substeps)
        return merged_stats(solid, self.flow.finish(substeps))

    def _frame(self, index: int, substeps: int) -> FrameStats:
        self.exchange.begin_frame(index, self.frame_time / substeps)
        return self.solid.advance(index, substeps)

    def read(self, index: int) -> Frame:
        """See `Solver`."""
        solid, flow = self.solid.read(index), self.flow.read(index)
        self.strained = max(self.solid.strained, self.flow.strained)
        n, parts = len(self.particles), ((self._solid, solid), (self._flow, flow))

        def merged(values: Sequence[Floats]) -> Floats:
            out = np.full((n, *values[0].shape[1:]), np.nan)
            for (part, _), own in zip(parts, values, strict=True):
                out[part.at] = own
            return out

        nothing = [np.full(len(part.at), np.nan) for part, _ in parts]
        names = dict.fromkeys([*solid.internal, *flow.internal])
        stress = None
        if solid.stress is not None and flow.stress is not None:
            stress = merged([solid.stress, flow.stress])
        return Frame(
            index=index,
            time=solid.time,
            particles=Pose(
                x=merged([f.particles.x for _, f in parts]),
                v=merged([f.particles.v for _, f in parts]),
                F=merged([f.particles.F for _, f in parts]),
            ),
            embedded={**solid.embedded, **flow.embedded},
            stress=stress,
            internal={
                name: merged([
                    f.internal.get(name, none) for (_, f), none in zip(parts, nothing, strict=True)
                ])
                for name in names
            },
            converted=self._converted(flow.converted),
            health=merged_health(solid.health, flow.health),
        )  # fmt: skip

    def _converted(self, of_flow: Ints | None) -> Ints | None:
        """(N,) of all particles, from those of the flow."""
        if of_flow is None:
            return None
        out = np.zeros(len(self.particles), bool)
        out[self._flow.at] = of_flow
        return out


def refuse(settings: Settings, pins: Sequence[Pin], goals: Goals | None) -> None:
    """Raise UsageError for options that a bake of solid and flowing bodies does not support."""
    unsupported = {
        "--flesh and attachments with springs": goals is not None,
        "--rigid": any(pin.rigid for pin in pins),
        "pins that move": any(len(pin.path) > 1 for pin in pins),
        "the WLS recomputation of F": settings.wls,
        "the Procrustes correction": settings.procrustes > 0.0,
        "--field and gravity that changes over time": bool(settings.fields),
        "--preset paper": settings.contact_rate is not None,
    }
    for what, wanted in unsupported.items():
        if wanted:
            raise UsageError(
                f"a bake with both flowing and solid bodies does not support {what}",
                "leave it out, or bake the bodies separately with --prim",
            )


class BothStates:
    """The combined state of the two solvers: `Saved`."""

    def __init__(self, solid: TotalLagrangian, flow: UpdatedLagrangian) -> None:
        self._parts = {"solid": solid, "flow": flow}

    def save(self) -> dict[str, Any]:
        """See `Saved`."""
        return {
            f"{name}_{key}": value
            for name, one in self._parts.items()
            for key, value in one.state.save().items()
        }

    def load(self, saved: Mapping[str, Any]) -> None:
        """See `Saved`."""
        for name, one in self._parts.items():
            start = f"{name}_"
            one.state.load(
                {k.removeprefix(start): v for k, v in saved.items() if k.startswith(start)}
            )


def merged_stats(solid: FrameStats, flow: FrameStats) -> FrameStats:
    """The statistics of both solvers."""
    sums = ("let_go", "friction_capped", "work", "injected", "planes", "clamped", "stress_capped")
    deepest = solid if solid.overlap >= flow.overlap else flow
    return replace(
        solid,
        **{name: getattr(solid, name) + getattr(flow, name) for name in sums},
        penetration=max(solid.penetration, flow.penetration),
        overlap=max(solid.overlap, flow.overlap),
        overlap_pair=deepest.overlap_pair,
        overlap_names=deepest.overlap_names,
        plastic_dissipation=_sum(solid.plastic_dissipation, flow.plastic_dissipation),
        conversion_dissipation=flow.conversion_dissipation,
    )


def merged_health(solid: Health, flow: Health) -> Health:
    """Sums of extensive values, extremes of others."""
    out: dict[str, Any] = {}
    for field in fields(Health):
        a, b = getattr(solid, field.name), getattr(flow, field.name)
        if field.name.startswith("min_"):
            out[field.name] = min(a, b)
        elif field.name.startswith("max_") or field.name in ("penetration", "overlap"):
            out[field.name] = max(a, b)
        elif field.name == "center":
            mass = solid.mass + flow.mass
            out[field.name] = tuple(
                (solid.mass * x + flow.mass * y) / mass for x, y in zip(a, b, strict=True)
            )
        elif isinstance(a, bool | str) or isinstance(b, bool | str):
            out[field.name] = b if a is None else a
        elif isinstance(a, tuple):
            out[field.name] = tuple(x + y for x, y in zip(a, b, strict=True))
        else:
            out[field.name] = _sum(a, b)
    # of the flow, lost particles are counted, not fallen bodies
    return Health(**{**out, "fallen": None, "fallen_kinetic": flow.fallen_kinetic})


def _sum(a: float | None, b: float | None) -> float | None:
    return None if a is None and b is None else (a or 0) + (b or 0)
