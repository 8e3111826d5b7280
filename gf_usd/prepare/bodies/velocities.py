"""Initial velocities of bodies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.asset import Asset
from gf_usd.core.frames.particles import Particles
from gf_usd.core.stage import BodyPhysics, Pin, Triple
from gf_usd.prepare.bodies.plan import BodyPlan
from gf_usd.readers.notes import Notes

CARRIED = (
    "its transform is animated: the simulation starts from its pose at the first frame, and does"
    " not follow the animation after that"
)


def unpinned_animation_notes(
    bodies: BodyPlan, physics: dict[str, BodyPhysics], particles: Particles, pins: Sequence[Pin]
) -> tuple[str, ...]:
    """Notes on surfaces with an animated transform whose body has no pin."""
    held = np.zeros(len(particles), bool)
    for pin in pins:
        if pin.rigid:
            continue
        mine = pin.holds(particles.X, particles.body)
        if not mine.any():  # a region may contain nodes of the grid only
            far = np.linalg.norm(particles.X - pin.anchors.mean(0), axis=1)
            own = True if pin.body is None else particles.body_of == pin.body
            mine[np.argmin(np.where(own, far, np.inf))] = True
        held |= mine
    body = np.zeros(len(particles), int) if particles.body is None else particles.body
    followed = set(body[held].tolist())
    notes = Notes()
    for k, paths in enumerate(bodies.surfaces):
        for path in paths:
            if k not in followed and path in physics and physics[path].carried:
                notes.add(CARRIED, path)
    return notes.lines()


def start_velocities(
    asset: Asset,
    bodies: BodyPlan,
    physics: dict[str, BodyPhysics],
    time_scale: float,
    particles: Particles,
    *,
    velocity: Triple | None = None,
    spin: Triple | None = None,
) -> list[Any]:
    """The initial motion of each body: X (n, 3) [m] -> (n, 3) [m/s], or three zeros.

    Options have precedence over a body's UsdPhysics velocity, which has precedence over the
    animation that ends at the start.  To the animation an affine velocity field v = a + A X is
    fitted. time_scale : simulated seconds per second of playback.

    velocity : [m/s]; spin : [rad/s] about each body's center of mass; None: not given.
    """
    centers = _centers(particles)
    points = {s.path: np.asarray(s.points, float) for s in asset.surfaces}
    out: list[Any] = []
    for k, paths in enumerate(bodies.surfaces):
        known = [physics[p] for p in paths if p in physics]
        stated = next((b for b in known if b.velocity or b.angular_velocity), None)
        moving = [(points[p], physics[p].moving) for p in paths if p in physics]
        # of Points the first are their own, which alone have velocities
        moving = [(x if v is None else x[: len(v)], v) for x, v in moving]
        if velocity or spin:
            own = stated or BodyPhysics(path="")
            own = replace(
                own,
                velocity=velocity or own.velocity,
                angular_velocity=spin or own.angular_velocity,
            )
            out.append(partial(own.initial_velocities, center=centers[k]))
        elif stated is not None:
            out.append(partial(stated.initial_velocities, center=centers[k]))
        elif any(v is not None for _, v in moving):
            X = np.concatenate([p for p, v in moving if v is not None])
            v = np.concatenate([v for _, v in moving if v is not None]) / time_scale
            out.append(_affine(X, v))
        else:
            out.append((0.0, 0.0, 0.0))
    return out


def _centers(particles: Particles) -> Floats:
    """(B, 3) [m] the center of volume of each body."""
    of = particles.body_of
    volume = np.bincount(of, particles.V0)
    return np.stack([np.bincount(of, particles.V0 * x) / volume for x in particles.X.T], axis=1)


@dataclass(frozen=True)
class AffineMotion:
    """X (n, 3) [m] -> v + (X - center) A, (n, 3) [m/s]."""

    center: Floats  # (3,) [m]
    v: Floats  # (3,) [m/s]
    A: Floats  # (3, 3) [1/s]

    def __call__(self, X: Floats) -> Floats:
        return self.v + (X - self.center) @ self.A


def _affine(X: Floats, v: Floats) -> AffineMotion:
    """The least-squares fit of velocities v (n, 3) at X (n, 3)."""
    center = X.mean(0)
    basis = np.hstack([np.ones((len(X), 1)), X - center])
    fit = np.linalg.lstsq(basis, v, rcond=1e-9)[0]
    return AffineMotion(center, fit[0], fit[1:])
