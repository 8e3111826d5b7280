"""Contact between bodies repeats to the bit, and to the bit from a saved state."""

from __future__ import annotations

import numpy as np
import pytest
from contact_scenes import bricks, contact_solver, half_space
from launching import WAYS, launched
from slow_parameters import slow_but
from solids import sphere, surface

from gf_usd.core.frames.frame import Health
from gf_usd.physics.contact.active import ActiveSamples


def falling(threads: int = 2, frames: int = 7):
    """Two balls on a slope that comes up: they meet it, each other and themselves."""
    rise = np.arange(frames)[:, None] * [0.0, 0.02, 0.0]
    low = sphere(center=(0.0, 1.1, 0.0), subdivisions=2, path="/Low")
    high = sphere(center=(0.3, 3.2, 0.1), subdivisions=2, path="/High")
    return contact_solver(
        low, high, particles=400, frames=frames, threads=threads, gravity=(0.0, -9.81, 0.0),
        velocity=[(0.0, -2.0, 0.0), (0.0, -5.0, 0.0)], colliders=(half_space(10.0, offset=rise),),
        self_contact=True,
    )  # fmt: skip


def whole(solver) -> np.ndarray:
    now = solver.state.view()
    return np.concatenate([now.u, now.v, [now.offset]])


def march(threads: int, way: str, monkeypatch) -> np.ndarray:
    solver = launched(falling(threads), way, monkeypatch)
    health = [f.health for f in solver.frames()]
    assert solver.pairs is not None
    faced = solver.pairs.planes
    assert (faced.partner >= 0).any(), "they meet each other"
    assert (faced.obstacle >= 0).any(), "and the slope"
    assert max(h.overlap for h in health) > 0.0
    return whole(solver)


@pytest.fixture(scope="module")
def first():
    with pytest.MonkeyPatch.context() as patch:
        return march(1, "alone", patch)


@pytest.mark.slow
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("way", slow_but(WAYS, "alone"))
def test_reruns_threads_and_launches_agree_to_the_bit(first, way, threads, monkeypatch):
    assert np.array_equal(first, march(threads, way, monkeypatch))


@pytest.mark.slow
def test_a_kept_state_continues_bit_identically():
    solver = falling()
    last, kept, strained, ends = Health(), {}, 1, []
    for frame in solver.frames():
        if frame.index == 4:
            assert frame.health.overlap > 0.0, "it is kept in contact"
            kept, last = solver.state.save(), frame.health
            strained = solver.strained
        ends.append(frame.health)
    other = falling()
    other.state.load(kept)
    other.strained = strained
    for index in range(5, 7):
        last = other.next(index, last).health
        assert last == ends[index]  # what is counted, too: overlap, work, energy of new planes
    assert np.array_equal(whole(solver), whole(other))


def closing(frames: int = 10):
    """Two prongs of one body that close on each other."""
    shape = np.ones((6, 12, 2), bool)
    shape[2:4, 2:] = False
    made = bricks(shape, 0.25)
    body = surface(made.points - [0.75, 0.5, 0.0], made.triangles, path="/Tongs")

    def close(X):
        speed = -5.0 * np.sign(X[:, 0]) * np.maximum(X[:, 1], 0.0)
        return np.stack([speed, 0.0 * speed, 0.0 * speed], -1)

    return contact_solver(body, particles=300, self_contact=True, velocity=[close], frames=frames)


@pytest.mark.slow
def test_a_body_in_self_contact_continues_bit_identically():
    solver, last, kept, met, ends = closing(), Health(), {}, 9, []
    assert solver.pairs is not None
    for frame in solver.frames():
        if not kept and (solver.pairs.planes.partner >= 0).any():
            kept, last, met = solver.save(), frame.health, frame.index
        ends.append(frame.health)
    assert kept, "they meet"
    assert met < 9
    other = closing()
    other.load(kept)
    for index in range(met + 1, 10):
        last = other.next(index, last).health
        assert last == ends[index]
    assert np.array_equal(whole(solver), whole(other))


@pytest.mark.slow
def test_samples_far_from_the_floor_are_left_out_without_a_trace(monkeypatch):
    """Between two detections only what the floor may reach until then is looked at.

    The number of substeps is given: fewer springs of the floor would require fewer.
    """
    counts, nearer, ends = [], ActiveSamples.nearer, []

    def counted(self, state, near, span):
        found = nearer(self, state, near, span)
        counts.append((len(found), len(near)))
        return found

    for chosen in (counted, lambda self, state, near, span: near):
        monkeypatch.setattr(ActiveSamples, "nearer", chosen)
        solver = contact_solver(
            sphere(center=(0.0, 1.1, 0.0), subdivisions=2, path="/Low"),
            sphere(center=(0.3, 3.4, 0.1), subdivisions=2, path="/High"),
            particles=300, frames=6, gravity=(0.0, -9.81, 0.0), floor=0.0, substeps=400,
            velocity=[(0.0, -2.0, 0.0), (0.0, -8.0, 0.0)],
        )  # fmt: skip
        ends.append(list(solver.frames())[-1])
    assert sum(few for few, _ in counts) < sum(many for _, many in counts)
    assert ends[0].health.penetration > 0.0
    assert ends[0].health.injected != 0.0, "they pushed each other"
    np.testing.assert_array_equal(ends[0].particles.x, ends[1].particles.x)
