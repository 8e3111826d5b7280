"""Duplication of grid cells for each connected part of the solid in them.

Without it, adjacent limbs that share grid nodes would stick together (as in the virtual node
algorithm of Molino, Bao and Fedkiw 2004).  The parts in a cell are found from the patches of its
surface (`patches`): a cell with at most one patch has one part.  In other cells two patches bound
the same part where a segment from one of them, or from a particle, hits the other first.  Parts of
two cells with a common face are connected

- where a triangle that passes through the face has a patch of both, or
- where no triangle does and the face lies in the solid, or
- where shells that touch meet at the face, as two halves do whose seam is a plane of the grid.

These are all cases: the solid in a face is bounded by such triangles, or is the whole face.

Separate shells that share nodes with a body, such as a button in front of a shirt, are not
separated from it, nor are shells that touch.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import igl
import numpy as np
from scipy.sparse import coo_matrix

from gf_usd.core.arrays import Floats, Ints, cross
from gf_usd.core.frames.particles import CellCopies, Particles
from gf_usd.core.neighbors import components, kd_tree, node_copies
from gf_usd.geometry.connected.bodies import TOUCHING, spread
from gf_usd.geometry.connected.patches import Patches, Skins, find_patches, found
from gf_usd.geometry.solid import Solid
from gf_usd.geometry.winding import winding_inside

CELL = 2.0  # edge of a cell over the particle spacing
MOST_PATCHES = 24  # of a cell: a cell with more is treated as one part
WHOLE = 8  # particles of a full cell
MOST_SHELLS = 256  # pairs of shells in one cell: with more, all count as touching


@dataclass(frozen=True, kw_only=True)
class Limbs:
    """The copies of the cells of a solid, and the lookup of the copy of a point."""

    copies: CellCopies
    crowded: int  # cells with more than MOST_PATCHES, treated as one part
    _patches: Patches
    _piece: Ints  # (P,) copy of each row of the patches; -1: a part without particles
    _X: Floats  # (N, 3) [m] particles
    _corners: Floats  # (bodies, 3) [m]

    def of_points(self, X: Floats, body: Ints | None = None) -> Ints:
        """(n,) copy of points X (n, 3) [m]: the one behind the nearest triangle.

        body : (n,) the body of each; None: the first.
        """
        body = np.zeros(len(X), np.int64) if body is None else body
        row = self._patches.behind((X - self._corners[body]) / self.copies.h, body)
        out = np.where(row >= 0, self._piece[row], -1)
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
    body = particles.body_of
    bodies = int(max(of_surface.max(), body.max())) + 1
    corners = particles.corner if particles.corners is None else particles.corners
    corners = np.broadcast_to(np.asarray(corners, float), (bodies, 3))
    skins = Skins.of(solid, of_surface, corners, h)
    at = (particles.X - corners[body]) / h
    cell = np.floor(at).astype(np.int64)
    rows = find_patches(skins, cell, bodies)
    parts = _Parts(rows, at, rows.keys.of(cell, body), TOUCHING * particles.spacing / h)
    links = np.concatenate(
        [_through_triangles(rows, parts), _through_open_faces(rows, parts), parts.at_seams(rows)]
    )
    skins.release()
    count = len(parts.key)
    graph = coo_matrix((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(count,) * 2)
    whole = components(graph)[1]
    held = np.isin(whole, whole[parts.of])  # connected components that have particles
    number = np.where(held, np.cumsum(held) - 1, -1)
    links = number[links[held[links[:, 0]]]]
    of, key, whole = number[parts.of], parts.key[held], whole[held]
    ijk, body = rows.keys.ijk(key), rows.keys.body(key)
    # Bodies are offset from each other on the grid, so that they share no nodes.
    apart = ijk + np.outer(body * (rows.keys.dims[0] + 3), [1, 0, 0])
    node, _ = node_copies(apart, links, whole)
    full = np.unique(of)
    place = apart[full][:, None, :] + np.stack(np.unravel_index(np.arange(27), (3, 3, 3)), -1)
    place -= place.min((0, 1))
    key = np.ravel_multi_index(tuple(np.moveaxis(place, 2, 0)), tuple(place.max((0, 1)) + 1))
    if len(np.unique(node[full])) == len(np.unique(key)):  # as many nodes as grid positions
        return None
    return Limbs(
        copies=CellCopies(h=h, cell=ijk, body=body, links=links, of=of),
        crowded=parts.crowded,
        _patches=rows,
        _piece=number[parts.of_patch[rows.patch]],
        _X=particles.X,
        _corners=corners,
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
        crowd = many > MOST_PATCHES
        self.crowded = int(crowd.sum())
        several = (many > 1) & ~crowd
        by_cell = np.argsort(in_cell, kind="stable")
        start = np.cumsum(many) - many
        # Particles outside the solid hit no patch, and are assigned to the nearest one.
        _, of_cell, held = np.unique(cell, return_inverse=True, return_counts=True)
        doubtful = np.flatnonzero(np.where(cut >= 0, several[cut], held[of_cell.ravel()] < WHOLE))
        body = rows.keys.body(cell)
        outside = doubtful[~rows.skins.inside(X[doubtful], body[doubtful])]
        within = np.ones(len(X), bool)
        within[outside] = False
        full, at_full = np.unique(cell[(cut < 0) & within], return_inverse=True)
        # One part per cell, except cells with several patches: there one per patch, merged by
        # segment casts.  Numbering: patches, full cells, particles in cells of several patches.
        among = np.flatnonzero((cut >= 0) & several[cut] & within)
        base = patches + len(full)
        ends = [self._same_cell(by_cell, in_cell, crowd)]
        ends.append(
            self._visible_patches(rows, X[among], cut[among], by_cell, start, many) + [base, 0]
        )
        ends.append(self._mutually_visible(rows, first, by_cell, start, many, several))
        self._reach = touching
        self._met: dict[tuple[int, int], bool] = {}  # of two shells: whether they touch
        ends.append(_touching(rows, first, in_cell, several, self._touch))
        a, b = np.concatenate(ends).T
        count = base + len(among)
        label = components(coo_matrix((np.ones(len(a)), (a, b)), shape=(count, count)))[1]
        _, one, label = np.unique(label[:count], return_index=True, return_inverse=True)
        label = label.ravel()
        keys = np.concatenate([rows.key[first], full, cell[among]])
        self.key, self.of_patch = keys[one], label[:patches]
        of = np.empty(len(X), np.int64)
        of[(cut < 0) & within] = label[patches + at_full.ravel()]
        alone = (cut >= 0) & ~several[cut]
        of[alone] = label[by_cell[start[cut[alone]]]]
        of[among] = label[base:]
        if len(outside):
            near = rows.behind(X[outside], body[outside])
            for i in np.flatnonzero((rows.key[near] != cell[outside]) & (cut[outside] >= 0)):
                own = rows.in_cell[slice(*rows.cell_start[cut[outside[i]] + np.arange(2)])]
                apart = np.linalg.norm(rows.center[own] - X[outside[i]], axis=1)
                near[i] = own[int(np.argmin(apart))]
            of[outside] = label[rows.patch[near]]
        self.of = of

    def _touch(self, skins: Skins, one: int, other: int) -> bool:
        """Whether two shells overlap, or come within reach."""
        pair = min(one, other), max(one, other)
        if pair not in self._met:
            self._met[pair] = len(self._met) >= MOST_SHELLS or _meet(skins, *pair, self._reach)
        return self._met[pair]

    def at_seams(self, rows: Patches) -> Ints:
        """(k, 2) parts of neighboring cells whose shells touch, and meet at the common face."""
        skins, part = rows.skins, self.of_patch[rows.patch]
        inset = rows.center - rows.keys.ijk(rows.key)  # [cells] from the low faces of its cell
        ends: set[tuple[int, int]] = set()
        if not skins.shell.any():  # there is one
            return np.zeros((0, 2), np.int64)
        for axis, stride in enumerate(rows.keys.strides):
            low = inset[:, axis] <= self._reach
            high = inset[:, axis] >= 1.0 - self._reach
            both = np.intersect1d(rows.key[high] + stride, rows.key[low])
            sides = []
            for near, shift in ((high, stride), (low, 0)):
                at = np.flatnonzero(near & np.isin(rows.key + shift, both))
                made = [rows.key[at] + shift, skins.shell[rows.triangle[at]], part[at]]
                sides.append(np.unique(np.stack(made, 1), axis=0))
            behind = np.split(sides[1], np.unique(sides[1][:, 0], return_index=True)[1][1:])
            for key, shell, here in sides[0].tolist():
                for _, other, there in behind[int(np.searchsorted(both, key))].tolist():
                    if shell != other and self._touch(skins, shell, other):
                        ends.add((here, there))
        return np.array(sorted(ends), np.int64).reshape(-1, 2)

    @staticmethod
    def _same_cell(by_cell: Ints, in_cell: Ints, which: Ints) -> Ints:
        """(k, 2) consecutive patches of some cells."""
        cell = in_cell[by_cell]
        same = np.flatnonzero((cell[1:] == cell[:-1]) & which[cell[1:]])
        return np.stack([by_cell[same], by_cell[same + 1]], 1)

    @staticmethod
    def _visible_patches(
        rows: Patches, X: Floats, cell: Ints, by_cell: Ints, start: Ints, many: Ints
    ) -> Ints:
        """(k, 2) particles and the patches that segments from them to their cell's patches hit."""
        patches = many[cell]
        who = np.repeat(np.arange(len(X)), patches)
        turn = np.arange(len(who)) - np.repeat(np.cumsum(patches) - patches, patches)
        target = rows.largest[by_cell[start[cell[who]] + turn]]
        hit = rows.first_hit(X[who], target)
        return np.unique(np.stack([who, rows.patch[hit]], 1), axis=0)

    @staticmethod
    def _mutually_visible(
        rows: Patches, first: Ints, by_cell: Ints, start: Ints, many: Ints, several: Ints
    ) -> Ints:
        """(k, 2) pairs of patches with a segment between them that lies in the solid."""
        cells = np.flatnonzero(several)
        n = many[cells]
        cell = np.repeat(cells, n * n)
        turn = np.arange(len(cell)) - np.repeat(np.cumsum(n * n) - n * n, n * n)
        one, other = (by_cell[start[cell] + t] for t in np.divmod(turn, many[cell]))
        differ = one != other
        largest = rows.largest
        one, other = one[differ], other[differ]
        begin, end = largest[one], largest[other]
        a, b, c = np.moveaxis(rows.skins.points[rows.skins.triangles[rows.triangle[begin]]], 1, 0)
        inward = -cross(b - a, c - a)
        way = rows.center[end] - rows.center[begin]
        visible = (inward * way).sum(1) > 0.0
        begin, end, one = begin[visible], end[visible], one[visible]
        hit = rows.first_hit(rows.center[begin], end, besides=begin)
        return np.stack([one, rows.patch[hit]], 1)


