"""Rows of the many points of a mesh or a capture that rides on a body, in little memory.

Most of a surface lies on light nodes, each of which follows a dozen free ones.  A row over free
nodes names them all, some hundred; a row over the 27 nodes around a point names those, once what
they do has been worked out:

    U = S u,   x = X + W U,   F = I + sum_b (G_b U) e_b

with S the followers' combinations, and an affine fit for nodes that no particle reaches.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gf_usd.model import Floats, Ints
from gf_usd.physics.stencil import CHUNK, OFFSETS, Rows, weights
from gf_usd.sparse import sparse

if TYPE_CHECKING:
    from gf_usd.physics.stencil import Stencil

NODES = len(OFFSETS)


def rider_rows(stencil: Stencil, X: Floats, body: Ints) -> Rows:
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
        base, fx = stencil.base(X[some] + stencil.shift[body[some]])
        ijk = base[:, None, :] + OFFSETS
        found = stencil.locate(ijk)
        keys, inverse = np.unique(ijk[found < 0], axis=0, return_inverse=True)
        lost.append(keys)
        parts.append((some, found < 0, inverse.ravel()))
        at[some] = found
        w[some], slopes = weights(fx, stencil.h)
        for axis in range(3):
            g[axis, some] = slopes[..., axis]
    beyond, place = np.unique(np.concatenate([np.zeros((0, 3), int), *lost]), axis=0,
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
