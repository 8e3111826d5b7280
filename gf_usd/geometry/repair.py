"""Repairs the triangles that bound a solid; the authored mesh is unchanged.

Only the triangles for the fill change: faces that enclose nothing are removed, small holes get caps
without new points, and orientations are made consistent.  Points, faces, UVs and normals of the
asset are unchanged, and all repairs are counted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import Asset, Surface
from gf_usd.core.mesh import areas, proper, shells, triangulate, weld
from gf_usd.geometry import winding
from gf_usd.geometry.diagnosis import (
    DUPLICATE,
    HOLE_LIMIT,
    OTHER_SIDE,
    SINGLE,
    WALL,
    authored_faces,
    doubled,
    removable_slivers,
    slivers,
)
from gf_usd.geometry.winding import Edges, boundary_loops, fan_area, overlapping


@dataclass(frozen=True, kw_only=True)
class Repairs:
    """The repairs of one surface, as numbers of triangles unless stated otherwise."""

    path: str
    collapsed: int = 0  # dropped: two corners in one place
    slivers: int = 0  # dropped: without area
    duplicates: int = 0  # dropped: another one faces the same way
    walls: int = 0  # dropped: back to back inside others or on them, bounding nothing
    other_sides: int = 0  # dropped: the second side of a surface that was modeled with both
    turned: int = 0  # faced against their neighbors
    turned_parts: int = 0  # whole parts that faced the wrong way
    cavities: int = 0  # parts inside others that face inward, kept so
    inner: int = 0  # parts dropped: inside others, where there is flesh anyway
    overlapping: int = 0  # parts that reach into others, kept: what they share is filled once
    holes_closed: int = 0  # holes
    caps: int = 0  # added to close them
    largest_closed: float = 0.0  # share of the closed area
    holes_left: int = 0  # holes above the limit
    largest_left: float = 0.0  # share of the closed area
    loose_edges: int = 0  # boundary edges in no closed loop, left open
    thickened: int = 0  # thin parts that were given one spacing of flesh
    thickness: float = 0.0  # [m] of theirs
    thin_left: int = 0  # sheets left as they are: too small, or without two sides

    @property
    def changed(self) -> bool:
        """Whether anything was altered."""
        return bool(
            self.collapsed + self.slivers + self.duplicates + self.walls + self.other_sides
            + self.turned + self.turned_parts + self.inner + self.holes_closed + self.thickened
        )  # fmt: skip

    def messages(self) -> tuple[str, ...]:
        """A sentence each; empty where nothing was wrong."""
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
        said = []
        if dropped:
            said.append(f"dropped triangles: {', '.join(dropped)}")
        if self.turned:
            said.append(f"turned {_count(self.turned, 'triangle')} to match the rest")
        if self.turned_parts:
            said.append(f"turned {_count(self.turned_parts, 'part')} that faced the wrong way")
        if self.inner:
            said.append(f"dropped {_count(self.inner, 'part')} inside others that bound no volume")
        if self.cavities:
            said.append(
                f"left {_count(self.cavities, 'part')} that lie inside others and face inward "
                f"(cavities)"
            )
        if self.overlapping:
            said.append(
                f"left {_count(self.overlapping, 'part')} that overlap others: the common "
                f"volume is filled once"
            )
        if self.holes_closed:
            said.append(
                f"closed {_count(self.holes_closed, 'hole')} with {_count(self.caps, 'triangle')},"
                f" the largest {_share(self.largest_closed)} of the closed area"
            )
        if self.holes_left:
            said.append(
                f"left {_count(self.holes_left, 'hole')} open, the largest"
                f" {_share(self.largest_left)} of the closed area (repair closes up to"
                f" {_share(HOLE_LIMIT)})"
            )
        if self.loose_edges:
            said.append(
                f"left {_count(self.loose_edges, 'boundary edge')} that form no closed loop"
            )
        if self.thickened:
            said.append(
                f"made {_count(self.thickened, 'thin part')} {self.thickness:.3g} m thick (one "
                f"spacing) for the simulation"
            )
        if self.thin_left:
            said.append(
                f"left {_count(self.thin_left, 'sheet')} unfilled: too small for a body of "
                f"particles, or one-sided"
            )
        return tuple(said)

    def as_dict(self) -> dict[str, object]:
        """Every count by name."""
        return asdict(self)


def repair_asset(asset: Asset) -> tuple[Asset, tuple[Repairs, ...]]:
    """The asset with every surface's triangles repaired, and what was done to each."""
    done = [repair_surface(surface) for surface in asset.surfaces]
    return replace(asset, surfaces=tuple(s for s, _ in done)), tuple(r for _, r in done)


def notes(repairs: Sequence[Repairs]) -> tuple[str, ...]:
    """The repairs as text, a line for each surface that needed any."""
    done = ((r.path, r.messages()) for r in repairs)
    return tuple(
        f"<{path}> repaired for the fill: {'; '.join(said)}" for path, said in done if said
    )


def consistently_oriented_asset(asset: Asset) -> tuple[Asset, tuple[str, ...]]:
    """The asset with triangles oriented as their neighbors, and notes on those that were reversed.

    In each connected part, where two adjacent triangles have opposite orientations, the group of
    smaller area is reversed.
    """
    made = [_consistently_oriented(surface) for surface in asset.surfaces]
    said = tuple(
        f"<{surface.path}>: {_count(turned, 'triangle')} facing the other way"
        f" {'is' if turned == 1 else 'are'} turned for the fill; the mesh itself does not change"
        for surface, turned in made
        if turned
    )
    return (replace(asset, surfaces=tuple(one for one, _ in made)), said) if said else (asset, ())


