"""The frames of one variant as a page keeps them: thinned arrays, and curves over all of the body.

How far a surface and its Gaussians are stretched, from their shapes alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.matrices import ellipsoids
from gf_usd.core.radiance import linear_to_srgb
from gf_usd.core.scene import GaussianSet, MotionFrame, Recording
from gf_usd.view.report.surface import Skin, cluster, corner_colors, make_skin, sample

FLOW_VERTICES = 400_000  # of meshes whose faces change, over all frames: some 6 MB of a page
FEWEST_OF_FLOW = 1000  # of a frame


@dataclass(frozen=True, kw_only=True)
class Flow:
    """Meshes whose faces change, thinned; all frames end to end."""

    starts: NDArray[np.int64]  # (F + 1, 2) where the vertices and triangles of each frame begin
    points: NDArray[np.float32]  # (V, 3) [m]
    corners: NDArray[np.int64]  # (T, 3) into the vertices of the frame
    colors: NDArray[np.uint8]  # (V, 3) sRGB
    vertices: int  # of all frames before thinning


@dataclass(frozen=True, kw_only=True)
class Motion:
    """One variant, thinned; F frames, K vertices, G Gaussians."""

    recording: Recording
    time_codes: tuple[float, ...]  # (F,) of the frames that are kept
    skin: Skin
    points: NDArray[np.float32]  # (F, K, 3) [m]
    stretch: NDArray[np.float32]  # (F, K) of the surface, furthest from 1
    chosen: NDArray[np.int64]  # (G,) Gaussians that are kept
    positions: NDArray[np.float32]  # (F, G, 3) [m]
    turns: NDArray[np.float32]  # (F, G, 4) (x, y, z, w) unit, continuous in time
    scales: NDArray[np.float32]  # (F, G, 3) [m]
    ratio: NDArray[np.float32]  # (F, G) volume ratio |J|
    measured: Mapping[str, NDArray[np.float32]]  # (F, G) by name, as `MotionFrame` has it
    curves: dict[str, list[float]] = field(default_factory=dict)  # (F,) each, over the whole body
    flow: Flow | None = None  # None: no faces change

    @property
    def gaussians(self) -> GaussianSet | None:
        return self.recording.gaussians


def collect(
    recording: Recording, frames: Iterable[MotionFrame], vertices: int, gaussians: int
) -> Motion:
    """Thin a motion while it is read; one whole frame is held at a time.

    vertices, gaussians : how many to keep at most.
    """
    skin = make_skin(recording.meshes, vertices)
    count = len(recording.gaussians or ())
    chosen = sample(count, gaussians)
    bodies = [i for i, is_body in enumerate(recording.baked) if is_body]
    surfaces = [SurfaceStretch(mesh.points, mesh.triangles) for mesh in recording.meshes]
    kept = _Kept()
    flow = _Flows(min(vertices, max(FEWEST_OF_FLOW, FLOW_VERTICES // len(recording.time_codes))))
    curves = _Curves(recording, bodies)
    for frame in frames:
        joined = np.concatenate([np.zeros((0, 3)), *frame.meshes])
        faces = [s.faces(points) for s, points in zip(surfaces, frame.meshes)]
        felt = [s.at_vertices(stretches) for s, stretches in zip(surfaces, faces)]
        ratio = None
        if recording.gaussians is not None and frame.axes is not None:
            ratio = volume_ratio(frame.axes, recording.gaussians.rest_scales)
        kept.add(frame, joined[skin.kept], np.concatenate([[], *felt])[skin.kept], chosen, ratio)
        curves.add(frame, faces, ratio)
        flow.add(frame)
    motion = kept.finish(recording, skin, chosen, curves.values)
    return replace(motion, flow=flow.finish()) if recording.flows else motion


class _Flows:
    """Grows a `Flow`; most : vertices of a frame."""

    def __init__(self, most: int) -> None:
        self._most, self._whole = most, 0
        self._starts = [(0, 0)]
        self._points: list[Floats] = []
        self._corners: list[Ints] = []
        self._colors: list[Floats] = []

    def add(self, frame: MotionFrame) -> None:
        before, faces = self._starts[-1]
        count = 0
        for mesh in frame.flows:
            kept, corners, _ = cluster(
                mesh.points, mesh.triangles, np.zeros(len(mesh.points), int), self._most
            )
            tints = np.zeros((len(mesh.points), 3))
            tints[np.asarray(mesh.triangles)] = corner_colors(mesh)
            self._points.append(np.asarray(mesh.points)[kept])
            self._colors.append(tints[kept])
            self._corners.append(corners + count)
            self._whole += len(mesh.points)
            count += len(kept)
            faces += len(corners)
        self._starts.append((before + count, faces))

    def finish(self) -> Flow:
        colors = np.concatenate([np.zeros((0, 3)), *self._colors])
        code = linear_to_srgb(np.clip(colors, 0.0, 1.0))
        return Flow(
            starts=np.array(self._starts),
            points=np.concatenate([np.zeros((0, 3)), *self._points]).astype(np.float32),
            corners=np.concatenate([np.zeros((0, 3), np.int64), *self._corners]),
            colors=np.round(code * 255.0).astype(np.uint8),
            vertices=self._whole,
        )


class _Kept:
    """Grows the thinned arrays, frame by frame."""

    def __init__(self) -> None:
        self.codes: list[float] = []
        self.rows: dict[str, list[NDArray[np.float32]]] = {}
        self.measured: set[str] = set()
        self._last: Floats | None = None

    def add(
        self,
        frame: MotionFrame,
        points: Floats,
        stretch: Floats,
        chosen: NDArray[np.int64],
        ratio: Floats | None,
    ) -> None:
        self.codes.append(frame.time_code)
        row: dict[str, Floats] = {"points": points, "stretch": stretch}
        if frame.positions is not None and frame.axes is not None and ratio is not None:
            turns, scales = ellipsoids(frame.axes[chosen])
            if self._last is not None:
                # q and -q are one rotation: the nearer to the last frame's packs better
                turns *= np.where((turns * self._last).sum(axis=1, keepdims=True) < 0.0, -1.0, 1.0)
            self._last = turns
            row["positions"] = frame.positions[chosen]
            row |= {"turns": turns, "scales": scales, "ratio": ratio[chosen]}
            row |= {name: values[chosen] for name, values in frame.measured.items()}
            self.measured |= set(frame.measured)
        for name, values in row.items():
            self.rows.setdefault(name, []).append(np.asarray(values, dtype=np.float32))

    def finish(
        self,
        recording: Recording,
        skin: Skin,
        chosen: NDArray[np.int64],
        curves: dict[str, list[float]],
    ) -> Motion:
        whole = {name: np.stack(rows) for name, rows in self.rows.items()}
        n = len(self.codes)

        def of(name: str, *shape: int) -> NDArray[np.float32]:
            return whole.get(name, np.zeros((n, 0, *shape), dtype=np.float32))

        # a bake writes them at all of its frames or at none
        measured = {name: whole[name] for name in sorted(self.measured) if len(whole[name]) == n}
        return Motion(
            recording=recording,
            time_codes=tuple(self.codes),
            skin=skin,
            points=of("points", 3),
            stretch=of("stretch"),
            chosen=chosen,
            positions=of("positions", 3),
            turns=of("turns", 4),
            scales=of("scales", 3),
            ratio=of("ratio"),
            measured=measured,
            curves=curves,
        )


class _Curves:
    """What the geometry alone says of each frame; over all vertices and Gaussians of the body.

    Where particles stand for a mesh from some frame on, it is what they say, in all frames.
    """

    def __init__(self, recording: Recording, bodies: list[int]) -> None:
        self._recording = recording
        vanish = any(recording.meshes[i].name in recording.vanishing for i in bodies)
        self._bodies = [] if vanish else bodies
        self.values: dict[str, list[float]] = {}

    def add(self, frame: MotionFrame, faces: list[Floats], ratio: Floats | None) -> None:
        """Add a frame; faces : (T, 2) stretches of every mesh."""
        up = np.array(self._recording.up)
        body = [frame.meshes[i] for i in self._bodies]
        if not body and frame.positions is not None:
            body = [frame.positions]
        elif not body:  # nothing but surfaces of what flows, and meshes that are there
            left = [points for points in frame.meshes if np.ptp(points, axis=0).any()]
            body = [mesh.points for mesh in frame.flows] + left * bool(self._recording.vanishing)
        points = np.concatenate([np.zeros((0, 3)), *body])
        row = {}
        if len(points):
            height = points @ up
            row |= {"lowest": height.min(), "highest": height.max()}
            row["center"] = height.mean()
        masses = self._recording.gaussians.masses if self._recording.gaussians else None
        if masses is not None and frame.positions is not None and masses.sum() > 0.0:
            row["center"] = masses @ (frame.positions @ up) / masses.sum()
        stretches = np.concatenate([np.zeros((0, 2)), *(faces[i] for i in self._bodies)])
        if len(stretches):
            row |= {"surface_min": stretches[:, 0].min(), "surface_max": stretches[:, 1].max()}
        if ratio is not None and len(ratio):
            row |= {"ratio_min": ratio.min(), "ratio_max": ratio.max()}
        for name, value in row.items():
            self.values.setdefault(name, []).append(float(value))


class SurfaceStretch:
    """Principal stretches of a triangle mesh against its rest shape.

    The edges of a triangle at rest, in its own plane, are the columns of Dm (2, 2); deformed, in
    space, those of Ds (3, 2).  F = Ds Dm^-1, and the stretches are the singular values of F.

    Parameters
    ----------
    points : (V, 3) at rest.   triangles : (T, 3).
    """

    def __init__(self, points: Floats, triangles: Ints) -> None:
        a, b = self._edges(points, triangles)
        length = np.linalg.norm(a, axis=1)
        area = np.linalg.norm(np.cross(a, b), axis=1)
        # slivers have no usable plane: their own stretch is noise
        good = area > 1e-6 * np.maximum(length**2, np.einsum("ij,ij->i", b, b))
        self._triangles = np.asarray(triangles)[good]
        a, b, length, area = a[good], b[good], length[good], area[good]
        along = np.einsum("ij,ij->i", a, b) / length
        self._inverse = np.zeros((len(a), 2, 2))
        self._inverse[:, 0, 0] = 1.0 / length
        self._inverse[:, 0, 1] = -along / area
        self._inverse[:, 1, 1] = length / area
        self._area = np.repeat(area, 3)
        self._vertices = len(points)
        flat = self._triangles.reshape(-1)
        self._weight = np.bincount(flat, self._area, minlength=self._vertices)

    def faces(self, points: Floats) -> NDArray[np.float64]:
        """(T', 2) smaller and larger stretch of each triangle that is no sliver."""
        a, b = self._edges(points, self._triangles)
        F = np.stack([a, b], axis=2) @ self._inverse
        C = np.einsum("nij,nik->njk", F, F)
        middle = 0.5 * (C[:, 0, 0] + C[:, 1, 1])
        reach = np.hypot(0.5 * (C[:, 0, 0] - C[:, 1, 1]), C[:, 0, 1])
        squared = np.stack([middle - reach, middle + reach], axis=1)
        return np.sqrt(np.maximum(squared, 0.0))

    def at_vertices(self, faces: Floats) -> NDArray[np.float64]:
        """(V,) the stretch that is furthest from 1, of the mean over the triangles around.

        Means are geometric and weighted by rest area; 1 where a vertex has no triangle.
        """
        flat = self._triangles.reshape(-1)
        log = np.log(np.maximum(faces, 1e-9))
        mean = np.stack(
            [
                np.bincount(flat, self._area * np.repeat(log[:, k], 3), minlength=self._vertices)
                for k in range(2)
            ]
        ) / np.where(self._weight > 0.0, self._weight, 1.0)
        return np.exp(np.where(np.abs(mean[0]) > np.abs(mean[1]), mean[0], mean[1]))

    @staticmethod
    def _edges(points: Floats, triangles: Ints) -> tuple[Floats, Floats]:
        corners = np.asarray(points)[np.asarray(triangles)]
        return corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]


def volume_ratio(axes: Floats, rest_scales: Floats) -> NDArray[np.float64]:
    """(N,) |J| of Gaussians: det Sigma = J^2 det Sigma0, so |J| = |det A| / (s1 s2 s3 at rest)."""
    rest = np.prod(rest_scales, axis=1)
    now = np.abs(np.linalg.det(axes))
    return np.divide(now, rest, out=np.ones_like(now), where=rest > 0.0)
