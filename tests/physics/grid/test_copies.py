"""Copies of nodes: limbs that share cells move apart, and every law of the grid holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from embedded import pose
from solids import solid, surface

from gf_usd.core.frames.particles import CellCopies
from gf_usd.geometry.connected.copies import find_limbs
from gf_usd.geometry.regions import box_region, make_pin
from gf_usd.geometry.sampling.contact_samples import sample_surface
from gf_usd.geometry.sampling.particles import sample_solid
from gf_usd.physics.grid.copies import SharedNodes
from gf_usd.physics.grid.dependent_nodes import affine_fit
from gf_usd.physics.grid.embedding import embedded_rows
from gf_usd.physics.grid.reference.build import build_stencil
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import ball, block, comb, elastic, set_state, settings
from gf_usd.verify.cases import limbs as case

SPACING, WIDTH, LENGTH, GAP = 0.1, 0.43, 2.2, 0.05
MATERIAL = elastic(E=1e5, nu=0.3, density=1000.0)


@pytest.fixture(scope="module")
def fork():
    """Particles, a finely cut skin, its samples and the copy that each is in."""
    import trimesh

    made = comb(2, WIDTH, GAP, LENGTH, 0.5, WIDTH)
    mesh = trimesh.Trimesh(made.points, made.triangles, process=False)
    for _ in range(3):
        mesh = mesh.subdivide()
    skin = surface(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    body = solid(skin)
    particles = sample_solid(body, particles=None, spacing=SPACING, seed=0)
    found = find_limbs(body, particles, np.zeros(1, np.int64))
    samples = sample_surface(body, particles.spacing)
    samples = replace(samples, cell_copy=found.of_points(samples.X))
    return replace(particles, copies=found.copies), skin, samples, found.of_points(skin.points)


def stencil_of(particles):
    m = particles.V0 * 1000.0
    return build_stencil(
        particles.X, m, 2.0 * particles.lattice, particles.corner, copies=particles.copies
    )


def side(X):
    """0, 1: the tooth; -1: near the root, whose nodes are reached through three cells and a fit."""
    which = (X[:, 0] > WIDTH + 0.5 * GAP).astype(int)
    return np.where(X[:, 1] < LENGTH - 14 * SPACING, which, -1)


def test_rows_reproduce_affine_fields_and_carry_the_mass(fork) -> None:
    particles, skin, samples, copy = fork
    made = stencil_of(particles)
    A = np.array([[1.2, 0.1, -0.3], [0.2, 0.9, 0.1], [0.0, -0.2, 1.1]])
    u = made.free_X @ (A - np.eye(3)).T + [0.1, 0.2, 0.3]
    for X, of in ((particles.X, particles.copies.of), (samples.X, samples.cell_copy),
                  (skin.points, copy)):  # fmt: skip
        body = np.zeros(len(X), int)
        for rows in (made.rows(X, body, of), embedded_rows(made, X, body, of)):
            out = pose(rows, u, u, np.zeros(3))
            np.testing.assert_allclose(out.x, X @ A.T + [0.1, 0.2, 0.3], atol=1e-9)
            np.testing.assert_allclose(out.F, np.broadcast_to(A, out.F.shape), atol=1e-8)
    np.testing.assert_allclose(made.mass.sum(), 1000.0 * particles.V0.sum(), rtol=1e-12)
    first = 1000.0 * particles.V0 @ particles.X
    np.testing.assert_allclose(made.mass @ made.free_X, first, rtol=1e-10)


def test_no_node_moves_both_teeth(fork) -> None:
    particles, skin, samples, copy = fork
    made = stencil_of(particles)
    moved = {0: set(), 1: set()}
    for X, of in ((particles.X, particles.copies.of), (samples.X, samples.cell_copy),
                  (skin.points, copy)):  # fmt: skip
        W = made.rows(X, None, of).W
        for k in (0, 1):
            moved[k] |= set(W[np.flatnonzero(side(X) == k)].indices)
    assert len(moved[0]) > 100
    assert not moved[0] & moved[1]


def test_one_copy_of_everything_is_the_grid_without_copies(fork) -> None:
    """Cells that are all linked make the same stencil, to the bit."""
    particles = fork[0]
    h = 2.0 * particles.lattice
    cell = np.floor((particles.X - particles.corner) / h).astype(int)
    cells, of = np.unique(cell, axis=0, return_inverse=True)
    index = {tuple(c): k for k, c in enumerate(cells.tolist())}
    links = np.array([
        (k, index[n]) for k, c in enumerate(cells.tolist()) for d in np.eye(3, dtype=int)
        if (n := tuple(c + d)) in index
    ])  # fmt: skip
    whole = CellCopies(h=h, cell=cells, body=np.zeros(len(cells), int), links=links, of=of.ravel())
    one = stencil_of(replace(particles, copies=whole))
    plain = stencil_of(replace(particles, copies=None))
    for name in ("order", "cell_start", "cell_nodes", "node_ijk", "mass", "node_mass", "fx"):
        np.testing.assert_array_equal(getattr(one, name), getattr(plain, name))
    assert (one.follow != plain.follow).nnz == 0
    a, b = (s.rows(particles.X, None, whole.of).W for s in (one, plain))
    assert abs(a - b).max() == 0.0


def swung(particles, skin, copy, *, plain=False, frames=8, gravity=(0.0, 0.0, 0.0)):
    """A free fork whose teeth start to swing apart."""
    solver = TotalLagrangian(
        particles, [MATERIAL], settings("cpu", frames=frames, gravity=gravity),
        embedded={"skin": skin.points}, embedded_copy=None if copy is None else {"skin": copy},
        plain=plain,
    )  # fmt: skip
    nodes = solver.body.stencil
    along = np.maximum(0.0, 1.0 - particles.X[:, 1] / LENGTH) ** 2
    way = np.where(particles.X[:, 0] > WIDTH + 0.5 * GAP, 1.0, -1.0) * along
    v = np.zeros((nodes.node_count, 3))
    free = nodes.free_count
    v[:free, 0] = (solver.body.rows.combined.T @ (solver.body.m * way)) / nodes.mass
    v[free:] = nodes.follow @ v[:free]
    solver.state.load({**solver.state.save(), "v": v})
    return solver


@pytest.mark.slow
def test_teeth_swing_apart_and_their_skin_goes_with_them(fork) -> None:
    particles, skin, _, copy = fork
    frames = list(swung(particles, skin, copy).frames())
    d = frames[-1].embedded["skin"].x - skin.points
    tips = skin.points[:, 1] < 1e-9
    left, right = (d[tips & (side(skin.points) == k)].mean(0) for k in (0, 1))
    glued = list(swung(replace(particles, copies=None), skin, None).frames())[-1]
    stuck = glued.embedded["skin"].x - skin.points
    together = np.diff([stuck[tips & (side(skin.points) == k)].mean(0)[0] for k in (0, 1)])
    assert right[0] - left[0] > 10.0 * abs(together[0])  # 8 frames of 1 m/s and 1 m/s
    # Edges of the skin keep their length to the strain of the bend: w t / L^2 and shear.
    edges = skin.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    edges = edges[(side(skin.points)[edges] >= 0).all(1)]
    at_rest = np.linalg.norm(np.diff(skin.points[edges], axis=1)[:, 0], axis=1)
    now = frames[-1].embedded["skin"].x[edges]
    ratio = np.linalg.norm(np.diff(now, axis=1)[:, 0], axis=1) / at_rest
    assert abs(ratio - 1.0).max() < 0.3
    # What swings apart starts and ends with no momentum but that of unequal samplings.
    p = np.array([f.health.momentum for f in frames])
    L = np.array([f.health.angular_momentum for f in frames])
    scale = frames[0].health.mass * 1.0
    assert abs(p - p[0]).max() < 1e-5 * scale
    assert abs(L - L[0]).max() < 1e-5 * scale * LENGTH


@pytest.mark.slow
def test_both_kernels_move_them_alike(fork) -> None:
    particles, skin, _, copy = fork
    one, other = (
        list(swung(particles, skin, copy, plain=plain, frames=3).frames())[-1].particles.x
        for plain in (False, True)
    )
    np.testing.assert_allclose(one, other, atol=1e-5)


@pytest.mark.slow
def test_a_state_is_taken_up_to_the_bit(fork) -> None:
    particles, skin, _, copy = fork
    whole = swung(particles, skin, copy, frames=5)
    frames = whole.frames()
    for _ in range(3):
        frame = next(frames)
    state = whole.save()
    rest = [f.particles.x for f in frames]
    again = swung(particles, skin, copy, frames=5)
    again.load(state)
    resumed = [f.particles.x for f in again.frames_after(frame.index, frame.health)]
    assert len(rest) == len(resumed) > 0
    for a, b in zip(rest, resumed):
        np.testing.assert_array_equal(a, b)


def test_a_quarter_turn_strains_nothing(fork) -> None:
    particles, skin, _, copy = fork
    solver = swung(particles, skin, copy)
    R = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    set_state(solver, solver.body.stencil.node_X @ (R - np.eye(3)).T)
    frame = solver.read(0)
    np.testing.assert_allclose(frame.particles.F, np.broadcast_to(R, frame.particles.F.shape),
                               atol=1e-5)  # fmt: skip
    np.testing.assert_allclose(frame.embedded["skin"].x, skin.points @ R.T, atol=1e-5)


def test_a_pin_in_one_tooth_does_not_hold_the_other(fork) -> None:
    particles, _, _, _ = fork
    pin = box_region("box:-1,-1,-1,0.455,1,1", 1.0, particles.X, particles.X[None])
    pin = make_pin(pin, None)
    solver = TotalLagrangian(particles, [MATERIAL], settings("cpu"), pins=[pin])
    nodes = solver.body.stencil
    held = nodes.held.pin[nodes.cell_nodes] >= 0
    cell = np.repeat(np.arange(len(held)), np.diff(nodes.cell_start))
    X = particles.X[nodes.order]
    low = X[:, 1] < 1.0 - 6 * SPACING
    right = X[:, 0] > WIDTH + 0.5 * GAP
    assert held[cell[low & ~right]].any(1).all()
    assert not held[cell[low & right]].any()


@pytest.mark.parametrize("cells", [2.75, 3.25])
def test_fits_do_not_reach_across_a_gap_that_nodes_do_not_span(cells) -> None:
    """Their feet in one row: the nodes nearest to a light one may be those of the other limb."""
    body = case.comb_particles((0, 1), cells)
    assert body.copies is None
    made = build_stencil(body.X, body.V0, 1.0, body.corner)
    right = body.X[:, 0] > case.WIDTH + 0.5 * cells
    deep = body.X[:, 1] < case.LENGTH - 7.0
    W = made.rows(body.X).W
    left, other = (set(W[np.flatnonzero(deep & (right == k))].indices) for k in (False, True))
    assert len(left) > 50
    assert not left & other
    near = affine_fit(made.node_ijk[made.free_count :], made.node_ijk[: made.free_count])
    far = SharedNodes(made.node_ijk, made.cell_nodes).unconnected_fits(
        near, np.arange(made.free_count), np.arange(made.free_count, made.node_count)
    )
    assert len(far) > 10  # of the fits that know nothing but places


def test_fits_within_a_ball_hang_together() -> None:
    body, _ = ball(1000)
    made = build_stencil(body.X, body.V0, 2.0 * body.lattice, body.corner)
    light = np.arange(made.free_count, made.node_count)
    rows = affine_fit(made.node_ijk[light], made.node_ijk[: made.free_count])
    shared = SharedNodes(made.node_ijk, made.cell_nodes)
    assert len(light) > 50
    assert len(shared.unconnected_fits(rows, np.arange(made.free_count), light)) == 0


def test_copies_are_for_cells_of_one_size(fork) -> None:
    with pytest.raises(ValueError, match="cells are copied"):
        TotalLagrangian(fork[0], [MATERIAL], settings("cpu"), h=0.3)


@pytest.mark.slow
def test_two_teeth_vibrate_as_one_does_alone() -> None:
    assert all(m.passed for m in case.two_teeth("cpu"))


@pytest.mark.slow
def test_each_body_has_the_copies_that_it_has_alone() -> None:
    """Two forks, each on cells of its own: the nodes, masses and rows of each are those alone."""
    one = comb(2, WIDTH, GAP, LENGTH, 0.5, WIDTH)
    other = replace(one, path="/Other", points=one.points + [0.137, 0.211, WIDTH + 0.023])
    made = solid(one, other)
    both = sample_solid(made, particles=None, spacing=SPACING, seed=0, bodies=np.array([0, 1]))
    found = find_limbs(made, both, np.array([0, 1]))
    both = replace(both, copies=found.copies)
    together = build_stencil(
        both.X, both.V0, 2.0 * both.lattice, both.corners, body=both.body, copies=both.copies
    )
    assert together.fx.min() > 0.5 - 1e-9
    assert together.fx.max() < 1.5 + 1e-9
    for k, surface_ in enumerate((one, other)):
        body = solid(surface_)
        alone = sample_solid(body, particles=None, spacing=SPACING, seed=0)
        copies = find_limbs(body, alone, np.zeros(1, np.int64)).copies
        single = build_stencil(alone.X, alone.V0, 2.0 * alone.lattice, alone.corner, copies=copies)
        mine = np.flatnonzero(both.body == k)
        np.testing.assert_allclose(both.X[mine], alone.X, atol=1e-12)
        free = together.node_body[: together.free_count] == k
        assert free.sum() == single.free_count
        np.testing.assert_allclose(np.sort(together.mass[free]), np.sort(single.mass), atol=1e-9)
        a = together.rows(both.X, both.body, both.copies.of).W[mine][:, np.flatnonzero(free)]
        b = single.rows(alone.X, None, copies.of).W
        np.testing.assert_allclose((a @ a.T).toarray(), (b @ b.T).toarray(), atol=1e-9)


def test_a_fleck_without_free_nodes_goes_with_what_is_nearest() -> None:
    """Eight light particles off a block: no node of theirs is free, and none is left at rest."""
    body = block((0.0, 0.0, 0.0), (4, 4, 4), 1.0)
    fleck = np.array([[7.3, 2.1, 2.2], [7.4, 2.3, 2.1]])
    X = np.concatenate([body.X, fleck])
    m = np.concatenate([body.V0, np.full(2, 1e-6)])
    made = build_stencil(X, m, 1.0, np.zeros(3))
    rows = made.follow
    np.testing.assert_allclose(np.asarray(rows.sum(1)).ravel(), 1.0, atol=1e-9)
    far = made.node_X[made.free_count :, 0] > 6.0
    assert far.any()
    np.testing.assert_allclose(made.rows(fleck).W @ made.free_X, fleck, atol=1e-8)
