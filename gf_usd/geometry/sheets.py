"""Which parts of an asset are too thin to be filled, and at what spacing they are given flesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gf_usd.geometry import winding
from gf_usd.geometry.edges import Edges
from gf_usd.geometry.parts import THIN
from gf_usd.geometry.sampling import LEAST_PARTICLES
from gf_usd.geometry.solid import FLAT_FRACTION, OPEN_FRACTION, hole_fraction
from gf_usd.model import Floats, Ints, Surface
from gf_usd.topology import proper, shells, weld

PROBES = 16  # vertices of a sheet that must lie in flesh for the sheet to do
ROUNDS = 16  # of choosing sheets by a spacing that depends on them


@dataclass(frozen=True, kw_only=True)
class Shells:
    """The shells of one surface, as bounds of something solid."""

    triangles: Ints  # (T, 3) welded, none collapsed
    source: Ints  # (T,) row in Surface.triangles of each
    label: Ints  # (T,) shell of each
    area: Floats  # (K,) [m^2]
    volume: Floats  # (K,) [m^3] signed: cavities in an outward body count below 0
    sheet: Ints  # (K,) 1 where it encloses nothing: open, or flat
    rim: Ints  # (K,) boundary edges
    held: Ints  # (K,) 1 for a sheet in the flesh of another shell, and for a cavity

    @property
    def thickness(self) -> Floats:
        """(K,) [m] 2 V / A; 0 for sheets with a rim."""
        open_ = (self.sheet == 1) & (self.rim > 0)
        area = np.where(self.area > 0.0, self.area, 1.0)
        return np.where(open_, 0.0, 2.0 * np.abs(self.volume) / area)

    @property
    def extent(self) -> Floats:
        """(K,) [m^2] of a sheet, of which a shell without a rim shows both sides."""
        return np.where((self.sheet == 1) & (self.rim > 0), self.area, 0.5 * self.area)

    def thin(self, spacing: float) -> Ints:
        """(K,) 1 for shells to thicken: too thin for a layer of particles, and wide enough to hold
        a body's worth of them once they are one spacing [m] thick.
        """
        few = (self.thickness < THIN * spacing) & (self.held == 0)
        return (few & (self.extent >= LEAST_PARTICLES * spacing**2)).astype(int)


def look_at(surface: Surface) -> Shells:
    """The shells of a surface whose triangles agree on which side is out."""
    points = surface.points
    welded = weld(points)[0][surface.triangles]
    source = np.flatnonzero(proper(welded))
    triangles = np.ascontiguousarray(welded[source], np.int64)
    label = shells(triangles)
    count = int(label.max(initial=-1)) + 1
    area = np.bincount(label, winding.areas(points, triangles), count)
    volume = winding.volumes(points, triangles, label) if count else np.zeros(0)
    sheet = (np.abs(volume) <= FLAT_FRACTION * area**1.5).astype(int)
    rows = winding.rows_of(label) if count else []
    rim = np.bincount(label[Edges.of(triangles).boundary // 3], minlength=count)
    for k in np.flatnonzero((rim > 0) & (sheet == 0)):
        used, local = np.unique(triangles[rows[k]], return_inverse=True)
        sheet[k] = hole_fraction(points[used], local.reshape(-1, 3)) > OPEN_FRACTION
    held = np.zeros(count, int)
    flesh = triangles[sheet[label] == 0]
    if len(flesh):
        held[(sheet == 0) & (volume < 0.0)] = 1
        for k in np.flatnonzero(sheet):
            corners = np.unique(triangles[rows[k]])
            probes = points[corners[:: max(1, len(corners) // PROBES)]]
            held[k] = winding.winding_inside(points, flesh, probes).all()
    return Shells(
        triangles=triangles, source=source, label=label, area=area, volume=volume, sheet=sheet,
        rim=rim, held=held,
    )  # fmt: skip


def choose(seen: list[Shells], spacing: float | None, particles: int) -> tuple[float, list[Ints]]:
    """The spacing a [m], and (K,) 1 for the shells of each surface to thicken to it.

    Without a spacing it is that at which so many particles fill all: V + S a = N a^3, V the volume
    of what stays as it is and S the extent of what is thickened.  a 0: there is nothing to fill.
    """
    if spacing is not None:
        return spacing, [one.thin(spacing) for one in seen]
    chosen = [one.sheet * (1 - one.held) for one in seen]
    a = 0.0
    for _ in range(ROUNDS):
        V = sum(float(one.volume[c == 0] @ (1 - one.sheet[c == 0])) for one, c in zip(seen, chosen))
        S = sum(float(one.extent @ c) for one, c in zip(seen, chosen))
        a = _solve(max(V, 0.0), S, particles)
        again = [one.thin(a) for one in seen]
        if all(np.array_equal(c, d) for c, d in zip(chosen, again)):
            break
        chosen = again
    return a, chosen


def _solve(V: float, S: float, N: int) -> float:
    """The root a >= 0 of N a^3 = V + S a, by Newton from above: it comes down to it."""
    a = float(np.cbrt(V / N) + np.sqrt(S / N))
    for _ in range(60):
        slope = 3.0 * N * a * a - S
        if slope <= 0.0:
            break
        a -= (N * a**3 - S * a - V) / slope
    return a
