"""Rigid regions of a body: six unknowns each in place of those of their nodes.

A node belongs to a region if the region's particles contribute enough of its mass. Its motion is

    x_l = x_c + Q rho_l,    v_l = V + omega x (x_l - x_c)

with x_c the center of mass, Q the rotation from the principal axes and rho_l the position along
these. Mass and inertia are those of the nodes, less the springs between them (`grid.mass`),

    M = sum_l m_l        J = sum_l m_l (X_l - X_c) (x) (X_l - X_c) - sum k_lk (X_l - X_k) (x) (..)

which for an isolated region equal the sums over its particles. Springs between a region and free
nodes are omitted: the mass there is lumped, and momentum is conserved. Nodal forces sum to a force
and a moment, dV/dt = F / M + g, dL/dt = T. The free rotation is integrated by successive rotations
about the principal axes (Dullweber, Leimkuhler and McLachlan 1997), which conserve L exactly and
are of second order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.errors import InputError
from gf_usd.core.stage import Pin
from gf_usd.physics.grid.mass import cell_springs, links
from gf_usd.physics.grid.reference.stencil import Stencil

THIN = 1e-3  # of m h^2: least moment of inertia of a region
# Layout of a region: displacement of the center, rotation (w, x, y, z) from the principal axes,
# velocity, angular momentum, mass, principal moments; then the layout of each of its nodes.
ROW, NODE = 17, 6
D, Q, V, L, M, J = 0, 3, 7, 10, 13, 14
RHO, ARM = 0, 3  # position along the principal axes; X_l - X_c


@dataclass(frozen=True, kw_only=True)
class RigidRegions:
    """The rigid regions of a body."""

    names: tuple[str, ...]
    nodes: tuple[Ints, ...]  # dependent nodes of each region, counted from the first dependent node
    mass: Floats  # (R,) [kg]
    center: Floats  # (R, 3) [m] at rest
    axes: Floats  # (R, 3, 3) principal axes, in columns
    moments: Floats  # (R, 3) [kg m^2]
    arms: tuple[Floats, ...]  # (k, 3) [m] X_l - X_c of the nodes of each region

    @property
    def count(self) -> int:
        """R, the number of regions."""
        return len(self.names)

    def arrays(self, velocity: Floats) -> dict[str, Floats]:
        """The arrays of the kernels; velocity : (dependent, 3) [m/s] at the start."""
        from scipy.spatial.transform import Rotation

        rows, nodes = np.zeros((self.count, ROW)), []
        for k, (of, arms) in enumerate(zip(self.nodes, self.arms)):
            rows[k, Q:V] = Rotation.from_matrix(self.axes[k]).as_quat()[[3, 0, 1, 2]]
            v = velocity[of]
            rows[k, V:L] = v.mean(0)
            # least squares rigid motion of the nodes, whose mean need not be the center
            away = arms - arms.mean(0)
            second = away.T @ away
            inertia = np.trace(second) * np.eye(3) - second
            moment = np.cross(away, v - rows[k, V:L]).sum(0)
            omega = np.linalg.solve(inertia, moment)
            rows[k, V:L] -= np.cross(omega, arms.mean(0))
            rows[k, L:M] = self.axes[k] @ (self.moments[k] * (self.axes[k].T @ omega))
            rows[k, M], rows[k, J:ROW] = self.mass[k], self.moments[k]
            nodes.append(np.hstack([arms @ self.axes[k], arms]))
        first = np.cumsum([0, *map(len, self.nodes)])
        return {
            "rigid": np.concatenate([rows.ravel(), np.concatenate(nodes).ravel()]),
            "rigid_nodes": np.concatenate([first, *self.nodes]),
        }

    def spread(self, motion: Floats, dependent: int) -> Floats:
        """c (dependent, 3) for small motions (2 R, 3): V and omega of each region."""
        out = np.zeros((dependent, 3))
        for k, (of, arms) in enumerate(zip(self.nodes, self.arms)):
            out[of] = motion[2 * k] + np.cross(motion[2 * k + 1], arms)
        return out

    def gathered(self, f: Floats) -> Floats:
        """F and T (2 R, 3) of forces (dependent, 3): the transpose of `spread`."""
        return np.concatenate(
            [
                np.stack([f[of].sum(0), np.cross(arms, f[of]).sum(0)])
                for of, arms in zip(self.nodes, self.arms)
            ]
        )

    def accelerated(self, F: Floats) -> Floats:
        """F / M and J^-1 T (2 R, 3) at rest."""
        out = np.empty_like(F)
        for k in range(self.count):
            out[2 * k] = F[2 * k] / self.mass[k]
            out[2 * k + 1] = self.axes[k] @ ((self.axes[k].T @ F[2 * k + 1]) / self.moments[k])
        return out


@dataclass(frozen=True, kw_only=True)
class RigidMotion:
    """Position and motion of the regions, from the kernels' values."""

    x: Floats  # (R, 3) [m] centers, without the offset
    v: Floats  # (R, 3) [m/s]
    turn: Floats  # (R, 3, 3) rotation from the principal axes
    spin: Floats  # (R, 3) [kg m^2/s] angular momentum about the center
    omega: Floats  # (R, 3) [1/s]

    @classmethod
    def of(cls, regions: RigidRegions, numbers: Floats) -> RigidMotion:
        """From the array `rigid`."""
        from scipy.spatial.transform import Rotation

        rows = numbers[: ROW * regions.count].astype(float).reshape(-1, ROW)
        turn = Rotation.from_quat(rows[:, [Q + 1, Q + 2, Q + 3, Q]]).as_matrix()
        spin = rows[:, L:M]
        local = np.einsum("kba,kb->ka", turn, spin) / regions.moments
        return cls(
            x=regions.center + rows[:, D:Q], v=rows[:, V:L], turn=turn, spin=spin,
            omega=np.einsum("kab,kb->ka", turn, local),
        )  # fmt: skip

    def constants(self, regions: RigidRegions, into: Floats, rate: Floats) -> None:
        """Write c [m] and its rate [m/s] of the regions' nodes to arrays (dependent, 3)."""
        for k, (of, arms) in enumerate(zip(regions.nodes, regions.arms)):
            arm = arms @ regions.axes[k] @ self.turn[k].T
            into[of] = (self.x[k] - regions.center[k]) + (arm - arms)
            rate[of] = self.v[k] + np.cross(self.omega[k], arm)

    def kinetic(self, regions: RigidRegions) -> float:
        """[J] M V^2 / 2 + omega . L / 2."""
        straight = regions.mass @ (self.v**2).sum(1)
        return float(0.5 * (straight + (self.omega * self.spin).sum()))


