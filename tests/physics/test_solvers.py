"""The registry of solvers, from its names to files on disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from solids import ball, preset_material, settings

import gf_usd
from gf_usd.core.errors import UsageError
from gf_usd.layers.check.run import check_file
from gf_usd.physics.frame_loop import Solver
from gf_usd.physics.solvers import SOLVERS, make_solver
from gf_usd.prepare.options.request import Request
from gf_usd.prepare.options.table import OPTIONS

SAMPLES = Path(__file__).parents[2] / "samples"


def test_the_words_of_the_option_are_the_registry():
    assert tuple(SOLVERS) == OPTIONS["solver"].choices


@pytest.mark.parametrize("name", SOLVERS)
def test_every_solver_flies(name):
    body, samples = ball(100)
    s = settings(frames=3, solver=name, gravity=(0.0, -9.81, 0.0), floor=-3.0)
    solver = make_solver(
        s, body, [preset_material("rubber", body)], samples=samples, embedded={"a": body.X}
    )
    assert isinstance(solver, Solver)
    *_, last = solver.frames()
    fallen = -0.5 * 9.81 * last.time**2
    np.testing.assert_allclose(last.embedded["a"].x[:, 1] - body.X[:, 1], fallen, atol=1e-5)
    assert last.health.substeps == solver.coarse


def test_an_unknown_solver_is_refused():
    body, _ = ball(100)
    with pytest.raises(UsageError, match="unknown solver 'fem'"):
        make_solver(settings(solver="fem"), body, [preset_material("rubber", body)])
    with pytest.raises(UsageError, match="there is no solver 'fem'"):
        Request(solver="fem").check()


@pytest.mark.parametrize("option", [{"filter_rate": 10.0}, {"pins": ("/Root/Pin",)}])
def test_options_that_ul_does_not_know_are_refused_before_anything_is_read(option):
    with pytest.raises(UsageError, match="--solver ul does not support"):
        Request(solver="ul", **option).check()
    Request(solver="tl", **option).check()
    Request(solver="ul", filter_rate=np.inf).check()


@pytest.mark.slow
@pytest.mark.parametrize("sample", ["sphere", "duck", "deformed_sphere"])
def test_every_sample_bakes_and_checks(tmp_path, sample):
    made = gf_usd.bake(
        SAMPLES / f"{sample}.usda", solver="ul", particles=200, frames=16, drop="0.3r",
        output=tmp_path / "out.usda",
    )  # fmt: skip
    assert made.settings.solver == "ul"
    assert made.settings.filter_rate == np.inf, "APIC in every substep"
    assert "--solver ul" in made.report.read_text()
    found = check_file(made.root)
    assert not found.findings
