"""The data of a simulation that targets are compared with, and its interpolation in time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import Surface
from gf_usd.core.materials.material import Material
from gf_usd.pipeline.measures.figures import Series
from gf_usd.system import exchange
from gf_usd.system.atomic_files import dropped_on_failure, publish


@dataclass(frozen=True, kw_only=True)
class Scene:
    """The data that all simulations of a fit have in common; SI, world frame of the stage."""

    material: Material  # initial material of all bodies
    radius: float  # [m] r = (3 V / 4 pi)^(1/3) of the largest body
    particles: int
    fps: float  # frames per second of playback
    frames: int
    start: float  # time code of the first frame
    time_codes_per_second: float
    unit: float  # [m] of the stage
    up: Floats  # (3,) unit
    floor: float | None  # [m] height along up; None: no floor
    surfaces: Mapping[str, Floats]  # (V, 3) [m] at the first frame, by prim path
    triangles: Mapping[str, Ints]  # (T, 3) of each
    lift: Floats  # (3,) [m] displacement from their position in the file
    notes: tuple[str, ...]
    identity: str  # hash of the inputs of a simulation except the material


@dataclass(frozen=True, kw_only=True)
class TrackedPoints:
    """Points on a surface whose motion is recorded, as barycentric combinations of vertices."""

    path: str  # of the surface
    vertices: Ints  # (p, 3)
    weights: Floats  # (p, 3), sum 1

    def of(self, x: Floats) -> Floats:
        """Values (p, 3) at the points, from values (V, 3) at vertices."""
        return np.einsum("pk,pkc->pc", self.weights, np.asarray(x, float)[self.vertices])


@dataclass(frozen=True, kw_only=True)
class Observation:
    """The observed quantities of a simulation: F frames, P tracked points."""

    seconds: Floats  # (F,) [s] of playback since the first frame
    x: Floats  # (F, P, 3) [m]
    v: Floats  # (F, P, 3) [m/s] of playback
    series: Series  # heights, center of mass, strains

    def at(self, seconds: Floats) -> Floats:
        """Positions (S, P, 3) [m] of the points at playback times (S,) [s], by cubic Hermite
        interpolation of fourth order.  Times are clamped to the range of frames.
        """
        t = np.clip(seconds, self.seconds[0], self.seconds[-1])
        i = np.clip(np.searchsorted(self.seconds, t, side="right") - 1, 0, len(self.seconds) - 2)
        span = (self.seconds[i + 1] - self.seconds[i])[:, None, None]
        s = (t - self.seconds[i])[:, None, None] / span
        return (
            (1.0 + 2.0 * s) * (1.0 - s) ** 2 * self.x[i]
            + s * (1.0 - s) ** 2 * span * self.v[i]
            + s**2 * (3.0 - 2.0 * s) * self.x[i + 1]
            + s**2 * (s - 1.0) * span * self.v[i + 1]
        )


def vertices_as_points(path: str, vertices: Ints) -> TrackedPoints:
    """Tracked points at vertices (p,) of a surface."""
    of = np.repeat(np.asarray(vertices, np.int64)[:, None], 3, axis=1)
    return TrackedPoints(path=path, vertices=of, weights=np.tile([1.0, 0.0, 0.0], (len(of), 1)))


def rest_points(surface: Surface) -> Floats:
    """Points (n, 3) [m] of a surface that are embedded in the body."""
    return surface.points if surface.splats is None else surface.splats.embedded_points


def save(path: Path, observation: Observation) -> None:
    """Write an observation to a file, atomically."""
    with dropped_on_failure(path) as partial:
        with partial.open("wb") as file:
            exchange.write(observation, file)
        publish(path)


def load(path: Path) -> Observation:
    """Read an observation of `save`.  Raises OSError or ValueError for an invalid file."""
    return exchange.read(path.read_bytes())
