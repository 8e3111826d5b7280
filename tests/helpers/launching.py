"""Ways to cut substeps into launches and to share them among threads: none may change a bit."""

from __future__ import annotations

import pytest

from gf_usd.physics.total_lagrangian import launch
from gf_usd.physics.total_lagrangian.launch import Launches
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian

WAYS = ("alone", "shared", "one by one", "resident")


def launched(solver: TotalLagrangian, way: str, monkeypatch: pytest.MonkeyPatch) -> TotalLagrangian:
    """The solver, made to launch its substeps in a way.

    alone : one thread, a frame a launch; shared : four threads, whatever the machine has, draw
    pieces of a few items; one by one : the same, a substep a launch; resident : as on a GPU, which
    one thread stands for.
    """
    if way == "resident":
        solver.launches = Launches(solver.body, solver.state, way)
        return solver
    monkeypatch.setattr(launch, "BUSY", 0.0)  # keeps its threads on a busy machine, too
    monkeypatch.setattr(launch, "LAUNCH_SECONDS", 1e-9 if way == "one by one" else 1e9)
    team = solver.launches.thread_count
    assert team is not None
    team.most = team.size = 1 if way == "alone" else 4
    return solver
