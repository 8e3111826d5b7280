"""Dependent nodes: nodes whose motion is interpolated from free nodes.

Nodes with very little mass and stiffness are not stable as unknowns: they move by hundreds of cells
(measured) and corrupt F of the particles at the surface. Such a light node is an affine fit of the
free ones, u_l = sum_j e_lj u_j with sum e = 1 and sum e X_j = X_l. Its force and mass are
distributed by the transpose, which conserves linear and angular momentum exactly. Nodes outside of
the particles' support are evaluated the same way, for points embedded there. Pinned nodes follow
their pin (`pins`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.neighbors import kd_tree
from gf_usd.physics.grid.copies import Fit, NodeCopies, SharedNodes
from gf_usd.physics.grid.pins import interpolation

if TYPE_CHECKING:
    from scipy.spatial import cKDTree


# A node is light below this fraction of the median mass and of the heaviest neighbor's: all nodes
# of a thin limb may be below the former.
FREE_MASS = 0.1
FIT_NEIGHBORS = 24  # free nodes in an affine fit
FIT_LEAST = 1e-6  # least weight in a fit, relative to that of the nearest node
TIE = 1e-9  # distances that differ by less are equal
FIT_REACH = 2.0  # [cells] distance up to which a fit uses the nodes nearest to the point
FAR_NEIGHBORS = 64  # nodes in a fit at a point beyond it: 24 stretch a lamp shade 5.6-fold, not 1.7
FAR_WIDTH = 0.5  # width of its weights over its distance from the nearest node


def affine_fit(ijk: Ints, free: Ints, reach: float | None = None) -> sparse.csr_matrix:
    """Rows e (n, len(free)) that extrapolate a field from free nodes, exact for affine fields.

    Moving least squares with a linear basis about the mean C of the nodes and Gaussian weights B:
    e_j = B_j (1 / sum B + (X_j - C) . M^+ (X_i - C)), M = sum B (X_j - C) (X_j - C)^T, so that
    sum_j e_j = 1 and sum_j e_j X_j = X_i. Where the nodes are coplanar the field is constant across
    the plane.  At a point beyond `FIT_REACH` of the nodes, B is wider the farther it is, so that it
    follows the mean deformation of a larger part.

    ijk : (n, 3), free : (m, 3) grid indices; reach : [cells] largest distance of a node.
    """
    if len(ijk) == 0:
        return sparse.csr_matrix((0, len(free)))
    tree = kd_tree(free)
    gap = tree.query(ijk)[0]
    far = np.flatnonzero(gap > FIT_REACH)
    if not len(far):
        return _fitted(ijk, ijk, tree, free, np.ones(len(ijk)), FIT_NEIGHBORS, reach)
    close = np.flatnonzero(gap <= FIT_REACH)
    # For a distant point the nearest nodes may be coplanar: use the neighbors of the nearest ones.
    # A gradient of a few of them would be multiplied by the distance, with its errors: leaves of a
    # plant grew to spikes.
    distance, closest = nearest(tree, ijk[far], 1)
    tied = np.isfinite(distance)
    around = np.where(tied[:, :, None], free[closest], 0).sum(1) / tied.sum(1)[:, None]
    width = np.maximum(1.0, FAR_WIDTH * gap[far])
    rows = sparse.vstack(
        [
            _fitted(ijk[close], ijk[close], tree, free, np.ones(len(close)), FIT_NEIGHBORS, reach),
            _fitted(ijk[far], around, tree, free, width, FAR_NEIGHBORS, reach),
        ]
    )
    return sparse.csr_matrix(rows)[np.argsort(np.concatenate([close, far]))]


def _fitted(
    ijk: Ints, around: Floats, tree: cKDTree, free: Ints, width: Floats, count: int,
    reach: float | None,
) -> sparse.csr_matrix:  # fmt: skip
    """Rows of `affine_fit` at (n, 3) to the nodes of a tree that are nearest to `around` (n, 3).

    width : (n,) [cells] of the Gaussian weights, less the distance of the nearest; count : of
    nodes, and those that are as near as the last.
    """
    if len(ijk) == 0:
        return sparse.csr_matrix((0, len(free)))
    distance, near = nearest(tree, around, count)
    if reach is not None:
        distance[distance > reach] = np.inf
    # With a single near node the gradient depends on far ones: their weights must exceed rounding.
    scale = distance[:, :1] + width[:, None]
    B = np.maximum(np.exp(-((distance / scale) ** 2)), FIT_LEAST)
    B[np.isinf(distance)] = 0.0
    B /= B.sum(1, keepdims=True)
    center = np.einsum("nk,nka->na", B, free[near])
    P = free[near] - center[:, None, :]
    M = np.einsum("nka,nk,nkb->nab", P, B, P)
    slope = np.einsum("nab,nb->na", np.linalg.pinv(M, rcond=1e-9, hermitian=True), ijk - center)
    e = B * (1.0 + np.einsum("nka,na->nk", P, slope))
    row, column = np.nonzero(B)
    return sparse.csr_matrix(
        (e[row, column], (row, near[row, column])), shape=(len(ijk), len(free))
    )


def nearest(tree: cKDTree, X: Floats, count: int) -> tuple[Floats, Ints]:
    """Distances (n, k) and nodes of the `count` nearest, with all that are as near as the last.

    Ties are included, since a choice among them would depend on the order of the axes. Rows are
    padded with distances inf.
    """
    count = min(count, tree.n)
    k = min(count + count // 4 + 2, tree.n)
    distance, near = tree.query(X, k=np.arange(1, k + 1))
    reach = distance[:, count - 1 : count] * (1.0 + TIE)
    while k < tree.n and len(rows := np.flatnonzero(distance[:, -1] <= reach[:, 0])):
        more = min(2 * k, tree.n) - k
        distance = np.pad(distance, ((0, 0), (0, more)), constant_values=np.inf)
        near = np.pad(near, ((0, 0), (0, more)))
        k += more
        distance[rows], near[rows] = tree.query(X[rows], k=np.arange(1, k + 1))
    beyond = distance > reach
    width = int((~beyond).sum(1).max())
    return np.where(beyond, np.inf, distance)[:, :width], near[:, :width]


def replaced(rows: sparse.csr_matrix, which: Ints, by: sparse.csr_matrix) -> sparse.csr_matrix:
    """Rows (n, m) with some of them (k,) replaced by others (k, m)."""
    if not len(which):
        return rows
    back = np.arange(rows.shape[0])
    back[which] = rows.shape[0] + np.arange(len(which))
    both: sparse.csr_matrix = sparse.csr_matrix(sparse.vstack([rows, by]))
    return sparse.csr_matrix(both[back])


class Fits:
    """Rows over nodes for points between and beyond them; each uses only nodes of its own limb.

    ijk : (M, 3) nodes; copies : of nodes near several limbs; cells : (K, 27) nodes of each cell,
    which separate limbs without shared nodes; None: limbs are not separated.
    """

    def __init__(self, ijk: Ints, copies: NodeCopies | None, cells: Ints | None = None) -> None:
        self.ijk, self.copies = ijk, copies
        self.home = np.full(len(ijk), -1) if copies is None else copies.home
        self._cells = None if cells is None else SharedNodes(ijk, cells)

    def affine(
        self, at: Ints, counts: NDArray[np.bool_], home: Ints, seed: Ints | None = None
    ) -> sparse.csr_matrix:
        """`affine_fit` at (n, 3) to the nodes `counts` (M,).

        home : (n,) cell copy from which nodes are searched, -1: no restriction; empty: none for
        all.
        seed : (n,) node to which each point belongs; None: the nearest.
        """
        nodes = np.flatnonzero(counts)
        rows = self._or_nearest(self._fit(affine_fit, at, nodes, home), at, nodes)
        if self._cells is None or not len(at):
            return rows
        own: Ints = kd_tree(self.ijk).query(at)[1] if seed is None else seed
        unconnected_fits = self._cells.unconnected_fits(rows, nodes, own)
        if len(home):
            unconnected_fits = unconnected_fits[home[unconnected_fits] < 0]
        if not len(unconnected_fits):
            return rows
        cells = self._cells.as_copies
        home = cells.home[own[unconnected_fits]]
        within = cells.through_solid(affine_fit, at[unconnected_fits], home, self.ijk, counts)[
            :, nodes
        ]
        return replaced(
            rows, unconnected_fits, self._or_nearest(within, at[unconnected_fits], nodes)
        )

    def _or_nearest(self, rows: sparse.csr_matrix, at: Ints, nodes: Ints) -> sparse.csr_matrix:
        """Rows with the nearest node in place of empty ones, for an isolated part without free
        nodes.
        """
        empty = np.flatnonzero(np.diff(rows.indptr) == 0)
        return replaced(rows, empty, affine_fit(at[empty], self.ijk[nodes]))

    def between(self, at: Floats, nodes: Ints, home: Ints) -> sparse.csr_matrix:
        """`interpolation` at (n, 3) [cells] of a field on nodes (m,); home as in `affine`."""
        return self._fit(lambda at, ijk, _: interpolation(at, ijk), at, nodes, home)

    def _fit(self, fit: Fit, at: Floats, nodes: Ints, home: Ints) -> sparse.csr_matrix:
        if self.copies is None or not (home >= 0).any():
            return fit(at, self.ijk[nodes], None)
        plain, bound = np.flatnonzero(home < 0), np.flatnonzero(home >= 0)
        counts = np.zeros(len(self.ijk), bool)
        counts[nodes] = True
        within = self.copies.through_solid(fit, at[bound], home[bound], self.ijk, counts)
        rows = sparse.vstack([fit(at[plain], self.ijk[nodes], None), within[:, nodes]])
        back = np.empty(len(at), np.int64)
        back[np.concatenate([plain, bound])] = np.arange(len(at))
        return sparse.csr_matrix(rows)[back]


def split_nodes(
    ijk: Ints,
    mass: Floats,
    free_mass: float = FREE_MASS,
    *,
    held: NDArray[np.bool_] | None = None,
    mirror: Floats | None = None,
    share: Floats | None = None,
    body: Ints | None = None,
    copies: NodeCopies | None = None,
    cells: Ints | None = None,
) -> tuple[NDArray[np.bool_], sparse.csr_matrix, Floats]:
    """Free nodes (M,), the rows of the dependent nodes, and the free nodes' lumped masses.

    A node whose lumped mass would fall below the bound by negative weights of a fit becomes
    dependent too.

    held : (M,) nodes of a pin; mirror : (M, 3) [cells] their mirror points, nan where deep.
    share : (M,) e of `pins`. A mirrored node contributes |e| of its mass, since kinetic energy does
    not depend on the sign.
    body : (M,) the body of each node: the median mass is that of its body.
    copies, cells : see `Fits`.
    """
    fits = Fits(ijk, copies, cells)
    held = np.zeros(len(mass), bool) if held is None else held
    body = np.zeros(len(mass), np.int64) if body is None else body
    counts = ~held & (mass > 0.0)
    members = [mass[counts & (body == k)] for k in range(int(body.max()) + 1)]
    medians = [np.median(m) if len(m) else 0.0 for m in members]
    typical = np.array(medians)[body]
    if cells is not None:
        around = heaviest_around(mass, cells)
        typical = np.where(around > 0.0, np.minimum(typical, around), typical)
    least = free_mass * typical
    free = (mass >= least) & ~held
    ghosts = sparse.csr_matrix((0, 0))
    while True:
        light = ~free & ~held
        follow = fits.affine(ijk[light], free, fits.home[light], np.flatnonzero(light))
        lumped = mass[free] + follow.T @ mass[light]
        if held.any():
            extend = sparse.vstack([sparse.identity(int(free.sum())), follow], format="csr")
            others = np.concatenate([np.flatnonzero(free), np.flatnonzero(light)])
            ghosts = (mirrored(held, mirror, share, others, fits) @ extend).tocsr()
            lumped = lumped + abs(ghosts).T @ mass[held]
        sound = lumped >= 0.5 * least[free]
        if sound.all():
            break
        free[np.flatnonzero(free)[~sound]] = False
    if held.any():
        rows = sparse.vstack([follow, ghosts], format="csr")
        back = np.empty(rows.shape[0], np.int64)
        back[np.concatenate([np.flatnonzero(light[~free]), np.flatnonzero(held[~free])])] = (
            np.arange(rows.shape[0])
        )
        follow = sparse.csr_matrix(rows)[back]
    return free, follow, lumped


def heaviest_around(mass: Floats, cells: Ints) -> NDArray[np.float64]:
    """(M,) the largest mass among the nodes that share a cell of `cells` (K, 27) with each."""
    most = np.zeros(len(mass))
    np.maximum.at(most, cells.ravel(), np.repeat(mass[cells].max(1), cells.shape[1]))
    return most


def mirrored(
    held: NDArray[np.bool_],
    mirror: Floats | None,
    share: Floats | None,
    others: Ints,
    fits: Fits,
) -> sparse.csr_matrix:
    """Rows (held, others) of pinned nodes: e times the field, on other nodes, at the mirror point.

    0 where the node is deep in the pin, or where no other node is around the mirror point.
    """
    count = int(held.sum())
    if mirror is None or share is None:
        return sparse.csr_matrix((count, len(others)))
    at = mirror[held]
    near = np.flatnonzero(np.isfinite(at).all(1))
    put = sparse.csr_matrix(
        (share[held][near], (near, np.arange(len(near)))), shape=(count, len(near))
    )
    return (put @ fits.between(at[near], others, fits.home[held][near])).tocsr()
