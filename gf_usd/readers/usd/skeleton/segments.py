"""Segments of bones that end in the flesh of a joint, and distances from segments.

Means and medians over the points of the flesh are weighted by the area of the surface around each.
Without these weights, corners that a file repeats for each face with a normal of its own would pull
a segment to them, and so would the many points of a face those of a head.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.mesh.measures import areas
from gf_usd.core.mesh.topology import weld
from gf_usd.core.neighbors import components

APART = 0.25  # of the size of a joint's flesh: what a wider gap separates is no part of it
INTO_FLESH = 1.5  # length of a segment toward the mean of a joint's points, over their distance


@dataclass(frozen=True, kw_only=True)
class FleshPoints:
    """Points of the surface of some flesh, with the area around each."""

    at: Floats  # (n, 3) [m]
    area: Floats  # (n,) [m^2], or any measure of them; positive for at least one

    def __len__(self) -> int:
        return len(self.at)

    def subset(self, chosen: NDArray[np.bool_] | Ints) -> FleshPoints:
        """Those of the points that are chosen, (n,) or by rows; alike where these have no area."""
        area = self.area[chosen]
        return FleshPoints(at=self.at[chosen], area=area if area.any() else np.ones(len(area)))

    def mean(self) -> NDArray[np.float64]:
        """(3,) [m] the mean of the points."""
        return np.asarray(self.area @ self.at / self.area.sum())

    def median(self, values: Floats) -> float:
        """The median of values (n,) at the points: at most half of the area has smaller ones."""
        order = np.argsort(values, kind="stable")
        below = np.cumsum(self.area[order])
        return float(values[order[np.searchsorted(below, 0.5 * below[-1], side="right")]])


def point_areas(points: Floats, triangles: Ints) -> NDArray[np.float64]:
    """(V,) a third of the areas of the triangles (T, 3) at each of the points (V, 3).

    Without triangles, as of a tetrahedral mesh, equal shares of the area of the box around them.
    """
    if not len(triangles):
        x, y, z = np.ptp(points, axis=0)
        return np.full(len(points), 2.0 * (x * y + y * z + z * x) / len(points))
    corners = np.asarray(triangles).reshape(-1)
    shares = np.repeat(areas(points, triangles) / 3.0, 3)
    return np.asarray(np.bincount(corners, shares, len(points)), np.float64)


def connected_parts(points: Floats, triangles: Ints) -> NDArray[np.int64]:
    """(V,) the connected part of a mesh that each of its points (V, 3) belongs to; points in one
    place are one.  Without triangles (T, 3), as of a tetrahedral mesh, all are one part.
    """
    if not len(triangles):
        return np.zeros(len(points), np.int64)
    corners = np.asarray(triangles)
    part = _linked(corners, len(points))
    if np.ptp(part[corners]) > 0:  # else welding, the slower step, changes nothing
        of = weld(points)[0]
        part = _linked(of[corners], len(points))[of]
    return part


def _linked(triangles: Ints, count: int) -> NDArray[np.int64]:
    """(count,) the part of each point that triangles (T, 3) connect."""
    from scipy.sparse import coo_matrix

    rows, columns = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]]]).T
    graph = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(count, count))
    return np.asarray(components(graph)[1], np.int64)


def near_flesh(
    at: Floats, part: Ints, joined: NDArray[np.bool_], joint: Floats
) -> NDArray[np.bool_]:
    """(n,) which points (n, 3) [m] of a joint are its flesh, and not of a part apart from it, such
    as a balloon that a hand leads: toward that, a bone would leave the flesh.

    Parts with points of other joints, too, are its flesh.  Of those that follow this joint alone
    all are whose bounding box is no farther from that of the flesh and the joint than a share APART
    of its diagonal, repeatedly.  Where no part has points of other joints, as in a jointed doll, it
    is unknown which are apart, and all are its flesh.

    part : (n,) of each point; joined : (n,) whether its part has points of other joints.
    """
    if joined.all() or not joined.any():
        return np.ones(len(at), bool)
    labels, of = np.unique(part, return_inverse=True)
    low, high = np.full((len(labels), 3), np.inf), np.full((len(labels), 3), -np.inf)
    np.minimum.at(low, of, at)
    np.maximum.at(high, of, at)
    kept = np.zeros(len(labels), bool)
    kept[of[joined]] = True
    while not kept.all():
        least = np.minimum(low[kept].min(0), joint)
        most = np.maximum(high[kept].max(0), joint)
        gaps = np.linalg.norm(np.maximum(np.maximum(low - most, least - high), 0.0), axis=1)
        near = kept | (gaps <= APART * np.linalg.norm(most - least))
        if (near == kept).all():
            break
        kept = near
    return kept[of]


def beyond(flesh: FleshPoints, joint: Floats, parent: Floats) -> FleshPoints:
    """The flesh that lies beyond a joint as seen from its parent; all if none does.

    The rest lies along the segment of the parent, and would shorten a segment toward the mean or
    turn it back.
    """
    far = (flesh.at - joint) @ (joint - parent) > 0.0
    return flesh.subset(far) if far.any() else flesh


def into_flesh(flesh: FleshPoints, joint: Floats) -> Floats:
    """End (3,) of a segment from a joint toward the mean of flesh, also where this is slender: then
    it ends before the last point by half of the width.
    """
    reach = INTO_FLESH * float(np.linalg.norm(flesh.mean() - joint))
    return np.asarray(joint + max(reach, slender(flesh, joint)) * direction(flesh, joint))


def direction(flesh: FleshPoints, joint: Floats) -> Floats:
    """(3,) unit vector from a joint to the mean of flesh, and then to that of its farther half:
    points around the joint, such as the skull behind a snout, would turn it.  All that is more than
    half as far as the last point belongs to it: the corners on the top of a head may differ by
    rounding only, and half of them would turn it, too.  0 where the mean is the joint.
    """
    along = (flesh.at - joint) @ (flesh.mean() - joint)
    far = along >= min(flesh.median(along), 0.5 * float(along.max()))
    way = flesh.subset(far).mean() - joint
    return np.asarray(way / max(float(np.linalg.norm(way)), np.finfo(float).tiny))


def slender(flesh: FleshPoints, joint: Floats) -> float:
    """[m] from a joint along the direction of flesh to the last point, less half the width: the
    median of the distances from this line.  What a gap of more than half of that distance
    separates, such as a mesh apart from the others, does not count.
    """
    way, at = direction(flesh, joint), flesh.at - joint
    along = at @ way
    half = flesh.median(np.linalg.norm(at - along[:, None] * way, axis=1))
    steps = np.sort(along)
    apart = np.flatnonzero(np.diff(steps) > max(2.0 * half, 0.5 * float(steps[-1])))
    return float(steps[apart[0] if len(apart) else -1]) - half


def distance(point: Floats, start: Floats, ends: Sequence[Floats]) -> float:
    """[m] distance of a point from the nearest of the segments that begin at `start`."""
    return min((float(to_segment(point[None], start, end)[0]) for end in ends), default=np.inf)


def to_segment(points: Floats, start: Floats, end: Floats) -> NDArray[np.float64]:
    """(n,) [m] distances of points (n, 3) from a segment."""
    way = end - start
    t = np.clip((points - start) @ way / (way @ way), 0.0, 1.0)
    return np.asarray(np.linalg.norm(points - start - t[:, None] * way, axis=1))
