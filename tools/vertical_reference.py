"""A finite element reference for the case `vertical` of `gf-usd verify`, independent of the solver.

    python tools/vertical_reference.py [N ...]

A cube of 1 m, P = mu (F - F^-T) + lam ln J F^-T, E = 1e6 Pa, nu = 0.3, rho = 1050 kg/m^3, its top
face held vertically only, under 1000 m/s^2 from rest: trilinear hexahedra, N along the edge, eight
Gauss points each, lumped mass, central differences in time, a quarter of the cube by symmetry.
Prints the largest displacement of the bottom corner, and its time.
"""

from __future__ import annotations

import argparse

import numpy as np

E, NU, DENSITY, GRAVITY = 1e6, 0.3, 1050.0, 1000.0
MU, LAM = E / (2.0 * (1.0 + NU)), E * NU / ((1.0 + NU) * (1.0 - 2.0 * NU))
END = 0.1  # [s]
COURANT = 0.25  # of h / c: the stretched block is stiffer across than at rest
GAUSS = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3.0)
CORNERS = np.array(list(np.ndindex(2, 2, 2)))


def gradients(h: float) -> list[np.ndarray]:
    """dN/dX (8, 3) [1/m] of a hexahedron of edge h at its eight Gauss points."""
    out = []
    for point in np.ndindex(2, 2, 2):
        x = GAUSS[list(point)]
        N = np.where(CORNERS, x, 1.0 - x)
        D = np.where(CORNERS, 1.0, -1.0)
        others = np.stack([N[:, 1] * N[:, 2], N[:, 0] * N[:, 2], N[:, 0] * N[:, 1]], 1)
        out.append(D * others / h)
    return out


def stress(F: np.ndarray) -> np.ndarray:
    """P (e, 3, 3) [Pa]."""
    inverse = np.linalg.inv(F).swapaxes(1, 2)
    return MU * (F - inverse) + LAM * np.log(np.linalg.det(F))[:, None, None] * inverse


def fall(n: int) -> tuple[float, float]:
    """Time [s] and displacement [m] of the bottom corner at the lowest; n even."""
    h = 1.0 / n
    counts = (n // 2, n, n // 2)
    node = np.arange(np.prod(np.add(counts, 1))).reshape(np.add(counts, 1))
    X = np.argwhere(node >= 0) * h - [0.0, 1.0, 0.0]
    cell = np.argwhere(np.ones(counts))
    elements = np.stack([node[tuple((cell + corner).T)] for corner in CORNERS], 1)
    mass = np.bincount(elements.ravel(), minlength=len(X)) * DENSITY * h**3 / 8.0
    held = np.stack([X[:, 0] < 1e-9, X[:, 1] > -1e-9, X[:, 2] < 1e-9], 1)
    shapes = gradients(h)
    steps = int(np.ceil(END / (COURANT * h / np.sqrt((LAM + 2.0 * MU) / DENSITY))))
    dt = END / steps
    u, v = np.zeros_like(X), np.zeros_like(X)
    corner = node[-1, 0, -1]
    lowest = (0.0, 0.0)
    for step in range(steps):
        local = u[elements]
        force = np.zeros_like(local)
        for G in shapes:
            F = np.eye(3) + np.einsum("eai,aj->eij", local, G)
            force -= h**3 / 8.0 * np.einsum("eij,aj->eai", stress(F), G)
        a = np.zeros_like(X)
        for axis in range(3):
            total = np.bincount(elements.ravel(), force[..., axis].ravel(), len(X))
            a[:, axis] = total / mass
        a[:, 1] -= GRAVITY
        a[held] = 0.0
        v += (0.5 if step == 0 else 1.0) * dt * a
        u += dt * v
        lowest = min(lowest, ((step + 1) * dt, float(u[corner, 1])), key=lambda point: point[1])
    return lowest


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("counts", type=int, nargs="*", default=[8, 16, 24], metavar="N")
    for count in parser.parse_args().counts:
        at, tip = fall(count)
        print(f"{count} along the edge: {tip:.4f} m at {at:.4f} s", flush=True)
