"""Walls whose two sides are meshes of their own, such as the outside and the inside of a mug.

A mesh that faces inward, directly inside one that faces outward, bounds a cavity of it: together
they bound a wall, as the shells of one mesh do (`winding.orientations`).  Two meshes that both face
outward are a body in a body, whose volumes are united.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import igl
import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import NO_COLOR, Asset, Surface
from gf_usd.core.mesh.measures import areas, signed_volume
from gf_usd.core.mesh.topology import Edges
from gf_usd.geometry.connected.joined import Joined
from gf_usd.geometry.connected.merged import corner_values, material_rows
from gf_usd.geometry.solid import Bounds, closed_triangles
from gf_usd.geometry.winding import boundary_loops, fan_area

TESTED = 64  # triangles of a mesh, about, whose centers are tested for being inside another one
INSIDE = 0.9  # of them: the flat faces of a coarse mesh may cut into a fine one
# of the volume of a mesh: another one in it that holds more is likely the inner side of its wall
HOLLOW = 0.5
BOX = 1e-5  # of its largest width, by which the box of a mesh may reach out of another one
MOST_NOTED = 3  # pairs
ORIENTATION = " (in USD by the attribute orientation)"


@dataclass(frozen=True, kw_only=True)
class Walls:
    """Pairs of meshes that bound walls, by prim path."""

    outer: Mapping[str, str] = field(default_factory=dict)  # of each inner side
    unclear: tuple[tuple[str, str], ...] = ()  # (inner, outer) of those that face otherwise
    colliders: tuple[tuple[str, str], ...] = ()  # of (mesh, mesh that it stands in for)

    @property
    def embedded(self) -> tuple[tuple[str, str], ...]:
        """The inner sides, each with the reason why it is not filled by itself."""
        reason = "it faces inward and bounds the wall of <{}>, which is filled"
        return tuple((path, reason.format(outer)) for path, outer in self.outer.items())

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on what is filled, and on pairs of which that is not clear."""
        others = len(self.outer) - MOST_NOTED
        joined = tuple(
            f"<{inner}> faces into <{outer}>"
            + (f" (and {others} more pairs are alike)" if others > 0 and not k else "")
            + ", as the inner side of a wall does: only the wall"
            f" between them is filled, with the material of <{outer}>. If <{inner}> is a body of"
            f" its own, turn its faces outward{ORIENTATION}"
            for k, (inner, outer) in enumerate(list(self.outer.items())[:MOST_NOTED])
        )
        more = len(self.unclear) - MOST_NOTED
        doubled = tuple(
            f"<{collider}> is a collider of the body of <{mesh}> and about as large"
            + (
                f" (and {len(self.colliders) - 1} more pairs are alike)"
                if self.colliders[1:]
                else ""
            )
            + ", and the volume of both is filled because both are visible. If it only stands in"
            f" for <{mesh}> in collisions, give it the purpose guide"
            for collider, mesh in self.colliders[:1]
        )
        unclear = tuple(
            f"<{inner}> is inside <{outer}>"
            + (f" (and {more} more pairs are alike)" if more > 0 and not k else "")
            + ", and the volume of both is filled. If they are the two sides of a wall, turn the"
            f" faces of <{outer}> outward and those of <{inner}> inward{ORIENTATION}"
            for k, (inner, outer) in enumerate(self.unclear[:MOST_NOTED])
        )
        return (*joined, *doubled, *unclear)

    def with_parts(self, joined: Joined) -> tuple[Walls, Joined]:
        """The same with every mesh of a joined inner side, and the joined meshes that are none."""
        outer = dict(self.outer)
        for group in joined.groups:
            if group[0] in outer:
                outer |= dict.fromkeys(group, outer[group[0]])
        left = tuple(group for group in joined.groups if group[0] not in outer)
        return replace(self, outer=outer), replace(joined, groups=left)


def find_walls(
    asset: Asset,
    one_thing: Callable[[str, str], bool],
    collider_of: Callable[[str, str], str] | None = None,
) -> Walls:
    """The walls among the surfaces of an asset, of consistent winding.

    one_thing : of two prim paths, whether they may be sides of one wall.
    collider_of : of two prim paths, the one that collides for the other; "", or None: none.
    """
    own = [s for s in asset.surfaces if not s.skinned and s.splats is None]
    if len(own) < 2:
        return Walls()
    volume = np.array([_capped_volume(s) for s in own])
    points = [s.face_points for s in own]
    low, high = np.array([p.min(0) for p in points]), np.array([p.max(0) for p in points])
    size = np.abs(volume)
    # meshes with a common rim have a side of their boxes in common, up to rounding
    slack = BOX * (high - low).max(1)[None, :, None]
    around = ((low[:, None] >= low - slack) & (high[:, None] <= high + slack)).all(2)
    around &= size[:, None] < size
    faces_in = (volume < 0.0)[:, None] & (volume > 0.0)
    candidates = around & (faces_in | (size[:, None] > HOLLOW * size))
    bounds: dict[int, Bounds | None] = {}

    def holds(outer: int, inner: int) -> bool:
        if outer not in bounds:
            triangles, _, fault = closed_triangles(own[outer])
            bounds[outer] = None if fault else Bounds(own[outer].points, triangles)
        one = bounds[outer]
        return one is not None and _share_in(one, own[inner]) >= INSIDE

    found: dict[str, str] = {}
    unclear: list[tuple[str, str]] = []
    colliders: list[tuple[str, str]] = []
    for k in np.flatnonzero(candidates.any(1)):
        if closed_triangles(own[k])[2]:
            continue
        hosts = np.flatnonzero(around[k])
        hosts = hosts[np.argsort(size[hosts], kind="stable")]
        host = next((int(h) for h in hosts if holds(int(h), int(k))), -1)
        if host < 0 or not candidates[k, host] or not one_thing(own[k].path, own[host].path):
            continue
        pair = own[k].path, own[host].path
        if collider_of and (collider := collider_of(*pair)):
            colliders.append((collider, pair[1] if collider == pair[0] else pair[0]))
        elif faces_in[k, host]:
            found[own[k].path] = own[host].path
        else:
            unclear.append(pair)
    # what is in a cavity is not the side of a wall
    left = tuple(pair for pair in unclear if pair[1] not in found)
    return Walls(outer=found, unclear=left, colliders=tuple(colliders))