def rigid_regions(stencil: Stencil, m: Floats, pins: Sequence[Pin]) -> RigidRegions | None:
    """The rigid regions of a stencil; None without any.

    m : (N,) [kg] of the particles; pins : all of them, as indexed by `stencil.region`.

    Raises InputError for a region that contains no particles, or has too small a moment of inertia.
    """
    if stencil.region is None:
        return None
    numbers = [k for k, pin in enumerate(pins) if pin.rigid]
    springs = cell_springs(stencil, m)
    low, high = links()
    i, j = stencil.cell_nodes[:, low].ravel(), stencil.cell_nodes[:, high].ravel()
    found: dict[str, list[Floats]] = {"mass": [], "center": [], "axes": [], "moments": []}
    nodes, arms = [], []
    for number in numbers:
        mine = np.flatnonzero(stencil.region == number)
        if not len(mine):
            raise InputError(
                f"--rigid {pins[number].name} holds no particle",
                "use more particles (--particles), or a larger region inside the body",
            )
        weight, X = stencil.node_mass[mine], stencil.node_X[mine]
        center = weight @ X / weight.sum()
        arm = X - center
        inner = (stencil.region[i] == number) & (stencil.region[j] == number)
        way = (stencil.node_X[j] - stencil.node_X[i])[inner]
        second = (arm * weight[:, None]).T @ arm
        second -= (way * springs.ravel()[inner, None]).T @ way
        moments, axes = np.linalg.eigh(np.trace(second) * np.eye(3) - second)
        if moments[0] < THIN * weight.sum() * stencil.h**2:
            raise InputError(
                f"--rigid {pins[number].name} holds {len(mine)} nodes of the grid, which are "
                f"too few to rotate",
                "use more particles (--particles), or a larger region",
            )
        axes[:, 0] *= np.sign(np.linalg.det(axes))
        for key, value in (
            ("mass", weight.sum()), ("center", center), ("axes", axes), ("moments", moments),
        ):  # fmt: skip
            found[key].append(value)
        nodes.append(mine - stencil.free_count)
        arms.append(arm)
    return RigidRegions(
        names=tuple(pins[k].name for k in numbers), nodes=tuple(nodes), arms=tuple(arms),
        mass=np.array(found["mass"]), center=np.array(found["center"]),
        axes=np.array(found["axes"]), moments=np.array(found["moments"]),
    )  # fmt: skip
