"""The search for the cheapest setting that is right, on made drops."""

from __future__ import annotations

import pytest

from tools.bench.equal_error import RUNGS, converged, error, row, search
from tools.bench.processes import PEERS

TRUTH = {"squash": 0.8, "rebound": 0.5}


class Ladder:
    """Settings n whose rebound has an error of `errors[n]`, each taking `each` seconds."""

    def __init__(self, errors, each=1.0):
        self.errors, self.each, self.now, self.tried = errors, each, 0.0, []

    def clock(self):
        return self.now

    def measure(self, rung, left):
        n = rung["n"]
        self.tried.append(n)
        if self.each > left:
            self.now += left
            return {"failed": f"no result within {left:.0f} s"}
        self.now += self.each
        if self.errors[n] is None:
            return {"failed": "positions that are no longer finite"}
        return {
            "particles": n, "dt": 1e-3, "squash": 0.8, "rebound": 0.5 * (1.0 + self.errors[n]),
            "simulated": 1.0, "cpu": float(n), "wall": float(n),
        }  # fmt: skip

    def found(self, seconds=100.0):
        return search([{"n": n} for n in self.errors], self.measure, TRUTH, seconds, self.clock)


def test_the_first_of_two_right_rungs_counts_and_no_finer_one_is_run():
    ladder = Ladder({1: 0.3, 2: 0.019, 4: -0.015, 8: 0.0})
    found = ladder.found()
    assert (found.result["particles"], found.met, found.remark) == (2, True, "")
    assert found.error == pytest.approx(0.019)
    assert ladder.tried == [1, 2, 4]


def test_a_rung_that_is_right_by_luck_does_not_count():
    assert Ladder({1: -0.1, 2: 0.0, 4: 0.05, 8: 0.01, 16: 0.005}).found().result["particles"] == 8


def test_a_right_last_rung_counts_and_says_that_nothing_confirms_it():
    found = Ladder({1: 0.1, 2: 0.01}).found()
    assert found.met
    assert found.result["particles"] == 2
    assert "not confirmed" in found.remark


def test_where_none_is_right_the_most_accurate_run_bounds_the_cost():
    found = Ladder({1: 0.3, 2: 0.06, 4: 0.08}).found()
    assert (found.result["particles"], found.met) == (2, False)
    assert found.error == pytest.approx(0.06)
    shown = row("taichi", "corotated", found, {"corotated": 10.0})
    # 10 simulated seconds a CPU second against 1/2
    assert "more than 20.0 x" in shown
    assert "not met" in shown


def test_time_ends_the_climb():
    ladder = Ladder({1: 0.3, 2: 0.2, 4: 0.0, 8: 0.0}, each=4.0)
    found = ladder.found(seconds=10.0)
    assert ladder.tried == [1, 2, 4]
    assert found.result["particles"] == 2
    assert "no result within 2 s" in found.remark


def test_a_setting_that_blows_up_is_passed_over():
    found = Ladder({1: None, 2: 0.01, 4: 0.005}).found()
    assert found.result["particles"] == 2


def test_no_result_at_all_is_said():
    found = Ladder({1: None}).found()
    assert not found.result
    assert "no longer finite" in row("vbd", "stableNeoHookean", found, {})


def test_the_larger_of_the_two_errors_counts():
    assert error({"squash": 0.84, "rebound": 0.5}, TRUTH) == pytest.approx(0.05)
    assert error({"squash": 0.8, "rebound": 0.45}, TRUTH) == pytest.approx(0.1)


def test_the_limit_of_a_sequence_is_exact_where_errors_shrink_by_a_factor():
    assert converged([2.0 + 0.5 * 0.3**k for k in range(3)]) == pytest.approx(2.0, abs=1e-12)
    with pytest.raises(ValueError, match="do not converge"):
        converged([1.0, 1.1, 1.3])


def test_rungs_grow_dearer():
    for key, rungs in RUNGS.items():
        cost = [rung["n"] / rung["dt"] for rung in rungs]
        assert cost == sorted(cost)
        assert PEERS[key].law
