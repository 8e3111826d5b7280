"""The surface of flowing particles: a separate closed mesh for every frame.

It is the zero level set of the field of Zhu and Bridson (2005, section 5), with the radius of
Solenthaler et al. (2007, section 4):

    phi(x) = |x_mean - x| - f r_mean,   x_mean = sum_p w_p x_p / sum_p w_p,   r_mean likewise,
    w_p = (1 - |x - x_p|^2 / R^2)^3 within R,   r_p = (3 V_p / 4 pi)^(1/3).

f is 1 where particles are dense, and decreases to 0 between separated particles, so that drops are
not connected: f = s^3 - 3 s^2 + 3 s, s = (3.5 - e) / 3.1 clamped to [0, 1], with e the largest
eigenvalue of the symmetric part of grad x_mean.

R is chosen by r. At the boundary of an evenly filled half-space, |x_mean - x| is R / 2 times the
ratio of the integrals of t^3 (1 - t^2)^3 and t^2 (1 - t^2)^3 over t in [0, 1]: R times `DEPTH`.
With R = r / DEPTH a flat surface is at the boundary of the material, and a drop of one particle has
the volume of that particle. A boundary of curvature radius a is drawn

    r^2 / a times DEPTH / 0.406

too far inside: .6 of a squared spacing over a.

The field is sampled at the nodes of cells of width R / 5, in blocks of 5 x 5 x 5 cells near
particles; other blocks are not stored. Marching cubes (Lorensen and Cline 1987, from libigl)
triangulates the level set, and smoothing without shrinkage (Taubin 1995) removes the steps of the
cells.
"""

from __future__ import annotations

from dataclasses import dataclass

import igl
import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints, cross
from gf_usd.core.errors import BakeError
from gf_usd.core.neighbors import components
from gf_usd.physics.output.surface_kernels import BLOCK, NODES, field, interpolated
from gf_usd.system.taichi_runtime import ensure_running

DEPTH = 63.0 / 256.0  # Beta(2, 4) / (2 Beta(3/2, 4)), the two integrals
# dphi/dn at the boundary of a half-space: DEPTH times the ratio of the integrals of t w and t^2 w
SLOPE = DEPTH * (1.0 / 8.0) / (16.0 / 315.0)
PASSES = 6
SHRINK, GROW = 0.5, -0.53  # Taubin's lambda and mu: 1/mu + 1/lambda = 0.11, his pass band
FAR = 1 << 20  # largest distance from the origin [blocks] with a key

