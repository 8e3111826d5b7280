"""Mesh repair of the triangles from which the solid is built; the authored mesh is not changed.

Degenerate and duplicate triangles are removed, the winding is made consistent and outward, and
small holes are closed with triangles between existing points. Points, faces, UVs and normals of the
asset stay as they are. Every change is counted (`Repairs`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import Asset, Surface
from gf_usd.core.errors import counted
from gf_usd.core.mesh.measures import areas
from gf_usd.core.mesh.topology import Edges, proper, shells
from gf_usd.core.mesh.triangulation import triangulate
from gf_usd.core.units import length_text, percent_text
from gf_usd.geometry import winding
from gf_usd.geometry.diagnosis import (
    DUPLICATE,
    HOLE_LIMIT,
    OTHER_SIDE,
    SINGLE,
    WALL,
    authored_faces,
    classify_duplicates,
    removable_slivers,
    slivers,
)
from gf_usd.geometry.winding import boundary_loops, fan_area, overlapping


@dataclass(frozen=True, kw_only=True)
class Repairs:
    """The changes to one surface, in numbers of triangles unless stated otherwise."""

    path: str
    collapsed: int = 0  # removed: two corners coincide
    slivers: int = 0  # removed: zero area
    duplicates: int = 0  # removed: coincident with one of the same orientation
    walls: int = 0  # removed: coincident pairs of opposite orientation that bound no volume
    other_sides: int = 0  # removed: one side of a double-sided surface
    turned: int = 0  # winding reversed, to agree with the neighbors
    turned_parts: int = 0  # parts whose winding was reversed as a whole
    cavities: int = 0  # parts inside others that face inward, kept
    inner: int = 0  # parts removed: inside the solid of others, so that they bound no volume
    overlapping: int = 0  # parts that overlap others, kept: the common volume is filled once
    holes_closed: int = 0  # holes
    caps: int = 0  # triangles added to close holes
    largest_closed: float = 0.0  # share of the closed area
    holes_left: int = 0  # holes above the limit
    largest_left: float = 0.0  # share of the closed area
    loose_edges: int = 0  # other boundary edges in no closed loop, left open
    one_sided_edges: int = 0  # boundary edges of one-sided strips, as a Moebius strip, left open
    thickened: int = 0  # thin parts that were made one spacing thick
    thickness: float = 0.0  # [m] of the thickened parts
    thin_left: int = 0  # sheets left unchanged: too small

    @property
    def changed(self) -> bool:
        """Whether anything was altered."""
        return bool(
            self.collapsed + self.slivers + self.duplicates + self.walls + self.other_sides
            + self.turned + self.turned_parts + self.inner + self.holes_closed + self.thickened
        )  # fmt: skip

    def messages(self) -> tuple[str, ...]:
        """One phrase for each kind of change; empty where there is none."""
        dropped = [
            f"{n} {what}"
            for n, what in (
                (self.collapsed, "collapsed"),
                (self.slivers, "without area"),
                (self.duplicates, "duplicate"),
                (self.walls, "back-to-back in walls without thickness"),
                (self.other_sides, "on the second side of double-sided surfaces"),
            )
            if n
        ]
        lines = []
        if dropped:
            lines.append(f"dropped triangles: {', '.join(dropped)}")
        if self.turned:
            lines.append(f"turned {counted(self.turned, 'triangle')} to match the rest")
        if self.turned_parts:
            lines.append(f"turned {counted(self.turned_parts, 'part')} of reversed winding")
        if self.inner:
            lines.append(
                f"dropped {counted(self.inner, 'part')} inside others that bound no volume"
            )
        if self.cavities:
            lines.append(
                f"left {counted(self.cavities, 'part')} that lie inside others and face inward "
                f"(cavities)"
            )
        if self.overlapping:
            lines.append(
                f"left {counted(self.overlapping, 'part')} that overlap others: the common "
                f"volume is filled once"
            )
        if self.holes_closed:
            lines.append(
                f"closed {counted(self.holes_closed, 'hole')} with"
                f" {counted(self.caps, 'triangle')}, the largest"
                f" {percent_text(self.largest_closed)} of the closed area"
            )
        if self.holes_left:
            lines.append(
                f"left {counted(self.holes_left, 'hole')} open, the largest"
                f" {percent_text(self.largest_left)} of the closed area (repair closes up to"
                f" {percent_text(HOLE_LIMIT)})"
            )
        if self.loose_edges:
            lines.append(
                f"left {counted(self.loose_edges, 'boundary edge')} that form no closed loop"
            )
        if self.one_sided_edges:
            lines.append(
                f"left {counted(self.one_sided_edges, 'boundary edge')} of one-sided strips, which"
                " have no inside to close"
            )
        if self.thickened:
            lines.append(
                f"made {counted(self.thickened, 'thin part')} {length_text(self.thickness)}"
                f" thick (one spacing) for the simulation"
            )
        if self.thin_left:
            lines.append(
                f"left {counted(self.thin_left, 'sheet')} unfilled: too small for a body of"
                " particles"
            )
        return tuple(lines)

    def as_dict(self) -> dict[str, object]:
        """The fields by name."""
        return asdict(self)


def repair_asset(asset: Asset) -> tuple[Asset, tuple[Repairs, ...]]:
    """The asset with every surface's triangles repaired, and what was done to each."""
    done = [repair_surface(surface) for surface in asset.surfaces]
    return replace(asset, surfaces=tuple(s for s, _ in done)), tuple(r for _, r in done)