def _touching(
    rows: Patches,
    first: Ints,
    in_cell: Ints,
    several: Ints,
    touch: Callable[[Skins, int, int], bool],
) -> Ints:
    """(k, 2) patches of one cell whose shells touch."""
    skins = rows.skins
    shell = skins.shell[rows.triangle[first]]
    patch = np.flatnonzero(several[in_cell])
    groups = np.unique(np.stack([in_cell[patch], shell[patch], patch], 1), axis=0)
    # The patches of each shell in a cell, in order of cells and shells.
    first_of = np.unique(groups[:, :2], axis=0, return_index=True)[1]
    patches = np.split(groups[:, 2], first_of[1:])
    _, start, count = np.unique(groups[first_of, 0], return_index=True, return_counts=True)
    shells = groups[first_of, 1].tolist()
    ends: list[tuple[int, int]] = []
    for k in np.flatnonzero(count > 1):
        for i, j in combinations(range(start[k], start[k] + count[k]), 2):
            if touch(skins, shells[i], shells[j]):
                a, b = patches[i].tolist(), patches[j].tolist()
                ends += [(p, b[0]) for p in a] + [(a[0], q) for q in b]
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
    """(k, 2) parts of neighboring cells that a triangle through their common face bounds."""
    out = []
    for stride in rows.keys.strides:
        beyond = rows.row(rows.triangle, rows.key + stride)
        here = np.flatnonzero(beyond >= 0)
        pair = rows.patch[np.stack([here, beyond[here]], 1)]
        out.append(parts.of_patch[pair])
    return np.unique(np.concatenate(out), axis=0)


