"""A finite element reference for the case `membrane` of `gf-usd verify`, independent of the solver.

    python tools/membrane_reference.py [--current] [N ...]

Cook's membrane in plane strain, of von Mises metal with logarithmic strain and saturating hardening
(the numbers are in `verify/cases/plastic/membrane.py`): quadratic quadrilaterals of eight nodes
with four Gauss points, which do not lock, N along each side; the load in 40 equal steps, each in
equilibrium by Newton's iteration. Prints the displacement of the upper right corner to the left and
up. With --current the traction acts on the current length of the right edge, not on its initial
length.
"""

from __future__ import annotations

import argparse

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

E, NU = 206.9, 0.29  # [GPa]; lengths in mm, forces in kN
MU, BULK = E / (2.0 * (1.0 + NU)), E / (3.0 * (1.0 - 2.0 * NU))
YIELD, SATURATED, RATE, LINEAR = 0.45, 0.715, 16.93, 0.12924
TRACTION, STEPS = 0.3125, 40
PROBE = 1e-7  # of F, for the tangent
CORNERS = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float)
MIDDLES = np.array([[0, -1], [1, 0], [0, 1], [-1, 0]], float)
GAUSS = CORNERS / np.sqrt(3.0)
ALONG = np.sqrt(0.6) * np.array([-1.0, 0.0, 1.0]), np.array([5.0, 8.0, 5.0]) / 9.0


def shapes(at: np.ndarray) -> np.ndarray:
    """N (8,) of the serendipity element at (xi, eta)."""
    c = CORNERS * at
    corner = 0.25 * (1.0 + c[:, 0]) * (1.0 + c[:, 1]) * (c[:, 0] + c[:, 1] - 1.0)
    m = MIDDLES * at
    flat = MIDDLES[:, 0] == 0.0
    middle = np.where(
        flat,
        0.5 * (1.0 - at[0] ** 2) * (1.0 + m[:, 1]),
        0.5 * (1.0 + m[:, 0]) * (1.0 - at[1] ** 2),
    )
    return np.concatenate([corner, middle])


def slopes(at: np.ndarray) -> np.ndarray:
    """dN/d(xi, eta) (8, 2), exact: N is quadratic along each axis."""
    steps = np.eye(2)
    return np.stack([0.5 * (shapes(at + s) - shapes(at - s)) for s in steps], 1)


