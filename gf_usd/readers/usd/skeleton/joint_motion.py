"""The motion of the joints of a skeleton, with a pre-roll from the bind pose into the animation.

Times before the first frame are the pre-roll.  The transform of each joint, relative to the next
ancestor with skinned points, is interpolated from the bind pose to an extrapolation of the
animation, separately in rotation, stretch and translation, with weights s = 3 r^2 - 2 r^3.
Position and velocity are continuous at the first frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import StageFacts
from gf_usd.core.errors import InputError
from gf_usd.core.matrices import signed_polar
from gf_usd.core.units import code_text
from gf_usd.readers.usd.skeleton.rig import Rig

MEMORY = 4.0  # [frames] by which the pre-roll extrapolates the animation backward


def skeleton_world(rig: Rig, code: float, facts: StageFacts) -> NDArray[np.float64]:
    """(4, 4) local-to-world transform of the skeleton at a time code, stage units."""
    matrix = UsdGeom.Xformable(rig.prim).ComputeLocalToWorldTransform(Usd.TimeCode(code))
    rows = np.array(matrix, dtype=np.float64)
    if not np.isfinite(rows).all() or abs(np.linalg.det(rows[:3, :3])) == 0.0:
        raise InputError(
            f"{facts.path}: --flesh: the transform of <{rig.path}> cannot be inverted at time "
            f"code {code_text(code)}",
            "repair the animation of the skeleton, or of a prim above it",
        )
    return rows


def _posed(rig: Rig, code: float, facts: StageFacts) -> NDArray[np.float64]:
    """(J, 4, 4) transforms of the joints in the skeleton's space at a time code."""
    found = rig.query.ComputeJointSkelTransforms(Usd.TimeCode(code))
    rows = np.array(found if found is not None else [], dtype=np.float64).reshape(-1, 4, 4)
    bad = ~np.isfinite(rows).all((1, 2))
    if len(rows) != len(rig.joints) or bad.any():
        what = (
            f"has {len(rows)} transforms for {len(rig.joints)} joints"
            if len(rows) != len(rig.joints)
            else f"moves joint {rig.joints[int(bad.argmax())]} to a position that is not finite"
        )
        raise InputError(
            f"{facts.path}: --flesh: the animation of <{rig.path}> {what} at time code"
            f" {code_text(code)}",
            "repair the animation (SkelAnimation), or author restTransforms, one for each joint",
        )
    return rows


def _carriers(rig: Rig) -> Ints:
    """(J,) the nearest ancestor of each joint with skinned points; -1: none."""
    flesh = np.zeros(len(rig.joints), bool)
    flesh[np.unique(np.concatenate(rig.owner))] = True
    out = np.full(len(rig.joints), -1)
    for j, parent in enumerate(rig.parents):  # parents come first in a valid order
        if parent >= 0:
            out[j] = parent if flesh[parent] else out[parent]
    return out


def _relative(above: Ints, matrices: Floats) -> NDArray[np.float64]:
    """(J, 4, 4) transforms relative to the joints `above`, from those in the skeleton's space."""
    base = np.where((above >= 0)[:, None, None], matrices[np.maximum(above, 0)], np.eye(4))
    return np.asarray(matrices @ np.linalg.inv(base))


def _joined(above: Ints, relative: Floats) -> NDArray[np.float64]:
    """The inverse of `_relative`."""
    out = np.array(relative, float)
    for j, parent in enumerate(above):
        if parent >= 0:
            out[j] = out[j] @ out[parent]
    return out


def joint_motion(rig: Rig, facts: StageFacts, first: float, times: Floats) -> NDArray[np.float64]:
    """(F, J, 4, 4) transforms of the joints in the skeleton's space."""
    out = [_posed(rig, code, facts) for code in times if code >= first]
    before = times[times < first]
    if not len(before):
        return np.stack(out)
    above = _carriers(rig)
    step = float(times[1] - times[0]) if len(times) > 1 else 1.0
    rest, start, after = (
        _Parts.of(_relative(above, M))
        for M in (rig.bind, _posed(rig, first, facts), _posed(rig, first + step, facts))
    )
    lead = [
        _joined(above, rest.toward(start.toward(after, back), s).matrices)
        for s, back in lead_in(before, first, step)
    ]
    return np.stack([*lead, *out])


def skeleton_worlds(
    rig: Rig, facts: StageFacts, first: float, times: Floats
) -> NDArray[np.float64]:
    """(F, 4, 4) local-to-world of the skeleton."""
    rest = skeleton_world(rig, first, facts)
    before = times[times < first]
    step = float(times[1] - times[0]) if len(times) > 1 else 1.0
    change = skeleton_world(rig, first + step, facts) - rest if len(before) else 0.0
    lead = [rest + back * s * change for s, back in lead_in(before, first, step)]
    return np.stack([*lead, *(skeleton_world(rig, code, facts) for code in times if code >= first)])


def lead_in(before: Floats, first: float, step: float) -> list[tuple[float, float]]:
    """(s, frames) of each time before the first frame.

    s is the weight of the animation, and `frames` how far it is extrapolated backward, with slope
    1 at the first frame.

    before : (B,) time codes; first : of the first frame; step : of one frame, in time codes.
    """
    out = []
    for code in before:
        r = (code - before[0]) / (first - before[0])
        frames = MEMORY * (np.exp((code - first) / (step * MEMORY)) - 1.0)
        out.append((3.0 * r**2 - 2.0 * r**3, float(frames)))
    return out


@dataclass(frozen=True)
class _Parts:
    """Transforms x -> R S x + t of joints, decomposed."""

    rotation: Floats  # (J, 3, 3)
    stretch: Floats  # (J, 3, 3)
    translation: Floats  # (J, 3)

    @classmethod
    def of(cls, matrices: Floats) -> _Parts:
        """Polar decomposition of matrices (J, 4, 4) for row vectors."""
        A = np.swapaxes(matrices[:, :3, :3], 1, 2)
        R = signed_polar(A)
        return cls(R, np.swapaxes(R, 1, 2) @ A, matrices[:, 3, :3])

    def toward(self, other: _Parts, s: float) -> _Parts:
        """Interpolation to other transforms by a fraction s; extrapolation for s < 0."""
        from scipy.spatial.transform import Rotation

        turn = Rotation.from_matrix(np.swapaxes(self.rotation, 1, 2) @ other.rotation).as_rotvec()
        return _Parts(
            self.rotation @ Rotation.from_rotvec(s * turn).as_matrix(),
            (1.0 - s) * self.stretch + s * other.stretch,
            (1.0 - s) * self.translation + s * other.translation,
        )

    @property
    def matrices(self) -> NDArray[np.float64]:
        """(J, 4, 4) for row vectors."""
        out = np.broadcast_to(np.eye(4), (len(self.rotation), 4, 4)).copy()
        out[:, :3, :3] = np.swapaxes(self.rotation @ self.stretch, 1, 2)
        out[:, 3, :3] = self.translation
        return out
