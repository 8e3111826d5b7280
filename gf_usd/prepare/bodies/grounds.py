"""Meshes that look like the ground, a wall, the backdrop, the room or the sky of a scene."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.asset import Asset, StageFacts, Surface
from gf_usd.core.mesh.measures import signed_volume

if TYPE_CHECKING:
    from gf_usd.geometry.solid import Bounds, Solid

FLAT = 0.05  # its height, as a share of its smaller width
SUNK = 0.05  # how far others are below its top, as a share of their height
LARGER = 3.0  # the diagonal of scenery, over that of all bodies
UPRIGHT = 0.5  # sine of the slope of a wall's normal, at most
SCENERY = (
    "it encloses no volume, lies under the bodies and reaches far beyond them, as a ground or a"
    " backdrop does"
)
IN_IT = 0.5  # of the tested points of a mesh, from where it is in a room: it may reach into a wall
TESTED = 64  # points of a mesh, about, that are tested
FULL = 0.5  # of the volume of a mesh: one that others fill to more than that is no room
HOLLOW = 0.5  # of the convex hull, that a room or a sky encloses: a body with limbs has less
WALL = (
    "it encloses no volume, is flat and upright, and everything baked is on one side of it and far"
    " smaller, as at a wall or a backdrop"
)
ROOM = "it faces inward around all other meshes, as a room or a sky does"


def without_rooms(asset: Asset, *, repair: bool, bodies: Collection[str] = ()) -> Asset:
    """The asset with closed meshes that face inward around all others among the prims skipped.

    Their volume would be filled as one body with everything in it.  A body that is inside out by
    mistake is no room: nothing that faces outward is in it, or it is far from convex, or what is in
    it fills it.

    repair : open meshes are filled too; bodies : paths of those that the stage makes soft or rigid.
    """
    from gf_usd.geometry.solid import Bounds, closed_triangles

    volume = [signed_volume(s.points, s.triangles) for s in asset.surfaces]
    if min(volume, default=0.0) >= 0.0 or len(volume) < 2:
        return asset
    closed = [closed_triangles(s) for s in asset.surfaces]
    filled = {k for k, one in enumerate(closed) if repair or not one[2]}
    found = []
    for k in np.argsort(volume):  # the largest that faces inward first: a room may be under a sky
        room, (triangles, _, fault) = asset.surfaces[k], closed[k]
        others = [j for j in filled if j != k]
        captured = room.splats is not None
        if volume[k] >= 0.0 or fault or room.skinned or captured or room.path in bodies:
            continue
        content = sum(volume[j] for j in others if volume[j] > 0.0)
        outward = any(volume[j] > 0.0 or closed[j][2] for j in others)
        if not outward or content > -FULL * volume[k] or not _convex(room, -volume[k]):
            continue
        bounds = Bounds(room.points, triangles)
        if all(_share_in(bounds, asset.surfaces[j]) >= IN_IT for j in others):
            found.append(room.path)
            filled.remove(k)
    if not found:
        return asset
    return asset.without(dict.fromkeys(found, ROOM))


def without_room_parts(asset: Asset, *, repair: bool, bodies: Collection[str] = ()) -> Asset:
    """`without_rooms`, also of rooms in several meshes, such as one for each material."""
    from gf_usd.geometry.connected.joined import joined_surfaces

    joined = joined_surfaces(asset, bodies)
    left = without_rooms(joined.asset, repair=repair, bodies=bodies)
    rooms = {path for path, reason in left.skipped if reason == ROOM}
    parts = {group[0]: group for group in joined.groups}
    out = [part for room in sorted(rooms) for part in parts.get(room, (room,))]
    if not out:
        return asset
    return asset.without(dict.fromkeys(out, ROOM))


def _convex(surface: Surface, volume: float) -> bool:
    """Whether a mesh encloses as much [m^3] of its convex hull as a room does."""
    from gf_usd.prepare.bodies.convexity import SupportPoints

    points = surface.face_points
    hull = SupportPoints(points).hull_lower_bound() or float(np.prod(np.ptp(points, axis=0)))
    return volume >= HOLLOW * hull


def _share_in(bounds: Bounds, surface: Surface) -> float:
    """Fraction of the points of a surface that are inside another one."""
    X = surface.face_points
    return float(bounds.inside(X[:: max(1, len(X) // TESTED)]).mean())


def without_scenery(asset: Asset, solid: Solid) -> tuple[Asset, Solid]:
    """The asset and its solid, with open meshes that are scenery among the prims that are skipped.

    They would follow a body that is much smaller than they are, whose motion is not theirs.
    """
    found = scenery_of(asset, solid)
    if not found:
        return asset, solid
    left = tuple(one for one in solid.embedded if one[0] not in found)
    return asset.without(found), replace(solid, embedded=left)


def scenery_of(asset: Asset, solid: Solid) -> dict[str, str]:
    """The reason for each open mesh that is scenery, by prim path."""
    if not solid.embedded:
        return {}
    embedded = dict(solid.embedded)
    filled = [s.face_points for s in asset.surfaces if s.path not in embedded]
    up = asset.facts.up
    low, high = (np.min([p.min(0) for p in filled], 0), np.max([p.max(0) for p in filled], 0))

    def surrounds(surface: Surface) -> bool:
        least, most = surface.face_points.min(0), surface.face_points.max(0)
        return bool(
            _beyond((least, most), (low, high), up)
            and least @ up <= low @ up + SUNK * ((high - low) @ up)
            and np.linalg.norm(most - least) >= LARGER * np.linalg.norm(high - low)
        )

    def beside(surface: Surface) -> bool:
        points = surface.face_points
        if np.linalg.norm(np.ptp(points, axis=0)) < LARGER * np.linalg.norm(high - low):
            return False
        center = points.mean(0)
        axes = np.linalg.eigh((points - center).T @ (points - center))[1]
        across, width = np.ptp((points - center) @ axes[:, :2], axis=0)
        sides = np.concatenate([(p - center) @ axes[:, 0] for p in filled])
        slack = SUNK * np.ptp(sides)
        return bool(
            across <= FLAT * width
            and abs(axes[:, 0] @ up) <= UPRIGHT
            and (sides.min() >= -slack or sides.max() <= slack)
        )

    return {
        s.path: SCENERY if surrounds(s) else WALL
        for s in asset.surfaces
        if s.path in embedded and not s.skinned and s.splats is None and (surrounds(s) or beside(s))
    }


def _beyond(box: tuple[Floats, Floats], other: tuple[Floats, Floats], up: Floats) -> bool:
    """Whether a box, of its low and its high corner, reaches as far as another across up."""
    across = up == 0.0
    return bool((box[0] <= other[0])[across].all() and (box[1] >= other[1])[across].all())


def floor_notes(scenery: Sequence[Surface], bodies: Sequence[Surface], facts: StageFacts) -> tuple[
    str, ...
]:  # fmt: skip
    """Notes on scenery that is higher or lower under the bodies than the default floor, at 0."""
    points = np.concatenate([s.face_points for s in bodies])
    low, high = points.min(0), points.max(0)
    notes = []
    for surface in scenery:
        height = _height_below(surface, 0.5 * (low + high), facts.up)
        if height is None or abs(height) <= SUNK * np.linalg.norm(high - low):
            continue
        written = f"{height / facts.units.length:.3g}"
        notes.append(
            f"bodies fall onto the floor of the bake, at 0, but under them <{surface.path}> is at a"
            f" height of {written}: --floor {written} puts the floor there"
        )
    return tuple(notes)


def _height_below(surface: Surface, X: Floats, up: Floats) -> float | None:
    """[m] of the highest place of a surface that is above or below X (3,); None: there is none."""
    corners = surface.points[surface.triangles]
    heights = corners @ up
    flat = (corners - X) - ((corners - X) @ up)[..., None] * up
    # signed areas of the triangles that X makes with each edge, seen from above
    parts = np.stack(
        [np.cross(flat[:, (k + 1) % 3], flat[:, (k + 2) % 3]) @ up for k in range(3)], axis=1
    )
    area = parts.sum(1)
    around = (area != 0.0) & ((parts * np.sign(area)[:, None]) >= 0.0).all(1)
    if not around.any():
        return None
    return float(((parts[around] / area[around][:, None]) * heights[around]).sum(1).max())


def ground_notes(
    surfaces: Sequence[Surface], embedded: Collection[str], up: Floats, unit: float
) -> tuple[str, ...]:
    """Notes on flat meshes that lie under all others and reach beyond them.

    They are soft as the others are: a mesh may be a mattress, and a name proves nothing.

    embedded : paths of the meshes that are not filled; up : (3,) unit; unit : [m] of the stage.
    """
    notes = []
    for surface, top in grounds(surfaces, up):
        does = "moves with the nearest body" if surface.path in embedded else "is soft and falls"
        notes.append(
            f"<{surface.path}> is flat and lies under everything else, as a ground does, but it"
            f" {does}: apply PhysicsCollisionAPI to it to make it an obstacle, or bake the"
            f" others alone (--prim) on a floor at its height (--floor {top / unit:.3g})"
        )
    return tuple(notes)


def grounds(surfaces: Sequence[Surface], up: Floats) -> list[tuple[Surface, float]]:
    """The surfaces that are flat, lie under all others and reach beyond them, and their tops [m]
    along up (3,)."""
    boxes = [(s.face_points.min(0), s.face_points.max(0)) for s in surfaces]
    axis = int(np.abs(up).argmax())
    across = [k for k in range(3) if k != axis]
    found = []
    for k, surface in enumerate(surfaces):
        others = [box for j, box in enumerate(boxes) if j != k]
        if not others:
            continue
        low, high = boxes[k]
        lows, highs = (np.array(ends) for ends in zip(*others, strict=True))
        # along up, which may be minus an axis
        bottom, top = sorted((up[axis] * low[axis], up[axis] * high[axis]))
        heights = np.sort(up[axis] * np.stack((lows[:, axis], highs[:, axis])), axis=0)
        lowest, highest = heights[0].min(), heights[1].max()
        flat = top - bottom <= FLAT * (high - low)[across].min()
        under = top <= lowest + SUNK * (highest - lowest)
        if flat and under and _beyond(boxes[k], (lows.min(0), highs.max(0)), up):
            found.append((surface, float(top)))
    return found
