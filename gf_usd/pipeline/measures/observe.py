"""Reduces the frames of a bake to the data from which its figures are computed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.frames.frame import AT_REST, Frame, Health, Pose
from gf_usd.core.frames.particles import Particles
from gf_usd.core.frames.settings import Settings
from gf_usd.core.materials.dimensionless import G0
from gf_usd.pipeline.measures.figures import Recorder, Series

# Times the kinetic energy that counts as rest: a body with less energy changes a height by less
# than its uncertainty.
SETTLED = 10.0


@dataclass(frozen=True, kw_only=True)
class Observed:
    """The reduced data of one run."""

    particles: int
    spacing: float  # [m] lattice edge
    series: Series
    at_rest: bool  # in the last frame


class Observer:
    """Receives every frame of a bake.

    particles : of the solver; settings : as `sampled`; paths : of the embedded surfaces of its
        bodies, whose points are recorded.
    """

    def __init__(self, particles: Particles, settings: Settings, paths: Sequence[str]) -> None:
        self._particles, self._paths = particles, paths
        self._volumes = np.asarray(particles.V0)
        self._last = Health()
        self._pull = -float(np.dot(settings.gravity, settings.normal))
        self._recorder = Recorder(settings.normal, settings.floor, np.array(settings.gravity))

    def add_frame(self, frame: Frame, poses: Mapping[str, Pose]) -> None:
        """Add the next frame, with its embedded points."""
        health = self._last = frame.health
        self._recorder.weight = health.mass * self._pull
        self._recorder.add(
            frame.time,
            np.concatenate([poses[path].x for path in self._paths]),
            np.concatenate([poses[path].v for path in self._paths]),
            center=health.center,
            velocity=tuple(p / health.mass for p in health.momentum),
            volume=float(self._volumes @ volume_ratios(frame.particles.F) / self._volumes.sum()),
            strain=max(health.max_stretch - 1.0, 1.0 - health.min_stretch),
            kinetic=health.kinetic,
            touching=health.penetration > 0.0 or health.overlap > 0.0,
            inverted=health.inverted,
        )

    def observed(self) -> Observed:
        """The reduced data, after the last frame."""
        still = AT_REST * self._last.mass * G0 * self._particles.radius
        return Observed(
            particles=len(self._particles),
            spacing=self._particles.lattice,
            series=self._recorder.series(),
            at_rest=self._last.kinetic <= SETTLED * still,
        )


def volume_ratios(F: Floats) -> Floats:
    """(N,) volume ratios J = det F of deformation gradients (N, 3, 3)."""
    a, b, c = (np.asarray(F)[:, k].T for k in range(3))
    return (
        a[0] * (b[1] * c[2] - b[2] * c[1])
        + a[1] * (b[2] * c[0] - b[0] * c[2])
        + a[2] * (b[0] * c[1] - b[1] * c[0])
    )