def notes(repairs: Sequence[Repairs]) -> tuple[str, ...]:
    """The repairs as text, a line for each surface that needed any."""
    done = ((r.path, r.messages()) for r in repairs)
    return tuple(
        f"<{path}> repaired for the fill: {'; '.join(lines)}" for path, lines in done if lines
    )


def consistently_oriented_asset(asset: Asset) -> tuple[Asset, tuple[str, ...]]:
    """The asset with triangles oriented as their neighbors, and notes on those that were reversed.

    In each connected part, where two adjacent triangles have opposite orientations, the group of
    smaller area is reversed.
    """
    made = [_with_consistent_winding(surface) for surface in asset.surfaces]
    lines = tuple(
        f"<{surface.path}>: {counted(turned, 'triangle')} facing the other way"
        f" {'is' if turned == 1 else 'are'} turned for the fill; the mesh itself does not change"
        for surface, turned in made
        if turned
    )
    return (replace(asset, surfaces=tuple(one for one, _ in made)), lines) if lines else (asset, ())


def _with_consistent_winding(surface: Surface) -> tuple[Surface, int]:
    """As above for one surface, with the number of triangles whose winding was reversed."""
    welded = surface.welded
    edges = welded.edges  # kept for the diagnosis
    if welded.consistent:
        return surface, 0
    against = np.zeros(len(surface.triangles), bool)
    patch = winding.patches(surface.points, welded.triangles, edges)
    against[welded.source] = patch.against
    corners = np.arange(3 * len(against)).reshape(-1, 3)
    return _with_corners(surface, winding.flipped(corners, against)), int(against.sum())


