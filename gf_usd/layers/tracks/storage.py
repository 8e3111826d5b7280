"""Reduced storage of a cache, with fewer samples and half precision, and the space saved.

The tolerance of a mesh is that of the smallest body in it; each particle has its own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from pxr import Sdf

from gf_usd.core.arrays import Floats
from gf_usd.core.frames.particles import Particles
from gf_usd.core.frames.settings import Settings
from gf_usd.core.units import Precision, bytes_text, length_text, percent_text
from gf_usd.layers.tracks.accuracy import (
    BOX,
    LENGTHS,
    NORMALS,
    POSITIONS,
    SHAPES,
    VELOCITIES,
    Allowed,
)
from gf_usd.layers.tracks.sparse import Sparse, Tally, Values

if TYPE_CHECKING:
    from gf_usd.layers.tracks.captured import SplatTrack
    from gf_usd.layers.tracks.meshes import MeshTrack
    from gf_usd.layers.tracks.particles import ParticleTrack

ROUNDING = 0.5  # of the tolerance of shapes, for half precision, where samples are left out as well
STILL = 0.5  # a shutter of 180 degrees is open for so much of a frame

Sample = tuple[Sdf.Path, float, Any]  # path of an attribute, time code and value


class Tolerance:
    """Error tolerances of a bake, in stage units.

    precision : as requested; particles : with their bodies; unit : [m] per stage length.
    """

    def __init__(self, precision: Precision, particles: Particles, unit: float) -> None:
        self._body = particles.body_of
        self._surface = np.asarray(particles.surface)
        radii = particles.radii
        self.radius = float(radii[radii > 0.0].min())  # [m]
        self._each = np.array([precision.meters(float(r)) for r in radii]) / unit
        self._least = float(self._each[radii > 0.0].min())
        self.share = precision.meters(self.radius) / self.radius

    @property
    def particles(self) -> Floats:
        """(N,) of each particle."""
        return self._each[self._body]

    @property
    def most(self) -> float:
        """Of the largest body."""
        return float(self._each.max())

    def body(self, body: int) -> float:
        """Of one body."""
        return float(self._each[body])

    def surface(self, number: int) -> float:
        """Of a surface of the asset; one that no particle belongs to moves with any body."""
        bodies = np.unique(self._body[self._surface == number])
        return float(self._each[bodies].min() if len(bodies) else self._least)


@dataclass(frozen=True)
class Group:
    """Prims that move together, with samples at the same times."""

    paths: tuple[Sdf.Path, ...]
    allowed: Allowed
    turn: Callable[[float], Floats]  # (3, 3) to the world at a time code, for rows
    rest: Values | None = None  # the asset's constant values of all their arrays


def allowed(
    length: Floats | float, share: float, settings: Settings, *, shape: float = 1.0
) -> Allowed:
    """The tolerances of a prim's samples from a length [stage units].

    share : the tolerance over the radius, also used for rotations [rad]; shape : share of the
        tolerance that is available for shapes.
    """
    each = np.asarray(length, float)
    return Allowed(
        length=each,
        shape=shape * each,
        angle=share,
        share=share,
        shutter=STILL / settings.fps / settings.samples_per_frame,
    )


def sample_groups(
    tolerance: Tolerance,
    settings: Settings,
    surfaces: Sequence[MeshTrack | SplatTrack | None],
    particles: ParticleTrack | None,
) -> list[Group]:
    """The groups of prims with common sample times: each surface, and the particles of each body.

    surfaces : tracks of the asset's surfaces, in order; None: not written.
    """
    share, found = tolerance.share, []
    for number, track in enumerate(surfaces):
        if track is not None:
            may = allowed(tolerance.surface(number), share, settings)
            turn = partial(_linear, track.to_world)
            found.append(Group((track.path,), may, turn, track.rest))
    for paths, body, rows in particles.groups if particles else ():
        each = tolerance.particles if body is None else tolerance.body(body)
        each = each if rows is None else np.asarray(each)[rows]
        left = 1.0 - ROUNDING * (particles is not None and particles.rounded)
        found.append(Group(tuple(paths), allowed(each, share, settings, shape=left), _in_world))
    return found


def _linear(to_world: Callable[[float], Floats], time_code: float) -> Floats:
    """The linear part (3, 3) of a transform at a time code."""
    return to_world(time_code)[:3, :3]


def _in_world(time_code: float) -> Floats:
    """The transform of prims in world space, which have at most a translation."""
    del time_code
    return np.eye(3)


def take_samples(layer: Sdf.Layer, time_code: float) -> dict[Sdf.Path, Any]:
    """The samples of a layer at a time code, which are erased there."""
    sites: list[Sdf.Path] = []
    layer.Traverse(Sdf.Path.absoluteRootPath, sites.append)
    found: dict[Sdf.Path, Any] = {}
    for path in sites:
        value = layer.QueryTimeSample(path, time_code) if path.IsPropertyPath() else None
        if value is not None:
            found[path] = value
            layer.EraseTimeSample(path, time_code)
    return found


class AdaptiveSamples:
    """Selects the samples of a cache.  Prims without a group and single values are unchanged.

    window : samples of a group that are buffered at most.
    """

    def __init__(self, groups: Sequence[Group], window: int) -> None:
        self._groups = {
            group.paths: Sparse(group.allowed, window, group.turn, rest=group.rest)
            for group in groups
        }
        self._of = {path: group.paths for group in groups for path in group.paths}

    @property
    def tallies(self) -> dict[str, Tally]:
        """Of each group, by the path of its first prim."""
        return {str(paths[0]): sparse.tally for paths, sparse in self._groups.items()}

    def begin(self, time_code: float, values: Values) -> None:
        """Continue from written samples, at the end of a clip."""
        for paths, mine in self._sorted(values)[0].items():
            self._groups[paths].begin(time_code, mine)

    def take(self, time_code: float, values: Values, *, last: bool = False) -> Iterator[Sample]:
        """Add the samples of a time code; returns samples to write, see `Sparse.take`."""
        moving, rest = self._sorted(values)
        yield from ((path, time_code, value) for path, value in rest.items())
        for paths, mine in moving.items():
            for code, kept in self._groups[paths].take(time_code, mine, last=last):
                yield from ((path, code, value) for path, value in kept.items())

    def close(self) -> Iterator[Sample]:
        """The remaining samples to write."""
        for sparse in self._groups.values():
            for code, kept in sparse.close():
                yield from ((path, code, value) for path, value in kept.items())

    def state(self) -> dict[str, Any]:
        """The state from which others continue, at the end of a clip; plain values."""
        return {name: asdict(tally) for name, tally in self.tallies.items()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore the state of the selection that wrote the existing samples."""
        for paths, sparse in self._groups.items():
            sparse.tally = Tally(**state[str(paths[0])])

    def _sorted(self, values: Values) -> tuple[dict[tuple[Sdf.Path, ...], Values], Values]:
        moving: dict[tuple[Sdf.Path, ...], dict[Sdf.Path, Any]] = {}
        rest: dict[Sdf.Path, Any] = {}
        for path, value in values.items():
            group = self._of.get(path.GetPrimPath())
            if group is not None and hasattr(value, "FromNumpy"):
                moving.setdefault(group, {})[path] = value
            else:
                rest[path] = value
        return dict(moving), rest


