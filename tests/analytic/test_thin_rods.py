"""Rods thinner than a cell next to a thick body: they stretch and bend as rods do."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy import sparse
from scipy.sparse.linalg import spsolve
from solids import solid, sphere, surface

from gf_usd.geometry.sampling.particles import sample_solid
from gf_usd.physics.grid.reference.build import build_stencil

NU = 0.3
LENGTH = 9.0  # [m] of the rods; cells have an edge of 1 m
TILT = (0.3, 0.5, 0.7)


def tip_compliance(thickness, tilt):
    """Displacement of a rod's tip along and across it over those of a beam, as (2,).

    A ball of the same body is far away: what is light next to its nodes is all that the rod has.
    """
    mesh = trimesh.creation.box((LENGTH, thickness, thickness))
    turn = trimesh.transformations.euler_matrix(*tilt)
    mesh.apply_transform(turn)
    rod = surface(np.asarray(mesh.vertices), np.asarray(mesh.faces), path="/Rod")
    body = solid(rod, sphere(2.0, center=(0.0, 12.0, 0.0)))
    made = sample_solid(body, particles=None, spacing=0.5, seed=0)
    nodes = build_stencil(made.X, made.V0, 2.0 * made.lattice, made.corner)
    rows, n = nodes.rows(made.X), nodes.free_count
    W, G, V = rows.W, rows.G, sparse.diags_array(made.V0)
    lam, mu = NU / ((1.0 + NU) * (1.0 - 2.0 * NU)), 0.5 / (1.0 + NU)
    shear = sum(g.T @ V @ g for g in G)
    K = [
        [lam * (a.T @ V @ b) + mu * (b.T @ V @ a) + (mu * shear if a is b else 0.0 * shear)
         for b in G] for a in G
    ]  # fmt: skip
    x = made.X @ turn[:3, 0]
    in_rod = made.surface == 0
    held = W.T @ sparse.diags_array(1e3 * made.V0 * ~(in_rod & (x > -0.5 * LENGTH + 1.0))) @ W
    K = sparse.block_array(K) + sparse.block_diag([held] * 3)
    tip = made.V0 * (in_rod & (x > 0.5 * LENGTH - 1.0))
    tip /= tip.sum()
    reach = float(tip @ x) + 0.5 * LENGTH - 1.0
    area = thickness**2
    beam = (reach / area, reach**3 / (3.0 * area * thickness**2 / 12.0))
    found = []
    for way in (turn[:3, 0], turn[:3, 2]):
        u = spsolve(K.tocsc(), np.concatenate([d * (W.T @ tip) for d in way])).reshape(3, n).T
        found.append(float(tip @ (W @ u) @ way))
    return np.array(found) / beam


@pytest.mark.slow
@pytest.mark.parametrize("tilt", [TILT, (0.0, 0.0, 0.0)])
@pytest.mark.parametrize("thickness", [1.0, 0.5, 0.15])
def test_a_rod_thinner_than_a_cell_is_a_rod(thickness, tilt):
    pulled, bent = tip_compliance(thickness, tilt)
    # Held where its end begins, to a cell of the length: 1 in 8.
    assert pulled == pytest.approx(1.0, abs=1.0 / 8.0)
    # Of third order in the length; light nodes stiffen what is thinner than half a cell.
    assert 0.4 < bent < 1.0 + 3.0 / 8.0