CORNERS = np.array(
    [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
)  # in the order of libigl
AROUND = np.stack(np.meshgrid(*[np.arange(-1, 2)] * 3, indexing="ij"), -1).reshape(27, 3)


@dataclass(frozen=True, kw_only=True)
class ParticleSurface:
    """A triangle mesh around particles, counter-clockwise seen from outside."""

    points: NDArray[np.float64]  # (V, 3) [m]
    triangles: NDArray[np.int64]  # (T, 3)
    normals: NDArray[np.float64]  # (V, 3) unit, outward
    interpolated: NDArray[np.float64]  # (V, c) weighted means of particle values


def reach(V0: Floats) -> float:
    """[m] R for particles of volumes (N,) [m^3], from their mean."""
    return float(np.cbrt(0.75 / np.pi * np.mean(V0))) / DEPTH


def surface(x: Floats, V0: Floats, values: Floats) -> ParticleSurface:
    """The surface of one or more particles at x (N, 3) [m] of volumes (N,) [m^3].

    values : (N, c) particle values that are interpolated to the vertices, such as velocity and
    color.

    Raises BakeError where a particle is more than a million R from the origin.
    """
    ensure_running()
    R = reach(V0)
    h = R / BLOCK
    blocks = _Blocks(np.asarray(x, np.float64) / h)
    radii = np.cbrt(0.75 / np.pi * np.asarray(V0, np.float64)) / h
    phi = blocks.field(radii.astype(np.float32))
    points, triangles = _march(blocks, phi)
    found = blocks.carry(np.asarray(values, np.float32), points)
    points = _smoothed(points, triangles) * h
    return ParticleSurface(
        points=points, triangles=triangles, normals=_normals(points, triangles), interpolated=found
    )


def _keys(block: Ints) -> NDArray[np.int64]:
    """One integer per block (n, 3), in lexicographic order."""
    a, b, c = (np.asarray(block, np.int64) + FAR).T
    return (a << 42) | (b << 21) | c


def _unkeyed(keys: Ints) -> NDArray[np.int64]:
    low = (1 << 21) - 1
    return np.stack([keys >> 42, keys >> 21 & low, keys & low], -1) - FAR


class _Blocks:
    """Blocks of cells near particles; lengths in cells.

    x : (N, 3) [cells] of the particles.
    """

    def __init__(self, x: Floats) -> None:
        block = np.floor(x / BLOCK).astype(np.int64)
        if not (np.abs(block) < FAR - 2).all():
            worst = int(np.abs(block).max(axis=1).argmax())
            raise BakeError(
                f"particle {worst} is {np.abs(block[worst]).max()} surface blocks from the "
                f"origin, but the limit is {FAR}",
                "leave out --surface, or end the bake with --frames before the particle flies away",
            )
        keys, of = np.unique(_keys(block), return_inverse=True)
        local = (x - BLOCK * block).astype(np.float32)
        slab = BLOCK * of + np.minimum(local[:, 0].astype(np.int64), BLOCK - 1)
        self._order = np.argsort(slab, kind="stable")
        self._x = local[self._order]
        starts = np.searchsorted(slab[self._order], np.arange(BLOCK * len(keys) + 1))
        self._first = starts.astype(np.int32)
        self.keys = np.unique(_keys((_unkeyed(keys)[:, None] + AROUND).reshape(-1, 3)))
        self.corners = _unkeyed(self.keys)
        self._around = _found(keys, _keys((self.corners[:, None] + AROUND).reshape(-1, 3)))
        self._around = self._around.reshape(-1, 27).astype(np.int32)

    def field(self, radii: NDArray[np.float32]) -> NDArray[np.float32]:
        """(B, NODES) phi [cells] at the nodes of each block."""
        phi = np.empty((len(self.keys), NODES), np.float32)
        field(self._x, radii[self._order], self._first, self._around, phi, float(BLOCK))
        phi[phi == 0.0] = np.finfo(np.float32).tiny  # a node on the surface counts as outside
        return phi

    def carry(self, values: NDArray[np.float32], points: Floats) -> NDArray[np.float64]:
        """(V, c) weighted means of particle values at points (V, 3) [cells] near the surface."""
        block = np.floor(points / BLOCK).astype(np.int64)
        at = (points - BLOCK * block).astype(np.float32)
        number = _found(self.keys, _keys(block)).astype(np.int32)
        out = np.empty((len(points), values.shape[1]), np.float32)
        interpolated(
            self._x, values[self._order], self._first, self._around, at, number, out, BLOCK
        )
        return out.astype(np.float64)


def _found(keys: Ints, wanted: Ints) -> NDArray[np.int64]:
    """Index of the wanted keys in sorted keys; -1 where absent."""
    at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    return np.where(keys[at] == wanted, at, -1)


def _march(blocks: _Blocks, phi: Floats) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices [cells] and triangles of the cells in which phi changes sign."""
    grid = phi.reshape(-1, BLOCK, BLOCK, BLOCK)
    inside = (grid < 0.0).reshape(len(grid), -1)
    # Nodes on the upper faces belong to neighbor blocks; without a neighbor they are outside.
    near = np.flatnonzero(inside.any(1))
    near = np.unique(_keys((blocks.corners[near][:, None] + AROUND).reshape(-1, 3)))
    near = _found(blocks.keys, near)
    near = near[near >= 0]
    whole = np.full((len(near), BLOCK + 1, BLOCK + 1, BLOCK + 1), np.float32(BLOCK))
    for step in np.ndindex(2, 2, 2):
        number = _found(blocks.keys, _keys(blocks.corners[near] + step))
        there = number >= 0
        put = tuple(slice(BLOCK, None) if one else slice(0, BLOCK) for one in step)
        take = tuple(slice(0, 1) if one else slice(0, BLOCK) for one in step)
        whole[(there, *put)] = grid[(number[there], *take)]
    sign = whole < 0.0
    any_, all_ = (
        reduce.reduce([sign[(slice(None), *_window(c))] for c in CORNERS])
        for reduce in (np.logical_or, np.logical_and)
    )
    of, *cell = np.nonzero(any_ & ~all_)
    local = np.stack(cell, -1)[:, None] + CORNERS
    values = whole[(of[:, None], *np.moveaxis(local, -1, 0))].reshape(-1)
    node = (BLOCK * blocks.corners[near][of][:, None] + local).reshape(-1, 3)
    low = node.min(0)
    size = node.max(0) - low + 1
    key = ((node[:, 0] - low[0]) * size[1] + node[:, 1] - low[1]) * size[2] + node[:, 2] - low[2]
    _, first, index = np.unique(key, return_index=True, return_inverse=True)
    points, triangles, _ = igl.marching_cubes(
        values[first].astype(np.float64), node[first].astype(np.float64), index.reshape(-1, 8), 0.0
    )
    return np.asarray(points, np.float64), np.asarray(triangles, np.int64)


def _window(corner: Ints) -> tuple[slice, ...]:
    return tuple(slice(int(c), int(c) + BLOCK) for c in corner)


def _smoothed(points: Floats, triangles: Ints) -> NDArray[np.float64]:
    """Points after `PASSES` of Taubin smoothing, with the umbrella operator.

    Every component is then scaled about its center to its previous volume (Desbrun et al. 1999,
    section 4.4), since drops of few triangles shrink.
    """
    from scipy.sparse import coo_matrix

    a, b = triangles.ravel(), triangles[:, [1, 2, 0]].ravel()  # every edge, once in each direction
    count = len(points)
    graph = coo_matrix((np.ones(len(a)), (a, b)), shape=(count, count))
    toward = graph.tocsr()
    share = 1.0 / np.asarray(toward.sum(1))
    parts, part = components(graph)
    size = np.bincount(part)
    middle = _sums(part, points, parts) / size[:, None]
    whole = _volumes(points - middle[part], triangles, part, parts)
    for _ in range(PASSES):
        for factor in (SHRINK, GROW):
            points = points + factor * (share * (toward @ points) - points)
    middle = _sums(part, points, parts) / size[:, None]
    away = points - middle[part]
    left = _volumes(away, triangles, part, parts)
    scale = np.cbrt(np.divide(whole, left, out=np.ones(parts), where=left * whole > 0.0))
    return middle[part] + scale[part, None] * away


def _volumes(points: Floats, triangles: Ints, part: Ints, parts: int) -> NDArray[np.float64]:
    """(parts,) six times the volume of each component, negative for a cavity; points relative to
    centers.
    """
    a, b, c = (points[triangles[:, k]] for k in range(3))
    six = np.einsum("ij,ij->i", a, cross(b, c))
    return np.bincount(part[triangles[:, 0]], six, parts).astype(np.float64)


def _sums(label: Ints, values: Floats, count: int) -> NDArray[np.float64]:
    """(count, 3) sums of values (n, 3) with each label."""
    columns = [np.bincount(label, values[:, d], count) for d in range(3)]
    return np.stack(columns, -1).astype(np.float64)


def _normals(points: Floats, triangles: Ints) -> NDArray[np.float64]:
    """(V, 3) unit area-weighted means of the normals of adjacent triangles."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    area = cross(b - a, c - a)
    total = _sums(triangles.ravel(), np.repeat(area, 3, axis=0), len(points))
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.divide(total, length, out=np.zeros_like(total), where=length > 0.0)
