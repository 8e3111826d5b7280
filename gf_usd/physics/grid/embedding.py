"""Embedded points: their poses, deformed normals and deformation gradients.

Rows of the many points of a mesh or a capture that is embedded in a body, in little memory.

Most of a surface lies on light nodes, each of which follows a dozen free ones.  A row over free
nodes names them all, some hundred; a row over the 27 nodes around a point names those, once what
they do has been worked out:

    U = S u,   x = X + W U,   F = I + sum_b (G_b U) e_b

with S the followers' combinations, and an affine fit for nodes that no particle reaches.

Sparse products shared among threads, rows in turns: SciPy lets go of the interpreter meanwhile.

Each row is a sum of its own, so that the result does not depend on how they are shared.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from gf_usd.core.arrays import Floats, Ints, lengths
from gf_usd.core.frames import Pose
from gf_usd.core.matrices import cofactors, entries
from gf_usd.physics.grid.reference import CHUNK, OFFSETS, Rows, weights
from gf_usd.system.taichi_runtime import ensure_running, resident_blocks, threads

if TYPE_CHECKING:
    from gf_usd.physics.grid.reference import Stencil


def pose(rows: Rows, u: Floats, v: Floats, offset: Floats) -> Pose:
    """x = X + offset + W u,  v = W v_i,  F = I + sum_i u_i (x) grad w_i  (docs/physics.md).

    u, v : (M, 3) nodal [m], [m/s]; offset : (3,) [m] rigid translation.
    """
    u, v = rows.nodes(u), rows.nodes(v)
    if len(rows.X) >= FEW and rows.alike and not resident_blocks():
        return _in_one_pass(rows, u, v, offset)
    x, v = placed(rows, u, v)
    return Pose(x=rows.X + offset + x, v=v, F=_gradient(rows, u))


def _in_one_pass(rows: Rows, u: Floats, v: Floats, offset: Floats) -> Pose:
    """The same, to the bit, in a third of the time."""
    ensure_running()
    from gf_usd.physics.grid.embedding_kernels import embed

    n = len(rows.X)
    x, rate, F = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 9))
    given = (np.ascontiguousarray(a, np.float64) for a in (rows.X, offset, u, v))
    values = (np.ascontiguousarray(one.data, np.float64) for one in (rows.W, *rows.G))
    embed(rows.W.indptr, rows.W.indices, *values, *given, x, rate, F)
    return Pose(x=x, v=rate, F=F.reshape(n, 3, 3))


def placed(rows: Rows, u: Floats, v: Floats) -> tuple[Floats, Floats]:
    """W u and W v of `Rows.nodes`, in one pass over W."""
    both = product(rows.W, np.concatenate([u, v], 1))
    return both[:, :3], np.ascontiguousarray(both[:, 3:])


def gradient(rows: Rows, u: Floats) -> Floats:
    """F = I + sum_i u_i (x) grad w_i, (n, 3, 3)."""
    return _gradient(rows, rows.nodes(u))


def _gradient(rows: Rows, u: Floats) -> Floats:
    n = len(rows.X)
    F = np.empty((n, 3, 3))
    if n < FEW:
        F.transpose(2, 0, 1)[...] = (rows.slopes @ u).reshape(3, n, 3)
    else:
        for axis, G in enumerate(rows.G):
            F[:, :, axis] = product(G, u)
    F += np.eye(3)
    return F


def deform_normals(normals: Floats, points: Ints, F: Floats) -> Floats:
    """n = cof(F) n0, normalized: surfaces turn with the cofactor, defined at J <= 0 too.

    normals : (K, 3) at rest; points : (K,) the point that carries each; F : (V, 3, 3).
    """
    turned = cofactors(entries(F)).reshape(3, 3, -1)
    n = np.einsum("abk,kb->ka", turned[:, :, points], normals)
    length = lengths(n)[:, None]
    if length.all():
        return np.divide(n, length, out=n)
    return np.where(length > 0.0, n / np.where(length > 0.0, length, 1.0), normals)


NODES = len(OFFSETS)


def embedded_rows(stencil: Stencil, X: Floats, body: Ints, cell_copy: Ints | None = None) -> Rows:
    """Rows of points X (n, 3) [m], each on a body (n,), whose `spread` is S.

    The same as `Stencil.rows` makes, to rounding.
    """
    count = len(X)
    at = np.empty((count, NODES), np.int32)
    w = np.empty((count, NODES))
    g = np.empty((3, count, NODES))
    lost, parts = [], []  # nodes that no particle reaches, chunk by chunk, and where they stand
    for k in range(0, count, CHUNK):
        some = slice(k, k + CHUNK)
        found, fx, ijk = stencil.reach(
            X[some], body[some], None if cell_copy is None else cell_copy[some]
        )
        keys, inverse = np.unique(ijk[found < 0], axis=0, return_inverse=True)
        lost.append(keys)
        parts.append((some, found < 0, inverse.ravel()))
        at[some] = found
        w[some], slopes = weights(fx, stencil.h)
        for axis in range(3):
            g[axis, some] = slopes[..., axis]
    columns = lost[0].shape[1] if lost else 3
    beyond, place = np.unique(np.concatenate([np.zeros((0, columns), int), *lost]), axis=0,
                              return_inverse=True)  # fmt: skip
    first = 0
    for keys, (some, missing, inverse) in zip(lost, parts):
        own = place.ravel()[first : first + len(keys)]
        at[some][missing] = stencil.node_count + own[inverse]
        first += len(keys)
    spread = stencil.extension(beyond)
    start = np.arange(0, NODES * count + 1, NODES)

    def over_nodes(values: Floats) -> sparse.csr_matrix:
        shape = (count, spread.shape[0])
        return sparse.csr_matrix((values.ravel(), at.ravel(), start), shape=shape, copy=False)

    W = over_nodes(w)
    G = (over_nodes(g[0]), over_nodes(g[1]), over_nodes(g[2]))
    for one in G:
        one.indices, one.indptr = W.indices, W.indptr
    return Rows(X=X, W=W, G=G, spread=spread)


FEW = 4_096  # rows for each thread, at least: handing them out takes some 50 us


def product(M: Any, u: Floats) -> NDArray[np.float64]:
    """M u of a sparse M (n, m) in rows and u (m, k)."""
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


def _rows(M: Any, first: int, behind: int) -> Any:
    """Some rows of M, without a copy of what is in them."""
    start, end = M.indptr[first], M.indptr[behind]
    return type(M)(
        (M.data[start:end], M.indices[start:end], M.indptr[first : behind + 1] - start),
        shape=(behind - first, M.shape[1]),
        copy=False,
    )


@cache
def _pool(size: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(size, thread_name_prefix="rows")
