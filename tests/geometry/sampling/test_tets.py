"""Tetrahedra of cells: closed, conforming, of positive volume, and around the whole body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gf_usd.core.frames.particles import CellCopies, Particles, SurfaceSamples
from gf_usd.core.mesh.topology import boundary_edges, tet_surface
from gf_usd.geometry.sampling.tets import KUHN, tet_lattices, without_hinges

NOTHING = SurfaceSamples(X=np.zeros((0, 3)), area=np.zeros(0))


def ball_particles(*, bodies: int = 1) -> Particles:
    """A lattice of edge .1 in the unit ball, in halves where there are two bodies."""
    axis = np.arange(-0.95, 1.0, 0.1)
    X = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    X = X[np.linalg.norm(X, axis=1) < 1.0]
    n = len(X)
    return Particles(
        X=X,
        V0=np.full(n, 1e-3),
        material=np.zeros(n, int),
        orientation=np.tile((1.0, 0.0, 0.0, 0.0), (n, 1)),
        scale=np.full((n, 3), 0.05),
        color=np.ones((n, 3)),
        opacity=np.ones(n),
        surface=np.zeros(n, int),
        spacing=0.1,
        volume=1e-3 * n,
        lattice=0.1,
        corner=np.full(3, -1.0),
        body=None if bodies == 1 else (X[:, 0] > 0.0).astype(int),
    )


def volumes(X: np.ndarray, tets: np.ndarray) -> np.ndarray:
    a, b, c, d = np.moveaxis(X[tets], 1, 0)
    return np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a)) / 6.0


def test_a_ball_of_cells_is_one_conforming_solid() -> None:
    particles = ball_particles()
    (made,) = tet_lattices(particles, NOTHING)
    h = 2.0 * particles.lattice
    v = volumes(made.X, made.tets)
    np.testing.assert_allclose(v, h**3 / 6.0, rtol=1e-9)
    assert len(np.unique(made.X, axis=0)) == len(made.X)
    faces, crowded = tet_surface(made.tets)
    # No face of more than two, and those of one alone close: there is no gap between cells.
    assert not crowded
    assert not len(boundary_edges(faces))
    a, b, c = np.moveaxis(made.X[faces], 1, 0)
    inside = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0
    assert inside == pytest.approx(v.sum(), rel=1e-9)


@pytest.mark.slow
def test_every_particle_and_sample_is_in_a_tetrahedron() -> None:
    particles = ball_particles()
    X = np.asarray(particles.X)
    out = X[np.linalg.norm(X, axis=1) > 0.8]
    normal = out / np.linalg.norm(out, axis=1)[:, None]
    samples = SurfaceSamples(X=1.02 * normal, area=np.ones(len(out)), normal=normal)
    (made,) = tet_lattices(particles, samples)
    h = 2.0 * particles.lattice
    below = samples.X - 0.05 * h * normal
    corner = made.X[made.tets]
    for x in (X, below):
        edges = corner[:, 1:] - corner[:, :1]
        weights = np.einsum("tij,xtj->xti", np.linalg.inv(edges.transpose(0, 2, 1)),
                            x[:, None] - corner[None, :, 0])  # fmt: skip
        held = (weights >= -1e-9).all(2) & (weights.sum(2) <= 1 + 1e-9)
        assert held.any(axis=1).all()


def test_each_body_has_points_of_its_own() -> None:
    particles = ball_particles(bodies=2)
    made = tet_lattices(particles, NOTHING)
    assert [one.body for one in made] == [0, 1]
    assert [one.key for one in made] == ["tets:0", "tets:1"]


@pytest.mark.parametrize(
    ("cells", "count"),
    [
        ([(0, 0, 0), (1, 0, 0)], 2),  # a face
        ([(0, 0, 0), (0, 1, 1)], 3),  # an edge
        ([(0, 0, 0), (0, 1, -1)], 3),
        ([(0, 0, 0), (1, 1, 1)], 4),  # a corner
        ([(0, 0, 0), (1, -1, 1)], 4),
        ([(0, 0, 0), (0, 1, 1), (0, 0, 1)], 3),  # joined already
        ([(0, 0, 0), (2, 0, 0)], 2),  # apart
    ],
)
def test_cells_that_meet_in_an_edge_or_corner_get_one_between(
    cells: list[tuple[int, int, int]], count: int
) -> None:
    made = without_hinges(np.array(cells))
    assert len(made) == count
    assert {tuple(cell) for cell in made.tolist()} >= set(cells)
    if count == len(cells):
        return
    # Faces lead from each cell to each other one.
    reached = {tuple(made[0].tolist())}
    for _ in made:
        reached |= {
            tuple(c) for c in made.tolist()
            for r in reached if np.abs(np.subtract(c, r)).sum() == 1
        }  # fmt: skip
    assert len(reached) == count


def test_copies_of_a_cell_share_no_point_unless_they_are_linked() -> None:
    particles = ball_particles()
    # Two limbs through the same cell, and a trunk that both lead to.
    copies = CellCopies(
        h=2.0 * particles.lattice,
        cell=np.array([(0, 0, 0), (0, 0, 0), (1, 0, 0)]),
        body=np.zeros(3, int),
        links=np.array([(0, 2)]),
        of=np.zeros(len(particles), int),
    )
    (made,) = tet_lattices(replace(particles, copies=copies), NOTHING)
    assert len(made.tets) == 3 * len(KUHN)
    # 8 corners each, of which the linked two share 4.
    assert len(made.X) == 20
    assert made.copy is not None
    assert set(made.copy.tolist()) == {0, 1, 2}
    assert not tet_surface(made.tets)[1]
