"""Parts of an asset that the particles do not reach, by name.

A part without particles of its own follows its surroundings stiffly.  Found are whole shells with
too few particles or too thin for one layer, and bare regions of shells that are otherwise filled:
an antenna, a brim, the edge of a blade.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from gf_usd.geometry import winding
from gf_usd.geometry.solid import Solid
from gf_usd.geometry.surface import nearest
from gf_usd.model import Floats, Ints, Particles, SurfaceSamples
from gf_usd.topology import shells

FEW = 8  # particles: a full cell of the solver's grid
THIN = 0.75  # [spacings] thinner, and a quarter of a wall has no particle in it
# Surface points lie within 1.5 spacings of a particle wherever a body is filled (measured on balls,
# boxes, the samples and a car kit, 300 to 30000 particles); a region is bare beyond that, if part
# of it is clearly so.
BARE, CLEARLY_BARE = 1.5, 2.0  # [spacings]
PROBE_STEPS = 64
PROBE_REACH = 2.0  # [spacings] inward, where the far side is looked for
SENSIBLE = 2_000_000  # particles: more is no advice


@dataclass(frozen=True, kw_only=True)
class Part:
    """A part that gets no or few particles."""

    path: str  # prim path
    shell: int  # as in topology.shells
    kind: str  # empty | few | thin | bare region
    low: Floats  # (3,) [m]
    high: Floats  # (3,) [m]
    area: float  # [m^2] of its surface
    particles: int  # inside it
    thickness: float  # [m] 2 V / A of a shell, the median measured inward for a region
    suggested: int | None  # total of particles that would fill it; None: more than is sensible

    @property
    def size(self) -> float:
        """[m] diagonal of its box."""
        return float(np.linalg.norm(self.high - self.low))

    @property
    def centre(self) -> Floats:
        """(3,) [m]"""
        return 0.5 * (self.low + self.high)


def poor_parts(solid: Solid, particles: Particles, samples: SurfaceSamples) -> tuple[Part, ...]:
    """Poorly filled parts, the largest first.

    samples : points about a spacing apart on the solid's surfaces (`sample_surface`).
    """
    labels = [shells(triangles) for triangles in solid.triangles]
    parts: list[Part] = []
    settled: set[tuple[int, int]] = set()  # shells that need no look at their regions
    for number, label in enumerate(labels):
        found, hollow = _poor_shells(solid, number, label, particles)
        parts += found
        settled |= {(number, part.shell) for part in found}
        settled |= {(number, shell) for shell in hollow}
    parts += _bare_regions(solid, labels, settled, particles, samples)
    return tuple(sorted(parts, key=lambda part: -part.size))


def suggestion(parts: tuple[Part, ...]) -> int | None:
    """Particles that fill every part that a sensible number fills; None where there is none."""
    return max((part.suggested for part in parts if part.suggested), default=None)


def _poor_shells(
    solid: Solid, number: int, label: Ints, particles: Particles
) -> tuple[list[Part], list[int]]:
    """Shells of one surface with few particles, and those that are cavities."""
    points, triangles = solid.surfaces[number].points, solid.triangles[number]
    area = np.bincount(label, winding.areas(points, triangles))
    volume = np.abs(winding.volumes(points, triangles, label))
    low, high = winding.boxes(points, triangles, label)
    reach = 0.5 * np.linalg.norm(high - low, axis=1)
    cavity = winding.facing(points, triangles, label).goal == -1
    tree = cKDTree(particles.X)
    found = []
    for k, rows in enumerate(winding.rows_of(label)):
        if cavity[k]:
            continue
        X = particles.X[tree.query_ball_point(0.5 * (low[k] + high[k]), reach[k])]
        count = int(winding.winding_inside(points, triangles[rows], X).sum()) if len(X) else 0
        thickness = float(2.0 * volume[k] / area[k]) if area[k] > 0.0 else 0.0
        kind = "empty" if count == 0 else "few" if count < FEW else ""
        kind = kind or ("thin" if thickness < THIN * particles.spacing else "")
        if not kind:
            continue
        spacing = min(thickness, float(np.cbrt(volume[k] / FEW)))
        found.append(
            Part(
                path=solid.surfaces[number].path,
                shell=k,
                kind=kind,
                low=low[k],
                high=high[k],
                area=float(area[k]),
                particles=count,
                thickness=thickness,
                suggested=_particles_for(solid, spacing),
            )
        )
    return found, np.flatnonzero(cavity).tolist()


def _bare_regions(
    solid: Solid,
    labels: list[Ints],
    settled: set[tuple[int, int]],
    particles: Particles,
    samples: SurfaceSamples,
) -> list[Part]:
    """Connected stretches of surface far from any particle."""
    s = particles.spacing
    distance = cKDTree(particles.X).query(samples.X)[0]
    bare = np.flatnonzero(distance > BARE * s)
    if len(bare) == 0:
        return []
    X, area = samples.X[bare], samples.area[bare]
    at = nearest(solid, X)
    # Rows of Surface.triangles, which name the shell through the welded triangles made of them.
    shell = np.full(len(bare), -1)
    for number, (label, source) in enumerate(zip(labels, solid.sources)):
        mine = np.flatnonzero(at.surface == number)
        shell[mine] = label[np.searchsorted(source, at.triangle[mine])]
    pairs = cKDTree(X).query_pairs(BARE * s, output_type="ndarray")
    same = (at.surface[pairs[:, 0]] == at.surface[pairs[:, 1]]) & (
        shell[pairs[:, 0]] == shell[pairs[:, 1]]
    )
    pairs = pairs[same]
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(X),) * 2)
    region = connected_components(graph, directed=False)[1]
    thickness = _thickness(solid, X, at.normal, PROBE_REACH * s)
    found = []
    for rows in winding.rows_of(region):
        home = (int(at.surface[rows[0]]), int(shell[rows[0]]))
        if home in settled or distance[bare[rows]].max() < CLEARLY_BARE * s:
            continue
        low, high = X[rows].min(0), X[rows].max(0)
        thick = float(np.median(thickness[rows]))
        found.append(
            Part(
                path=solid.surfaces[home[0]].path,
                shell=home[1],
                kind="bare region",
                low=low,
                high=high,
                area=float(area[rows].sum()),
                particles=0,
                thickness=thick,
                suggested=_particles_for(solid, thick),
            )
        )
    return found


def _thickness(solid: Solid, X: Floats, normal: Floats, reach: float) -> Floats:
    """(n,) [m] from surface points X inward to where the solid ends, reach at most."""
    depth = (np.arange(PROBE_STEPS) + 0.5) / PROBE_STEPS * reach
    probes = X[:, None, :] - depth[:, None] * normal[:, None, :]
    inside = solid.inside(probes.reshape(-1, 3)).reshape(len(X), PROBE_STEPS)
    out = ~inside
    return np.where(out.any(1), depth[np.argmax(out, axis=1)], reach)


def _particles_for(solid: Solid, spacing: float) -> int | None:
    """V / spacing^3, two digits, rounded up; None beyond what is sensible."""
    if spacing <= 0.0 or solid.volume / spacing**3 > SENSIBLE:
        return None
    count = solid.volume / spacing**3
    digit = 10.0 ** (np.floor(np.log10(count)) - 1.0)
    return int(np.ceil(count / digit) * digit)
