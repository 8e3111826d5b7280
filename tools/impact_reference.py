"""A finite element reference for the case `rim` of `gf-usd verify`, independent of the solver.

    python tools/impact_reference.py [--held] [N ...]

Taylor's bar on a rigid floor without friction, from which it may separate (the numbers are in
`verify/cases/plastic/taylor.py`), with axial symmetry: bilinear quadrilaterals with four Gauss
points and one pressure each (Simo, Taylor and Pister 1985), which do not lock, N along the radius;
von Mises flow with logarithmic strain; lumped mass, explicit steps.  A node on the floor may leave
it but not enter it.  Prints radius of the foot, length and height of the rim at four times, the
last two also per node of the foot.  `--held` keeps the foot on the floor, which is the set-up of
the published figures, 7.2259 and 21.42 mm.
"""

from __future__ import annotations

import argparse

import numpy as np

RADIUS, LENGTH, SPEED, DENSITY = 3.2, 32.4, 227.0, 8930e-6  # [mm], [mm/ms], [g/mm^3]: MPa, ms
E, NU, YIELD, HARDENING = 117e3, 0.35, 400.0, 100.0  # [MPa]
MU, BULK = E / (2.0 * (1.0 + NU)), E / (3.0 * (1.0 - 2.0 * NU))
WAVE = np.sqrt((BULK + 4.0 / 3.0 * MU) / DENSITY)
TIMES = 0.02, 0.04, 0.06, 0.08  # [ms]
STRETCH = 3.0  # how much longer the elements at the top are than those at the foot
SAFETY = 0.5
CORNERS = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float)
EVERY = 10  # steps between evaluations of the stable step