@dataclass(frozen=True, kw_only=True)
class Storage:
    """The result of reduced storage."""

    precision: Precision | None
    bytes: int  # of the cache, or of its clips
    samples_left_out: int = 0  # [bytes] that this saved
    half_precision: int = 0
    velocities_left_out: int = 0
    samples: Mapping[str, tuple[int, int]] = field(default_factory=dict)  # kept, of all; by prim
    errors: Mapping[str, float] = field(default_factory=dict)  # largest; see ERRORS
    radius: float = 0.0  # [m] of the smallest body

    @property
    def bytes_without(self) -> int:
        """[bytes] of every sample in single precision."""
        saved = self.samples_left_out + self.half_precision + self.velocities_left_out
        return self.bytes + saved

    def as_json(self) -> dict[str, Any]:
        """Plain values; docs/guide/report.md has the keys."""
        return {
            "precision": self.precision.text if self.precision else None,
            "bytes": self.bytes,
            "bytes_without": self.bytes_without,
            "saved": {
                "samples_left_out": self.samples_left_out,
                "half_precision": self.half_precision,
                "velocities_left_out": self.velocities_left_out,
            },
            "samples": {path: {"kept": k, "of": n} for path, (k, n) in self.samples.items()},
            "errors": dict(self.errors),
        }

    @property
    def text(self) -> str:
        """A note on the saved space."""
        parts = [
            f"{bytes_text(size)} by {how}"
            for size, how in (
                (self.samples_left_out, "leaving samples out" + self._left()),
                (self.half_precision, "half precision"),
                (self.velocities_left_out, "leaving velocities out"),
            )
            if size
        ]
        if self.samples and not self.samples_left_out:
            parts.append("nothing from samples, because none could be left out")
        saved = f"{', '.join(parts)}" if parts else "nothing"
        text = (
            f"{bytes_text(self.bytes)} instead of {bytes_text(self.bytes_without)}; saved: {saved}"
        )
        if "positions_m" in self.errors:
            off = self.errors["positions_m"]
            text += f"; the largest error of points is {length_text(off)}"
            if self.precision is not None and self.precision.relative:
                text += f", {percent_text(off / self.radius)} of the radius"
        return text

    def _left(self) -> str:
        kept, of = (sum(pair[i] for pair in self.samples.values()) for i in (0, 1))
        return f" ({of - kept} of {of})"


# kind -> (key of `Storage.errors`, what an error is multiplied by: length or angle)
ERRORS = {
    POSITIONS: "positions_m",
    VELOCITIES: "velocities_m",
    SHAPES: "shapes_m",
    BOX: "boxes_m",
    NORMALS: "normals_deg",
}


def errors_of(tallies: Sequence[Tally], rounding: float | None, unit: float) -> dict[str, float]:
    """The largest errors, by the keys of ERRORS; those of other values as "others_share".

    rounding : [stage units] of shapes, in half precision; unit : [m] per stage length.
    """
    total = Tally()
    for tally in tallies:
        total.note(tally.largest)
    if rounding is not None:
        total.largest[SHAPES] = total.largest.get(SHAPES, 0.0) + rounding
    found: dict[str, float] = {}
    for kind, error in sorted(total.largest.items()):
        key = ERRORS.get(kind, "others_share")
        size = unit if kind in LENGTHS else np.degrees(1.0) if kind == NORMALS else 1.0
        found[key] = max(found.get(key, 0.0), float(error * size))
    return found
