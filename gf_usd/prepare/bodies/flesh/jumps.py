"""Jumps of an animation, as at a cut, which throw the flesh of a character."""

from __future__ import annotations

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.stage import Skeleton
from gf_usd.core.units import code_text, length_text, rounded_text

FAR = 0.2  # of the size of the skeleton: a runner moves as far between two frames
STEEP = 4.0  # times as far as in the frames before and after


def jump_notes(skeleton: Skeleton, times: Floats, lead: int) -> tuple[str, ...]:
    """A note on the jumps of a skeleton, the first of which it states.

    A jump is a step between two frames in which half of the joints move far, and several times as
    far as in the steps before and after.

    times : (F,) ascending time codes of the frames of its bones; lead : number of frames before
        its animation.
    """
    times = times[lead:]
    joints = np.stack([bone.path[lead:, 0] for bone in skeleton.bones], axis=1)  # (F, J, 3)
    if len(joints) < 4:
        return ()
    rest = np.stack([bone.anchors for bone in skeleton.bones])
    size = float(np.linalg.norm(np.ptp(rest.reshape(-1, 3), axis=0)))
    steps = np.median(np.linalg.norm(np.diff(joints, axis=0), axis=2), axis=1)
    beside = np.maximum(np.append(0.0, steps[:-1]), np.append(steps[1:], 0.0))
    jumps = np.flatnonzero((steps > FAR * size) & (steps > STEEP * beside))
    if not len(jumps):
        return ()
    at = int(jumps[0])
    before, after = code_text(float(times[at])), code_text(float(times[at + 1]))
    ratio = f", {rounded_text(steps[at] / beside[at])} times as far as in the frames beside it"
    more = len(jumps) - 1
    others = f", and {more} more time{'s' * (more > 1)} later" if more else ""
    return (
        f"the animation jumps by {length_text(steps[at])} between time codes {before} and {after}"
        f"{ratio if beside[at] > 0.0 else ''}{others}, which throws the flesh: bake the parts"
        f" before and after a cut separately (--range :{before} and --start {after})",
    )
