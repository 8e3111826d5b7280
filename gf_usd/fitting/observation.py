"""What is kept of a simulation to be compared with targets, and its values between frames."""

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
    """What the simulations of a fit have in common; SI, world frame of the stage."""

    material: Material  # that the search starts from, of all bodies
    radius: float  # [m] r = (3 V / 4 pi)^(1/3) of the largest body
    particles: int
    fps: float  # frames per second of playback
    frames: int
    start: float  # time code of the first frame
    time_codes_per_second: float
    unit: float  # [m] of the stage
    up: Floats  # (3,) unit
    floor: float | None  # [m] height along up; None: there is none
    surfaces: Mapping[str, Floats]  # (V, 3) [m] at the first frame, by prim path
    triangles: Mapping[str, Ints]  # (T, 3) of each
    lift: Floats  # (3,) [m] from where the file has them
    notes: tuple[str, ...]
    identity: str  # of the simulation but for its material


@dataclass(frozen=True, kw_only=True)
class Followed:
    """Points of surfaces whose motion is kept: sums of three vertices each."""

    path: str  # of the surface
    vertices: Ints  # (p, 3)
    weights: Floats  # (p, 3), sum 1

    def of(self, x: Floats) -> Floats:
        """(p, 3) of what vertices (V, 3) have."""
        return np.einsum("pk,pkc->pc", self.weights, np.asarray(x, float)[self.vertices])


@dataclass(frozen=True, kw_only=True)
class Observation:
    """A simulation as far as targets look at it: F frames, P points that are followed."""

    seconds: Floats  # (F,) [s] of playback since the first frame
    x: Floats  # (F, P, 3) [m]
    v: Floats  # (F, P, 3) [m/s] of playback
    series: Series  # heights, center of mass, strains

    def at(self, seconds: Floats) -> Floats:
        """(S, P, 3) [m] of the points at these times, by cubic Hermite interpolation.

        Exact to fourth order of the frame's length where the motion is smooth; times before the
        first frame or after the last are held to it.
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


def corner(path: str, vertices: Ints) -> Followed:
    """Vertices (p,) of a surface, to be followed."""
    of = np.repeat(np.asarray(vertices, np.int64)[:, None], 3, axis=1)
    return Followed(path=path, vertices=of, weights=np.tile([1.0, 0.0, 0.0], (len(of), 1)))


def rest_points(surface: Surface) -> Floats:
    """(n, 3) [m] of a surface that move with the body."""
    return surface.points if surface.splats is None else surface.splats.embedded_points


def save(path: Path, observation: Observation) -> None:
    """Write it under its name in one step."""
    with dropped_on_failure(path) as partial:
        with partial.open("wb") as file:
            exchange.write(observation, file)
        publish(path)


def load(path: Path) -> Observation:
    """What `save` wrote.  Raises OSError and ValueError for another file."""
    return exchange.read(path.read_bytes())
