"""UV charts: as-rigid-as-possible flattening, and a packed atlas with one texel density.

A chart is a set of quads with the topology of a disc.  Its flattening minimizes
sum_t sum_(ij in t) cot_ij |(u_i - u_j) - R_t (x_i - x_j)|^2 over positions u and one rotation R_t
per triangle, alternating the two (Liu et al. 2008, A Local/Global Approach to Mesh
Parameterization).  Points of the plane are complex numbers, so R_t = S / |S| with
S = sum cot du conj(dx).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Plane = NDArray[np.complex128]

SIDES = ((0, 1), (1, 2), (2, 0))


@dataclass(frozen=True, kw_only=True)
class Atlas:
    """Face-varying texture coordinates, shared where corners agree."""

    values: Floats  # (K, 2) in [0, 1]
    indices: Ints  # (F, 4) into values


def boundary_loop(faces: Ints) -> Ints:
    """The vertices of the single border loop, in the direction of the faces."""
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    present = {(int(a), int(b)) for a, b in edges}
    after = {a: b for a, b in present if (b, a) not in present}
    loop = [min(after)]
    while after[loop[-1]] != loop[0]:
        loop.append(after[loop[-1]])
    if len(loop) != len(after):
        raise ValueError(f"chart has a border of {len(after)} edges, its first loop {len(loop)}")
    return np.array(loop)


def on_disc(points: Floats, faces: Ints) -> Plane:
    """Tutte's embedding: the border on the unit circle by arc length, each interior vertex at the
    mean of its neighbors, hence free of flips."""
    count = len(points)
    loop = boundary_loop(faces)
    step = np.linalg.norm(points[np.roll(loop, -1)] - points[loop], axis=1)
    rim = np.exp(2j * np.pi * (np.cumsum(step) - step) / step.sum())
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    near = sparse.coo_matrix((np.ones(len(edges)), tuple(edges.T)), shape=(count, count)).tocsr()
    near = (near + near.T).sign()
    inner = np.setdiff1d(np.arange(count), loop)
    laplacian = (sparse.diags(np.asarray(near.sum(axis=1))[:, 0]) - near).tocsr()
    flat = np.zeros(count, dtype=complex)
    flat[loop] = rim
    flat[inner] = solve_complex(laplacian[inner][:, inner], near[inner][:, loop] @ rim)
    return flat


def solve_complex(matrix: sparse.csr_matrix, right: Plane) -> Plane:
    """x of a real sparse A x = b with complex b."""
    factor = splu(matrix.tocsc())
    return factor.solve(right.real) + 1j * factor.solve(right.imag)


def flatten(points: Floats, faces: Ints, passes: int) -> Plane:
    """(n,) plane coordinates, in the units of ``points``, of a disc of quads (F, 4)."""
    a, b, c, d = faces.T
    # both diagonals: the result has no bias toward either
    triangles = np.stack([a, b, c, a, c, d, a, b, d, b, c, d], axis=1).reshape(-1, 3)
    count = len(points)
    x = [points[triangles[:, k]] for k in range(3)]
    length = np.linalg.norm(x[1] - x[0], axis=1)
    along = (x[1] - x[0]) / length[:, None]
    foot = np.einsum("ij,ij->i", x[2] - x[0], along)
    height = np.linalg.norm(x[2] - x[0] - foot[:, None] * along, axis=1)
    corner = np.stack([0j * foot, length + 0j, foot + 1j * height])

    start, end, weight, edge = [], [], [], []
    for i, j in SIDES:
        opposite = corner[3 - i - j]
        spread = (corner[i] - opposite) * np.conj(corner[j] - opposite)
        start.append(triangles[:, i])
        end.append(triangles[:, j])
        # a floor keeps the system positive definite at the rare obtuse corner
        weight.append(np.maximum(spread.real / np.abs(spread.imag), 0.02))
        edge.append(corner[i] - corner[j])
    start, end, weight, edge = map(np.stack, (start, end, weight, edge))

    adjacency = sparse.coo_matrix(
        (weight.ravel(), (start.ravel(), end.ravel())), shape=(count, count)
    ).tocsr()
    adjacency = adjacency + adjacency.T
    laplacian = sparse.diags(np.asarray(adjacency.sum(axis=1))[:, 0]) - adjacency
    factor = splu(laplacian.tocsc()[1:, 1:])
    flat = on_disc(points, faces)
    for _ in range(passes):
        turn = np.sum(weight * (flat[start] - flat[end]) * np.conj(edge), axis=0)
        turn /= np.abs(turn)
        pull = (weight * turn * edge).ravel()
        right = np.zeros(count, dtype=complex)
        np.add.at(right, start.ravel(), pull)
        np.add.at(right, end.ravel(), -pull)
        flat[0] = 0.0
        flat[1:] = factor.solve(right[1:].real) + 1j * factor.solve(right[1:].imag)
    return flat


def facing(flat: Plane, picture: Plane) -> Plane:
    """``flat`` turned to agree best with ``picture``, a flat view of the same vertices."""
    turn = np.sum((picture - picture.mean()) * np.conj(flat - flat.mean()))
    return flat * turn / np.abs(turn)


def chart(
    points: Floats, faces: Ints, right: Floats, up: Floats, passes: int
) -> tuple[Plane, Ints]:
    """Plane coordinates and local quads of a disc of a mesh, turned as seen with `right`, `up`."""
    vertices, quads = np.unique(faces, return_inverse=True)
    quads, points = quads.reshape(-1, 4), points[vertices]
    return facing(flatten(points, quads, passes), points @ right + 1j * (points @ up)), quads


def pack(rows: Sequence[Sequence[Plane]], margin: float) -> list[list[Plane]]:
    """Charts laid out left to right in rows from the bottom, all scaled alike into [0, 1]^2."""
    placed, widths, base = [], [], margin
    for row in rows:
        cursor, top, line = margin, 0.0, []
        for chart in row:
            chart = chart - (chart.real.min() + 1j * chart.imag.min())
            line.append(chart + cursor + 1j * base)
            cursor += chart.real.max() + margin
            top = max(top, chart.imag.max())
        placed.append(line)
        widths.append(cursor)
        base += top + margin
    scale = 1.0 / max(*widths, base)
    return [[scale * chart for chart in line] for line in placed]


def gather(charts: Sequence[tuple[Plane, Ints, Ints]], face_count: int) -> Atlas:
    """The atlas of charts given as (plane coordinates, face numbers, local quads of those)."""
    indices = np.empty((face_count, 4), dtype=np.int64)
    offset = 0
    for flat, numbers, quads in charts:
        indices[numbers] = quads + offset
        offset += len(flat)
    plane = np.concatenate([flat for flat, _, _ in charts])
    return Atlas(values=np.stack([plane.real, plane.imag], axis=1), indices=indices)