def _capped_volume(surface: Surface) -> float:
    """[m^3] signed, with the holes of an open surface closed by fans."""
    edges = Edges.of(surface.representative[surface.triangles])
    points, triangles = [surface.points], [surface.triangles]
    for hub, loop in enumerate(boundary_loops(edges)[0], len(surface.points)):
        ends = edges.directed[loop]
        points.append(surface.points[ends[:, 0]].mean(0, keepdims=True))
        triangles.append(np.column_stack([ends[:, 1], ends[:, 0], np.full(len(ends), hub)]))
    return signed_volume(np.concatenate(points), np.concatenate(triangles))


def _share_in(bounds: Bounds, surface: Surface) -> float:
    """Fraction of a surface's triangles whose centers are inside another one."""
    triangles = surface.triangles[:: max(1, len(surface.triangles) // TESTED)]
    return float(bounds.inside(surface.points[triangles].mean(1)).mean())


def with_walls(asset: Asset, walls: Walls) -> Asset:
    """The asset to fill: the inner side of each wall is part of the surface of the outer one."""
    by_path = {s.path: s for s in asset.surfaces}
    for inner, outer in walls.outer.items():
        by_path[outer] = _joined(by_path[outer], by_path[inner])
    kept = (by_path[s.path] for s in asset.surfaces if s.path not in walls.outer)
    return replace(asset, surfaces=tuple(kept))


def _joined(outer: Surface, inner: Surface) -> Surface:
    """A surface of both, and of the rim between them where both are open.

    Its faces are those of the outer one: what the stage states of faces holds for the triangles of
    the inner one next to them.
    """
    first = len(outer.points)
    points = np.concatenate([outer.points, inner.points])
    sides = np.concatenate([outer.triangles, first + inner.triangles])
    made = replace(
        outer,
        points=points,
        own_points=first if outer.own_points is None else outer.own_points,
        triangles=sides,
    )
    rim = _rim(points, closed_triangles(made)[0], first)
    center = outer.points.mean(0)
    new = points[np.concatenate([first + inner.triangles, rim])].mean(1)
    _, at, _ = igl.point_mesh_squared_distance(
        new - center, outer.points - center, outer.triangles.astype(np.int64)
    )
    near = np.asarray(at).reshape(-1)
    of_rim = near[len(inner.triangles) :]
    both = (outer, inner)
    materials = [
        replace(one, texture=None) if of.triangle_uvs is None else one
        for of in both
        for one in of.materials
    ]
    colors = corner_values([s.triangle_colors for s in both], both, NO_COLOR)
    uvs = corner_values([s.triangle_uvs for s in both], both, (0.0, 0.0))
    bound = material_rows(both)
    return replace(
        made,
        triangles=np.concatenate([sides, rim]),
        triangle_corners=np.concatenate([outer.triangle_corners, outer.triangle_corners[near]]),
        triangle_colors=None if colors is None else np.concatenate([colors, colors[of_rim]]),
        triangle_uvs=None if uvs is None else np.concatenate([uvs, uvs[of_rim]]),
        triangle_materials=None if bound is None else np.concatenate([bound, bound[of_rim]]),
        materials=tuple(materials),
    )


def _rim(points: Floats, triangles: Ints, first: int) -> Ints:
    """(R, 3) triangles between the boundary of an outer and of an inner mesh.

    None where either has not one boundary loop, or where caps on both would be smaller.

    triangles : (T, 3) welded, of both; first : the first of `points` (V, 3) of the inner one.
    """
    edges = Edges.of(triangles)
    loops = [edges.directed[loop, 0] for loop in boundary_loops(edges)[0]]
    none = np.zeros((0, 3), np.int64)
    if len(loops) != 2 or (loops[0][0] < first) == (loops[1][0] < first):
        return none
    one, two = sorted(loops, key=lambda loop: int(loop[0]))
    two = two[::-1]  # along the other one: the two meshes have opposite winding
    two = np.roll(two, -int(np.linalg.norm(points[two] - points[one[0]], axis=1).argmin()))
    made, i, j = [], 0, 0
    while i < len(one) or j < len(two):
        a, next_a = one[i % len(one)], one[(i + 1) % len(one)]
        b, next_b = two[j % len(two)], two[(j + 1) % len(two)]
        across = np.linalg.norm(points[[next_a, a]] - points[[b, next_b]], axis=1)
        if j == len(two) or (i < len(one) and across[0] <= across[1]):
            made.append((next_a, a, b))
            i += 1
        else:
            made.append((b, next_b, a))
            j += 1
    rim = np.array(made)
    caps = fan_area(points[one]) + fan_area(points[two])
    return rim if areas(points, rim).sum() <= caps else none
