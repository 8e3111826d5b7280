"""Random rotations, drawn evenly, and deformation gradients.

SciPy's `stats` has such rotations too, and takes a second to import.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from gf_usd.core.arrays import Floats


def random_turns(n: int, seed: int) -> Floats:
    """(n, 3, 3) rotation matrices."""
    return Rotation.random(n, random_state=seed).as_matrix()


def gradients(n: int, size: float, seed: int = 0) -> Floats:
    """(n, 3, 3) gradients with logarithmic stretches within a size, turned at random."""
    s = np.exp(np.random.default_rng(seed).uniform(-size, size, (n, 3)))
    return (random_turns(n, seed + 1) * s[:, None, :]) @ random_turns(n, seed + 2).swapaxes(1, 2)


def log_strains(F: Floats) -> tuple[Floats, Floats]:
    """|dev e| and tr e (n,) of the logarithmic strains e of gradients (n, 3, 3)."""
    e = np.log(np.linalg.svd(F)[1])
    return np.linalg.norm(e - e.mean(1, keepdims=True), axis=1), e.sum(1)
