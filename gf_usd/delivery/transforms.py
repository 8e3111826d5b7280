"""The joints of a rig as a hierarchy: a root, the others below it, each with a bind position."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.delivery.joints import STEPS
from gf_usd.delivery.rig import Rig


@dataclass(frozen=True, kw_only=True)
class Hierarchy:
    """Joint 0 is the root; the transforms of the others are relative to it."""

    bind: Floats  # (1 + J, 3) [m] world positions in the rest pose; nothing is turned there
    rotations: Floats  # (T, 1 + J, 4) unit quaternions (x, y, z, w), continuous in time
    translations: Floats  # (T, 1 + J, 3) [m]

    def __len__(self) -> int:
        return len(self.bind)

    @property
    def bind_local(self) -> Floats:
        """(1 + J, 3) [m] relative to the root."""
        return np.concatenate([self.bind[:1], self.bind[1:] - self.bind[0]])


def hierarchy(rig: Rig) -> Hierarchy:
    """The joints of a rig; a joint is at the weighted mean of its points."""
    rest, root = rig.body.rest, rig.root
    center = rest.mean(axis=0)
    bind = [center]
    R, d = [root.rotations], [root.rotations @ center + root.translations]
    if rig.skinning is not None:
        skin = rig.skinning
        for j in range(len(skin)):
            w = ((skin.joints == j) * skin.weights).sum(axis=1) / STEPS
            total = float(w.sum())
            at = w @ rest / total if total > 0.0 else center
            bind.append(at)
            R.append(skin.rotations[j])
            d.append(skin.rotations[j] @ at + skin.translations[j] - center)
    turns = np.array([_quaternions(one) for one in R])
    return Hierarchy(
        bind=np.array(bind), rotations=turns.transpose(1, 0, 2), translations=np.stack(d, axis=1)
    )


def _quaternions(R: Floats) -> Floats:
    """(T, 4) (x, y, z, w) of (T, 3, 3), each on the side of the one before it."""
    from scipy.spatial.transform import Rotation

    q = Rotation.from_matrix(R).as_quat(canonical=True)
    turned = (q[1:] * q[:-1]).sum(axis=1) < 0.0
    sign = np.cumprod(np.where(np.concatenate([[False], turned]), -1.0, 1.0))
    return q * sign[:, None]
