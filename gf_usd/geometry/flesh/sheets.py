"""Sheets of a character: skinned meshes that enclose no volume, such as a skirt or hair.

A sheet follows its skinned pose, and moves with the flesh where it is near it.  With s the skinned
pose of a point X of the sheet, X* the nearest point of the flesh at rest, f the skinned pose of X*,
and e where the simulation takes it,

    x = s + a (e - f),    a = 1 - 3 r^2 + 2 r^3,    r = min(d / D, 1)

with d the distance of X from the flesh and D a share of the flesh's size.  Without the skinned pose
a sheet would move with the flesh that happens to be nearest: the hem of a skirt with either leg.

A garment is an open mesh around others, as a skirt is around legs.  Its holes are where these pass
through, not defects of a closed mesh, so that it encloses no volume although they may be small.
A closed mesh around no bone that is thinner than the particles are apart, such as a solidified
skirt, is a sheet as well: filled, it would be a slab of jelly that hangs from its upper rim.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix, diags_array

from gf_usd.core.arrays import Floats
from gf_usd.core.asset import Surface
from gf_usd.core.frames.differences import velocity_at
from gf_usd.core.frames.frame import Pose
from gf_usd.core.neighbors import nearest
from gf_usd.core.stage import Skeleton
from gf_usd.geometry.flesh.goals import on_skin, weights_with_thickened
from gf_usd.geometry.flesh.linear_blend import bone_transforms, skinned_with_gradients
from gf_usd.geometry.flesh.single_joint import single_joint_meshes
from gf_usd.geometry.solid import Bounds, Solid, closed_triangles, mean_thickness, spread_evenly

REACH = 0.1  # of the size of the flesh: D
# A garment: the share of its volume that others fill, of their points outside it, and of its own
# points inside them.
FILLED, PASSING, INSIDE = 0.2, 0.25, 0.25
ALONG, HELD = 25, 0.1  # points along a bone, and the share of them by which it is in a mesh
# times the thickness: bones of which less is in a mesh go through its wall, as into the sleeve of a
# jacket, at up to 75 degrees from its normal
THROUGH = 4.0
TESTED = 256  # points of a surface, about, that are tested for being inside another one
PROBES = 4_000  # points in the box of a mesh, by which its volume is compared


@dataclass(frozen=True, kw_only=True)
class Skinning:
    """The linear blend skinning of some points."""

    X: Floats  # (n, 3) [m] at rest
    weights: csr_matrix  # (n, bones) rows sum to 1
    linear: Floats  # (F, bones, 3, 3) as in `bone_transforms`
    offset: Floats  # (F, bones, 3) [m]

    def at(self, frame: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Positions (n, 3) [m] and gradients (n, 3, 3) at a frame, of the first or last at most."""
        k = int(np.clip(frame, 0, len(self.linear) - 1))
        return skinned_with_gradients(self.weights, self.linear[k], self.offset[k], self.X)

    def rate(self, frame: int, frame_time: float) -> NDArray[np.float64]:
        """(n, 3) [m/s] at a frame, see `velocity_at`; frame_time : [s] of one frame."""
        return velocity_at(lambda k: self.at(k)[0], frame, frame_time, len(self.linear) - 1)


@dataclass(frozen=True, kw_only=True)
class Sheet:
    """A skinned mesh without volume, next to flesh."""

    skin: Skinning  # of its points
    flesh: Skinning  # of the nearest points of the flesh
    share: Floats  # (n,) a
    unbound: int = 0  # of its points, which have the weights of the nearest one that is bound

    @property
    def near(self) -> Floats:
        """(n, 3) [m] the nearest points of the flesh at rest, whose poses `pose` takes."""
        return self.flesh.X

    def pose(self, near: Pose, frame: int, frame_time: float) -> Pose:
        """The pose of the sheet at a frame, from that of `near`; frame_time : [s] of one frame."""
        (s, S), (f, F), a = self.skin.at(frame), self.flesh.at(frame), self.share[:, None]
        rate = self.skin.rate(frame, frame_time) - a * self.flesh.rate(frame, frame_time)
        return Pose(x=s + a * (near.x - f), v=rate + a * near.v, F=S + a[:, :, None] * (near.F - F))


def skinned_sheets(
    surfaces: Sequence[Surface], solid: Solid, skeleton: Skeleton, taken: Collection[str] = ()
) -> dict[str, Sheet]:
    """The sheets among the surfaces of a character, by prim path.

    solid : of the same character; taken : prim paths of surfaces whose motion is given otherwise.
    """
    filled, weights = solid.filled, skeleton.weights
    rows = [k for k, s in enumerate(solid.surfaces) if s.path in weights]
    found = [s for s in surfaces if s.path not in filled and s.path not in taken]
    found = [s for s in found if s.splats is None and len(s.points)]
    found = [s for s in found if s.path in weights and weights[s.path].sum() > 0.0]
    if not rows or not found:
        return {}
    flesh = solid.part(np.array(rows))
    linear, offset = bone_transforms(skeleton)
    reach = REACH * float(np.linalg.norm(flesh.high - flesh.low))
    out = {}
    for surface in found:
        X = np.asarray(surface.points, np.float64)
        near, bones, known = _nearest(flesh, X, weights)
        ratio = np.minimum(np.linalg.norm(X - near, axis=1) / reach, 1.0)
        motion = {"linear": linear, "offset": offset}
        own, unbound = _all_bound(X, weights[surface.path])
        out[surface.path] = Sheet(
            skin=Skinning(X=X, weights=own, **motion),
            flesh=Skinning(X=near, weights=bones, **motion),
            unbound=unbound,
            share=known * (1.0 - ratio**2 * (3.0 - 2.0 * ratio)),
        )
    return out


