"""Sampling of the animation of a glTF file: translations, rotations and scales of nodes, and the
weights of their morph targets.

glTF 2.0, 3.11 and appendix C.  Between keyframes k and k + 1 at t_k and t_k+1, with
d = t_k+1 - t_k and s = (t - t_k) / d, a value is

    STEP         v_k
    LINEAR       (1 - s) v_k + s v_k+1; for rotations, slerp along the shorter arc
    CUBICSPLINE  (2 s^3 - 3 s^2 + 1) v_k + d (s^3 - 2 s^2 + s) b_k
                 + (3 s^2 - 2 s^3) v_k+1 + d (s^3 - s^2) a_k+1

with in-tangent a and out-tangent b of a keyframe; rotations are normalized.  Values are constant
before the first keyframe and after the last.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats
from gf_usd.core.errors import InputError
from gf_usd.readers.mesh.data import REPAIR
from gf_usd.readers.mesh.gltf.container import Gltf, index, require_types, rows, table, text
from gf_usd.readers.mesh.gltf.morphs import target_count
from gf_usd.readers.mesh.gltf.primitives import decoded
from gf_usd.readers.notes import Notes

WIDTHS = {"translation": 3, "rotation": 4, "scale": 3}
WEIGHTS = "weights"  # of as many morph targets as the mesh of the node has
STEP, LINEAR, CUBIC = "STEP", "LINEAR", "CUBICSPLINE"
RATES = (24.0, 25.0, 30.0, 48.0, 50.0, 60.0, 120.0)  # [frames/s] candidate rates of keyframes
ON_FRAME = 1e-3  # [frames] tolerance of keyframe times in single precision
LONGEST = 100_000  # frames

ANIMATIONS = table(
    animations=rows(
        table(
            name=text,
            channels=rows(table(sampler=index, target=table(node=index, path=text))),
            samplers=rows(table(input=index, output=index, interpolation=text)),
        )
    )
)


@dataclass(frozen=True, kw_only=True)
class Channel:
    """One animation channel: a translation, rotation or scale, or weights, over time."""

    times: Floats  # (n,) [s] increasing
    values: Floats  # (n, w)
    tangents: Floats | None = None  # (n, 2, w) [1/s] into and out of each key, of CUBICSPLINE
    mode: str = LINEAR
    turns: bool = False  # values are quaternions (x, y, z, w)

    def at(self, t: Floats, tolerance: float = 0.0) -> NDArray[np.float64]:
        """(F, w) values at times t (F,) [s]; tolerance : [s] of the times of steps."""
        if len(self.times) == 1:
            return np.repeat(self.values, len(t), axis=0)
        if self.mode == STEP:
            k = np.searchsorted(self.times, t + tolerance, side="right") - 1
            return np.asarray(self.values[np.clip(k, 0, len(self.times) - 1)])
        t = np.clip(t, self.times[0], self.times[-1])
        k = np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, len(self.times) - 2)
        d = (self.times[k + 1] - self.times[k])[:, None]
        s = (t - self.times[k])[:, None] / d
        a, b = self.values[k], self.values[k + 1]
        if self.tangents is not None:
            out, into = self.tangents[k, 1], self.tangents[k + 1, 0]
            value = (2 * s**3 - 3 * s**2 + 1) * a + (3 * s**2 - 2 * s**3) * b
            value += d * ((s**3 - 2 * s**2 + s) * out + (s**3 - s**2) * into)
            return _unit(value) if self.turns else value
        return _arc(a, b, s) if self.turns else (1.0 - s) * a + s * b


@dataclass(frozen=True, kw_only=True)
class Animation:
    """The animation channels of the nodes of a file; empty: no animation."""

    # by node, and WIDTHS or WEIGHTS
    channels: dict[tuple[int, str], Channel] = field(default_factory=dict)

    @property
    def nodes(self) -> set[int]:
        """The nodes with an animated transform."""
        return {node for node, path in self.channels if path != WEIGHTS}

    @property
    def morphing(self) -> set[int]:
        """The nodes of the meshes whose morph targets have animated weights."""
        return {node for node, path in self.channels if path == WEIGHTS}

    @property
    def span(self) -> tuple[float, float]:
        """[s] times of the first and the last keyframe."""
        times = [channel.times for channel in self.channels.values()]
        return min(float(t[0]) for t in times), max(float(t[-1]) for t in times)

    @property
    def rate(self) -> float:
        """[frames/s] rate in RATES that all keyframes match; 24 where none does."""
        keys = np.concatenate([c.times for c in self.channels.values()]) - self.span[0]
        for rate in RATES:
            if np.abs(keys * rate - np.rint(keys * rate)).max() <= ON_FRAME:
                return rate
        return RATES[0]


def read_animation(gltf: Gltf, notes: Notes, morphs: Mapping[int, int]) -> Animation:
    """The first animation of a file.

    morphs : how many morph targets the mesh of each node has, of the nodes whose weights are read.

    Raises InputError for keyframe times that do not increase or are not finite, for a wrong number
    of values, and for invalid targets.
    """
    require_types(gltf.path, gltf.tree, ANIMATIONS)
    every = gltf.rows("animations")
    if not every:
        return Animation()
    names = [str(row.get("name") or f"number {k}") for k, row in enumerate(every)]
    if names[1:]:
        notes.add(f"only the first of {len(names)} animations is read: {names[0]}")
    channels = {}
    samplers = every[0].get("samplers", [])
    for k, row in enumerate(every[0].get("channels", [])):
        where = f"{gltf.path}: animation {names[0]}, channel {k}"
        target = row.get("target", {})
        node, path = target.get("node"), target.get("path")
        if node is None or (path not in WIDTHS and not (path == WEIGHTS and node in morphs)):
            if path == WEIGHTS:
                notes.add(*_ignored_weights(gltf, node))
            continue
        if path != WEIGHTS and "matrix" in gltf.row("nodes", node):
            raise InputError(
                f"{where} animates node {node}, which has a matrix and so cannot be animated",
                REPAIR,
            )
        if row.get("sampler", len(samplers)) >= len(samplers):
            raise InputError(
                f"{where} does not refer to any of the {len(samplers)} samplers", REPAIR
            )
        width = morphs[node] if path == WEIGHTS else WIDTHS[path]
        channels[node, path] = _channel(gltf, where, samplers[row["sampler"]], path, width)
    return Animation(channels=channels)


def _ignored_weights(gltf: Gltf, node: int | None) -> tuple[str, str]:
    """Why the animated weights of a node are not read, and its name; None: no node is given."""
    if node is None:
        return "animated weights without a node are ignored", ""
    row = gltf.row("nodes", node)
    has = "mesh" in row and target_count(gltf.row("meshes", row["mesh"])) > 0
    why = "no skeleton poses it" if has else "it has no morph targets"
    return f"{why}: its animated weights are ignored", str(row.get("name") or f"node{node}")


def frame_times(
    animation: Animation, fps: float | None, where: str
) -> tuple[float, NDArray[np.float64]]:
    """Frames per second, and the times (F,) [s] of the frames of an animation.

    fps : None: that of its keyframes.  Raises InputError where there are too many frames.
    """
    if not animation.channels:
        return fps or RATES[0], np.zeros(1)
    rate, (first, last) = fps or animation.rate, animation.span
    steps = (last - first) * rate
    if not steps <= LONGEST:
        raise InputError(
            f"{where}: its animation lasts {last - first:.3g} s, which is {steps:.3g} frames at "
            f"{rate:g} frames per second",
            f"give an animation of at most {LONGEST} frames, or a smaller --fps",
        )
    return rate, first + np.arange(int(np.ceil(steps - ON_FRAME)) + 1) / rate


def _channel(gltf: Gltf, where: str, sampler: dict[str, Any], path: str, width: int) -> Channel:
    """The channel of a sampler, whose values have a width: for weights, one in each row."""
    times = decoded(gltf, sampler.get("input"))[:, 0]
    values = decoded(gltf, sampler.get("output"))
    mode = sampler.get("interpolation", LINEAR)
    if mode not in (STEP, LINEAR, CUBIC):
        raise InputError(f"{where}: unknown interpolation {mode}", REPAIR)
    if not len(times) or not np.isfinite(times).all() or (np.diff(times) <= 0.0).any():
        raise InputError(f"{where}: its {len(times)} key times do not increase or are not finite",
                         REPAIR)  # fmt: skip
    each = 3 if mode == CUBIC else 1
    if path == WEIGHTS and values.shape == (each * len(times) * width, 1):
        values = values.reshape(-1, width)
    if values.shape != (each * len(times), width) or not np.isfinite(values).all():
        raise InputError(
            f"{where}: {path} has {len(values)} rows of {values.shape[1]} values for "
            f"{len(times)} keys ({mode}), or some values are not finite",
            REPAIR,
        )
    tangents = None
    if mode == CUBIC:
        values = values.reshape(-1, 3, width)
        tangents, values = values[:, [0, 2]], values[:, 1]
    turns = path == "rotation"
    if turns and (np.linalg.norm(values, axis=1) == 0.0).any():
        raise InputError(f"{where}: a rotation is a quaternion of length 0", REPAIR)
    return Channel(
        times=times, values=_unit(values) if turns else values, tangents=tangents, mode=mode,
        turns=turns,
    )  # fmt: skip


def _unit(q: Floats) -> NDArray[np.float64]:
    length = np.linalg.norm(q, axis=1, keepdims=True)
    return np.asarray(q / np.where(length > 0.0, length, 1.0))


def _arc(a: Floats, b: Floats, s: Floats) -> NDArray[np.float64]:
    """(F, 4) spherical linear interpolation by s (F, 1) between unit quaternions (F, 4)."""
    dot = (a * b).sum(1, keepdims=True)
    b = np.where(dot < 0.0, -b, b)
    angle = np.arccos(np.clip(np.abs(dot), 0.0, 1.0))
    near = angle < 1e-6  # linear interpolation is exact to rounding
    sine = np.where(near, 1.0, np.sin(angle))
    from_a = np.where(near, 1.0 - s, np.sin((1.0 - s) * angle) / sine)
    from_b = np.where(near, s, np.sin(s * angle) / sine)
    return _unit(from_a * a + from_b * b)
