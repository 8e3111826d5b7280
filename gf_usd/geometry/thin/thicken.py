"""Thickening: shells too thin for a layer of particles become one spacing thick in the simulation.

The authored meshes, which are rendered, do not change.  Open sheets are offset to both sides,
closed shells outward (`thicken_asset`).  `choose_shells` finds the shells to thicken, and the
spacing where only the number of particles is given.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_matrix

from gf_usd.core.arrays import Floats, Ints, cross
from gf_usd.core.asset import Asset, Surface
from gf_usd.core.errors import InputError
from gf_usd.core.mesh.measures import areas, signed_volume
from gf_usd.core.mesh.topology import Edges
from gf_usd.core.neighbors import components
from gf_usd.geometry import winding
from gf_usd.geometry.repair import Repairs
from gf_usd.geometry.sampling.particles import LEAST_PARTICLES, count_particles
from gf_usd.geometry.solid import FLAT_FRACTION, OPEN_FRACTION, build_solid, hole_fraction
from gf_usd.geometry.thin.parts import THIN

MITRE = 2.0  # length limit of the offset that moves all faces around a vertex by 1
SHARP = 0.1  # of the greatest eigenvalue: pseudo-inverse cutoff in `offsets`
LAYER = 0.97  # [spacings] thickness: a flat sheet stays within one layer in spite of rounding
POOR = 0.25  # of the expected volume: below it the offset surface is rejected


COUNTED = 20_000  # particles up to which they are counted; beyond, the ratio is the same
TRIES = 6  # iterations of the search for a spacing
NEAR_ENOUGH = 0.05  # relative tolerance of the number of particles


def thicken_to_count(
    asset: Asset, repairs: Sequence[Repairs], particles: int
) -> tuple[Asset, tuple[Repairs, ...], float | None]:
    """`thicken_asset` at the spacing [m] that gives the requested number of particles.

    The spacing is searched for by counting: cells that a sheet crosses have as many particles as
    full ones, so that a sheet has two to four times volume / spacing^3, depending on its position
    in the grid.  The spacing is None where nothing is thickened or nothing can be filled.
    """
    wanted = min(particles, COUNTED)
    shells = _shells_by_surface(asset)
    best: tuple[float, float] | None = None  # error, and the number to request
    tried, least = float(wanted), None
    low, high = 0.0, np.inf  # requested numbers that give too few, too many
    for _ in range(TRIES):
        filled, done = _thickened(asset, repairs, shells, spacing=None, particles=round(tried))
        thick = sum(one.thickened for one in done)
        if least is None:
            least = thick
        if not thick or thick < least:  # so few particles that a sheet is too small for them
            break
        try:
            solid = build_solid(filled, repaired=True)
        except InputError:  # the step that fills it reports the fault
            break
        spacing = max(one.thickness for one in done) / LAYER
        count = count_particles(solid, spacing, asset.facts.up_axis)
        off = abs(np.log(max(count, 1) / wanted))
        if best is None or off < best[0]:
            best = off, tried
        if off <= NEAR_ENOUGH:
            break
        low, high = (max(low, tried), high) if count < wanted else (low, min(high, tried))
        tried *= wanted / max(count, 1)
        if not low < tried < high:  # a sheet then crosses one more layer of cells
            tried = float(np.sqrt(low * high))
    if best is None:
        filled, done = _thickened(asset, repairs, shells, spacing=None, particles=particles)
        return filled, done, None
    tried = best[1] * particles / wanted
    filled, done = _thickened(asset, repairs, shells, spacing=None, particles=round(tried))
    thickness = max(one.thickness for one in done)
    return filled, done, thickness / LAYER if thickness else None


def thicken_asset(
    asset: Asset, repairs: Sequence[Repairs], *, spacing: float | None, particles: int
) -> tuple[Asset, tuple[Repairs, ...]]:
    """The asset to be filled, with thickened shells, and its repairs with their numbers.

    Open or flat shells, and closed ones thinner than `parts.THIN` spacings, become one spacing
    thick (`LAYER`).

    asset : repaired by `repair_asset`.
    spacing : [m]; None: chosen so that about `particles` fill the asset.
    """
    shells = _shells_by_surface(asset)
    return _thickened(asset, repairs, shells, spacing=spacing, particles=particles)


def _shells_by_surface(asset: Asset) -> dict[int, Shells]:
    """The shells of each mesh with faces, by its row in `Asset.surfaces`."""
    meshes = ((k, s) for k, s in enumerate(asset.surfaces) if s.splats is None)
    return {k: shells_of(s) for k, s in meshes if len(s.triangles)}


def _thickened(
    asset: Asset,
    repairs: Sequence[Repairs],
    shells: Mapping[int, Shells],
    *,
    spacing: float | None,
    particles: int,
) -> tuple[Asset, tuple[Repairs, ...]]:
    """`thicken_asset` of known shells."""
    a, chosen = choose_shells(list(shells.values()), spacing, particles)
    surfaces, done = list(asset.surfaces), list(repairs)
    for (k, one), which in zip(shells.items(), chosen):
        surfaces[k], thick = _thicken(surfaces[k], one, which, LAYER * a)
        left = int((one.sheet * (1 - one.enclosed)).sum()) - int(one.sheet @ thick)
        done[k] = replace(
            done[k],
            thickened=int(thick.sum()),
            thickness=LAYER * a if thick.any() else 0.0,
            thin_left=left,
        )
    return replace(asset, surfaces=tuple(surfaces)), tuple(done)


def _thicken(surface: Surface, seen: Shells, which: Ints, a: float) -> tuple[Surface, Ints]:
    """The surface with the shells `which` (K,) made a [m] thick; (K,) 1 for those that were."""
    done = np.zeros(len(which), int)
    if not which.any():
        return surface, done
    points, triangles, corners = [surface.points], [], []
    first = len(surface.points)
    corner = 3 * seen.source[:, None] + np.arange(3)  # flat indices into Surface.triangles
    patch = winding.patches(surface.points, seen.triangles, Edges.of(seen.triangles))
    rows_of = winding.rows_of(seen.label)
    for k in np.flatnonzero(which):
        made = _thick_shell(surface.points, seen, rows_of[k], patch, a)
        done[k] = len(made) > 0
        for X, faces, at in made:
            points.append(X)
            triangles.append(first + faces)
            corners.append(corner.reshape(-1)[at])
            first += len(X)
    kept = done[seen.label] == 0
    triangles.append(seen.triangles[kept])
    corners.append(corner[kept])
    slot = np.concatenate(corners)
    made_of = replace(
        surface, points=np.concatenate(points), triangles=np.concatenate(triangles),
        triangle_corners=surface.triangle_corners.reshape(-1)[slot],
    )  # fmt: skip
    colors, uvs, bound = (
        surface.triangle_colors, surface.triangle_uvs, surface.triangle_materials,
    )  # fmt: skip
    return replace(
        made_of,
        triangle_colors=None if colors is None else colors.reshape(-1, 3)[slot],
        triangle_uvs=None if uvs is None else uvs.reshape(-1, 2)[slot],
        triangle_materials=None if bound is None else bound[slot[:, 0] // 3],
    ), done


def _thick_shell(
    points: Floats, seen: Shells, rows: Ints, patch: winding.Patches, a: float
) -> list[tuple[Floats, Ints, Ints]]:
    """A shell made a [m] thick, in pieces: points, triangles, corners (in `seen.triangles`).

    Empty where the offset surfaces enclose too little volume (`POOR`).
    """
    k = int(seen.label[rows[0]])
    if seen.sheet[k] and seen.rim[k]:
        # At non-manifold edges, each patch is thickened separately; the results overlap.
        label = patch.label[rows]
        parts = [rows[label == p] for p in np.unique(label)]
        made = [
            _offset_both_sides(points, seen, one, a, bool(patch.one_sided[one[0]])) for one in parts
        ]
    else:
        way = float(np.sign(seen.volume[k]))
        grow = 0.5 * way * (a - float(seen.thickness[k]))
        made = [_offset_outward(points, seen, rows, grow)]
    volume = sum(abs(signed_volume(X, faces)) for X, faces, _ in made)
    return made if volume >= POOR * float(seen.extent[k]) * a else []


def _offset_both_sides(
    points: Floats, seen: Shells, rows: Ints, a: float, one_sided: bool
) -> tuple[Floats, Ints, Ints]:
    """The solid between the two offsets of a sheet by a / 2, closed along its boundary edges.

    A one-sided sheet has a single offset: that of its orientation double cover.
    """
    used, local = np.unique(seen.triangles[rows], return_inverse=True)
    local, n = local.reshape(-1, 3), len(used)
    edges = Edges.of(local)
    if one_sided:
        front, back, vertex = _double_cover(local, edges)
        X = points[used[vertex]]
        X = X + 0.5 * a * offsets(X, np.concatenate([front, back[:, ::-1]]))
    else:
        front, back = local, n + local
        offset = 0.5 * a * offsets(points[used], local)
        X = np.concatenate([points[used] + offset, points[used] - offset])
    slot = 3 * rows[:, None] + np.arange(3)
    here = np.flatnonzero(edges.uses[edges.id] != 2)
    there = here - here % 3 + (here + 1) % 3
    at, to = front.reshape(-1)[here], front.reshape(-1)[there]
    back_at, back_to = back.reshape(-1)[here], back.reshape(-1)[there]
    at_slot, to_slot = slot.reshape(-1)[here], slot.reshape(-1)[there]
    return (
        X,
        np.concatenate(
            [
                front,
                back[:, ::-1],
                np.stack([to, at, back_at], 1),
                np.stack([to, back_at, back_to], 1),
            ]
        ),
        np.concatenate(
            [
                slot,
                slot[:, ::-1],
                np.stack([to_slot, at_slot, at_slot], 1),
                np.stack([to_slot, at_slot, to_slot], 1),
            ]
        ),
    )


def _double_cover(triangles: Ints, edges: Edges) -> tuple[Ints, Ints, Ints]:
    """Corners (T, 3) of the triangles and of their copies that are to be reversed, and the vertex
    (V,) of each corner's number.

    Copies of neighbors are connected as in `winding.patches`: across an edge that both traverse in
    the same direction, a triangle is connected to the other's reversed copy.
    """
    count = triangles.size
    one, two = edges.pairs.T
    clash = edges.directed[one, 0] == edges.directed[two, 0]
    next_one, next_two = (k - k % 3 + (k + 1) % 3 for k in (one, two))
    rows = np.concatenate([one, next_one])
    columns = np.concatenate([np.where(clash, two, next_two), np.where(clash, next_two, two)])
    other = np.where(np.tile(clash, 2), count, 0)
    rows, columns = (
        np.concatenate([rows, rows + count]),
        np.concatenate([columns + other, columns + count - other]),
    )
    graph = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(2 * count, 2 * count))
    number, label = components(graph)
    vertex = np.empty(number, np.int64)
    vertex[label] = np.tile(triangles.reshape(-1), 2)
    front, back = label.reshape(2, -1, 3)
    return front, back, vertex


def _offset_outward(
    points: Floats, seen: Shells, rows: Ints, grow: float
) -> tuple[Floats, Ints, Ints]:
    """A closed shell offset along its normals by grow [m]."""
    used, local = np.unique(seen.triangles[rows], return_inverse=True)
    local = local.reshape(-1, 3)
    X = points[used] + grow * offsets(points[used], local)
    return X, local, 3 * rows[:, None] + np.arange(3)


def offsets(points: Floats, triangles: Ints) -> Floats:
    """(V, 3) vertex offsets o that move the faces around each vertex by 1 along their normals.

    The least-squares solution of n . o = 1 over the faces, weighted by their areas A: o = M^+ r
    with M = sum A n n^T and r = sum A n, without eigenvalues of M below `SHARP` of the greatest.
    Lengths are limited to `MITRE`.
    """
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    normal = cross(b - a, c - a)
    size = np.linalg.norm(normal, axis=1)
    unit = normal / np.where(size > 0.0, size, 1.0)[:, None]
    M, r = np.zeros((len(points), 3, 3)), np.zeros((len(points), 3))
    for k in range(3):
        np.add.at(M, triangles[:, k], np.einsum("ti,tj->tij", normal, unit))
        np.add.at(r, triangles[:, k], normal)
    value, axis = np.linalg.eigh(M)
    real = (value > SHARP * value[:, -1:]) & (value > 0.0)
    along = np.einsum("vij,vi->vj", axis, r)
    o = np.einsum("vij,vj->vi", axis, np.where(real, along / np.where(real, value, 1.0), 0.0))
    length = np.linalg.norm(o, axis=1, keepdims=True)
    return o * np.minimum(1.0, MITRE / np.where(length > 0.0, length, 1.0))


PROBES = 16  # vertices of a sheet that are tested to lie inside another shell
ROUNDS = 16  # fixed-point iterations of `choose_shells`


@dataclass(frozen=True, kw_only=True)
class Shells:
    """Area, volume and boundary of the K shells of one surface."""

    triangles: Ints  # (T, 3) welded, without collapsed triangles
    source: Ints  # (T,) row in Surface.triangles of each
    label: Ints  # (T,) shell of each
    area: Floats  # (K,) [m^2]
    volume: Floats  # (K,) [m^3] signed: negative for a cavity
    sheet: Ints  # (K,) 1 where it encloses no volume: open, or flat
    rim: Ints  # (K,) number of boundary edges
    enclosed: Ints  # (K,) 1 for a sheet inside the solid of another shell, and for a cavity

    @property
    def thickness(self) -> Floats:
        """(K,) [m] 2 V / A; 0 for sheets with boundary edges."""
        open_ = (self.sheet == 1) & (self.rim > 0)
        area = np.where(self.area > 0.0, self.area, 1.0)
        return np.where(open_, 0.0, 2.0 * np.abs(self.volume) / area)

    @property
    def extent(self) -> Floats:
        """(K,) [m^2] one-sided area: half of the area of a shell without boundary edges."""
        return np.where((self.sheet == 1) & (self.rim > 0), self.area, 0.5 * self.area)

    def thin(self, spacing: float) -> Ints:
        """(K,) 1 for shells to thicken: too thin for a layer of particles at a spacing [m], and
        large enough for `LEAST_PARTICLES` once they are one spacing thick.
        """
        few = (self.thickness < THIN * spacing) & (self.enclosed == 0)
        return (few & (self.extent >= LEAST_PARTICLES * spacing**2)).astype(int)


def shells_of(surface: Surface) -> Shells:
    """The shells of a surface of consistent winding."""
    points, welded = surface.points, surface.welded
    source, triangles, label = welded.source, welded.triangles, welded.shell
    count = int(label.max(initial=-1)) + 1
    area = np.bincount(label, areas(points, triangles), count)
    volume = winding.volumes(points, triangles, label) if count else np.zeros(0)
    sheet = (np.abs(volume) <= FLAT_FRACTION * area**1.5).astype(int)
    rows = winding.rows_of(label) if count else []
    rim = np.bincount(label[Edges.of(triangles).boundary // 3], minlength=count)
    for k in np.flatnonzero((rim > 0) & (sheet == 0)):
        used, local = np.unique(triangles[rows[k]], return_inverse=True)
        sheet[k] = hole_fraction(points[used], local.reshape(-1, 3)) > OPEN_FRACTION
    held = np.zeros(count, int)
    solid = triangles[sheet[label] == 0]
    if len(solid):
        held[(sheet == 0) & (volume < 0.0)] = 1
        if len(sheets := np.flatnonzero(sheet)):
            corners = [np.unique(triangles[rows[k]]) for k in sheets]
            probes = [c[:: max(1, len(c) // PROBES)] for c in corners]
            start = np.cumsum([0, *map(len, probes[:-1])])
            inside = winding.winding_inside(points, solid, points[np.concatenate(probes)])
            held[sheets] = np.logical_and.reduceat(inside, start)
    return Shells(
        triangles=triangles, source=source, label=label, area=area, volume=volume, sheet=sheet,
        rim=rim, enclosed=held,
    )  # fmt: skip


def choose_shells(
    seen: list[Shells], spacing: float | None, particles: int
) -> tuple[float, list[Ints]]:
    """The spacing a [m], and (K,) 1 for the shells of each surface to thicken to it.

    Without a spacing, a is the solution of V + S a = N a^3 for N particles, with V the volume of
    the shells that are not thickened and S the extent of those that are; by fixed-point iteration,
    since the choice of shells depends on a.  a = 0: there is nothing to fill.
    """
    if spacing is not None:
        return spacing, [one.thin(spacing) for one in seen]
    chosen = [one.sheet * (1 - one.enclosed) for one in seen]
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
    """The root a >= 0 of N a^3 = V + S a, by Newton's method from an upper bound."""
    a = float(np.cbrt(V / N) + np.sqrt(S / N))
    for _ in range(60):
        slope = 3.0 * N * a * a - S
        if slope <= 0.0:
            break
        a -= (N * a**3 - S * a - V) / slope
    return a
