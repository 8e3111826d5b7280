"""Rotations drawn evenly from all; SciPy's `stats` has them too and takes a second to import."""

from __future__ import annotations

from scipy.spatial.transform import Rotation

from gf_usd.core.arrays import Floats


def random_turns(n: int, seed: int) -> Floats:
    """(n, 3, 3) rotation matrices."""
    return Rotation.random(n, random_state=seed).as_matrix()
