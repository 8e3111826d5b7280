"""The motion of one variant for a page: thinned arrays per frame, and curves of the whole body.

Stretches of the surface and volume ratios of Gaussians are computed from their geometry.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.matrices import ellipsoids
from gf_usd.core.mesh.measures import areas
from gf_usd.core.radiance import linear_to_srgb
from gf_usd.core.scene import GaussianSet, MotionFrame, Recording
from gf_usd.view.report.surface import DisplayMesh, corner_colors, make_display_mesh
from gf_usd.view.report.thinning import cluster_vertices, random_subset

FLOW_VERTICES = 400_000  # of meshes of varying topology, over all frames: about 6 MB of a page
MIN_FLOW_VERTICES = 1000  # of a frame


@dataclass(frozen=True, kw_only=True)
class Flow:
    """Meshes of varying topology, thinned; the frames are concatenated."""

    starts: NDArray[np.int64]  # (F + 1, 2) first vertex and first triangle of each frame
    points: NDArray[np.float32]  # (V, 3) [m]
    corners: NDArray[np.int64]  # (T, 3) into the vertices of the frame
    colors: NDArray[np.uint8]  # (V, 3) sRGB
    vertices: int  # of all frames before thinning


@dataclass(frozen=True, kw_only=True)
class Motion:
    """One variant, thinned; F frames, K vertices, G Gaussians."""

    recording: Recording
    time_codes: tuple[float, ...]  # (F,)
    mesh: DisplayMesh
    points: NDArray[np.float32]  # (F, K, 3) [m]
    stretch: NDArray[np.float32]  # (F, K) principal stretch of the surface that is furthest from 1,
    # within its `stretch_range`
    areas: Floats  # (K,) [m^2] at rest of the thinned surface around a vertex; 0: not a soft body's
    gaussian_indices: NDArray[np.int64]  # (G,) into all Gaussians of the recording
    positions: NDArray[np.float32]  # (F, G, 3) [m]
    rotations: NDArray[np.float32]  # (F, G, 4) unit quaternions (x, y, z, w), continuous in time
    scales: NDArray[np.float32]  # (F, G, 3) [m]
    ratio: NDArray[np.float32]  # (F, G) volume ratio |J|
    measured: Mapping[str, NDArray[np.float32]]  # (F, G) by name, see `MotionFrame.measured`
    curves: dict[str, list[float]] = field(default_factory=dict)  # (F,) each, over the whole body
    flow: Flow | None = None  # None: the topology of all meshes is constant

    @property
    def gaussians(self) -> GaussianSet | None:
        return self.recording.gaussians


def collect(
    recording: Recording, frames: Iterable[MotionFrame], vertices: int, gaussians: int
) -> Motion:
    """Read and thin a motion frame by frame.

    vertices, gaussians : upper limits of their numbers.
    """
    mesh = make_display_mesh(recording.meshes, vertices)
    count = len(recording.gaussians or ())
    gaussian_indices = random_subset(count, gaussians)
    bodies = [i for i, is_body in enumerate(recording.baked) if is_body]
    surfaces = [SurfaceStretch(mesh.points, mesh.triangles) for mesh in recording.meshes]
    kept = _FrameArrays()
    flow = _FlowBuilder(
        min(vertices, max(MIN_FLOW_VERTICES, FLOW_VERTICES // len(recording.time_codes)))
    )
    curves = _GeometryCurves(recording, bodies)
    for frame in frames:
        joined = np.concatenate([np.zeros((0, 3)), *frame.meshes])
        faces = [s.faces(points) for s, points in zip(surfaces, frame.meshes)]
        ranges = [stretch_range(stretches, s.areas) for s, stretches in zip(surfaces, faces)]
        # colors show no more than the curves do: a sliver has the end of the range of its surface
        vertex_stretches = [
            np.clip(s.at_vertices(stretches), *(ends or (1.0, 1.0)))
            for s, stretches, ends in zip(surfaces, faces, ranges)
        ]
        ratio = None
        if recording.gaussians is not None and frame.axes is not None:
            ratio = volume_ratio(frame.axes, recording.gaussians.rest_scales)
        kept.add(
            frame,
            joined[mesh.kept],
            np.concatenate([[], *vertex_stretches])[mesh.kept],
            gaussian_indices,
            ratio,
        )
        curves.add(frame, ranges, ratio)
        flow.add(frame)
    motion = kept.finish(recording, mesh, gaussian_indices, curves.values)
    return replace(motion, flow=flow.finish()) if recording.flows else motion


class _FlowBuilder:
    """Builds a `Flow` frame by frame.

    most : vertices of a frame at most.
    """

    def __init__(self, most: int) -> None:
        self._most, self._vertices_before = most, 0
        self._starts = [(0, 0)]
        self._points: list[Floats] = []
        self._corners: list[Ints] = []
        self._colors: list[Floats] = []

    def add(self, frame: MotionFrame) -> None:
        before, faces = self._starts[-1]
        count = 0
        for mesh in frame.flows:
            kept, corners, _ = cluster_vertices(
                mesh.points, mesh.triangles, np.zeros(len(mesh.points), int), self._most
            )
            vertex_colors = np.zeros((len(mesh.points), 3))
            vertex_colors[np.asarray(mesh.triangles)] = corner_colors(mesh)
            self._points.append(np.asarray(mesh.points)[kept])
            self._colors.append(vertex_colors[kept])
            self._corners.append(corners + count)
            self._vertices_before += len(mesh.points)
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
            vertices=self._vertices_before,
        )


class _FrameArrays:
    """Collects the thinned arrays of all frames."""

    def __init__(self) -> None:
        self.codes: list[float] = []
        self.rows: dict[str, list[NDArray[np.float32]]] = {}
        self.measured: set[str] = set()
        self._last_rotations: Floats | None = None

    def add(
        self,
        frame: MotionFrame,
        points: Floats,
        stretch: Floats,
        gaussian_indices: NDArray[np.int64],
        ratio: Floats | None,
    ) -> None:
        self.codes.append(frame.time_code)
        row: dict[str, Floats] = {"points": points, "stretch": stretch}
        if frame.positions is not None and frame.axes is not None and ratio is not None:
            rotations, scales = ellipsoids(frame.axes[gaussian_indices])
            if self._last_rotations is not None:
                # q and -q are one rotation; continuity in time compresses better
                rotations *= np.where(
                    (rotations * self._last_rotations).sum(axis=1, keepdims=True) < 0.0, -1.0, 1.0
                )
            self._last_rotations = rotations
            row["positions"] = frame.positions[gaussian_indices]
            row |= {"rotations": rotations, "scales": scales, "ratio": ratio[gaussian_indices]}
            row |= {name: values[gaussian_indices] for name, values in frame.measured.items()}
            self.measured |= set(frame.measured)
        for name, values in row.items():
            self.rows.setdefault(name, []).append(np.asarray(values, dtype=np.float32))

    def finish(
        self,
        recording: Recording,
        mesh: DisplayMesh,
        gaussian_indices: NDArray[np.int64],
        curves: dict[str, list[float]],
    ) -> Motion:
        stacked = {name: np.stack(rows) for name, rows in self.rows.items()}
        n = len(self.codes)

        def array_or_empty(name: str, *shape: int) -> NDArray[np.float32]:
            return stacked.get(name, np.zeros((n, 0, *shape), dtype=np.float32))

        # a bake writes a measured quantity in all frames or in none
        measured = {
            name: stacked[name] for name in sorted(self.measured) if len(stacked[name]) == n
        }
        return Motion(
            recording=recording,
            time_codes=tuple(self.codes),
            mesh=mesh,
            points=array_or_empty("points", 3),
            stretch=array_or_empty("stretch"),
            areas=_vertex_areas(recording, mesh),
            gaussian_indices=gaussian_indices,
            positions=array_or_empty("positions", 3),
            rotations=array_or_empty("rotations", 4),
            scales=array_or_empty("scales", 3),
            ratio=array_or_empty("ratio"),
            measured=measured,
            curves=curves,
        )


def _vertex_areas(recording: Recording, mesh: DisplayMesh) -> Floats:
    """See `Motion.areas`: a third of the area of each triangle at a vertex."""
    points = np.concatenate([np.zeros((0, 3)), *(m.points for m in recording.meshes)])[mesh.kept]
    baked = np.repeat(recording.baked, [len(m.points) for m in recording.meshes])[mesh.kept]
    triangles = mesh.source[mesh.corners]
    third = np.repeat(areas(points, triangles) / 3.0, 3)
    return np.bincount(triangles.ravel(), third, minlength=len(points)) * baked


OMITTED = 1e-3  # of the area at rest, at each end of the stretches of a surface


def stretch_range(stretches: Floats, areas: Floats) -> tuple[float, float] | None:
    """Smallest and largest of the stretches (T, 2) of triangles with areas (T,) at rest.

    The most compressed and the most stretched OMITTED of the area are left out: a thin sliver may
    be stretched a hundredfold where the body around it is stretched by a tenth.  None without a
    triangle.
    """
    if not len(stretches):
        return None
    ends = []
    for values, order in ((stretches[:, 0], 1), (stretches[:, 1], -1)):
        ranked = np.argsort(values)[::order]
        covered = np.cumsum(areas[ranked])
        first = np.searchsorted(covered, OMITTED * covered[-1], "right")
        ends.append(float(values[ranked[min(first, len(ranked) - 1)]]))  # without area: the last
    return ends[0], ends[1]


class _GeometryCurves:
    """Heights, stretches and volume ratios of each frame, over all vertices and Gaussians.

    Where particles replace a mesh from some frame on, they are used in all frames.
    """

    def __init__(self, recording: Recording, bodies: list[int]) -> None:
        self._recording = recording
        vanish = any(recording.meshes[i].name in recording.vanishing for i in bodies)
        self._bodies = [] if vanish else bodies
        self.values: dict[str, list[float]] = {}

    def add(
        self, frame: MotionFrame, ranges: list[tuple[float, float] | None], ratio: Floats | None
    ) -> None:
        """Add a frame; ranges : the smallest and largest stretch of every mesh."""
        up = np.array(self._recording.up)
        body = [frame.meshes[i] for i in self._bodies]
        if not body and frame.positions is not None:
            body = [frame.positions]
        elif not body:  # only surfaces of flowing material, and meshes that are not converted yet
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
        ends = [end for i in self._bodies if (end := ranges[i])]
        if ends:
            row |= {
                "surface_min": min(low for low, _ in ends),
                "surface_max": max(high for _, high in ends),
            }
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
        # the plane of a sliver is ill-conditioned, and so is its stretch
        valid = area > 1e-6 * np.maximum(length**2, np.einsum("ij,ij->i", b, b))
        self._triangles = np.asarray(triangles)[valid]
        a, b, length, area = a[valid], b[valid], length[valid], area[valid]
        along = np.einsum("ij,ij->i", a, b) / length
        self._inverse = np.zeros((len(a), 2, 2))
        self._inverse[:, 0, 0] = 1.0 / length
        self._inverse[:, 0, 1] = -along / area
        self._inverse[:, 1, 1] = length / area
        self.areas: Floats = 0.5 * area  # (T',) at rest
        self._area = np.repeat(area, 3)
        self._vertices = len(points)
        corner_vertices = self._triangles.reshape(-1)
        self._weight = np.bincount(corner_vertices, self._area, minlength=self._vertices)

    def faces(self, points: Floats) -> NDArray[np.float64]:
        """Smaller and larger principal stretch (T', 2) of each triangle except for slivers."""
        a, b = self._edges(points, self._triangles)
        F = np.stack([a, b], axis=2) @ self._inverse
        C = np.einsum("nij,nik->njk", F, F)
        mean = 0.5 * (C[:, 0, 0] + C[:, 1, 1])
        radius = np.hypot(0.5 * (C[:, 0, 0] - C[:, 1, 1]), C[:, 0, 1])
        squared = np.stack([mean - radius, mean + radius], axis=1)
        return np.sqrt(np.maximum(squared, 0.0))

    def at_vertices(self, faces: Floats) -> NDArray[np.float64]:
        """Stretch (V,) at vertices: that of the two mean principal stretches furthest from 1.

        Means over the adjacent triangles are geometric and weighted by rest area; 1 without a
        triangle.
        """
        corner_vertices = self._triangles.reshape(-1)
        log = np.log(np.maximum(faces, 1e-9))
        mean = np.stack(
            [
                np.bincount(
                    corner_vertices, self._area * np.repeat(log[:, k], 3), minlength=self._vertices
                )
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
    rest_volume = np.prod(rest_scales, axis=1)
    volume = np.abs(np.linalg.det(axes))
    return np.divide(volume, rest_volume, out=np.ones_like(volume), where=rest_volume > 0.0)
