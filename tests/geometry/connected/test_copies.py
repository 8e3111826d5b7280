"""Limbs that share cells of the grid are found, and what hangs together is not taken apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from solids import cube, solid, sphere, surface

from gf_usd.core.frames.particles import Particles
from gf_usd.geometry.connected import copies
from gf_usd.geometry.connected.copies import Limbs, find_limbs
from gf_usd.geometry.sampling.particles import sample_solid
from gf_usd.geometry.solid import Solid
from gf_usd.verify.bodies import comb

SPACING = 0.1  # cells are .2 wide
WIDTH, LENGTH, ROOT = 0.43, 1.9, 0.5
# A node is in cells that span three, and is one where they hang together: turned, a diagonal.
DEEP = LENGTH - 5.2 * 2.0 * SPACING


def filled(made: Solid, spacing: float = SPACING) -> tuple[Particles, Limbs | None]:
    particles = sample_solid(made, particles=None, spacing=spacing, seed=0)
    return particles, find_limbs(made, particles, np.zeros(len(made.surfaces), np.int64))


def turn(degrees: float) -> np.ndarray:
    axis = np.array([0.3, -0.5, 0.8])
    return trimesh.transformations.rotation_matrix(np.radians(degrees), axis)[:3, :3]


def fork(gap: float, *, finer: int = 0, degrees: float = 0.0, teeth: int = 2):
    """A comb, its triangles cut in four some times, turned; and the way back."""
    made = comb(teeth, WIDTH, gap, LENGTH, ROOT, WIDTH)
    mesh = trimesh.Trimesh(made.points, made.triangles, process=False)
    for _ in range(finer):
        mesh = mesh.subdivide()
    R = turn(degrees)
    return surface(np.asarray(mesh.vertices) @ R.T, np.asarray(mesh.faces)), R


def teeth_of(X: np.ndarray, R: np.ndarray, gap: float) -> np.ndarray:
    """Which tooth points of a turned comb lie in; -1 in the root."""
    flat = X @ R
    which = np.floor((flat[:, 0] + 0.5 * gap) / (WIDTH + gap)).astype(int)
    return np.where(flat[:, 1] < LENGTH - 1e-6, which, -1)


def nodes_of(limbs: Limbs) -> np.ndarray:
    """(K, 27) of each copy of a cell."""
    found = limbs.copies
    label = np.zeros(len(found.cell), np.int64)
    return copies.node_copies(found.cell, found.links, label)[0]


@pytest.mark.parametrize("finer", [0, 2])
@pytest.mark.parametrize("degrees", [0.0, 37.0])
@pytest.mark.parametrize("gap", [0.002, 0.05, 0.1])
def test_teeth_share_no_nodes_below_the_root_and_each_hangs_together(gap, degrees, finer) -> None:
    body, R = fork(gap, finer=finer, degrees=degrees)
    particles, limbs = filled(solid(body))
    assert limbs is not None
    tooth = teeth_of(particles.X, R, gap)
    # A particle or two may lie in the gap, nearer to either.
    tooth = np.where(solid(body).inside(particles.X), tooth, -1)
    assert particles.outside <= 4
    deep = (particles.X @ R)[:, 1] < DEEP
    nodes = nodes_of(limbs)
    left, right = (np.unique(nodes[limbs.copies.of[deep & (tooth == k)]]) for k in (0, 1))
    assert len(left) > 50
    assert len(np.intersect1d(left, right)) == 0
    count = len(limbs.copies.cell)
    a, b = limbs.copies.links.T
    for k in (0, 1):
        mine = np.ones(count, bool)
        mine[limbs.copies.of[deep & (tooth == 1 - k)]] = False
        keep = mine[a] & mine[b]
        graph = coo_matrix((np.ones(keep.sum()), (a[keep], b[keep])), shape=(count, count))
        part = connected_components(graph)[1]
        assert len(np.unique(part[limbs.copies.of[tooth == k]])) == 1


def test_links_join_cells_with_a_common_face_and_particles_lie_in_their_cells() -> None:
    particles, limbs = filled(solid(fork(0.05)[0]))
    found = limbs.copies
    step = np.abs(found.cell[found.links[:, 1]] - found.cell[found.links[:, 0]])
    np.testing.assert_array_equal(step.sum(1), 1)
    cell = np.floor((particles.X - particles.corner) / found.h)
    np.testing.assert_array_equal(found.cell[found.of], cell)


@pytest.mark.parametrize(
    "body",
    [
        sphere(1.0),
        cube((0, 0, 0), (1.0, 1.0, 1.0)),
        cube((0, 0, 0), (2.0, 0.07, 2.0)),  # thinner than a cube of the lattice
        cube((0, 0, 0), (2.0, 0.19, 0.13)),
    ],
)
def test_what_has_no_limbs_is_left_as_it_is(body) -> None:
    assert filled(solid(body))[1] is None


@pytest.mark.slow
@pytest.mark.parametrize("thickness", [0.04, 0.1, 0.25])
def test_a_thin_bowl_hangs_together(thickness) -> None:
    """A hollow sphere: between two particles of its wall there may be nothing but air."""
    outer, inner = (trimesh.creation.icosphere(3, r) for r in (1.0, 1.0 - thickness))
    shell = trimesh.util.concatenate([outer, trimesh.Trimesh(inner.vertices, inner.faces[:, ::-1])])
    particles, limbs = filled(solid(surface(shell.vertices, shell.faces)))
    assert len(particles) > 300
    assert limbs is None


def test_a_bent_sheet_is_one_until_it_meets_itself() -> None:
    """A strip bent to a ring with a slit: only the ends at the slit are apart."""
    angle = np.linspace(0.05, 2.0 * np.pi - 0.05, 181)
    ring = np.stack([np.cos(angle), np.sin(angle)], 1)
    corners = np.stack(
        [np.c_[r * ring, np.full(len(ring), z)] for r in (1.0, 1.12) for z in (0.0, 0.5)], 1
    )
    n = len(ring)
    quads = [
        (4 * i + a, 4 * i + b, 4 * i + 4 + b, 4 * i + 4 + a)
        for i in range(n - 1)
        for a, b in ((0, 1), (1, 3), (3, 2), (2, 0))
    ]
    quads += [(0, 2, 3, 1), (4 * n - 3, 4 * n - 1, 4 * n - 2, 4 * n - 4)]
    faces = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    points = corners.reshape(-1, 3)
    mesh = trimesh.Trimesh(points, faces, process=False)
    assert mesh.is_watertight
    particles, limbs = filled(solid(surface(points, np.array(faces))))
    assert limbs is not None
    nodes = nodes_of(limbs)
    place = np.arctan2(particles.X[:, 1], particles.X[:, 0])
    for low, high in ((-0.15, -0.04), (0.04, 0.15)):
        assert ((place > low) & (place < high)).any()
    up, down = (np.unique(nodes[limbs.copies.of[(s * place > 0) & (s * place < 0.3)]])
                for s in (1, -1))  # fmt: skip
    assert len(np.intersect1d(up, down)) == 0
    # All around, neighbors share nodes.
    order = np.argsort(place)
    several = copies.node_copies(limbs.copies.cell, limbs.copies.links,
                                 np.zeros(len(limbs.copies.cell), int))[1]  # fmt: skip
    doubled = np.unique(np.flatnonzero((several[nodes] > 1).any(1)))
    far = np.abs(place[order]) > 1.0
    assert not np.isin(limbs.copies.of[order[far]], doubled).any()


@pytest.mark.slow
def test_fingers_of_their_own_shells_that_overlap_a_palm_move_apart() -> None:
    gap = 0.05
    boxes = [cube((0, LENGTH, 0), (2 * WIDTH + gap, ROOT, WIDTH))]
    boxes += [cube((k * (WIDTH + gap), 0, 0), (WIDTH, LENGTH + 0.2, WIDTH)) for k in (0, 1)]
    points = np.concatenate([b.points for b in boxes])
    triangles = np.concatenate([b.triangles + 8 * k for k, b in enumerate(boxes)])
    particles, limbs = filled(solid(surface(points, triangles)))
    assert limbs is not None
    tooth = teeth_of(particles.X, np.eye(3), gap)
    deep = particles.X[:, 1] < DEEP
    nodes = nodes_of(limbs)
    left, right = (np.unique(nodes[limbs.copies.of[deep & (tooth == k)]]) for k in (0, 1))
    assert len(np.intersect1d(left, right)) == 0


@pytest.mark.slow
def test_what_floats_apart_and_what_touches_stays_with_its_body() -> None:
    shirt, button = cube((0, 0, 0), (1.0, 1.0, 0.4)), cube((0.3, 0.3, 0.45), (0.35, 0.35, 0.2))
    nose = cube((0.3, 0.3, 0.4 - 1e-3), (0.35, 0.35, 0.2))
    for other in (button, nose):
        points = np.concatenate([shirt.points, other.points])
        triangles = np.concatenate([shirt.triangles, other.triangles + 8])
        assert filled(solid(surface(points, triangles)))[1] is None


def test_points_are_embedded_in_the_tooth_they_lie_on() -> None:
    gap = 0.01
    body, R = fork(gap, finer=3, degrees=20.0)
    particles, limbs = filled(solid(body))
    which = teeth_of(body.points, R, gap)
    deep = (body.points @ R)[:, 1] < DEEP
    copy = limbs.of_points(body.points)
    nodes = nodes_of(limbs)
    tooth = teeth_of(particles.X, R, gap)
    for k in (0, 1):
        mine = np.unique(nodes[copy[deep & (which == k)]])
        theirs = np.unique(nodes[limbs.copies.of[tooth == 1 - k]])
        root = np.unique(nodes[limbs.copies.of[tooth == -1]])
        assert len(np.setdiff1d(np.intersect1d(mine, theirs), root)) == 0


def test_bodies_are_distinguished_before_limbs_are() -> None:
    """Two forks that cross each other's gaps: each has the copies that it has alone."""
    one, _ = fork(0.06)
    other = replace(one, path="/Other", points=one.points + [0.0, 0.0, WIDTH + 0.03])
    made = solid(one, other)
    particles = sample_solid(made, particles=None, spacing=SPACING, seed=0)
    body = particles.surface
    both = find_limbs(made, replace(particles, body=body), np.array([0, 1]))
    assert set(both.copies.body[both.copies.of[body == 0]]) == {0}
    nodes = nodes_of(both)
    # `node_copies` has no bodies: copies of different bodies are never linked.
    assert (
        len(np.intersect1d(nodes[both.copies.of[body == 0]], nodes[both.copies.of[body == 1]])) == 0
    )


def test_scraps_without_number_are_left_as_one(monkeypatch) -> None:
    monkeypatch.setattr(copies, "MOST_PATCHES", 1)
    _, limbs = filled(solid(fork(0.03)[0]))
    assert limbs is None or limbs.crowded > 0


@pytest.mark.parametrize("gap", [1e-4, 0.01])
def test_halves_that_meet_on_a_plane_of_the_grid_stay_together(gap: float) -> None:
    """Symmetric bodies are sampled with a grid plane on their seam: no cell has both halves.

    A bar joins them at one end, so that the seam between them would be a slit of one body.
    """
    half, bar = (
        cube((0.5 * gap, 0.0, 0.0), (0.7, 2.0, 0.4)),
        cube((-0.5, 0.0, 0.3), (1.0, 0.4, 0.4)),
    )
    mirrored = surface(half.points * [-1.0, 1.0, 1.0], half.triangles[:, ::-1])
    made = solid(half, mirrored, bar)
    particles, limbs = filled(made)
    at = float(np.atleast_2d(particles.corner)[0, 0]) / (copies.CELL * particles.lattice)
    assert at == pytest.approx(round(at), abs=1e-6)  # the seam is on a plane of the grid
    assert limbs is None
