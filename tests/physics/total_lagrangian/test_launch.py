"""Threads of a launch are reduced where cores are lacking, and restored."""

from __future__ import annotations

import numpy as np
import pytest

from gf_usd.physics.total_lagrangian import launch as thread_count
from gf_usd.physics.total_lagrangian.launch import ThreadCount, filter_schedule


class Machine:
    """A clock by hand: each launch takes so long, and its threads run for so long."""

    def __init__(self) -> None:
        self.wall, self.ran = 0.0, 0.0
        self.others = 0
        self.sizes: list[int] = []

    def thread_count(self, threads: int, particles: int = 100_000) -> ThreadCount:
        made = ThreadCount(
            threads,
            particles,
            clock=lambda: self.wall,
            ran=lambda: self.ran,
            others=lambda: self.others,
        )
        self.launch(made, wall=9.0, cores=1.0)  # compiles, which says nothing
        self.sizes.clear()
        return made

    def launch(self, made: ThreadCount, wall: float, cores: float, substeps: int = 10) -> None:
        """One in which threads have so many cores to themselves."""

        def work(threads: int) -> None:
            self.sizes.append(threads)
            self.wall += wall
            self.ran += wall * min(threads, cores)

        made.launch(work, substeps)


def test_all_threads_take_part_while_each_has_a_core() -> None:
    machine = Machine()
    team = machine.thread_count(4)
    for _ in range(5):
        machine.launch(team, wall=0.05, cores=4.0)
    assert machine.sizes == [4] * 5


def test_as_many_as_there_are_cores_for_take_part_for_a_while() -> None:
    machine = Machine()
    team = machine.thread_count(4)
    for _ in range(thread_count.REST + 1):
        machine.launch(team, wall=0.05, cores=2.0)
    assert machine.sizes == [4] + [2] * (thread_count.REST - 1) + [4]


def test_the_rest_grows_while_cores_are_lacking_and_ends_when_they_are_back() -> None:
    machine = Machine()
    team = machine.thread_count(2)
    for _ in range(3 * thread_count.REST + 2):
        machine.launch(team, wall=0.05, cores=1.0)
    tries = [k for k, size in enumerate(machine.sizes) if size == 2]
    assert tries == [0, thread_count.REST, 3 * thread_count.REST]
    machine.sizes.clear()
    for _ in range(5 * thread_count.REST):
        machine.launch(team, wall=0.05, cores=2.0)
    assert machine.sizes[-1] == 2


def test_work_in_parallel_has_a_core_and_does_not_change_the_thread_count(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(thread_count, "cores", lambda: 4)
    machine = Machine()
    team = machine.thread_count(4)
    machine.others = 1
    for _ in range(3):
        machine.launch(team, wall=0.05, cores=1.0)
    machine.others = 9
    machine.launch(team, wall=0.05, cores=1.0)
    machine.others = 0
    machine.launch(team, wall=0.05, cores=4.0)
    assert machine.sizes == [3, 3, 3, 1, 4]
    few = machine.thread_count(2)
    machine.others = 1
    machine.launch(few, wall=0.05, cores=4.0)
    assert machine.sizes == [2], "four cores are enough for both"


def test_a_launch_too_short_to_be_timed_says_nothing() -> None:
    machine = Machine()
    team = machine.thread_count(2)
    machine.launch(team, wall=0.5 * thread_count.SHORT, cores=1.0)
    machine.launch(team, wall=0.5 * thread_count.SHORT, cores=1.0)
    assert machine.sizes == [2, 2]


@pytest.mark.parametrize(("particles", "most"), [(120, 1), (4_000, 2), (10**6, 8)])
def test_few_particles_ask_for_few_threads(particles: int, most: int) -> None:
    assert ThreadCount(8, particles).most == most


def test_a_launch_takes_as_many_substeps_as_last_a_moment() -> None:
    machine = Machine()
    team = machine.thread_count(2)
    machine.launch(team, wall=0.05, cores=2.0, substeps=10)
    assert team.fitting(1000) == pytest.approx(thread_count.LAUNCH_SECONDS / 0.005, abs=1)
    assert team.fitting(3) == 3
    machine.launch(team, wall=5.0, cores=2.0, substeps=1)
    assert team.fitting(1000) == 1


def test_the_filter_of_tiny_substeps_fits_a_kernels_count() -> None:
    every, alpha = filter_schedule(10.0, 1e-20)
    assert every == 2**31 - 1
    assert alpha == pytest.approx(10.0 * every * 1e-20, rel=1e-6, abs=1e-15)
    every, alpha = filter_schedule(10.0, 1e-3)
    assert every * 10.0 * 1e-3 <= 0.2 < (every + 1) * 10.0 * 1e-3
    assert alpha == pytest.approx(1.0 - np.exp(-10.0 * every * 1e-3))
