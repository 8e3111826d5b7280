"""The particles of a body, the samples of its surface, and tetrahedra around them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.materials.conversion import Conversion
from gf_usd.core.materials.keys import ValueKeys
from gf_usd.core.units import rounded_text

NOTABLE = 1.05  # times as long: less is not worth a note


def times_as_long(count: float, present: float) -> str:
    """How much longer a bake with another number of particles takes, as text; "" if hardly so.

    N^(4/3): N particles, and time steps proportional to the distance between them.  It is a bound:
    start-up does not grow, frames grow as N, and more particles occupy more threads.
    """
    ratio = (count / present) ** (4.0 / 3.0)
    return f"up to {rounded_text(ratio)} times as long" if ratio >= NOTABLE else ""


@dataclass(frozen=True, kw_only=True)
class CellCopies:
    """Grid cells that a solid fills, with a copy for each connected part of the solid in a cell.

    Where limbs are near each other, cells and nodes have several copies (docs/physics.md).
    """

    h: float  # [m] edge of a cell; cells start at the corners of `Particles`
    cell: Ints  # (K, 3) cell of each copy, counted from there
    body: Ints  # (K,) as in Particles
    links: Ints  # (E, 2) copies of cells with a common face, across which the solid is connected
    of: Ints  # (N,) copy of each particle; some copies have none


@dataclass(frozen=True, kw_only=True)
class Particles:
    """Quadrature points of the solid and their rest Gaussians."""

    X: Floats  # (N, 3) [m] rest positions, world
    V0: Floats  # (N,) [m^3] rest volumes
    material: Ints  # (N,) into the materials of the bake
    orientation: Floats  # (N, 4) rest orientation; axis 0 is the surface normal
    scale: Floats  # (N, 3) [m] rest standard deviations (sigma_r, sigma_t, sigma_t)
    color: Floats  # (N, 3) linear
    opacity: Floats  # (N,)
    surface: Ints  # (N,) index of the nearest surface: where the particle came from
    spacing: float  # [m] mean distance s = (V / N)^(1/3), or `lattice` where that is longer
    volume: float  # [m^3] of the solid: the sum of V0
    lattice: float  # [m] half the edge of the cells the particles were made for
    corner: Floats  # (3,) [m] a corner of these cells: those of the solver's grid are laid along it
    corners: Floats | None = None  # (bodies, 3) [m] the same of each body; None: all have `corner`
    outside: int = 0  # particles outside the solid from which they were sampled
    body: Ints | None = None  # (N,) which of the bodies, from 0; None: all are one
    own: Mapping[str, Floats] | None = None  # (N,) instead of the material's, see own_values
    copies: CellCopies | None = None  # None: no limbs are near each other, every cell is one
    keys: ValueKeys | None = None  # None: no value of a material changes with time
    conversions: tuple[Conversion, ...] = ()  # of no two of them is the same particle
    scatter: Floats | None = None  # (N, 3) [m] at rest by which those with one are moved then

    def __len__(self) -> int:
        return len(self.X)

    @property
    def radius(self) -> float:
        """r = (3 V / 4 pi)^(1/3) [m]: the body's scale."""
        return float((3.0 * self.volume / (4.0 * np.pi)) ** (1.0 / 3.0))

    @property
    def radii(self) -> NDArray[np.float64]:
        """(bodies,) [m] the same of each body; 0 of one without particles."""
        return np.cbrt(0.75 / np.pi * np.bincount(self.body_of, np.asarray(self.V0, float)))

    @property
    def body_of(self) -> Ints:
        """(N,) the body of each; 0 where all are one."""
        return np.zeros(len(self), np.int64) if self.body is None else np.asarray(self.body)


@dataclass(frozen=True, kw_only=True)
class TetLattice:
    """Tetrahedra around a body, which move with it."""

    body: int  # as in Particles
    X: Floats  # (n, 3) [m] rest positions, world
    tets: Ints  # (m, 4) into X, each of positive volume
    copy: Ints | None = None  # (n,) into Particles.copies; None where that is

    @property
    def key(self) -> str:
        """Its name among the embedded points."""
        return f"tets:{self.body}"


@dataclass(frozen=True, kw_only=True)
class TetAttachment:
    """Points of a body's tetrahedra that are pinned."""

    pin: str  # name of the pin, as given
    body: int  # as in Particles
    points: Ints  # (n,) into TetLattice.X
    path: Floats  # (F, k, 3) [m] places known of the pin at each sample; F = 1: they stay


@dataclass(frozen=True, kw_only=True)
class SurfaceSamples:
    """Points at which contact acts, spread over the surfaces about one spacing apart."""

    X: Floats  # (n, 3) [m] rest positions, world
    area: Floats  # (n,) [m^2] of surface that each represents
    normal: Floats | None = None  # (n, 3) unit, outward; None: they touch only the floor
    body: Ints | None = None  # (n,) as in Particles
    cell_copy: Ints | None = None  # (n,) into Particles.copies; None where that is

    def subset(self, rows: Ints) -> SurfaceSamples:
        """Some of the samples."""
        return SurfaceSamples(
            X=self.X[rows],
            area=self.area[rows],
            normal=None if self.normal is None else self.normal[rows],
            body=None if self.body is None else self.body[rows],
            cell_copy=None if self.cell_copy is None else self.cell_copy[rows],
        )

    def with_grains(self, particles: Particles, flows: Ints) -> SurfaceSamples:
        """Those of solid bodies, and every particle of the bodies (B,) that flow.

        The area of each particle is such that rho * area * spacing is its own mass.
        """
        of = np.zeros(len(self.X), np.int64) if self.body is None else np.asarray(self.body)
        shell, body = ~flows[of], particles.body_of
        grains = flows[body]
        count = int(grains.sum())
        normal = np.zeros_like(self.X) if self.normal is None else np.asarray(self.normal)
        copy = None if self.cell_copy is None else np.asarray(self.cell_copy)
        return SurfaceSamples(
            X=np.concatenate([self.X[shell], particles.X[grains]]),
            area=np.concatenate([self.area[shell], particles.V0[grains] / particles.spacing]),
            normal=np.concatenate([normal[shell], np.zeros((count, 3))]),
            body=np.concatenate([of[shell], body[grains]]),
            cell_copy=None
            if copy is None
            else np.concatenate([copy[shell], np.zeros(count, np.int64)]),
        )
