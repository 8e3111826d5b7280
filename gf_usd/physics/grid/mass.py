"""The nodal mass matrix: near the consistent one, with a sparse inverse.

The consistent mass MC_ij = sum_p m_p w_ip w_jp of the interpolated velocities cannot be inverted in
every substep. Its row sums M_i, the lumped mass, can, but they increase the inertia: for quadratic
B-splines sum_i w_ip |X_i - X_p|^2 = h^2/4 along each axis, and a wave of length 2 pi / k is too
slow by the relative error (k h)^2 / 8. For an affine velocity field, the difference to the
consistent mass is a Laplacian of springs between neighbors along the axes,

    (M - MC) X = K X,    k_ij = sum_p m_p x (flux of w_p (X - X_p) through the edge i j)

with, for edges along x, the fluxes w_0 f w_b w_c and w_2 (2 - f) w_b w_c, f the distance from the
base node in cells. All k are positive. The mass matrix M~ of the solver is defined by

    M~^-1 = M^-1 + M^-1 K M^-1

the first two terms of the Neumann series of (M - K)^-1. It is symmetric and positive definite. M~ 1
= M 1, so that linear momentum is sum_i M_i v_i; angular momentum sum_i x_i x (M~ v)_i is conserved,
as for any symmetric mass. The error of a wave decreases to the order (k h)^4: in one dimension, 1 +
(1 - cos kh) / 2 instead of 1 / (1 - (kh)^2 / 4 ...).

Dependent nodes enter as E^T K E. Near the surface this couples nodes to some eighty others, mostly
by springs that are far weaker than the rest; these are omitted (`WEAK`). The third term of the
series is compensated near the surface by a correction of the springs by direction (`balanced`), so
that the inertia tensor of each body is that of its particles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from gf_usd.core.arrays import Floats, Ints
from gf_usd.physics.grid.embedding import kernel_supports
from gf_usd.physics.grid.reference.stencil import CHUNK, Stencil, bspline
from gf_usd.physics.grid.spectrum import ACCURACY, largest_eigenvalue
from gf_usd.physics.taichi_arrays import widened
from gf_usd.system.taichi_runtime import ensure_running

WEAK = 5e-3  # of sqrt(M_i M_j): weaker springs are omitted
SOLVED = 1e-13  # residual of M~ v, relative
MANY = 1000  # nodes above which a kernel saves more time than its loading takes
PASSES = 4  # Newton steps of `balanced`: each reduces the error a hundredfold
STIFFEST, SOFTEST = 2.0, 0.5  # bounds of the factor on a spring there
RIDGE = 1e-2  # regularization, for directions of few springs
PRODUCTS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
PAIRS = np.array([[a for a, _ in PRODUCTS], [b for _, b in PRODUCTS]])


@dataclass(frozen=True, kw_only=True)
class NodalMass:
    """M~ of the free nodes."""

    lumped: Floats  # (n,) [kg] M
    springs: sparse.csr_matrix  # (n, n) [kg] k_ij, symmetric, no diagonal
    ground: Floats  # (n,) [kg] sum_j K_ij: nonzero next to pins only
    axes: tuple[NodalMass, NodalMass, NodalMass] | None = None  # along each, where pins slide

    @cached_property
    def laplacian(self) -> sparse.csr_matrix:
        """K (n, n) [kg]."""
        diagonal = np.asarray(self.springs.sum(1)).ravel() + self.ground
        return sparse.csr_matrix(sparse.diags_array(diagonal) - self.springs)

    @property
    def is_lumped(self) -> bool:
        """Whether K = 0."""
        return not (self.springs.nnz or self.ground.any())

    @property
    def strengths(self) -> Floats:
        """(nnz, 3) [kg] of the springs along each axis, one row per entry of `springs`."""
        # Not `springs.nonzero()`, which omits stored zeros: springs along held axes only.
        row = np.repeat(np.arange(self.springs.shape[0]), np.diff(self.springs.indptr))
        column = self.springs.indices
        axes = self.axes or (self, self, self)
        return np.stack([np.asarray(one.springs[row, column]).ravel() for one in axes], 1)

    @property
    def grounds(self) -> Floats:
        """(n, 3) [kg] `ground` along each axis."""
        return np.stack([one.ground for one in self.axes or (self, self, self)], 1)

    def acceleration(self, f: Floats) -> Floats:
        """M~^-1 f of forces (n, ...) [N]; (n, 3) are vectors."""
        if self.axes and f.shape[1:] == (3,):
            return np.stack([one.acceleration(f[:, a]) for a, one in enumerate(self.axes)], 1)
        inverse = per_row(1.0 / self.lumped, f)
        a = inverse * f
        return a if self.is_lumped else a + inverse * (self.laplacian @ a)

    @cached_property
    def scaled(self) -> sparse.csr_matrix:
        """S = 1 + M^-1/2 K M^-1/2 (n, n), whose eigenvalues lie between 1 and `lightest`."""
        inverse = sparse.diags_array(1.0 / np.sqrt(self.lumped))
        one = sparse.eye_array(len(self.lumped))
        return sparse.csr_matrix(one + inverse @ self.laplacian @ inverse)

    def momentum(self, v: Floats) -> Floats:
        """p = M~ v = M^1/2 S^-1 M^1/2 v [kg m/s] of velocities (n, 3) [m/s], to rounding.

        By Chebyshev iteration, whose error decreases by (sqrt(k) - 1) / (sqrt(k) + 1) per step,
        with k the condition number of S, about 2 [Saad 2003, algorithm 12.1]. Unlike conjugate
        gradients it needs no inner products.
        """
        if self.axes:
            return np.stack([one.momentum(v[:, a]) for a, one in enumerate(self.axes)], 1)
        if self.is_lumped:
            return per_row(self.lumped, v) * v
        root, S = per_row(np.sqrt(self.lumped), v), self.scaled
        most = self.lightest * (1.0 + ACCURACY)
        middle, half = 0.5 * (most + 1.0), max(0.5 * (most - 1.0), np.finfo(float).eps)
        r = root * v
        least = (SOLVED**2) * squares(r)
        d = r / middle
        z, rho = d.copy(), half / middle
        fall = rho / (1.0 + np.sqrt(1.0 - rho * rho))
        steps = int(np.ceil(np.log(2.0 / SOLVED) / -np.log(fall)))
        last = np.inf
        while True:
            shrink, grow = np.empty(steps), np.empty(steps)
            for k in range(steps):
                after = 1.0 / (2.0 * middle / half - rho)
                shrink[k], grow[k] = after * rho, 2.0 * after / half
                rho = after
            r, d, z = _iterated(S, shrink, grow, r, d, z)
            left = squares(r - S @ d)
            # converged to rounding where the residual stagnates
            if (left <= least).all() or not left.sum() < last:
                return root * z
            last = left.sum()

    @cached_property
    def lightest(self) -> float:
        """Largest eigenvalue of M M~^-1: the largest ratio of lumped to actual mass of a motion."""
        if self.axes:
            return max(one.lightest for one in self.axes)
        if self.is_lumped:
            return 1.0
        start = np.random.default_rng(0).normal(size=len(self.lumped))
        inverse = 1.0 / self.lumped
        return 1.0 + largest_eigenvalue(lambda f: inverse * f, lambda a: self.laplacian @ a, start)


def _iterated(
    S: sparse.csr_matrix, shrink: Floats, grow: Floats, *fields: Floats
) -> tuple[Floats, ...]:
    """Residual r, direction d and solution z (n, ...) after steps of the Chebyshev iteration."""
    if len(fields[0]) >= MANY and kernel_supports(S, fields[0]):
        return _iterated_by_kernel(S, shrink, grow, fields)
    r, d, z = fields
    for a, b in zip(shrink, grow):
        r -= S @ d
        d *= a
        d += b * r
        z += d
    return r, d, z


def _iterated_by_kernel(
    S: sparse.csr_matrix, shrink: Floats, grow: Floats, fields: Sequence[Floats]
) -> tuple[Floats, ...]:
    """`_iterated` by a kernel, bit-identical, in a third of the time."""
    ensure_running()
    from gf_usd.physics.grid.row_kernels import LANES, iterate

    wide = [widened(a, LANES) for a in fields]
    iterate(S.indptr, S.indices, S.data, shrink, grow, *wide)
    return tuple(a[:, :3] for a in wide)


def squares(a: Floats) -> Floats:
    """Sum of a^2 over the rows of a (n, ...)."""
    return np.einsum("i...,i...->...", a, a)


def per_row(values: Floats, like: Floats) -> Floats:
    """Values (n,) as a column that broadcasts to a field (n, ...)."""
    return values.reshape(-1, *(1,) * (like.ndim - 1))


def lumped_mass(stencil: Stencil) -> NodalMass:
    """M alone, as in the paper (GaussianFlesh)."""
    n = stencil.free_count
    return NodalMass(lumped=stencil.mass, springs=sparse.csr_matrix((n, n)), ground=np.zeros(n))


def consistent_mass(stencil: Stencil, m: Floats) -> NodalMass:
    """M~ of a stencil with particles of masses m (N,) [kg], 0 for pinned ones."""
    if stencil.factors is not None:
        return _of_axes(stencil, m)
    K = reduced(stencil, _without_regions(stencil, cell_springs(stencil, m)))
    exact = split(K, stencil.mass, 0.0)
    sparse_mass = split(K, stencil.mass, WEAK)
    out = balanced(stencil, sparse_mass, m)
    # E^T K E is positive semi-definite, but possibly not without the weak springs of either sign.
    return out if positive(out) else exact


def _without_regions(stencil: Stencil, springs: Floats) -> Floats:
    """Springs (cells, 54), set to 0 at nodes of rigid regions, where mass is lumped."""
    if stencil.region is None:
        return springs
    low, high = links()
    own = stencil.region[stencil.cell_nodes] >= 0
    return np.where(own[:, low] | own[:, high], 0.0, springs)


def _of_axes(stencil: Stencil, m: Floats) -> NodalMass:
    """M~ with springs per axis, for sliding pins; `springs` are those of the free axes."""
    x, y, z = (consistent_mass(stencil.along(axis), m) for axis in range(3))
    free = consistent_mass(stencil.across, m)
    union = sum((abs(one.springs) for one in (x, y, z)), abs(free.springs))
    row, column = union.nonzero()
    k = np.asarray(free.springs[row, column]).ravel()
    springs = sparse.csr_matrix((k, (row, column)), shape=union.shape)
    springs.sort_indices()
    return NodalMass(lumped=free.lumped, springs=springs, ground=free.ground, axes=(x, y, z))


def links() -> tuple[Ints, Ints]:
    """The pairs of nodes (54,) joined by the edges of a cell: two on each of nine lines
    per axis.
    """
    node = np.arange(27).reshape(3, 3, 3)
    low = [node.take([0, 1], axis).ravel() for axis in range(3)]
    high = [node.take([1, 2], axis).ravel() for axis in range(3)]
    return np.concatenate(low), np.concatenate(high)


def cell_springs(stencil: Stencil, m: Floats) -> Floats:
    """k [kg] of the edges of each cell (cells, 54), in the order of `links`."""
    start = stencil.cell_start
    cells = len(start) - 1
    out = np.empty((cells, 54))
    first = 0
    while first < cells:
        behind = int(np.searchsorted(start, start[first] + CHUNK, side="right")) - 1
        behind = min(max(behind, first + 1), cells)
        some = slice(start[first], start[behind])
        out[first:behind] = np.add.reduceat(
            particle_springs(stencil.fx[some], m[stencil.order[some]]),
            start[first:behind] - start[first],
        )
        first = behind
    return out


def particle_springs(fx: Floats, m: Floats) -> Floats:
    """k [kg] of the 54 edges from particles (n,) at fx (n, 3) in their cells."""
    w = bspline(fx)[0]  # (n, node, axis)
    flux = np.stack([w[:, 0] * fx, w[:, 2] * (2.0 - fx)], 1)  # (n, edge, axis)
    x, y, z = np.moveaxis(w, 2, 0)
    fx0, fy0, fz0 = np.moveaxis(flux, 2, 0)
    n = len(m)
    return m[:, None] * np.concatenate(
        [
            (a[:, :, None, None] * b[:, None, :, None] * c[:, None, None, :]).reshape(n, 18)
            for a, b, c in ((fx0, y, z), (x, fy0, z), (x, y, fz0))
        ],
        1,
    )


def reduced(stencil: Stencil, springs: Floats) -> sparse.csr_matrix:
    """E^T K E (free, free) [kg] of springs (cells, 54)."""
    low, high = links()
    i, j = stencil.cell_nodes[:, low].ravel(), stencil.cell_nodes[:, high].ravel()
    count, k = stencil.node_count, springs.ravel()
    adjacency = sparse.csr_matrix((k, (i, j)), shape=(count, count))
    adjacency = adjacency + adjacency.T
    K = sparse.diags_array(np.asarray(adjacency.sum(1)).ravel()) - adjacency
    E = sparse.vstack([sparse.identity(stencil.free_count), stencil.follow], format="csr")
    K = E.T @ K @ E
    return sparse.csr_matrix(0.5 * (K + K.T))


def split(K: sparse.csr_matrix, lumped: Floats, weak: float) -> NodalMass:
    """K without the springs below weak sqrt(M_i M_j); K 1 is unchanged."""
    ground = np.asarray(K.sum(1)).ravel()
    ground[np.abs(ground) < 1e-9 * lumped] = 0.0
    all_of = K.tocoo()
    i, j, k = all_of.row, all_of.col, np.negative(all_of.data)
    keep = (i != j) & (np.abs(k) > weak * np.sqrt(lumped[i] * lumped[j]))
    springs = sparse.csr_matrix((k[keep], (i[keep], j[keep])), shape=K.shape)
    springs.sort_indices()
    return NodalMass(lumped=lumped, springs=springs, ground=ground)


def balanced(stencil: Stencil, mass: NodalMass, m: Floats) -> NodalMass:
    """Springs k (1 + n . C n) with n their direction and a symmetric C (3, 3) per body, to match
    inertia.

    sum_i X_i (x) (M~ X)_i = sum_p m_p X_p (x) X_p is solved by Newton's method for the six entries
    of C; the left side decreases by z . K z with z = M^-1 M~ X. A pinned body is unchanged.
    """
    node_body = stencil.node_body[: stencil.free_count]
    i = np.repeat(np.arange(stencil.free_count), np.diff(mass.springs.indptr))
    j, k = mass.springs.indices, mass.springs.data
    cell_body = stencil.node_body[stencil.cell_nodes[:, 0]]
    body = np.repeat(cell_body, np.diff(stencil.cell_start))
    held = np.unique(stencil.node_body[stencil.held.pin >= 0])
    bodies = np.setdiff1d(np.unique(node_body), held)
    mp = m[stencil.order]
    # fx is relative to the base node; cell corners are half a cell from nodes.
    Xp = particle_places(stencil)
    X = stencil.free_X.copy()
    target = np.zeros((len(bodies), 6))
    for b, number in enumerate(bodies):
        mine, nodes = body == number, node_body == number
        center = (mp[mine, None] * Xp[mine]).sum(0) / mp[mine].sum()
        X[nodes] -= center
        target[b] = products(mp[mine], Xp[mine] - center, Xp[mine] - center)
    way = X[j] - X[i]
    n = way / np.maximum(np.linalg.norm(way, axis=1), 1e-300)[:, None]
    shape = np.where(PAIRS[0] == PAIRS[1], 1.0, 2.0) * n[:, PAIRS[0]] * n[:, PAIRS[1]]
    C = np.zeros((len(bodies), 6))
    spring_body = node_body[i]
    for _ in range(PASSES):
        now = scaled_springs(mass, k, shape, spring_body, bodies, C)
        p = now.momentum(X)
        z = p / mass.lumped[:, None]
        dz = z[j] - z[i]
        for b, number in enumerate(bodies):
            nodes, mine = node_body == number, spring_body == number
            over = products(np.ones(int(nodes.sum())), X[nodes], p[nodes]) - target[b]
            # each spring is stored twice
            T = (
                0.5
                * (dz[mine][:, PAIRS[0]] * dz[mine][:, PAIRS[1]]).T
                @ (shape[mine] * k[mine, None])
            )
            ridge = RIDGE * max(np.trace(T[:3, :3]) / 3.0, 1e-300)
            C[b] = np.linalg.solve(T.T @ T + ridge**2 * np.eye(6), T.T @ (over + T @ C[b]))
    return scaled_springs(mass, k, shape, spring_body, bodies, C)


def products(m: Floats, a: Floats, b: Floats) -> Floats:
    """Symmetric part of sum m a (x) b, its six entries in the order of PRODUCTS."""
    S = np.stack([(m * a[:, r] * b[:, c] + m * a[:, c] * b[:, r]).sum() for r, c in PRODUCTS])
    return 0.5 * S


def scaled_springs(
    mass: NodalMass, k: Floats, shape: Floats, spring_body: Ints, bodies: Ints, C: Floats
) -> NodalMass:
    """`mass` with its springs multiplied by 1 + n . C n, within bounds."""
    factor = np.ones(len(k))
    for b, number in enumerate(bodies):
        mine = spring_body == number
        factor[mine] = np.clip(1.0 + shape[mine] @ C[b], SOFTEST, STIFFEST)
    springs = mass.springs.copy()
    springs.data = k * factor
    return NodalMass(lumped=mass.lumped, springs=springs, ground=mass.ground)


def particle_places(stencil: Stencil) -> Floats:
    """(N, 3) [m] positions of the particles, in the order of the stencil."""
    base = stencil.node_ijk[stencil.cell_nodes[:, 0]]
    shift = stencil.shift[stencil.node_body[stencil.cell_nodes[:, 0]]]
    cell = np.repeat(np.arange(len(base)), np.diff(stencil.cell_start))
    return stencil.origin + stencil.h * (base[cell] + stencil.fx) - shift[cell]


def positive(mass: NodalMass) -> bool:
    """Whether M~ is positive definite with a margin: 1 + K / M >= 1/2."""
    inverse = 1.0 / mass.lumped
    most = mass.lightest
    # The largest eigenvalue of most - K / M gives the smallest of K / M.
    shift = most * mass.lumped
    start = np.random.default_rng(1).normal(size=len(inverse))
    value = largest_eigenvalue(
        lambda f: inverse * f, lambda a: shift * a - mass.laplacian @ a, start
    )
    return most - value > -0.5
