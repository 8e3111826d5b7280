"""Embedded points: interpolation rows, poses, normals and deformation gradients.

A surface lies mostly in the support of light nodes, each of which depends on a dozen free ones. A
row over free nodes would have some hundred entries; a row over the 27 nodes around a point has 27,
after the dependent nodes are evaluated once:

    U = S u,   x = X + W U,   F = I + sum_b (G_b U) e_b

with S the combinations for dependent nodes, and an affine fit for nodes outside of the particles'
support. W and the three G depend only on the position of a point in its cell and are recomputed on
use: stored, they would take a kilobyte per point.

Sparse products are split by rows among threads; SciPy releases the interpreter lock. Each row is an
independent sum, so that the result does not depend on the split.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from gf_usd.core.arrays import Floats, Ints, lengths
from gf_usd.core.frames.frame import Pose
from gf_usd.core.matrices import cofactors, entries
from gf_usd.physics.grid.reference.stencil import CHUNK, OFFSETS, Rows, renumbered, weights
from gf_usd.physics.taichi_arrays import aligned, widened
from gf_usd.system.taichi_runtime import ensure_running, resident_blocks, threads

if TYPE_CHECKING:
    from gf_usd.physics.grid.reference.stencil import Stencil


NODES = len(OFFSETS)
FEW = 4_096  # least number of rows per thread: starting one takes some 50 us
MANY = 100_000  # entries of a matrix above which a kernel saves more time than its loading takes


@dataclass(frozen=True, kw_only=True)
class SplineRows:
    """Rows of W and G of points over the 27 nodes of their cells, by the position in the cell."""

    X: Floats  # (n, 3) [m]
    cell: Ints  # (n,) the row of `around` with a point's nodes
    around: Ints  # (K, 27) nodes, int32
    fx: Floats  # (n, 3) distance from the first of them in cells
    h: float  # [m]
    spread: sparse.csr_matrix  # S, from the stacked vector of `Rows` to the nodes
    particles: int  # of the body

    def nodes(self, u: Floats) -> Floats:
        """U = S u of a stacked u (or v)."""
        return self.spread @ u

    @cached_property
    def combined(self) -> sparse.csr_matrix:
        """W S: the rows over the stacked vector of `Rows`."""
        return sparse.csr_matrix(self.W @ self.spread)

    @cached_property
    def W(self) -> sparse.csr_matrix:
        """(n, M)."""
        values = np.empty((len(self.X), NODES))
        for some in self._chunks():
            values[some] = weights(self.fx[some], self.h)[0]
        places = np.ascontiguousarray(self.around[self.cell]).ravel()
        return self._over_nodes(values, places, np.arange(0, values.size + 1, NODES))

    @cached_property
    def G(self) -> tuple[sparse.csr_matrix, ...]:
        """Three, (n, M) [1/m] each."""
        values = np.empty((3, len(self.X), NODES))
        for some in self._chunks():
            values[:, some] = np.moveaxis(weights(self.fx[some], self.h)[1], 2, 0)
        return tuple(self._over_nodes(one, self.W.indices, self.W.indptr) for one in values)

    @cached_property
    def slopes(self) -> sparse.csr_matrix:
        """See `Rows`."""
        return sparse.csr_matrix(sparse.vstack(self.G, format="csr"))

    @property
    def uses_kernels(self) -> bool:
        """Whether there are enough points, or particles, for kernels, which take time to load."""
        return max(len(self.X), self.particles) >= FEW and not resident_blocks()

    @property
    def cells(self) -> tuple[Any, ...]:
        """The arguments of the kernels that describe the points."""
        return self.cell, self.around, self.fx, 1.0 / self.h

    def _chunks(self) -> list[slice]:
        return [slice(k, k + CHUNK) for k in range(0, len(self.X), CHUNK)]

    def _over_nodes(self, values: Floats, places: Ints, start: Ints) -> sparse.csr_matrix:
        shape = (len(self.X), self.spread.shape[0])
        return sparse.csr_matrix((values.ravel(), places, start), shape=shape, copy=False)


def embedded_pose(rows: Rows | SplineRows, motion: Floats, offset: Floats) -> Pose:
    """x = X + offset + W u,  v = W v_i,  F = I + sum_i u_i (x) grad w_i  (docs/physics.md).

    motion : (M, 6) u [m] and v [m/s] of nodes, in columns of one array that many sets of points
    may share; offset : (3,) [m] rigid translation.
    """
    motion = rows.nodes(motion)
    u, v = motion[:, :3], motion[:, 3:]
    if isinstance(rows, SplineRows) and rows.uses_kernels:
        return _pose_by_kernel(rows, u, v, offset)
    x, v = placed(rows, u, v)
    return Pose(x=rows.X + offset + x, v=v, F=_gradient(rows, u))


def _pose_by_kernel(rows: SplineRows, u: Floats, v: Floats, offset: Floats) -> Pose:
    """`embedded_pose` by a kernel, equal to rounding, in a third of the time."""
    ensure_running()
    from gf_usd.physics.grid.row_kernels import LANES, embed

    n = len(rows.X)
    x, rate, F = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 9))
    given = (np.ascontiguousarray(a, np.float64) for a in (rows.X, offset))
    wide = (widened(a, LANES) for a in (u, v))
    embed(*rows.cells, *given, *wide, x, rate, F)
    return Pose(x=x, v=rate, F=F.reshape(n, 3, 3))


def placed(rows: Rows | SplineRows, u: Floats, v: Floats) -> tuple[Floats, Floats]:
    """W u and W v of `Rows.nodes`, in one pass over W where no kernel computes them."""
    if uses_kernel(rows.W, u):
        return product(rows.W, u), product(rows.W, v)
    both = product(rows.W, np.concatenate([u, v], 1))
    return both[:, :3], np.ascontiguousarray(both[:, 3:])


def gradient(rows: Rows | SplineRows, u: Floats) -> Floats:
    """F = I + sum_i u_i (x) grad w_i, (n, 3, 3)."""
    return _gradient(rows, rows.nodes(u))


def _gradient(rows: Rows | SplineRows, u: Floats) -> Floats:
    F = stretches(rows, u)
    F += np.eye(3)
    return F


def stretches(rows: Rows | SplineRows, u: Floats) -> Floats:
    """sum_i u_i (x) grad w_i (n, 3, 3) of `Rows.nodes`."""
    n = len(rows.X)
    if isinstance(rows, SplineRows) and rows.uses_kernels:
        ensure_running()
        from gf_usd.physics.grid.row_kernels import LANES, stretch

        out = np.empty((n, 9))
        stretch(*rows.cells, widened(u, LANES), out)
        return out.reshape(n, 3, 3)
    F = np.empty((n, 3, 3))
    if n < FEW:
        F.transpose(2, 0, 1)[...] = (rows.slopes @ u).reshape(3, n, 3)
    else:
        for axis, G in enumerate(rows.G):
            F[:, :, axis] = product(G, u)
    return F


def gathered(rows: SplineRows, P: Floats) -> Floats:
    """sum_p P_p grad w_ip (M, 3) of P (n, 3, 3): the transpose of `stretches`."""
    n, count = len(rows.X), rows.spread.shape[0]
    if rows.uses_kernels:
        ensure_running()
        from gf_usd.physics.grid.row_kernels import LANES, gather

        out = aligned(count, LANES)
        out[...] = 0.0
        P = np.ascontiguousarray(P, np.float64).reshape(n, 9)
        gather(*rows.cells, P, out)
        return out[:, :3]
    if n < FEW:
        return rows.slopes.T @ np.moveaxis(P, 2, 0).reshape(3 * n, 3)
    return sum((G.T @ P[:, :, b] for b, G in enumerate(rows.G)), np.zeros((count, 3)))


def deform_normals(normals: Floats, points: Ints, F: Floats) -> Floats:
    """n = cof(F) n0, normalized (Nanson's formula; defined for J <= 0 too).

    normals : (K, 3) at rest; points : (K,) the point of each; F : (V, 3, 3).
    """
    turned = cofactors(entries(F)).reshape(3, 3, -1)
    n = np.einsum("abk,kb->ka", turned[:, :, points], normals)
    length = lengths(n)[:, None]
    if length.all():
        return np.divide(n, length, out=n)
    return np.where(length > 0.0, n / np.where(length > 0.0, length, 1.0), normals)


def particle_rows(stencil: Stencil, X: Floats) -> SplineRows:
    """Rows of the particles of a stencil, X (n, 3) [m]."""
    cell, fx = np.empty(len(X), np.int32), np.empty_like(stencil.fx)
    fx[stencil.order] = stencil.fx
    cell[stencil.order] = np.repeat(
        np.arange(len(stencil.cell_nodes), dtype=np.int32), np.diff(stencil.cell_start)
    )
    return SplineRows(
        X=X, cell=cell, around=stencil.cell_nodes.astype(np.int32), fx=fx, h=stencil.h,
        spread=stencil.extension(np.zeros((0, 3), int)), particles=len(X),
    )  # fmt: skip


def embedded_rows(
    stencil: Stencil, X: Floats, body: Ints, cell_copy: Ints | None = None
) -> SplineRows:
    """Rows of points X (n, 3) [m], each of a body (n,).

    Equal to those of `Stencil.rows`, to rounding.
    """
    count = len(X)
    at = np.empty((count, NODES), np.int32)
    inside = np.empty((count, 3))
    lost, parts = [], []  # nodes outside of the particles' support, by chunk, and their positions
    for k in range(0, count, CHUNK):
        some = slice(k, k + CHUNK)
        found, fx, ijk = stencil.reach(
            X[some], body[some], None if cell_copy is None else cell_copy[some]
        )
        keys, inverse = np.unique(ijk[found < 0], axis=0, return_inverse=True)
        lost.append(keys)
        parts.append((some, found < 0, inverse.ravel()))
        at[some], inside[some] = found, fx
    columns = lost[0].shape[1] if lost else 3
    beyond, place = np.unique(np.concatenate([np.zeros((0, columns), int), *lost]), axis=0,
                              return_inverse=True)  # fmt: skip
    first = 0
    for keys, (some, missing, inverse) in zip(lost, parts):
        own = place.ravel()[first : first + len(keys)]
        at[some][missing] = stencil.node_count + own[inverse]
        first += len(keys)
    nodes, around = renumbered(at, stencil.node_count + len(beyond))
    spread = stencil.extension(beyond, nodes[nodes < stencil.node_count])
    return SplineRows(
        X=X, cell=np.arange(count, dtype=np.int32), around=around, fx=inside, h=stencil.h,
        spread=spread, particles=len(stencil.order),
    )  # fmt: skip


def product(M: Any, u: Floats) -> NDArray[np.float64]:
    """M u of a sparse M (n, m) in CSR format and u (m, k); bit-identical however it is computed."""
    if uses_kernel(M, u):
        return _multiplied(M, u)
    count = M.shape[0]
    parts = min(threads(), count // FEW)
    if parts < 2:
        return M @ u
    bounds = [count * k // parts for k in range(parts + 1)]
    out = np.empty((count, *u.shape[1:]))

    def part(first: int, behind: int) -> None:
        out[first:behind] = _rows(M, first, behind) @ u

    list(_pool(parts).map(part, bounds[:-1], bounds[1:]))
    return out


def uses_kernel(M: Any, u: Floats) -> bool:
    """Whether `product` launches a kernel."""
    return M.nnz >= MANY and kernel_supports(M, u)


def kernel_supports(M: Any, u: Floats) -> bool:
    """Whether the kernels of CSR matrices can multiply a sparse M and u: vectors, on the CPU."""
    return M.indices.dtype == np.int32 and u.shape[1:] == (3,) and not resident_blocks()


def _multiplied(M: Any, u: Floats) -> NDArray[np.float64]:
    """`product` with vectors by a kernel, in a third of the time."""
    ensure_running()
    from gf_usd.physics.grid.row_kernels import LANES, multiply

    out = np.empty((M.shape[0], 3))
    multiply(M.indptr, M.indices, M.data, widened(u, LANES), out)
    return out


def _rows(M: Any, first: int, behind: int) -> Any:
    """Some rows of M, without a copy of its data."""
    start, end = M.indptr[first], M.indptr[behind]
    return type(M)(
        (M.data[start:end], M.indices[start:end], M.indptr[first : behind + 1] - start),
        shape=(behind - first, M.shape[1]),
        copy=False,
    )


@cache
def _pool(size: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(size, thread_name_prefix="rows")
