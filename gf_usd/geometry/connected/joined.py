"""Meshes that bound one volume together, such as a bottle that was split by its materials.

Converters write one mesh for each material of an object, and terrain is often one mesh for each
kind of ground.  Each of them is open where the next one begins, so that none has an inside, or only
one that a flat cap would close.  Their borders coincide: edges of one triangle each in two meshes.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import NO_COLOR, Asset, Surface
from gf_usd.core.errors import listed_paths
from gf_usd.core.mesh.measures import areas
from gf_usd.core.mesh.topology import weld
from gf_usd.geometry.connected.merged import corner_values, material_rows, starts
from gf_usd.geometry.solid import closed_triangles

Alike = Callable[[str, str], bool]  # whether meshes of two prim paths may be parts of one


@dataclass(frozen=True, kw_only=True)
class Joined:
    """An asset whose surfaces of one volume are one surface."""

    asset: Asset
    groups: tuple[tuple[str, ...], ...] = ()  # prim paths; the first is that of their surface
    against: frozenset[str] = frozenset()  # paths of parts of opposite winding

    @property
    def notes(self) -> tuple[str, ...]:
        """One on each group."""
        return tuple(
            f"{len(paths)} meshes share borders and enclose a volume only together: they are filled"
            f" as one body: {listed_paths(paths)}"
            for paths in self.groups
        )


def joined_alike(asset: Asset, found: Joined) -> Asset:
    """The asset with the groups joined that were found in it with another winding."""
    order = {s.path: k for k, s in enumerate(asset.surfaces)}
    made: dict[str, Surface | None] = {}
    for paths in found.groups:
        group = [asset.surfaces[k] for k in sorted(order[path] for path in paths)]
        against = np.array([s.path in found.against for s in group])
        made |= dict.fromkeys(paths) | {paths[0]: _one_surface(group, against)}
    return _with_surfaces(asset, made)


def _with_surfaces(asset: Asset, made: Mapping[str, Surface | None]) -> Asset:
    """The asset with other surfaces at some prim paths; None: without them."""
    kept = (made.get(s.path, s) for s in asset.surfaces)
    return replace(asset, surfaces=tuple(s for s in kept if s is not None))


def joined_surfaces(
    asset: Asset, apart: Collection[str] = (), alike: Alike | None = None
) -> Joined:
    """Join open meshes with common borders where they enclose a volume only together.

    At least one of them has none by itself, and all of them are together as closed as a mesh must
    be to be filled.  Meshes of different components are not joined.

    apart : prim paths of meshes that are not joined; alike : of the others, None: all are.
    """
    pieces, edges = _open_pieces(asset.surfaces, apart)
    without_volume = {s.path for s in pieces if closed_triangles(s)[2]}
    if len(pieces) < 2 or not without_volume:
        return Joined(asset=asset)
    made: dict[str, Surface | None] = {}
    groups = []
    reverse: set[str] = set()
    for members, against in _adjacent(pieces, edges, alike):
        group = [pieces[k] for k in members]
        if without_volume.isdisjoint(s.path for s in group):
            continue
        one = _one_surface(group, against)
        if closed_triangles(one)[2]:
            continue
        made |= {s.path: None for s in group} | {one.path: one}
        groups.append((one.path, *(s.path for s in group if s.path != one.path)))
        reverse |= {s.path for s, back in zip(group, against, strict=True) if back}
    return Joined(
        asset=_with_surfaces(asset, made), groups=tuple(groups), against=frozenset(reverse)
    )


def bordering(surfaces: Sequence[Surface], paths: Collection[str]) -> set[str]:
    """Prim paths of the open meshes that common borders connect to meshes, and those of these."""
    pieces, edges = _open_pieces(surfaces)
    found: set[str] = set()
    if len(pieces) > 1:
        for members, _ in _adjacent(pieces, edges, None):
            group = {pieces[k].path for k in members}
            found |= set() if group.isdisjoint(paths) else group
    return found


def _open_pieces(
    surfaces: Sequence[Surface], apart: Collection[str] = ()
) -> tuple[list[Surface], list[Ints]]:
    """The meshes that may be parts of one, and the (E, 2) directed border edges of each."""
    pieces = [
        s
        for s in surfaces
        if s.type_name == "Mesh" and s.splats is None and s.own_points is None
        and s.path not in apart
    ]  # fmt: skip
    if len(pieces) < 2:
        return [], []
    found = [(s, s.welded.boundary) for s in pieces]
    return [s for s, e in found if len(e)], [e for _, e in found if len(e)]


def _adjacent(
    pieces: Sequence[Surface], edges: Sequence[Ints], alike: Alike | None
) -> list[tuple[list[int], NDArray[np.bool_]]]:
    """Groups of pieces that common border edges connect, and which members have opposite winding
    than the first.

    edges : (E, 2) directed border edges of each piece.
    """
    ends = np.concatenate([s.points[e] for s, e in zip(pieces, edges, strict=True)])
    owner = np.repeat(np.arange(len(pieces)), [len(e) for e in edges])
    welded = weld(ends.reshape(-1, 3))[0].reshape(-1, 2)
    low, high = welded.min(1), welded.max(1)
    order = np.lexsort((high, low))
    same = (low[order][1:] == low[order][:-1]) & (high[order][1:] == high[order][:-1])
    # where three meshes meet, as a mesh and its copies do, neighbors are ambiguous
    crowded = np.zeros(len(same), bool)
    crowded[1:] |= same[:-1]
    crowded[:-1] |= same[1:]
    same &= ~crowded
    # votes of the common edges: neighbors of the same winding run along them in opposite
    # directions
    votes: dict[int, dict[int, int]] = defaultdict(lambda: defaultdict(int))
    for k in np.flatnonzero(same):
        a, b = int(order[k]), int(order[k + 1])
        one, two = int(owner[a]), int(owner[b])
        if one != two and low[a] != high[a] and _may_join(pieces[one], pieces[two], alike):
            vote = 1 if welded[a, 0] != welded[b, 0] else -1
            votes[one][two] += vote
            votes[two][one] += vote
    against = np.zeros(len(pieces), bool)
    seen: set[int] = set()
    groups = []
    for start in range(len(pieces)):
        if start in seen or start not in votes:
            continue
        seen.add(start)
        members = [start]
        for k in members:
            for other, vote in votes[k].items():
                if other not in seen:
                    seen.add(other)
                    against[other] = against[k] ^ (vote < 0)
                    members.append(other)
        groups.append((sorted(members), against[sorted(members)]))
    return groups


def _may_join(one: Surface, two: Surface, alike: Alike | None) -> bool:
    same = one.component == two.component and one.skinned == two.skinned
    return same and (alike is None or alike(one.path, two.path))


def _one_surface(group: Sequence[Surface], against: NDArray[np.bool_]) -> Surface:
    """One surface of several, under the path of the largest; against : which are reversed."""
    largest = max(group, key=lambda s: areas(s.points, s.triangles).sum())
    points = starts([len(s.points) for s in group])
    corners = starts([len(s.face_indices) for s in group])
    turn = [np.array([2, 1, 0] if back else [0, 1, 2]) for back in against]

    def turned(values: Sequence[Floats | None]) -> list[Floats | None]:
        return [None if one is None else one[:, t] for one, t in zip(values, turn, strict=True)]

    limits = [s.limit for s in group if s.limit is not None]
    return replace(
        largest,
        points=np.concatenate([s.points for s in group]),
        face_counts=np.concatenate([s.face_counts for s in group]),
        face_indices=np.concatenate([s.face_indices + n for s, n in zip(group, points)]),
        triangles=np.concatenate([s.triangles[:, t] + n for s, t, n in zip(group, turn, points)]),
        triangle_corners=np.concatenate(
            [s.triangle_corners[:, t] + n for s, t, n in zip(group, turn, corners)]
        ),
        normals=None,
        normals_interpolation="",
        normal_points=None,
        triangle_colors=corner_values(turned([s.triangle_colors for s in group]), group, NO_COLOR),
        triangle_uvs=corner_values(turned([s.triangle_uvs for s in group]), group, (0.0, 0.0)),
        triangle_materials=material_rows(group),
        materials=tuple(one for s in group for one in s.materials),
        hole_faces=sum(s.hole_faces for s in group),
        limit=max(limits, key=lambda one: one.shift) if limits else None,
    )
