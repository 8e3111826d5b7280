"""Faces that are there more than once: duplicates, walls back to back, surfaces with two sides."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gf_usd.geometry.edges import Edges
from gf_usd.model import Ints, Surface
from gf_usd.nearby import components
from gf_usd.sparse import coo_matrix

Flags = NDArray[np.bool_]

SINGLE, DUPLICATE, WALL, OTHER_SIDE = range(4)


def authored_faces(surface: Surface) -> Ints:
    """(T,) the authored face that each of `Surface.triangles` was cut from."""
    ends = np.cumsum(surface.face_counts)
    return np.searchsorted(ends, surface.triangle_corners[:, 0], side="right")


def doubled(triangles: Ints, face: Ints) -> Ints:
    """(T,) what makes a triangle superfluous as the fill sees it; SINGLE where nothing does.

    DUPLICATE : one that faces the same way, or more of them, is there too.
    WALL : as many face one way as the other, so that they cancel: both go.
    OTHER_SIDE : so too, but without them the rest would be open or gone (a surface that was
    modelled with both its sides): one side stays.

    Whole faces (T,) are compared by their outlines, since a quad and its reverse may be cut along
    different diagonals; then what is left, triangle by triangle.
    """
    kind = np.full(len(triangles), SINGLE)
    for one in (face, np.arange(len(triangles))):
        left = np.flatnonzero(kind == SINGLE)
        if len(left):
            kind[left] = _doubled(triangles[left], np.unique(one[left], return_inverse=True)[1])
    return kind


def _doubled(triangles: Ints, face: Ints) -> Ints:
    """As `doubled`, for faces numbered from 0."""
    edges = Edges.of(triangles)
    group, odd = _outlines(edges, face)
    ahead, back = np.bincount(group, ~odd), np.bincount(group, odd)
    kind = np.full(len(group), SINGLE)
    if (ahead + back == 1).all():
        return kind[face]
    balanced = (ahead == back)[group]
    wanted = balanced | ((back > ahead)[group] == odd)
    mine = np.flatnonzero(wanted)
    first = np.zeros(len(group), bool)
    first[mine[np.unique(group[mine], return_index=True)[1]]] = True
    kind[~first] = DUPLICATE
    kind[balanced] = WALL
    two_sided = balanced & _needed(edges, face, balanced)
    kind[two_sided] = OTHER_SIDE
    kind[two_sided & first] = SINGLE
    return kind[face]


def _outlines(edges: Edges, face: Ints) -> tuple[Ints, Flags]:
    """(F,) a number for each outline, and whether it is run through the other way.

    An outline is the set of edges that one triangle of the face has alone.
    """
    of = np.repeat(face, 3)
    _, at, uses = np.unique(
        of * len(edges.uses) + edges.id, return_inverse=True, return_counts=True
    )
    rim = np.flatnonzero(uses[at.reshape(-1)] == 1)
    rim = rim[np.lexsort((edges.id[rim], of[rim]))]
    count = np.bincount(of[rim], minlength=int(face.max()) + 1)
    start = np.cumsum(count) - count
    group = np.arange(len(count))  # a face without an outline is like no other
    odd = np.zeros(len(count), bool)
    for n in np.unique(count[count > 0]):
        rows = np.flatnonzero(count == n)
        halves = rim[start[rows][:, None] + np.arange(n)]
        _, first, same = np.unique(edges.id[halves], axis=0, return_index=True, return_inverse=True)
        group[rows] = rows[first[same.reshape(-1)]]
        lowest = edges.directed[halves[:, 0]]
        odd[rows] = lowest[:, 0] > lowest[:, 1]
    return group, odd


def _needed(edges: Edges, face: Ints, balanced: Flags) -> Flags:
    """(F,) balanced faces of which one side must stay.

    Of a connected set of them the rim decides.  Edges that the rest uses an odd number of times
    would be left open without it; where the rest uses them an even number of times it hangs on
    a surface that is whole.  A set without either is all there is of its shell.
    """
    double = balanced[face]
    slot = np.repeat(double, 3)
    rest = np.bincount(edges.id[~slot], minlength=len(edges.uses))
    n = len(face)
    mine = np.flatnonzero(slot)
    graph = coo_matrix(
        (np.ones(len(mine), np.int8), (mine // 3, n + edges.id[mine])),
        shape=(n + len(edges.uses),) * 2,
    )
    part = components(graph)[1][:n]
    met = rest[edges.id[mine]]
    size = int(part.max()) + 1
    opened = np.bincount(part[mine // 3], met % 2 == 1, size)
    whole = np.bincount(part[mine // 3], (met > 0) & (met % 2 == 0), size)
    needed = (opened > whole) | ((opened == 0) & (whole == 0))
    out = np.zeros(len(balanced), bool)
    out[face[double & needed[part]]] = True
    return out