def mesh(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes X (m, 2) [mm] and elements (n n, 8)."""
    number: dict[tuple[int, int], int] = {}
    elements = []
    for i, j in np.ndindex(n, n):
        places = np.array([2 * i + 1, 2 * j + 1]) + np.concatenate([CORNERS, MIDDLES])
        elements.append([number.setdefault((int(a), int(b)), len(number)) for a, b in places])
    s, t = (np.array(list(number)) / (2.0 * n)).T
    low, high = 44.0 * s, 44.0 + 16.0 * s
    return np.stack([48.0 * s, low + (high - low) * t], 1), np.array(elements)


def respond(
    F2: np.ndarray, Cp: np.ndarray, a: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """P (m, 2, 2) [GPa], C_p^-1 (m, 3, 3) and plastic strain (m,) after a step to F2 (m, 2, 2)."""
    F = np.tile(np.eye(3), (len(F2), 1, 1))
    F[:, :2, :2] = F2
    values, axes = np.linalg.eigh(F @ Cp @ F.swapaxes(1, 2))
    e = 0.5 * np.log(values)
    mean = e.mean(1, keepdims=True)
    d = e - mean
    size = np.linalg.norm(d, axis=1)
    trial = np.sqrt(6.0) * MU * size
    g = np.zeros(len(F))
    for _ in range(20):
        grown = np.exp(-RATE * (a + g))
        bears = YIELD + LINEAR * (a + g) + (SATURATED - YIELD) * (1.0 - grown)
        rise = LINEAR + (SATURATED - YIELD) * RATE * grown
        g = np.where(trial > YIELD, g + (trial - 3.0 * MU * g - bears) / (3.0 * MU + rise), 0.0)
        g = np.maximum(g, 0.0)
    d = d * (1.0 - np.sqrt(1.5) * g / np.maximum(size, 1e-30))[:, None]
    tau = 2.0 * MU * d + 3.0 * BULK * mean
    inverse = np.linalg.inv(F)
    P = np.einsum("mik,mk,mjk->mij", axes, tau, axes) @ inverse.swapaxes(1, 2)
    be = np.einsum("mik,mk,mjk->mij", axes, np.exp(2.0 * (d + mean)), axes)
    return P[:, :2, :2], inverse @ be @ inverse.swapaxes(1, 2), a + g


def traction(x: np.ndarray, edge: np.ndarray) -> np.ndarray:
    """Load (2 m,) [kN / mm] on elements (n, 8) whose right sides form the edge, nodes x (m, 2)."""
    load = np.zeros(2 * len(x))
    for element in edge:
        for eta, w in zip(*ALONG):
            at = np.array([1.0, eta])
            length = np.linalg.norm(slopes(at)[:, 1] @ x[element])
            load[2 * element + 1] += shapes(at) * w * TRACTION * length
    return load


def corner(n: int, current: bool = False) -> tuple[float, float]:
    """[mm] that the corner moves right and up; current : by the traction on the current edge."""
    X, elements = mesh(n)
    G, weight = [], []
    for at in GAUSS:
        D = slopes(at)
        jacobian = np.einsum("eai,aj->eij", X[elements], D)
        G.append(np.einsum("aj,eji->eai", D, np.linalg.inv(jacobian)))
        weight.append(np.linalg.det(jacobian))
    G, weight = np.concatenate(G), np.concatenate(weight)
    nodes = np.tile(elements, (len(GAUSS), 1))
    dofs = (2 * nodes[:, :, None] + np.arange(2)).reshape(len(nodes), 16)
    edge = elements[X[elements[:, 1], 0] > 48.0 - 1e-9]
    load = traction(X, edge)
    free = np.repeat(X[:, 0] > 1e-9, 2)
    u = np.zeros(2 * len(X))
    Cp, a = np.tile(np.eye(3), (len(G), 1, 1)), np.zeros(len(G))
    rows, columns = np.repeat(dofs, 16, 1).ravel(), np.tile(dofs, (1, 16)).ravel()
    for step in range(1, STEPS + 1):
        for _ in range(60):
            load = traction(X + u.reshape(-1, 2), edge) if current else load
            F = np.eye(2) + np.einsum("mai,maj->mij", u.reshape(-1, 2)[nodes], G)
            P, grown, strain = respond(F, Cp, a)
            inner = np.einsum("m,mij,maj->mai", weight, P, G).reshape(len(G), 16)
            off = load * step / STEPS - np.bincount(dofs.ravel(), inner.ravel(), len(u))
            if np.abs(off[free]).max() < 1e-9 * np.abs(load).max():
                break
            tangent = np.zeros((len(G), 16, 16))
            for k, m in np.ndindex(2, 2):
                shift = np.zeros((2, 2))
                shift[k, m] = PROBE
                slope = respond(F + shift, Cp, a)[0] - respond(F - shift, Cp, a)[0]
                left = np.einsum("m,mij,maj->mai", weight, slope / (2.0 * PROBE), G)
                column = np.zeros((len(G), 8, 2))
                column[:, :, k] = G[:, :, m]
                tangent += left.reshape(-1, 16, 1) * column.reshape(-1, 1, 16)
            K = sparse.csr_matrix((tangent.ravel(), (rows, columns)), shape=(len(u), len(u)))
            u[free] += spsolve(K[free][:, free].tocsc(), off[free])
        else:
            raise SystemExit(f"no balance in step {step}")
        Cp, a = grown, strain
    right, up = u.reshape(-1, 2)[(X == [48.0, 60.0]).all(1)][0]
    return float(right), float(up)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("counts", type=int, nargs="*", default=[8, 16, 32], metavar="N")
    parser.add_argument(
        "--current", action="store_true", help="the traction acts on the edge as long as it becomes"
    )
    args = parser.parse_args()
    for count in args.counts:
        right, up = corner(count, args.current)
        print(f"{count} along a side: {-right:.4f} mm left, {up:.4f} mm up", flush=True)