def _all_bound(X: Floats, weights: csr_matrix) -> tuple[csr_matrix, int]:
    """Weights (n, bones) of points X (n, 3) [m], and how many points without any were given those
    of the nearest point with some.
    """
    bound = np.asarray(weights.sum(1)).ravel() > 0.0
    if bound.all():
        return weights, 0
    rows = np.arange(len(X))
    rows[~bound] = np.flatnonzero(bound)[nearest(X[bound], X[~bound], 1)[1].ravel()]
    return csr_matrix(weights[rows]), int((~bound).sum())


def _nearest(
    flesh: Solid, X: Floats, weights: Mapping[str, csr_matrix]
) -> tuple[NDArray[np.float64], csr_matrix, NDArray[np.float64]]:
    """The nearest points (n, 3) [m] of the flesh to X (n, 3), which may be inside it, the weights
    (n, bones) of its skin there, and their sum (n,) before they are scaled to 1: where it is 0, the
    skinned pose of the flesh is not known.
    """
    near, total = np.zeros_like(X), None
    for surface, on in zip(flesh.surfaces, on_skin(flesh, X), strict=True):
        to_points = on.to_points(len(surface.points))
        near += to_points @ surface.points
        bones = to_points @ weights_with_thickened(surface, weights[surface.path])
        total = bones if total is None else total + bones
    within, (bones, known) = flesh.inside(X), unit_rows(csr_matrix(total))
    return np.where(within[:, None], X, near), bones, known


def unit_rows(weights: csr_matrix) -> tuple[csr_matrix, NDArray[np.float64]]:
    """Weights (n, bones), rows scaled to a sum of 1 if they are not empty; sums (n,) before."""
    total = np.asarray(weights.sum(1)).ravel()
    return csr_matrix(diags_array(1.0 / np.where(total > 0.0, total, 1.0)) @ weights), total


def garments(solid: Solid, posed: Collection[str]) -> tuple[str, ...]:
    """Prim paths of the filled meshes that are garments around others.

    posed : prim paths of the meshes that a skeleton poses: others are none.

    Empty where nothing else would be left.
    """
    points = [s.face_points for s in solid.surfaces]
    found = [
        surface.path
        for k, surface in enumerate(solid.surfaces)
        if surface.path in posed
        and len(surface.welded.boundary)
        and _holds_others(solid.bounds, k, points)
    ]
    return tuple(found) if len(found) < len(points) else ()


def _holds_others(bounds: Sequence[Bounds], k: int, points: Sequence[Floats]) -> bool:
    """Whether others pass through surface k, fill a part of it, and hold little of it.

    points : (n, 3) [m] of each surface.
    """
    mine, own = bounds[k], points[k][:: max(1, len(points[k]) // TESTED)]
    low, high = points[k].min(0), points[k].max(0)
    others, covered = [], np.zeros(len(own), bool)
    for j, other in enumerate(bounds):
        apart = (other.low >= high).any() or (other.high <= low).any()
        if j == k or apart or not _passes(points[j], mine):
            continue
        others.append(other)
        covered |= other.inside(own)
        if covered.mean() > INSIDE:
            return False
    if not others:
        return False
    X = low + (high - low) * spread_evenly(PROBES)
    X = X[mine.inside(X)]
    held = np.zeros(len(X), bool)
    for other in others:
        held[~held] = other.inside(X[~held])
    return bool(len(X)) and bool(held.mean() >= FILLED)


def _passes(X: Floats, bounds: Bounds) -> bool:
    """Whether a share PASSING of the points X (n, 3) [m] of a surface is outside another one, but
    not all are.
    """
    near = X[((bounds.low <= X) & (bounds.high >= X)).all(1)]
    if not len(near):
        return False
    inside = bounds.inside(near[:: max(1, len(near) // TESTED)]).mean() * len(near) / len(X)
    return bool(0.0 < inside <= 1.0 - PASSING)


def thin_sheets(
    solid: Solid, skeleton: Skeleton, spacing: float, drawn: Sequence[Surface] = ()
) -> dict[str, float]:
    """The mean thickness [m] of the filled meshes that are closed sheets, by prim path.

    See `mean_thickness`; it is less than the spacing [m] of the particles.  A mesh with a bone in
    it, not just through it, is flesh, however thin, and one of a single joint moves rigidly.

    drawn : the authored surfaces, where those of the solid may have been thickened: open ones are
        no closed sheets.

    Empty where no other mesh has a bone in it.
    """
    single = single_joint_meshes(skeleton)
    segments = np.concatenate([np.zeros((0, 2, 3)), *(b.segments for b in skeleton.bones)])
    along = np.linspace(0.0, 1.0, ALONG)[:, None]
    ways = segments[:, 1] - segments[:, 0]
    X = segments[:, None, 0] + along * ways[:, None]
    lengths = np.linalg.norm(ways, axis=1)
    found, flesh = {}, False
    authored = {s.path: s for s in drawn}
    for surface, bounds in zip(solid.surfaces, solid.bounds, strict=True):
        share = bounds.inside(X.reshape(-1, 3)).reshape(X.shape[:2]).mean(1)
        one = authored.get(surface.path, surface)
        thickness = mean_thickness(one)
        least = THROUGH * thickness if thickness < spacing else 0.0
        if ((share >= HELD) & (share * lengths >= least)).any():
            flesh = True
        elif (
            surface.path in skeleton.weights.keys() - single.keys()
            and thickness < spacing
            and not closed_triangles(one)[2]
        ):
            found[surface.path] = thickness
    return found if flesh else {}
