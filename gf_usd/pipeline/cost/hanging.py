"""How many substeps a body takes that stretches by its own weight, as it hangs from a pin.

Damping of Kelvin and Voigt grows with the square of a stretch (`time_step`): a rubber cable that
carries a lamp is stretched by a factor of ten, and needs a hundred times the damping rate.

At a distance d from the pin, along the body, the material of one cross-section carries the weight
of all that is farther away. With the stiffness E A of that section the strain at rest is

    e(d) = g m(> d) / (E A)(d),         E A = sum of E V over a layer of the thickness D, over D

and the stretch L that of a bar: L - L^-2 = 3 e for rubber, with which mu = E / 3 (Neo-Hookean), and
1 + e for other laws; a law that flows keeps no more strain than that of its yield. The body is
released where nothing is stretched: a mass on a spring that is D longer at rest falls as
D (1 - e^(-z w t) cos w t), with w = sqrt(g / D) and z = w tau / 2, and so do all stretches.

Where most of what a section carries is above it, the body stands on the pin, and is not stretched.
Bending, and what moves a pin, are left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.frames.particles import Particles
from gf_usd.core.frames.settings import Settings
from gf_usd.core.materials.laws import LAWS
from gf_usd.core.materials.material import Material
from gf_usd.core.stage import Pin
from gf_usd.physics.time_step import StableStep, strained_step

LAYER = 2.0  # [spacings] thickness of a section: a cell of the grid
AROUND = 2  # layers before and after one, over which its section is averaged
TIMES = 24  # at which a bake is sampled
RUBBER = "neoHookean"


@dataclass(frozen=True, kw_only=True)
class Hanging:
    """The bodies that hang from pins, of the bakes of one material."""

    stretch: float = 1.0  # the largest at rest
    longer: float = 0.0  # [m] by which that body is longer at rest
    damping_time: float = 0.0  # [s]
    gravity: float = 0.0  # [m/s^2]

    def stretches(self, times: Floats) -> Floats:
        """(n,) largest stretch at times (n,) [s] after the release."""
        if self.stretch <= 1.0 or self.longer <= 0.0:
            return np.ones_like(times)
        w = math.sqrt(self.gravity / self.longer)
        z = min(1.0, 0.5 * w * self.damping_time)
        way = 1.0 - np.exp(-z * w * times) * np.cos(w * times)
        return 1.0 + (self.stretch - 1.0) * way

    def profile(self, step: StableStep | None, duration: float) -> list[float]:
        """Substeps relative to those at rest, at TIMES equal intervals of a bake [s]; []: always 1,
        or the `step` at rest is unknown.
        """
        if step is None or self.stretch <= 1.0:
            return []
        times = (np.arange(TIMES) + 0.5) / TIMES * duration
        many = [_factor(step, float(each)) for each in self.stretches(times)]
        return many if max(many) > 1.0 else []


def _factor(step: StableStep, stretch: float) -> float:
    """Substeps of a body that is stretched so much, relative to those at rest."""
    # With h = q = 1 the frequency is the speed of waves, which remains as it is at rest.
    limit = strained_step(step, step.elastic, 1.0, 1.0, 1.0, damping=max(1.0, stretch) ** 2)
    return max(1.0, step.dt / limit)


@dataclass(frozen=True, kw_only=True)
class Voxels:
    """Cells of a body that contain particles."""

    X: Floats  # (k, 3) [m] mean place of their particles
    near: tuple[Ints, Ints]  # pairs of neighbors, in both orders
    of: Ints  # (N,) the voxel of each particle

    @classmethod
    def of_particles(cls, X: Floats, edge: float) -> Voxels:
        """Of particles X (N, 3) [m], with an edge [m]; each has 26 neighbors."""
        ijk = np.floor((X - X.min(0)) / edge).astype(np.int64) + 1
        dims = ijk.max(0) + 2
        keys, of = np.unique(np.ravel_multi_index(tuple(ijk.T), tuple(dims)), return_inverse=True)
        of = of.reshape(-1)
        count = np.bincount(of)
        center = np.stack([np.bincount(of, X[:, k]) / count for k in range(3)], 1)
        rows, columns = [], []
        for step in np.ndindex(3, 3, 3):
            shift = np.array(step) - 1
            other = keys + shift @ np.array([dims[1] * dims[2], dims[2], 1])
            at = np.minimum(np.searchsorted(keys, other), len(keys) - 1)
            near = (keys[at] == other) & (other != keys)
            rows.append(np.flatnonzero(near))
            columns.append(at[near])
        return cls(X=center, near=(np.concatenate(rows), np.concatenate(columns)), of=of)

    def distances(self, held: NDArray[np.bool_]) -> Floats:
        """(k,) [m] from the pinned ones (k,) along the body; inf where there is no path."""
        from scipy.sparse import coo_matrix
        from scipy.sparse.csgraph import dijkstra

        row, column = self.near
        ways = np.linalg.norm(self.X[row] - self.X[column], axis=1)
        graph = coo_matrix((ways, (row, column)), shape=(len(self.X), len(self.X))).tocsr()
        return np.asarray(dijkstra(graph, indices=np.flatnonzero(held), min_only=True))


def hanging(
    particles: Particles, table: Sequence[Material], pins: Sequence[Pin], settings: Settings
) -> Hanging:
    """The body that is stretched most; `Hanging()` where none hangs from a pin.

    table : the materials of the particles. Cores in flesh, which are no sharp pins, are left out.
    """
    g = np.asarray(settings.gravity, float)
    size, edge = float(np.linalg.norm(g)), LAYER * particles.spacing
    sharp = [pin for pin in pins if pin.sharp and not pin.rigid]
    worst = Hanging()
    if size == 0.0 or not sharp:
        return worst
    kind = np.asarray(particles.material)
    V, X = np.asarray(particles.V0, float), np.asarray(particles.X, float)
    density, young = (
        np.array([getattr(one, name) for one in table], float)[kind] * V
        for name in ("density", "youngs_modulus")
    )
    for body in np.unique(particles.body_of):
        mine = np.flatnonzero(particles.body_of == body)
        voxels = Voxels.of_particles(X[mine], edge)
        held = _held(voxels.X, int(body), sharp, edge)
        if not held.any():
            continue
        distance = voxels.distances(held)
        found = np.isfinite(distance)
        weight, EV = (np.bincount(voxels.of, one[mine])[found] for one in (density * size, young))
        strain, thick = strains(distance[found], weight, EV, voxels.X[found] @ g / size, edge)
        damped = max((table[k] for k in np.unique(kind[mine])), key=lambda one: one.damping_time)
        stretch = bar_stretches(strain, damped)
        if len(stretch) and stretch.max() > worst.stretch:
            worst = Hanging(
                stretch=float(stretch.max()), longer=float((stretch - 1.0).sum()) * thick,
                damping_time=damped.damping_time, gravity=size,
            )  # fmt: skip
    return worst


def _held(X: Floats, body: int, pins: Sequence[Pin], edge: float) -> NDArray[np.bool_]:
    """(k,) voxels X (k, 3) [m] of a body in its pins, or half an edge [m] from one."""
    held = np.zeros(len(X), bool)
    for pin in pins:
        if pin.body is not None and pin.body != body:
            continue
        inside = pin.holds(X, np.full(len(X), body))
        away = np.linalg.norm(pin.nearest(X) - X, axis=1)
        least = float(away.min()) if pin.patch and pin.body == body else 0.0
        held |= inside | (away <= max(0.5 * edge, least))
    return held


def strains(
    distance: Floats, weight: Floats, stiffness: Floats, down: Floats, layer: float
) -> tuple[Floats, float]:
    """(k,) strains e of the layers that hang, by the weight beyond each, and their thickness [m].

    Of voxels: distance (N,) [m] from the pin, weight (N,) [N], stiffness E V (N,) [N m] and place
    along gravity (N,) [m]; layer : [m] between distances that are distinguished.
    """
    number = np.floor(distance / layer).astype(np.int64)
    each, EV, low = (np.bincount(number, one) for one in (weight, stiffness, weight * down))
    # Paths from voxel to voxel leave layers empty and fill others twice, and a section that is much
    # shorter than a few cells stretches with its neighbors.
    EA = _window_sums(EV) / (layer * _window_sums(np.ones_like(EV)))
    beyond = np.append(np.cumsum(each[::-1])[::-1][1:], 0.0)
    moment = np.append(np.cumsum(low[::-1])[::-1][1:], 0.0)
    full = each > 0.0
    deeper = moment[full] - (beyond * low)[full] / each[full]
    # what is beside a layer falls; what is above it by a part of a layer is that, too
    hangs = (beyond[full] > 0.0) & (deeper > -0.25 * layer * beyond[full])
    strain = ((beyond + 0.5 * each)[full] / EA[full])[hangs]
    return strain, float(len(each)) / float(full.sum()) * layer


def _window_sums(values: Floats) -> Floats:
    """(k,) sums of each value, and of those at most `AROUND` before and after it."""
    total = np.cumsum(np.pad(values, (AROUND + 1, AROUND)))
    return total[2 * AROUND + 1 :] - total[: -2 * AROUND - 1]


def bar_stretches(strain: Floats, material: Material) -> Floats:
    """(k,) stretches of a bar of a material under nominal stresses E e; strain : e (k,)."""
    law = LAWS[material.law]
    if law.flows:
        return 1.0 + np.minimum(strain, material.yield_strain or 0.0)
    if material.law != RUBBER:
        return 1.0 + strain
    stretch = 1.0 + 3.0 * strain  # the bound from above: Newton's method comes from there
    for _ in range(8):
        slope = 1.0 + 2.0 * stretch**-3
        stretch = stretch - (stretch - stretch**-2 - 3.0 * strain) / slope
    return np.maximum(1.0, stretch)
