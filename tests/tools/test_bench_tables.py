"""Rounds of measurements, medians, ratios and the sections of the page, on made figures."""

from __future__ import annotations

import pytest

from tools.bench.processes import middle
from tools.bench.revisions import bake_table, row
from tools.bench.speed import peer_tables, rounds, size_ratio
from tools.bench.tables import marks, put


def test_cells_are_measured_in_turns():
    order = []
    found = rounds("ab", lambda c: order.append(c) or {"x": len(order)}, runs=2, seconds=1e9)
    assert order == ["a", "b", "a", "b"]
    assert found == {"a": [{"x": 1}, {"x": 3}], "b": [{"x": 2}, {"x": 4}]}


def test_a_run_that_would_end_too_late_is_not_begun():
    now = [0.0]

    def measure(cell):
        now[0] += cell
        return {"took": cell}

    found = rounds([1.0, 6.0], measure, runs=3, seconds=10.0, clock=lambda: now[0])
    # the first round ends at 7, the second runs the cell of 1 s; 6 s more would end at 14
    assert [len(found[cell]) for cell in (1.0, 6.0)] == [3, 1]


def test_what_failed_is_not_tried_again():
    found = rounds(["a"], lambda cell: {"failed": "no"}, runs=3, seconds=1e9)
    assert found == {"a": [{"failed": "no"}]}


def test_some_cells_are_measured_once():
    found = rounds([1, 9], lambda n: {"n": n}, 3, 1e9, once=lambda n: n > 5)
    assert [len(found[n]) for n in (1, 9)] == [3, 1]


def test_medians_leave_failures_out():
    runs = [{"cpu": 1.0, "law": "x"}, {"failed": "late"}, {"cpu": 3.0, "law": "x"}]
    assert middle(runs) == {"cpu": 2.0, "law": "x", "runs": 2}
    assert middle([{"failed": "late"}]) == {"failed": "late"}


def speed(n, cpu, wall=None):
    return {
        "particles": n, "dt": 1e-3, "cpu": cpu, "wall": wall or cpu, "start_up_cpu": 1.0,
        "memory": 1e8,
    }  # fmt: skip


def test_ratios_are_of_cpu_time_per_particle():
    results = {
        ("gf-usd", 10_000): [speed(10_000, 1e-3)],
        # half as many particles, five times the time: ten times dearer each
        ("taichi", 10_000): [speed(5_000, 5e-3, wall=9.0)],
        ("genesis", 10_000): [{"failed": "no result within 150 s"}],
    }
    shown = "\n".join(peer_tables(results))
    own, taichi, genesis = [line for line in shown.splitlines() if line.startswith("| ")][1:]
    assert "| 10 | 10 |" in own
    assert "| 10.0 x |" in taichi
    assert "no result within 150 s" in genesis


def test_a_frame_is_a_sixtieth_of_a_second():
    line = peer_tables({("gf-usd", 120): [speed(120, 6e-5)]})[-2]
    # 1/60 s in steps of 1 ms are 16.67 steps of 0.06 ms
    assert "| 1.00 |" in line


def test_the_price_of_size():
    small, large = speed(10_000, 1e-3), speed(1_000_000, 0.13)
    results = {("gf-usd", 10_000): [small], ("gf-usd", 1_000_000): [large]}
    assert "1.30 times" in size_ratio(results)
    assert "not measured" in size_ratio({("gf-usd", 10_000): [small]})


def test_a_section_is_replaced_and_nothing_else():
    begin, end = marks("limits")
    page = f"head\n{begin}\nold\n{end}\ntail\n"
    assert put(page, "limits", "new\n") == f"head\n{begin}\nnew\n{end}\ntail\n"
    with pytest.raises(ValueError, match="no section"):
        put(page, "peers", "new")


def test_revisions_are_compared_turn_by_turn():
    # A machine that slows down by turns: each ratio is 1.25, though the medians alone are not.
    slow = [1.0, 1.0, 5.0, 1.0, 9.0, 1.0, 1.0]
    cells = row("a bake", "s", [(4.0 * k, 5.0 * k) for k in slow]).strip("| ").split(" | ")
    assert cells == ["a bake", "4.0 s", "5.0 s", "1.250", "1.250 to 1.250", "1.250"]
    # One turn in which the old one alone was disturbed does not count.
    cells = row("a bake", "s", [(4.0, 5.0)] * 6 + [(40.0, 5.0)]).strip("| ").split(" | ")
    assert cells[3:] == ["1.250", "1.250 to 1.250", "1.250"]


def test_bakes_of_two_revisions_are_compared_turn_by_turn():
    # the machine is half as fast in the second turn: medians of times and of ratios differ
    lines = bake_table("a", "b", [(10.0, 5.0), (20.0, 10.0), (12.0, 9.0)])
    assert lines[2:] == [
        "| 1 | 10.0 s | 5.0 s | 0.500 |",
        "| 2 | 20.0 s | 10.0 s | 0.500 |",
        "| 3 | 12.0 s | 9.0 s | 0.750 |",
        "| median | 12.0 s | 9.0 s | 0.500 |",
    ]
