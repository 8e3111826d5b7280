"""Cells copied for each connected part of the solid in them, so that near limbs share no nodes.

The parts of the solid in a cell are found from patches of its surface (`patches`): a cell that one
patch cuts, or none, has one part.  Elsewhere patches belong to one part where a segment from one,
or from a particle, hits the other first.  Parts of two cells with a common face are connected

- where a triangle that passes through the face has a patch of both, or
- where no triangle does and the face lies in the solid,

which is all there is: what of the solid is in a face is bounded by such triangles, or is the whole.

What is not connected anywhere, as a button that floats before a shirt, stays with what it shares
nodes with: it moves with its body.  So do shells that touch.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import igl
import numpy as np
from scipy.sparse import coo_matrix

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.frames import CellCopies, Particles
from gf_usd.core.neighbors import components, kd_tree, node_copies
from gf_usd.geometry.connected.bodies import TOUCHING, spread
from gf_usd.geometry.connected.patches import Patches, Skins, find_patches, found
from gf_usd.geometry.solid import Solid
from gf_usd.geometry.surface import barycentric
from gf_usd.geometry.winding import winding_inside

CELL = 2.0  # edge of a cell over the lattice's
MOST_PATCHES = 24  # of a cell: more are the surface of no limbs, and are taken as one
MOST_SHELLS = 256  # pairs that meet in cells: beyond it all count as touching


@dataclass(frozen=True, kw_only=True)
class Limbs:
    """The copies of the cells of a solid, and which copy a point of it rides on."""

    copies: CellCopies
    nodes: int  # copies of nodes beyond the first of each
    crowded: int  # cells of so many patches that they were taken as one
    _patches: Patches
    _piece: Ints  # (P,) copy of each row of the patches; -1: of none that holds particles
    _X: Floats  # (N, 3) [m] particles
    _corner: Floats

    def of_points(self, X: Floats, body: Ints | None = None) -> Ints:
        """(n,) the copies that points X (n, 3) [m] ride on: those behind their nearest triangles.

        body : (n,) the body that each rides on; None: the first.
        """
        body = np.zeros(len(X), np.int64) if body is None else body
        out = np.full(len(X), -1)
        h, rows, skins = self.copies.h, self._patches, self._patches.skins
        for k in np.unique(body):
            mine = np.flatnonzero(body == k)
            faces = np.flatnonzero(skins.body == k)
            if not len(faces):
                continue
            at = np.ascontiguousarray((X[mine] - self._corner) / h)
            triangles = np.ascontiguousarray(skins.triangles[faces], np.int64)
            seen: Any = igl.point_mesh_squared_distance(at, skins.points, triangles)
            _, hit, closest = seen
            triangle = faces[hit]
            corners = np.moveaxis(skins.points[skins.triangles[triangle]], 1, 0)
            weight = barycentric(closest, *corners)
            place = np.einsum("kna,nk->na", corners, weight)
            cell = np.floor(place).astype(np.int64)
            row = rows.row(triangle, rows.keys.of(cell, skins.body[triangle]))
            for i in np.flatnonzero(row < 0):  # rounding at the edge of a cell
                low, high = np.searchsorted(rows.triangle, [triangle[i], triangle[i] + 1])
                if high > low:
                    apart = np.linalg.norm(rows.center[low:high] - place[i], axis=1)
                    row[i] = low + int(np.argmin(apart))
            out[mine] = np.where(row >= 0, self._piece[row], -1)
        lost = np.flatnonzero(out < 0)
        for k in np.unique(body[lost]):
            mine = lost[body[lost] == k]
            theirs = np.flatnonzero(self.copies.body[self.copies.of] == k)
            near = kd_tree(self._X[theirs]).query(X[mine])[1]
            out[mine] = self.copies.of[theirs[near]]
        return out


def find_limbs(solid: Solid, particles: Particles, of_surface: Ints) -> Limbs | None:
    """The copies of cells of a solid and its particles; None where every node has one copy.

    of_surface : (S,) body of each surface, in the order of `Solid.surfaces`.
    """
    h = CELL * particles.lattice
    skins = Skins.of(solid, of_surface, particles.corner, h)
    at = (particles.X - particles.corner) / h
    body = np.zeros(len(at), np.int64) if particles.body is None else particles.body
    cell = np.floor(at).astype(np.int64)
    bodies = int(max(of_surface.max(), body.max())) + 1
    rows = find_patches(skins, cell, bodies)
    parts = _Parts(rows, at, rows.keys.of(cell, body), TOUCHING * particles.spacing / h)
    links = np.concatenate([_through_triangles(rows, parts), _through_open_faces(rows, parts)])
    count = len(parts.key)
    graph = coo_matrix((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(count,) * 2)
    whole = components(graph)[1]
    held = np.isin(whole, whole[parts.of])  # what no particle hangs on moves by the others
    number = np.where(held, np.cumsum(held) - 1, -1)
    links = number[links[held[links[:, 0]]]]
    of, key, whole = number[parts.of], parts.key[held], whole[held]
    ijk, body = rows.keys.ijk(key), key % bodies
    # Bodies share no nodes: they are set apart on the grid.
    apart = ijk + np.outer(body * (rows.keys.dims[0] + 3), [1, 0, 0])
    node, _ = node_copies(apart, links, whole)
    full = np.unique(of)
    place = apart[full][:, None, :] + np.stack(np.unravel_index(np.arange(27), (3, 3, 3)), -1)
    seen = np.unique(np.c_[node[full].ravel(), place.reshape(-1, 3)], axis=0)
    extra = len(seen) - len(np.unique(seen[:, 1:], axis=0))
    if not extra:
        return None
    return Limbs(
        copies=CellCopies(h=h, cell=ijk, body=body, links=links, of=of),
        nodes=extra,
        crowded=parts.crowded,
        _patches=rows,
        _piece=number[parts.of_patch[rows.patch]],
        _X=particles.X,
        _corner=particles.corner,
    )


class _Parts:
    """The connected parts of the solid in each cell."""

    key: Ints  # (K,) of the cell of each
    of: Ints  # (N,) part of each particle
    of_patch: Ints

    def __init__(self, rows: Patches, X: Floats, cell: Ints, touching: float) -> None:
        """X : (N, 3) [cells] particles; cell : (N,) their keys; touching : [cells] of shells."""
        patches = int(rows.patch.max()) + 1
        first = np.unique(rows.patch, return_index=True)[1]
        in_cell = np.searchsorted(rows.cells, rows.key[first])  # of each patch
        many = np.bincount(in_cell, minlength=len(rows.cells))
        cut = found(rows.cells, cell, np.ones(len(cell), bool))
        full, at_full = np.unique(cell[cut < 0], return_inverse=True)
        # One part a cell, but where several patches cut it: there one a patch, joined by what is
        # seen.  Numbers: patches, full cells, particles among several patches.
        crowd = many > MOST_PATCHES
        self.crowded = int(crowd.sum())
        several = (many > 1) & ~crowd
        by_cell = np.argsort(in_cell, kind="stable")
        start = np.cumsum(many) - many
        ends = [self._same_cell(by_cell, in_cell, crowd)]
        among = np.flatnonzero((cut >= 0) & several[cut])
        base = patches + len(full)
        ends.append(self._seen(rows, X[among], cut[among], by_cell, start, many) + [base, 0])
        ends.append(self._facing(rows, first, by_cell, start, many, several))
        ends.append(_touching(rows, first, in_cell, several, touching))
        a, b = np.concatenate(ends).T
        count = base + len(among)
        label = components(coo_matrix((np.ones(len(a)), (a, b)), shape=(count, count)))[1]
        _, one, label = np.unique(label[:count], return_index=True, return_inverse=True)
        label = label.ravel()
        keys = np.concatenate([rows.key[first], full, cell[among]])
        self.key, self.of_patch = keys[one], label[:patches]
        of = np.empty(len(X), np.int64)
        of[cut < 0] = label[patches + at_full.ravel()]
        alone = (cut >= 0) & ~several[cut]
        of[alone] = label[by_cell[start[cut[alone]]]]
        of[among] = label[base:]
        self.of = of

    @staticmethod
    def _same_cell(by_cell: Ints, in_cell: Ints, which: Ints) -> Ints:
        """Pairs of patches, one after the other, of some cells."""
        cell = in_cell[by_cell]
        same = np.flatnonzero((cell[1:] == cell[:-1]) & which[cell[1:]])
        return np.stack([by_cell[same], by_cell[same + 1]], 1)

    @staticmethod
    def _seen(rows: Patches, X: Floats, cell: Ints, by_cell: Ints, start: Ints, many: Ints) -> Ints:
        """(k, 2) particle and patch that it sees, looking at every patch of its cell."""
        looks = many[cell]
        who = np.repeat(np.arange(len(X)), looks)
        turn = np.arange(len(who)) - np.repeat(np.cumsum(looks) - looks, looks)
        target = _largest(rows)[by_cell[start[cell[who]] + turn]]
        hit = rows.first_hit(X[who], target)
        return np.unique(np.stack([who, rows.patch[hit]], 1), axis=0)

    @staticmethod
    def _facing(
        rows: Patches, first: Ints, by_cell: Ints, start: Ints, many: Ints, several: Ints
    ) -> Ints:
        """(k, 2) patches of which one sees the other through the solid."""
        cells = np.flatnonzero(several)
        n = many[cells]
        cell = np.repeat(cells, n * n)
        turn = np.arange(len(cell)) - np.repeat(np.cumsum(n * n) - n * n, n * n)
        one, other = (by_cell[start[cell] + t] for t in np.divmod(turn, many[cell]))
        differ = one != other
        largest = _largest(rows)
        one, other = one[differ], other[differ]
        begin, end = largest[one], largest[other]
        a, b, c = np.moveaxis(rows.skins.points[rows.skins.triangles[rows.triangle[begin]]], 1, 0)
        inward = -np.cross(b - a, c - a)
        way = rows.center[end] - rows.center[begin]
        sees = (inward * way).sum(1) > 0.0
        begin, end, one = begin[sees], end[sees], one[sees]
        hit = rows.first_hit(rows.center[begin], end, besides=begin)
        return np.stack([one, rows.patch[hit]], 1)


def _largest(rows: Patches) -> Ints:
    """(patches,) a row of each patch, the one whose triangle has the largest piece in the cell."""
    a, b, c = np.moveaxis(rows.skins.points[rows.skins.triangles[rows.triangle]], 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    order = np.lexsort([-area, rows.patch])
    return order[np.unique(rows.patch[order], return_index=True)[1]]


def _touching(rows: Patches, first: Ints, in_cell: Ints, several: Ints, reach: float) -> Ints:
    """(k, 2) patches of one cell whose shells overlap, or are within reach [cells] somewhere."""
    skins = rows.skins
    shell = skins.shell[rows.triangle[first]]
    patch = np.flatnonzero(several[in_cell])
    groups = np.unique(np.stack([in_cell[patch], shell[patch], patch], 1), axis=0)
    # One patch of each shell in a cell, with one of each other.
    one = groups[np.unique(groups[:, :2], axis=0, return_index=True)[1]]
    cells, count = np.unique(one[:, 0], return_counts=True)
    ends: list[tuple[int, int]] = []
    met: dict[tuple[int, int], bool] = {}
    for cell in cells[count > 1]:
        mine = one[one[:, 0] == cell]
        for i in range(len(mine)):
            for j in range(i + 1, len(mine)):
                pair = (int(mine[i, 1]), int(mine[j, 1]))
                if pair not in met:
                    met[pair] = len(met) >= MOST_SHELLS or _meet(skins, *pair, reach)
                if met[pair]:
                    a = groups[(groups[:, 0] == cell) & (groups[:, 1] == pair[0]), 2]
                    b = groups[(groups[:, 0] == cell) & (groups[:, 1] == pair[1]), 2]
                    ends += [(int(p), int(b[0])) for p in a] + [(int(a[0]), int(q)) for q in b]
    return np.array(ends, np.int64).reshape(-1, 2)


def _meet(skins: Skins, one: int, other: int, reach: float) -> bool:
    """Whether two shells overlap, or come within reach [cells] of each other."""
    faces = [np.ascontiguousarray(skins.triangles[skins.shell == k]) for k in (one, other)]
    for mine, theirs in (faces, faces[::-1]):
        X = np.concatenate([skins.points[np.unique(mine)], spread(skins.points, mine, 0.5)])
        corners = skins.points[theirs.ravel()]
        low, high = corners.min(0) - reach, corners.max(0) + reach
        near = ((low <= X) & (high >= X)).all(1)
        X = np.ascontiguousarray(X[near])
        if not len(X):
            continue
        squared = np.asarray(igl.point_mesh_squared_distance(X, skins.points, theirs)[0])
        if squared.min() <= reach**2 or winding_inside(skins.points, theirs, X).any():
            return True
    return False


def _through_triangles(rows: Patches, parts: _Parts) -> Ints:
    """(k, 2) parts that a triangle bounds on both sides of a common face."""
    out = []
    for stride in rows.keys.strides:
        beyond = rows.row(rows.triangle, rows.key + stride)
        here = np.flatnonzero(beyond >= 0)
        pair = rows.patch[np.stack([here, beyond[here]], 1)]
        out.append(parts.of_patch[pair])
    return np.unique(np.concatenate(out), axis=0)


def _through_open_faces(rows: Patches, parts: _Parts) -> Ints:
    """(k, 2) parts of cells whose common face no triangle passes and lies in the solid."""
    known = np.unique(parts.key)
    of_cell = np.argsort(parts.key, kind="stable")
    start = np.searchsorted(parts.key[of_cell], known)
    count = np.diff(np.append(start, len(parts.key)))
    cut = found(rows.cells, known, np.ones(len(known), bool))
    largest = _largest(rows)
    out = []
    for axis, stride in enumerate(rows.keys.strides):
        beyond = found(known, known + stride, np.ones(len(known), bool))
        here = np.flatnonzero(beyond >= 0)
        there = beyond[here]
        passed = rows.row(rows.triangle, rows.key + stride) >= 0
        open_ = ~np.isin(known[here], rows.key[passed])
        here, there = here[open_], there[open_]
        both_cut = (cut[here] >= 0) & (cut[there] >= 0)
        middle = rows.keys.ijk(known[here]) + 0.5 + 0.5 * np.eye(3)[axis]
        inside = ~both_cut
        if both_cut.any():
            inside[both_cut] = rows.skins.inside(middle[both_cut])
        here, there, middle = here[inside], there[inside], middle[inside]
        pair = np.empty((len(here), 2), np.int64)
        for side, cell in enumerate((here, there)):
            pair[:, side] = of_cell[start[cell]]
            look = np.flatnonzero(count[cell] > 1)
            if len(look):
                target = rows.in_cell[rows.cell_start[cut[cell[look]]]]
                hit = rows.first_hit(middle[look], largest[rows.patch[target]])
                pair[look, side] = parts.of_patch[rows.patch[hit]]
        out.append(pair)
    return np.concatenate(out)
