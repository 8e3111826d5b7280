"""A ball that hardly moves, strained by hand: what the tests of the paper's options act on."""

from __future__ import annotations

from functools import cache

import numpy as np
from solids import ball, preset_material, settings

from gf_usd.physics.total_lagrangian.shape_correction import clip_stretches
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian

EXACT = 1e-12  # sums of a few hundred float64 of order one
SQUASH = np.array([[1.1, 0.3, 0.0], [0.0, 0.4, -0.2], [0.1, 0.0, 1.6]])
INVERTED = np.diag([1.2, 0.9, -0.5])


@cache
def body():
    return ball(300)[0]


def made(
    real: type = np.float64,
    velocity=(0.0, 0.0, 0.0),
    embedded=None,
    pins=(),
    law="corotated",
    **options,
):
    """A ball like rubber that floats, in two substeps a frame so short that it hardly moves."""
    values = {"frames": 2, "fps": 1e5, "substeps": 2, **options}
    material = preset_material("rubber", body(), damping_time=0.0, law=law)
    return TotalLagrangian(
        body(),
        [material],
        settings(**values),
        velocity=velocity,
        embedded=embedded,
        pins=pins,
        real=real,
    )


def strain(solver, A):
    """Put every node where x = A X would have it."""
    u = solver.body.stencil.node_X @ (np.asarray(A) - np.eye(3)).T
    solver.state.arrays["u"].from_numpy(u.astype(solver.body.real).ravel())


def shear_modulus():
    return preset_material("rubber", body()).mu


def force(solver):
    """(free, 3) [N] of the stress alone: m dv/dt over a short frame from rest."""
    solver.advance(1, 1)
    return solver.state.view().momentum / solver.frame_time


def clipped(F, low, high):
    return clip_stretches(np.asarray(F)[None], low, high)[0][0]


def corotated(F: np.ndarray, mu: float, lam: float) -> np.ndarray:
    """P = 2 mu (F - R) + lam (J - 1) J F^-T by singular values; (N, 3, 3)."""
    U, _, Vt = np.linalg.svd(F)
    J = np.linalg.det(F)[:, None, None]
    return 2.0 * mu * (F - U @ Vt) + lam * (J - 1.0) * J * np.linalg.inv(F).swapaxes(1, 2)