def _through_open_faces(rows: Patches, parts: _Parts) -> Ints:
    """(k, 2) parts of neighboring cells whose common face lies in the solid, without triangles."""
    known = np.unique(parts.key)
    of_cell = np.argsort(parts.key, kind="stable")
    start = np.searchsorted(parts.key[of_cell], known)
    count = np.diff(np.append(start, len(parts.key)))
    cut = found(rows.cells, known, np.ones(len(known), bool))
    pairs, middles = [], []
    for axis, stride in enumerate(rows.keys.strides):
        beyond = found(known, known + stride, np.ones(len(known), bool))
        passed = rows.key[rows.row(rows.triangle, rows.key + stride) >= 0]
        here = np.flatnonzero((beyond >= 0) & ~np.isin(known, passed))
        pairs.append(np.stack([here, beyond[here]], 1))
        middles.append(rows.keys.ijk(known[here]) + 0.5 + 0.5 * np.eye(3)[axis])
    cells, middle = np.concatenate(pairs), np.concatenate(middles)
    # A face of a full cell lies in the solid.
    inside: Any = (cut[cells] < 0).any(1)
    between = ~inside
    body = rows.keys.body(known[cells[between, 0]])
    inside[between] = rows.skins.inside(middle[between], body)
    cells, middle = cells[inside], middle[inside]
    out = of_cell[start[cells]]
    for side in (0, 1):
        several = np.flatnonzero(count[cells[:, side]] > 1)
        if len(several):
            first = rows.in_cell[rows.cell_start[cut[cells[several, side]]]]
            hit = rows.first_hit(middle[several], rows.largest[rows.patch[first]])
            out[several, side] = parts.of_patch[rows.patch[hit]]
    return out