def mesh(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes (r, z) (m, 2) [mm] and elements (k, 4)."""
    rows = round(LENGTH / RADIUS * n / (0.5 * (1.0 + STRETCH)))
    s = np.linspace(0.0, 1.0, rows + 1)
    z = LENGTH * (s + 0.5 * (STRETCH - 1.0) * s * s) / (0.5 * (STRETCH + 1.0))
    X = np.stack(np.meshgrid(np.linspace(0.0, RADIUS, n + 1), z), -1).reshape(-1, 2)
    j, i = np.divmod(np.arange(n * rows), n)
    first = j * (n + 1) + i
    return X, np.stack([first, first + 1, first + n + 2, first + n + 1], 1)


class Bar:
    """State of the bar; arrays of Gauss points are (4, k), of elements (k,)."""

    def __init__(self, n: int, held: bool) -> None:
        self.n, self.held = n, held
        self.X, self.elements = mesh(n)
        x = self.X[self.elements]  # (k, 4, 2)
        self.N, self.G, self.V, self.R = [], [], [], []
        for at in CORNERS / np.sqrt(3.0):
            N = 0.25 * np.prod(1.0 + CORNERS * at, axis=1)
            D = 0.25 * CORNERS * (1.0 + CORNERS * at)[:, ::-1]
            jacobian = np.einsum("kai,aj->kij", x, D)
            self.N.append(N)
            self.G.append(np.einsum("aj,kji->aik", D, np.linalg.inv(jacobian)))
            self.R.append(x[:, :, 0] @ N)
            self.V.append(2.0 * np.pi * self.R[-1] * np.linalg.det(jacobian))
        self.N, self.G = np.array(self.N), np.array(self.G)  # (4, 4), (4, 4, 2, k)
        self.R, self.V = np.array(self.R), np.array(self.V)
        share = DENSITY * np.einsum("ga,gk->ka", self.N, self.V)
        self.m = np.bincount(self.elements.ravel(), share.ravel(), len(self.X))
        self.x, self.v = self.X.copy(), np.tile([0.0, -SPEED], (len(self.X), 1))
        shape = self.V.shape
        self.Cp = np.array([np.ones(shape), np.zeros(shape), np.ones(shape), np.ones(shape)])
        self.a = np.zeros(shape)  # rr, rz, zz, and around, of C_p^-1; equivalent plastic strain
        self.lost = 0.0  # by flow
        self.axis = self.X[:, 0] == 0.0
        self.outside = (self.X[:, 1] == 0.0) | (self.X[:, 0] == RADIUS)
        self.bottom = self.X[:, 1] == 0.0

    def strain(self) -> tuple[np.ndarray, np.ndarray]:
        """F in the plane (2, 2, 4, k) and around (4, k)."""
        at = self.x[self.elements]
        F = np.einsum("kai,gajk->ijgk", at, self.G, optimize=True)
        return F, np.einsum("ka,ga->gk", at[:, :, 0], self.N) / self.R

    def force(self) -> np.ndarray:
        """Of the stress on nodes (m, 2) [N]; flow continues."""
        F, around = self.strain()
        (A, B), (C, D) = F
        det = A * D - B * C
        J = det * around
        rr, rz, zz, tt = self.Cp
        # b_e = F C_p^-1 F^T and its axes in the plane
        b11 = A * A * rr + 2.0 * A * B * rz + B * B * zz
        b12 = A * C * rr + (A * D + B * C) * rz + B * D * zz
        b22 = C * C * rr + 2.0 * C * D * rz + D * D * zz
        half, mean = 0.5 * (b11 - b22), 0.5 * (b11 + b22)
        r = np.hypot(half, b12)
        large = mean + r
        small = (b11 * b22 - b12 * b12) / large
        c2, s2 = half / np.maximum(r, 1e-30), b12 / np.maximum(r, 1e-30)
        e = 0.5 * np.log(np.stack([large, small, around * around * tt]))
        d = e - e.mean(0)
        size = np.sqrt(np.einsum("igk,igk->gk", d, d))
        trial = np.sqrt(6.0) * MU * size
        bears = YIELD + HARDENING * self.a
        g = np.maximum(trial - bears, 0.0) / (3.0 * MU + HARDENING)
        self.lost += float((self.V * (trial - 3.0 * MU * g) * g).sum())
        d *= 1.0 - np.sqrt(1.5) * g / np.maximum(size, 1e-30)
        self.a += g
        # C_p^-1 = F^-1 b_e F^-T, of what is left
        l1, l2, l3 = np.exp(2.0 * (d + e.mean(0)))
        mean, half = 0.5 * (l1 + l2), 0.5 * (l1 - l2)
        b11, b22, b12 = mean + half * c2, mean - half * c2, half * s2
        rr = (D * D * b11 - 2.0 * B * D * b12 + B * B * b22) / det**2
        zz = (C * C * b11 - 2.0 * A * C * b12 + A * A * b22) / det**2
        rz = (-C * D * b11 + (A * D + B * C) * b12 - A * B * b22) / det**2
        self.Cp = np.array([rr, rz, zz, l3 / around**2])
        # One pressure an element: K ln(J) / J of the mean J, on J
        Jbar = (self.V * J).sum(0) / self.V.sum(0)
        p = BULK * np.log(Jbar) / Jbar * J
        mean, half = MU * (d[0] + d[1]), MU * (d[0] - d[1])
        t11, t22, t12 = mean + half * c2 + p, mean - half * c2 + p, half * s2
        w = self.V / det  # P = tau F^-T
        P = w * np.array([
            [t11 * D - t12 * B, t12 * A - t11 * C], [t12 * D - t22 * B, t22 * A - t12 * C]
        ])  # fmt: skip
        f = np.einsum("ijgk,gajk->ika", P, self.G, optimize=True)
        hoop = self.V * (2.0 * MU * d[2] + p) / around / self.R
        f[0] += np.einsum("gk,ga->ka", hoop, self.N)
        nodes = self.elements.ravel()
        return -np.stack([np.bincount(nodes, part.ravel(), len(self.X)) for part in f], 1)

    def stable(self) -> float:
        """[ms] the step: the least height of the elements, over the speed of waves."""
        at = self.x[self.elements]
        sides = np.roll(at, -1, axis=1) - at
        longest = np.sqrt((sides**2).sum(2)).max(1)
        one, other = at[:, 2] - at[:, 0], at[:, 3] - at[:, 1]
        area = 0.5 * np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0])
        return float(SAFETY * (area / longest).min() / WAVE)

    def step(self, dt: float) -> None:
        """Velocities and then places; the floor takes what would enter it to its surface."""
        self.v += dt * self.force() / self.m[:, None]
        self.v[self.axis, 0] = 0.0
        z, v = self.x[:, 1], self.v[:, 1]
        if self.held:
            v[self.bottom] = 0.0
        enters = self.outside & (z + dt * v < 0.0)
        v[enters] = -z[enters] / dt
        self.x += dt * self.v

    def energy(self) -> float:
        """[mJ] of motion and dissipated by flow."""
        return float(0.5 * self.m @ (self.v**2).sum(1)) + self.lost


def impact(n: int, held: bool) -> None:
    bar = Bar(n, held)
    start, t, steps = bar.energy(), 0.0, 0
    for end in TIMES:
        while t < end - 1e-12:
            if steps % EVERY == 0:
                dt = bar.stable()
            bar.step(min(dt, end - t))
            t, steps = t + min(dt, end - t), steps + 1
        corner, top = bar.x[n], bar.x[-n - 1]
        print(
            f"{n} along the radius, {1e3 * end:.0f} us: radius {corner[0]:.4f} length"
            f" {top[1] - bar.x[0, 1]:.4f} rim {corner[1]:.4f} widest {bar.x[:, 0].max():.4f} mm;"
            f" energy {bar.energy() / start:.4f}, {steps} steps", flush=True,
        )  # fmt: skip
    foot = bar.x[: n + 1]
    print("foot r:", *(f"{r:.3f}" for r in foot[:, 0]))
    print("foot z:", *(f"{z:.4f}" for z in foot[:, 1]), flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("counts", type=int, nargs="*", default=[6, 8, 12])
    parser.add_argument("--held", action="store_true", help="the foot stays on the floor")
    args = parser.parse_args()
    for count in args.counts:
        impact(count, args.held)