def repair_surface(surface: Surface) -> tuple[Surface, Repairs]:
    """The surface with repaired triangles, and the changes.

    In this order: remove collapsed triangles, removable slivers and duplicates
    (`classify_duplicates`); make the winding of neighbors consistent; orient every part outward,
    except cavities; remove parts inside others that bound no volume; close holes up to
    `HOLE_LIMIT`. Only the triangles and their per-corner attributes change.
    """
    points = surface.points
    vertex = surface.representative[surface.triangles].reshape(-1)
    corners = np.arange(len(vertex)).reshape(-1, 3)  # flat indices into Surface.triangles
    sound = proper(vertex[corners])
    corners = corners[sound]
    triangles = vertex[corners]
    flat = removable_slivers(slivers(points, triangles), Edges.of(triangles))
    corners = corners[~flat]
    face = authored_faces(surface)[corners[:, 0] // 3]
    double = classify_duplicates(vertex[corners], face)
    corners = corners[double == SINGLE]
    if len(corners) == 0:
        return surface, Repairs(path=surface.path)

    patch = winding.patches(points, vertex[corners], Edges.of(vertex[corners]))
    corners = winding.flipped(corners, patch.against)
    orientation = winding.orientations(points, vertex[corners], patch.label)
    corners = winding.flipped(corners, orientation.wrong[patch.label])
    kept = ~orientation.inner[patch.label]
    corners = corners[kept]
    label = np.unique(patch.label[kept], return_inverse=True)[1]
    shared = overlapping(points, vertex[corners], label)
    caps, closing = _close(points, vertex, corners, patch.one_sided[kept])
    corners = np.concatenate([corners, caps])

    done = Repairs(
        path=surface.path,
        collapsed=int((~sound).sum()),
        slivers=int(flat.sum()),
        duplicates=int((double == DUPLICATE).sum()),
        walls=int((double == WALL).sum()),
        other_sides=int((double == OTHER_SIDE).sum()),
        turned=int(patch.against.sum()),
        turned_parts=int((orientation.wrong & ~orientation.inner).sum()),
        inner=int(orientation.inner.sum()),
        cavities=int((orientation.target == -1).sum()),
        overlapping=int(shared.sum()),
        caps=len(caps),
        **closing,
    )
    return (_with_corners(surface, corners) if done.changed else surface), done


def _close(
    points: Floats, vertex: Ints, corners: Ints, one_sided: NDArray[np.bool_]
) -> tuple[Ints, dict[str, Any]]:
    """(C, 3) corners of the triangles that close the small holes, and fields of `Repairs`.

    one_sided : (T,) triangles of non-orientable patches: their boundary is no hole.
    """
    triangles = vertex[corners]
    label = shells(triangles)
    area = np.bincount(label, areas(points, triangles))
    edges = Edges.of(triangles)
    loops, loose = boundary_loops(edges)
    strips = int(one_sided[edges.boundary // 3].sum())
    if strips:
        inside = [loop for loop in loops if one_sided[loop[0] // 3]]
        loops = [loop for loop in loops if not one_sided[loop[0] // 3]]
        loose -= strips - int(np.isin(edges.boundary, np.concatenate([*inside, []])).sum())
    fans = [fan_area(points[triangles.reshape(-1)[loop]]) for loop in loops]
    homes = [int(label[loop[0] // 3]) for loop in loops]
    closed = area + np.bincount(homes, fans, minlength=len(area)) if loops else area
    caps = [np.zeros((0, 3), np.int64)]
    small, large = [0.0], [0.0]
    for loop, fan, home in zip(loops, fans, homes):
        share = fan / closed[home] if closed[home] > 0.0 else 0.0
        if share > HOLE_LIMIT:
            large.append(share)
            continue
        small.append(share)
        # reversed: adjacent triangles traverse their common edge in opposite directions
        ring = corners.reshape(-1)[loop[::-1]]
        _, of_ring, _ = triangulate(points, np.array([len(ring)]), vertex[ring])
        caps.append(ring[of_ring])
    return np.concatenate(caps), {
        "holes_closed": len(small) - 1,
        "largest_closed": float(max(small)),
        "holes_left": len(large) - 1,
        "largest_left": float(max(large)),
        "loose_edges": loose,
        "one_sided_edges": strips,
    }


def _with_corners(surface: Surface, corners: Ints) -> Surface:
    """The surface with new triangles, whose corners (T', 3) are corners of its own triangles.

    A triangle over a hole takes the color and UV at each corner, and its material, from the
    triangle next to it.
    """
    colors, uvs, materials = (
        surface.triangle_colors, surface.triangle_uvs, surface.triangle_materials,
    )  # fmt: skip
    return replace(
        surface,
        triangles=np.ascontiguousarray(surface.triangles.reshape(-1)[corners]),
        triangle_corners=np.ascontiguousarray(surface.triangle_corners.reshape(-1)[corners]),
        triangle_colors=None if colors is None else colors.reshape(-1, 3)[corners],
        triangle_uvs=None if uvs is None else uvs.reshape(-1, 2)[corners],
        triangle_materials=None if materials is None else materials[corners[:, 0] // 3],
    )
