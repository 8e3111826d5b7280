"""The motion of the joints of a skeleton: the pre-roll from the bind pose into the animation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from arm import FIRST, arm, write

from gf_usd.core.stage import Bone
from gf_usd.readers import read_asset
from gf_usd.readers.usd.skeleton.bones import read_skeleton


def bones(path: Path, times: Sequence[float]) -> tuple[Bone, ...]:
    facts = read_asset(path).facts
    return read_skeleton(path, ["/Arm/Skin"], facts, first=FIRST, times=times).bones


def test_the_preroll_begins_at_rest_and_joins_the_animation_smoothly(tmp_path: Path) -> None:
    lead = 24
    path = write(tmp_path, arm(lift=(0.0, 0.6)))
    times = FIRST + np.arange(-lead, 4.0)
    posed = bones(path, [FIRST])
    for bone, first in zip(bones(path, times.tolist()), posed):
        x = bone.path
        np.testing.assert_array_equal(x[lead], first.path[0])
        np.testing.assert_array_equal(x[0], bone.anchors)
        v = np.diff(x, axis=0)
        # ease in: 3 r^2 of the way, a sixty-fourth of the mean speed in the first frame at most
        way = np.abs(np.diff(x, axis=0)).sum(0).max()
        assert np.abs(v[0]).max() <= 4.0 / lead**2 * way + 1e-6
        # no jump in velocity: the change over the seam is one of acceleration, as before it
        jump = np.abs(v[lead] - v[lead - 1]).max()
        usual = np.abs(np.diff(v[: lead - 1], axis=0)).max()
        assert jump <= 1.5 * usual + 1e-6