def _consistently_oriented(surface: Surface) -> tuple[Surface, int]:
    """The same for one surface, and the number of reversed triangles."""
    welded = weld(surface.points)[0][surface.triangles]
    sound = np.flatnonzero(proper(welded))
    triangles = welded[sound]
    edges = Edges.of(triangles)
    starts = edges.directed[edges.pairs, 0]
    if not (starts[:, 0] == starts[:, 1]).any():
        return surface, 0
    against = np.zeros(len(welded), bool)
    against[sound] = winding.patches(surface.points, triangles, edges).against
    corners = np.arange(3 * len(welded)).reshape(-1, 3)
    return _with_slots(surface, winding.turned(corners, against)), int(against.sum())


def repair_surface(surface: Surface) -> tuple[Surface, Repairs]:
    """A surface whose triangles bound a solid as well as they can, and what was done.

    In this order: drop collapsed triangles, those without area that hold no seam together,
    duplicates, walls back to back and second sides; make neighbors agree; face every part outward,
    cavities aside; drop parts inside others, which bound nothing; close holes up to `HOLE_LIMIT`.
    Nothing but the triangles and what hangs on their corners changes.
    """
    points = surface.points
    vertex = weld(points)[0][surface.triangles].reshape(-1)
    material_parts = np.arange(len(vertex)).reshape(
        -1, 3
    )  # corners of Surface.triangles, counted through

    sound = proper(vertex[material_parts])
    material_parts = material_parts[sound]
    flat = removable_slivers(
        slivers(points, vertex[material_parts]), Edges.of(vertex[material_parts])
    )
    material_parts = material_parts[~flat]
    double = doubled(vertex[material_parts], authored_faces(surface)[material_parts[:, 0] // 3])
    material_parts = material_parts[double == SINGLE]
    if len(material_parts) == 0:
        return surface, Repairs(path=surface.path)

    patch = winding.patches(points, vertex[material_parts], Edges.of(vertex[material_parts]))
    material_parts = winding.turned(material_parts, patch.against)
    facing = winding.facing(points, vertex[material_parts], patch.label)
    material_parts = winding.turned(material_parts, facing.wrong[patch.label])
    kept = ~facing.inner[patch.label]
    material_parts, label = (
        material_parts[kept],
        np.unique(patch.label[kept], return_inverse=True)[1],
    )
    shared = overlapping(points, vertex[material_parts], label)
    caps, closing = _close(points, vertex, material_parts)
    material_parts = np.concatenate([material_parts, caps])

    done = Repairs(
        path=surface.path,
        collapsed=int((~sound).sum()),
        slivers=int(flat.sum()),
        duplicates=int((double == DUPLICATE).sum()),
        walls=int((double == WALL).sum()),
        other_sides=int((double == OTHER_SIDE).sum()),
        turned=int(patch.against.sum()),
        turned_parts=int((facing.wrong & ~facing.inner).sum()),
        inner=int(facing.inner.sum()),
        cavities=int((facing.goal == -1).sum()),
        overlapping=int(shared.sum()),
        caps=len(caps),
        **closing,
    )
    return (_with_slots(surface, material_parts) if done.changed else surface), done


def _close(points: Floats, vertex: Ints, material_parts: Ints) -> tuple[Ints, dict[str, Any]]:
    """Caps (C, 3) of slots over the small holes, and what was counted."""
    triangles = vertex[material_parts]
    label = shells(triangles)
    area = np.bincount(label, areas(points, triangles))
    loops, loose = boundary_loops(Edges.of(triangles))
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
        ring = material_parts.reshape(-1)[loop[::-1]]  # a cap runs along each edge the other way
        _, corners, _ = triangulate(points, np.array([len(ring)]), vertex[ring])
        caps.append(ring[corners])
    return np.concatenate(caps), {
        "holes_closed": len(small) - 1,
        "largest_closed": float(max(small)),
        "holes_left": len(large) - 1,
        "largest_left": float(max(large)),
        "loose_edges": loose,
    }


def _with_slots(surface: Surface, material_parts: Ints) -> Surface:
    """The surface with triangles made of these corners of its own triangles, (T', 3).

    A cap takes color and UV at each corner, and its material, from the triangle next to it.
    """
    colors, uvs, materials = (
        surface.triangle_colors, surface.triangle_uvs, surface.triangle_materials,
    )  # fmt: skip
    return replace(
        surface,
        triangles=np.ascontiguousarray(surface.triangles.reshape(-1)[material_parts]),
        triangle_corners=np.ascontiguousarray(surface.triangle_corners.reshape(-1)[material_parts]),
        triangle_colors=None if colors is None else colors.reshape(-1, 3)[material_parts],
        triangle_uvs=None if uvs is None else uvs.reshape(-1, 2)[material_parts],
        triangle_materials=None if materials is None else materials[material_parts[:, 0] // 3],
    )


def _count(n: int, what: str) -> str:
    return f"{n} {what}{'' if n == 1 else 's'}"


def _share(value: float) -> str:
    return f"{100 * value:.2g} %"
