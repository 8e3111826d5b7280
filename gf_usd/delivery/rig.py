"""The rig of a body in a delivered file: one root joint, and joints or blend shapes.

    x_v(t) = Q(t) s_v(t) + c(t)            the root joint: the rigid motion of the whole body
    s_v(t) = sum_j w_vj (R_j(t) p_v + d_j(t))    joints, or
    s_v(t) = p_v + sum_k a_k(t) b_kv             blend shapes b_k with keys a_k

Blend shapes are the principal components of the frames without the motion of the root.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.delivery.joints import Skinning, decompositions, kabsch
from gf_usd.delivery.motion import BodyMotion


@dataclass(frozen=True, kw_only=True)
class Root:
    """The rigid motion of a body, from the rest pose to each frame."""

    rotations: Floats  # (T, 3, 3) for column vectors
    translations: Floats  # (T, 3) [m]

    def __call__(self, points: Floats) -> Floats:
        """World positions (T, V, 3) [m] of points (V, 3) or (T, V, 3) of the body's own frame."""
        return points @ self.rotations.transpose(0, 2, 1) + self.translations[:, None]

    def undone(self, points: Floats) -> Floats:
        """(T, V, 3) [m] world points in the body's own frame."""
        return (points - self.translations[:, None]) @ self.rotations


@dataclass(frozen=True, kw_only=True)
class Rig:
    """A body as it is delivered; `skinning` or `shapes`, never both."""

    body: BodyMotion
    root: Root
    skinning: Skinning | None = None  # translations in meters
    shapes: Floats | None = None  # (K, V, 3) [m]
    keys: Floats | None = None  # (T, K)
    # (n,) for each of `body.splats`: the one joint that each Gaussian follows, 0 the root;
    # none: they follow joints with weights, or shapes, as all points do
    single: tuple[Ints, ...] = ()

    @property
    def joints(self) -> int:
        """How many joints, without the root."""
        return 0 if self.skinning is None else len(self.skinning)

    @property
    def blend_shapes(self) -> int:
        """How many blend shapes."""
        return 0 if self.shapes is None else len(self.shapes)

    @property
    def own(self) -> Floats:
        """(T, V, 3) [m] in the body's own frame."""
        if self.skinning is not None:
            return self.skinning.pose(self.body.rest)
        assert self.shapes is not None
        assert self.keys is not None
        return self.body.rest + np.tensordot(self.keys, self.shapes, axes=1)

    @property
    def error(self) -> float:
        """The largest distance to the bake over points and frames, in radii."""
        off = self.root(self.own) - self.body.frames
        return float(np.sqrt((off**2).sum(axis=2).max())) / self.body.radius


def root_of(body: BodyMotion) -> Root:
    """The rigid motion nearest to that of the points."""
    R, d = kabsch(body.rest, body.frames, np.ones(len(body.rest)))
    return Root(rotations=R, translations=d)


def with_joints(body: BodyMotion, tolerance: float, most: int) -> Iterator[Rig]:
    """Rigs of more and more joints until the error is within the tolerance, in radii, or `most`.

    A body that moves as a rigid one has the root joint alone.
    """
    root = root_of(body)
    own, r = root.undone(body.frames), body.radius
    alone = Rig(body=body, root=root, shapes=np.zeros((0, *body.rest.shape)),
                keys=np.zeros((len(own), 0)))  # fmt: skip
    if alone.error <= tolerance:
        yield alone
        return
    for found, _ in decompositions(body.rest / r, own / r, tolerance, most):
        yield Rig(
            body=body,
            root=root,
            skinning=Skinning(
                rotations=found.rotations, translations=found.translations * r,
                joints=found.joints, weights=found.weights,
            ),
        )  # fmt: skip


def with_shapes(body: BodyMotion, tolerance: float, most: int) -> Rig | None:
    """The rig of the fewest principal components within the tolerance, in radii; None above `most`.

    Keys are in 0 to 1, where programs clamp them: each shape goes from its least to its largest
    key, and a shape with the constant key 1 adds what all of them are at their least.
    """
    root = root_of(body)
    own = root.undone(body.frames)
    T, V = own.shape[:2]
    moved = (own - body.rest).reshape(T, -1)
    u, s, vt = np.linalg.svd(moved, full_matrices=False)
    for count in range(min(most - 1, len(s)) + 1):
        keys, shapes = u[:, :count] * s[:count], vt[:count]
        low, high = keys.min(axis=0, initial=0.0), keys.max(axis=0, initial=0.0)
        size = np.maximum(high - low, np.finfo(float).tiny)
        scaled = np.concatenate([shapes * size[:, None], (low @ shapes)[None]])
        rig = Rig(
            body=body,
            root=root,
            shapes=scaled.reshape(count + 1, V, 3)[: count + bool(count)],
            keys=np.column_stack([(keys - low) / size, np.ones(T)])[:, : count + bool(count)],
        )
        if rig.error <= tolerance:
            return rig
    return None


def with_single_joints(rig: Rig) -> Rig:
    """Each Gaussian on the one joint with the smallest largest error over the frames."""
    if rig.skinning is None:
        return rig  # rigid: all follow the root
    skin, found = rig.skinning, []
    own = rig.root.undone(rig.body.frames)
    for number in range(len(rig.body.splats)):
        part = rig.body.splats_of(number)
        p, x = rig.body.rest[part], own[:, part]
        least = ((x - p) ** 2).sum(axis=2).max(axis=0)
        joint = np.zeros(len(p), np.int64)
        for j in range(len(skin)):
            moved = p @ skin.rotations[j].transpose(0, 2, 1) + skin.translations[j][:, None]
            off = ((x - moved) ** 2).sum(axis=2).max(axis=0)
            joint = np.where(off < least, 1 + j, joint)
            least = np.minimum(off, least)
        found.append(joint)
    return replace(rig, single=tuple(found))
