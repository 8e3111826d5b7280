"""Detection of parts with too few particles, for advice on the resolution.

A part without particles inside moves with the nearest ones and does not deform by itself.  Detected
are whole shells that have too few particles or are too thin for one layer, and regions of other
shells that are far from any particle or too thin: an antenna, the brim of a hat.  A shell wholly
inside others, such as an eye in a head, is none: it adds nothing to the union that is filled.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import igl
import numpy as np
from scipy.sparse import coo_matrix

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.frames.particles import Particles, SurfaceSamples
from gf_usd.core.mesh.measures import areas
from gf_usd.core.neighbors import components, kd_tree
from gf_usd.geometry import winding
from gf_usd.geometry.solid import Bounds, Solid
from gf_usd.geometry.surface import Nearest, nearest
from gf_usd.geometry.thin.thickness import chords, gaps, shell_chords, spread

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

FEW = 8  # particles: a full cell of the solver's grid
# [lattice edges] three quarters of a cell: a thinner wall may have no cell of its own that is more
# than half full, and bends by one layer of cells in any orientation
WHOLE_LAYER = 1.5
THIN = 0.75  # [spacings] a thinner wall has no particles in more than a quarter of its area
# Surface points lie within 1.5 spacings of a particle wherever a body is filled (measured on balls,
# boxes, the samples and a car kit, 300 to 30000 particles); a region is bare beyond that, if part
# of it is clearly so.
BARE, CLEARLY_BARE = 1.5, 2.0  # [spacings]
PLATE = 4.0  # [spacings] area over length from which a region is a strip, not just an edge
STEPS = 4  # inward sample points
AHEAD = 0.01  # [spacings] from which a ray starts ahead of its triangle
OFF_EDGE = 0.01  # of the way to the centroid of a triangle
RAYS = 64  # of a part, for its thickness
CLEAR_OF_WALL = 0.05  # [walls] offset from its surface for an unambiguous inside test
CLEAR = 1e-4  # [diagonals of its box] at least, for points on both sides: loose faces
VOLUME_POINTS = 20_000  # gives the volume of a region of 1 % of its box to 7 %
WHOLE = ("empty", "few", "thin")  # kinds of whole shells
# [spacings^3] volume from which particles in a shell that is not thin are not counted: there are
# more than `FEW`, and counting them would take half of the time (measured).
SURE = 8 * FEW
# A shell that is apart from the others is a speck below these shares of the diagonal of all shells,
# and of their volume.
SPECK, SPECK_VOLUME = 0.1, 1e-3
APART = 0.25  # [spacings] from other shells: bodies that are nearer count as touching
SENSIBLE = 2_000_000  # particles: the greatest number that is suggested
# Of the box's diagonal: below it a thickness is the rounding error of the volume of loose faces.
LOOSE = 1e-9


@dataclass(frozen=True, kw_only=True)
class Part:
    """A part with no or few particles."""

    path: str  # prim path
    shell: int  # as in topology.shells
    kind: str  # empty | few | thin (whole shells) | bare region | thin region
    low: Floats  # (3,) [m]
    high: Floats  # (3,) [m]
    area: float  # [m^2] of its surface
    particles: int  # inside it; of a region, those nearest to its surface
    wall: float  # [m] 2 V / A: the thickness of a plate, the radius of a rod
    suggested: int | None  # particles of the bake that would fill it; None: above `SENSIBLE`
    rays: tuple[Floats, Floats]  # points (n, 3) [m] of its surface, and normals
    within: Floats  # (n,) [m] lengths of these rays in a whole shell by itself; nan: of a region
    thickness: float = 0.0  # [m] median along rays inward: the diameter of a rod
    speck: bool = False  # a whole shell that is small and apart from all others, as noise of scans

    @property
    def size(self) -> float:
        """[m] diagonal of its box."""
        return float(np.linalg.norm(self.high - self.low))

    @property
    def loose(self) -> bool:
        """Whether it consists of faces that enclose no volume."""
        return self.wall <= LOOSE * self.size

    @property
    def sides(self) -> Floats:
        """(2, n, 3) [m] points on both sides of its surface."""
        X, normal = self.rays
        step = max(CLEAR_OF_WALL * self.wall, CLEAR * self.size) * normal
        return np.stack([X + step, X - step])

    @property
    def center(self) -> Floats:
        """(3,) [m]"""
        return 0.5 * (self.low + self.high)


def poor_parts(solid: Solid, particles: Particles, samples: SurfaceSamples) -> tuple[Part, ...]:
    """The parts with too few particles, the largest first.

    samples : points about one spacing apart on the solid's surfaces (`sample_surface`).
    """
    labels = [surface.welded.shell for surface in solid.surfaces]
    parts: list[Part] = []
    corners: list[Floats] = []  # (6, 3) [m] of each whole shell
    settled: set[tuple[int, int]] = set()  # shells whose regions are not checked
    tree = kd_tree(particles.X)
    for number, label in enumerate(labels):
        found, ends, hollow = _poor_shells(solid, number, label, particles, tree)
        parts += found
        corners += ends
        settled |= {(number, part.shell) for part in found}
        settled |= {(number, shell) for shell in hollow}
    parts = _not_enclosed(solid, parts, corners)
    parts += _poor_regions(solid, labels, settled, particles, samples)
    parts = _with_thickness(solid, _with_specks(solid, labels, parts, particles.spacing))
    return tuple(sorted(parts, key=lambda part: -part.size))


def suggestion(parts: tuple[Part, ...]) -> int | None:
    """The greatest number of particles that is suggested for a part; None where there is none.

    Specks do not count: they would require many times as many particles, and are rarely intended.
    """
    return max((p.suggested for p in parts if p.suggested and not p.speck), default=None)


def filling_spacing(volume: float, area: float) -> float:
    """[m] spacing of particles that fills a shell of this volume [m^3] and area [m^2]: `FEW` of
    them, and one across a plate.
    """
    wall = 2.0 * volume / area if area > 0.0 else 0.0
    return min(wall, float(np.cbrt(volume / FEW)))


def _with_specks(
    solid: Solid, labels: Sequence[Ints], parts: Sequence[Part], spacing: float
) -> list[Part]:
    """The parts, where specks are marked.

    labels : (T,) shell of each triangle, for each surface; spacing : [m] of the particles.
    """
    longest = float(np.linalg.norm(solid.high - solid.low))
    small = [
        p.kind in WHOLE
        and p.size < SPECK * longest
        and 0.5 * p.wall * p.area < SPECK_VOLUME * solid.volume
        for p in parts
    ]
    if not any(small):
        return list(parts)
    rows = {(p.path, p.shell): k for k, p in enumerate(parts) if small[k]}
    some = [p for p, one in zip(parts, small, strict=True) if one]
    low, high = np.stack([p.low for p in some]) - APART * spacing, np.stack([p.high for p in some])
    high += APART * spacing
    ends, owner, rest, points = [], [], [], []
    first, far = 0, False
    for surface, triangles, label, box in zip(
        solid.surfaces, solid.triangles, labels, solid.bounds, strict=True
    ):
        if not ((low <= box.high) & (high >= box.low)).all(1).any():
            far = True  # from all of them
            continue
        row = np.array([rows.get((surface.path, k), -1) for k in range(label.max() + 1)])[label]
        # each vertex of a part once: some six triangles share it
        of, vertex = np.divmod(
            np.unique(row[row >= 0, None] * len(surface.points) + triangles[row >= 0]),
            len(surface.points),
        )
        ends.append(surface.points[vertex])
        owner.append(of)
        rest.append(triangles[row < 0] + first)
        points.append(surface.points)
        first += len(surface.points)
    X, others = np.concatenate(ends), np.concatenate(rest)
    if not len(others) and not far:
        return list(parts)
    gap = np.full(len(parts), np.inf)
    if len(others):
        center, whole = X.mean(0), np.concatenate(points)
        squared = igl.point_mesh_squared_distance(
            X - center, whole - center, others.astype(np.int64)
        )[0]
        whose = np.concatenate(owner)
        np.minimum.at(gap, whose, np.sqrt(np.asarray(squared).reshape(-1)))
        # one that pierces another has no end near its surface
        clear = np.flatnonzero(gap[whose] > APART * spacing)
        gap[whose[clear[Bounds(whole, others).inside(X[clear])]]] = 0.0
    return [
        replace(part, speck=bool(small[k] and gap[k] > APART * spacing))
        for k, part in enumerate(parts)
    ]


def _poor_shells(
    solid: Solid, number: int, label: Ints, particles: Particles, tree: cKDTree
) -> tuple[list[Part], list[Floats], list[int]]:
    """The shells of one surface with few particles, their vertices (6, 3) [m] that are first and
    last along each axis, and its cavities."""
    points, triangles = solid.surfaces[number].points, solid.triangles[number]
    area = np.bincount(label, areas(points, triangles))
    volume = np.abs(winding.volumes(points, triangles, label))
    low, high = winding.boxes(points, triangles, label)
    reach = 0.5 * np.linalg.norm(high - low, axis=1)
    # a single shell is no cavity, and its hierarchy is that of the solid
    one = len(area) == 1
    cavity = [False] if one else winding.orientations(points, triangles, label).target == -1
    found, ends = [], []
    wide = 2.0 * volume >= THIN * particles.spacing * area
    filled = wide & (volume >= SURE * particles.spacing**3)
    for k, rows in enumerate(winding.rows_of(label)):
        if cavity[k] or filled[k]:
            continue
        X = particles.X[tree.query_ball_point(0.5 * (low[k] + high[k]), reach[k])]
        within = (
            solid.bounds[number].inside
            if one
            else partial(winding.winding_inside, points, triangles[rows])
        )
        count = int(within(X).sum()) if len(X) else 0
        wall = float(2.0 * volume[k] / area[k]) if area[k] > 0.0 else 0.0
        kind = "empty" if count == 0 else "few" if count < FEW else ""
        kind = kind or ("thin" if wall < THIN * particles.spacing else "")
        if not kind:
            continue
        spacing = filling_spacing(float(volume[k]), float(area[k]))
        rays = spread(points, triangles[rows], RAYS)
        clear = np.full(RAYS, CLEAR_OF_WALL * wall)
        part = Part(
            path=solid.surfaces[number].path,
            shell=k,
            kind=kind,
            low=low[k],
            high=high[k],
            area=float(area[k]),
            particles=count,
            wall=wall,
            rays=rays,
            within=shell_chords(points, triangles[rows], *rays, clear),
            suggested=_particles_for(solid, spacing),
        )
        if _is_patch(solid, part):
            continue
        corners = points[triangles[rows]].reshape(-1, 3)
        ends.append(corners[np.concatenate([corners.argmin(0), corners.argmax(0)])])
        found.append(part)
    return found, ends, np.flatnonzero(cavity).tolist()


def _is_patch(solid: Solid, part: Part) -> bool:
    """Whether a shell bounds nothing by itself, but is part of the boundary of the union, as a
    piece of skin with a material of its own.

    It is as thick as the body there, and belongs to the regions.
    """
    if np.isfinite(part.within).any():
        return False
    outer, inner = (solid.inside(X) for X in part.sides)
    return bool(2 * np.count_nonzero(outer != inner) > len(outer))


def _not_enclosed(solid: Solid, parts: list[Part], corners: Sequence[Floats]) -> list[Part]:
    """The whole shells except those wholly inside others: the union is on both sides of their
    surface.

    corners : (6, 3) [m] of each, since few of the rays start at the end of a hair.
    """
    if not parts:
        return []
    sides = np.stack([part.sides for part in parts]).reshape(len(parts), -1, 3)
    tested = np.concatenate([sides, np.stack(corners)], axis=1)
    inside = solid.inside(tested.reshape(-1, 3)).reshape(tested.shape[:2]).all(1)
    return [parts[k] for k in np.flatnonzero(~inside)]


def _poor_regions(
    solid: Solid,
    labels: list[Ints],
    settled: set[tuple[int, int]],
    particles: Particles,
    samples: SurfaceSamples,
) -> list[Part]:
    """Connected surface regions far from any particle, or thinner than a layer."""
    s = particles.spacing
    distance, closest = kd_tree(particles.X).query(samples.X)
    at = nearest(solid, samples.X)
    X = _off_edges(solid, samples.X, at)
    side = np.sign(((particles.X[closest] - X) * at.normal).sum(axis=1))
    bare = distance > BARE * s
    poor = np.flatnonzero(bare | _thin(solid, X, at.normal, side, s))
    ends = _solid_ends(solid, X[poor], at.normal[poor], s)
    kept = bare[poor] | ends
    poor, ends = poor[kept], ends[kept]
    if len(poor) == 0:
        return []
    moved, normal = X[poor], at.normal[poor]
    X, area, owner = samples.X[poor], samples.area[poor], at.surface[poor]
    # The shell of a row of Surface.triangles is that of its welded triangle.
    shell = np.full(len(poor), -1)
    for number, (label, source) in enumerate(zip(labels, solid.sources)):
        mine = np.flatnonzero(owner == number)
        shell[mine] = label[np.searchsorted(source, at.triangle[poor[mine]])]
    pairs = kd_tree(X).query_pairs(BARE * s, output_type="ndarray")
    one, two = pairs[(owner[pairs] == owner[pairs][:, :1]).all(1)].T
    joined = shell[one] == shell[two]
    graph = coo_matrix((np.ones(joined.sum()), (one[joined], two[joined])), shape=(len(X),) * 2)
    region = components(graph)[1]
    # A particle belongs to the region that its nearest surface point is in.
    home = np.full(len(samples.X), -1)
    home[poor] = region
    tree = kd_tree(samples.X)
    count = np.bincount(home[tree.query(particles.X)[1]] + 1, minlength=region.max() + 2)[1:]
    found = []
    for k, rows in enumerate(winding.rows_of(region)):
        low, high = X[rows].min(0), X[rows].max(0)
        plate = area[rows].sum() / max(float(np.linalg.norm(high - low)), s)
        # a sheet of an open mesh, which no number of particles fills, counts only where it is wide
        sheet = 2 * np.count_nonzero(ends[rows]) < len(rows)
        clearly = distance[poor[rows]].max() > CLEARLY_BARE * s and not sheet
        if (int(owner[rows[0]]), int(shell[rows[0]])) in settled or (
            plate < PLATE * s and not clearly
        ):
            continue
        wall = 0.0
        if not sheet:
            volume = _volume_where(
                solid, low - s, high + s, lambda P, k=k: home[tree.query(P)[1]] == k
            )
            wall = float(2.0 * volume / area[rows].sum())
        some = rows[:: max(1, len(rows) // RAYS)]
        found.append(
            Part(
                path=solid.surfaces[owner[rows[0]]].path,
                shell=int(shell[rows[0]]),
                kind="thin region" if count[k] else "bare region",
                low=low,
                high=high,
                area=float(area[rows].sum()),
                particles=int(count[k]),
                wall=wall,
                rays=(moved[some], normal[some]),
                within=np.full(len(some), np.nan),
                suggested=_particles_for(solid, wall / WHOLE_LAYER),
            )
        )
    return found


def _with_thickness(solid: Solid, parts: Sequence[Part]) -> list[Part]:
    """The parts with their thickness, which is the wall where no ray gives one.

    A ray ends where it leaves the union, as in the wall of a hollow shell, or a whole shell, as in
    a plate that lies on a body.
    """
    parts = [replace(part, thickness=part.wall) for part in parts]
    solids = [part for part in parts if part.wall > 0.0]
    if not solids:
        return parts
    start, normal = (np.concatenate(ends) for ends in zip(*(part.rays for part in solids)))
    counts = [len(part.rays[0]) for part in solids]
    clear = np.repeat([CLEAR_OF_WALL * part.wall for part in solids], counts)
    within = np.concatenate([part.within for part in solids])
    lengths = np.split(np.fmin(chords(solid, start, normal, clear), within), np.cumsum(counts)[:-1])
    found = {
        id(part): replace(part, thickness=float(np.nanmedian(length)))
        for part, length in zip(solids, lengths, strict=True)
        if np.isfinite(length).any()
    }
    return [found.get(id(part), part) for part in parts]


def _off_edges(solid: Solid, X: Floats, at: Nearest) -> Floats:
    """Surface points X (n, 3) moved slightly toward the centroid of their triangle.

    A point inward of an edge may lie in the plane of the adjacent face, where the inside test is
    ambiguous.
    """
    moved = X.copy()
    order = np.argsort(at.surface, kind="stable")
    first = np.searchsorted(at.surface[order], np.arange(len(solid.surfaces) + 1))
    for number, surface in enumerate(solid.surfaces):
        mine = order[first[number] : first[number + 1]]
        middle = surface.points[surface.triangles[at.triangle[mine]]].mean(axis=1)
        moved[mine] += OFF_EDGE * (middle - X[mine])
    return moved


def _thin(solid: Solid, X: Floats, normal: Floats, side: Floats, spacing: float) -> winding.Flags:
    """(n,) True for surface points X where the solid is thinner than `THIN` spacings.

    Inward is the side of the normal on which the solid is deeper, since the winding may be
    reversed.  side : (n,) the sign of the one that is tested first.
    """
    depth = (np.arange(STEPS) + 0.5) / STEPS * THIN * spacing

    def reaches(rows: Ints, sign: Floats) -> winding.Flags:
        way = sign[:, None, None] * depth[:, None] * normal[rows, None, :]
        inside = solid.inside((X[rows, None, :] + way).reshape(-1, 3))
        return np.all(inside.reshape(len(rows), STEPS), axis=1)

    first = np.where(side < 0.0, -1.0, 1.0)
    thin = ~reaches(np.arange(len(X)), first)
    rows = np.flatnonzero(thin)
    thin[rows] = ~reaches(rows, -first[rows])
    return thin


def _solid_ends(solid: Solid, X: Floats, normal: Floats, spacing: float) -> winding.Flags:
    """(n,) True where the solid ends at another surface within `THIN` spacings of its points X.

    Next to a hole it may also end where the winding number falls below one half, however thick it
    is there.  In closed surfaces it cannot.
    """
    if not len(X) or not any(len(surface.welded.boundary) for surface in solid.surfaces):
        return np.ones(len(X), bool)
    return gaps(solid, X, normal, AHEAD * spacing) <= THIN * spacing


def _volume_where(
    solid: Solid, low: Floats, high: Floats, belongs: Callable[[Floats], winding.Flags]
) -> float:
    """[m^3] of the part of a solid in a box where `belongs` (n, 3) -> (n,) is True, by sampling."""
    X = np.random.default_rng(0).uniform(low, high, (VOLUME_POINTS, 3))
    X = X[solid.inside(X)]
    hits = int(belongs(X).sum()) if len(X) else 0
    return float(np.prod(high - low)) * hits / VOLUME_POINTS


def _particles_for(solid: Solid, spacing: float) -> int | None:
    """V / spacing^3, rounded up to two digits; None above `SENSIBLE`."""
    if spacing <= 0.0 or solid.volume / spacing**3 > SENSIBLE:
        return None
    count = solid.volume / spacing**3
    digit = 10.0 ** (np.floor(np.log10(count)) - 1.0)
    return int(np.ceil(count / digit) * digit)
