"""Simulated seconds per second at equal error: the cheapest accurate setting of each solver.

A setting is accurate if its least height (over the height at rest) and its rebound (the top of the
center's path over its height at rest) are both within 2 % of a converged reference.  The reference
is gf-usd with the solver's own law at three particle counts, each four times the last,
extrapolated.

Each solver has a list of settings, cheap ones first. A setting counts if the next one is accurate,
too: errors change sign, and a coarse run may coincidentally have the right value.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from tools.bench import scene
from tools.bench.processes import PEERS, run

WITHIN = 0.02
SIZES = (10_000, 40_000, 160_000)  # of the reference
QUANTITIES = ("squash", "rebound")
COURANT = 1.4  # times that of the speed tables: .35, a tenth below the limit of the strictest


def explicit(*sizes: int) -> list[dict[str, Any]]:
    """Rungs of an explicit solver: the step follows from the grid."""
    return [{"n": n, "dt": COURANT * scene.step(n)} for n in sizes]


RUNGS: dict[str, list[dict[str, Any]]] = {
    "gf-usd": explicit(2_500, 5_000, 10_000, 20_000, 40_000, 80_000),
    "ul": explicit(10_000, 40_000, 160_000),
    "taichi": explicit(10_000, 40_000, 160_000),
    "genesis": explicit(10_000, 40_000, 160_000),
    "vbd": [
        {"n": n, "dt": dt} for n, dt in ((500, 2e-3), (1_000, 1e-3), (2_500, 1e-3), (5_000, 1e-3))
    ],
}


def converged(values: Sequence[float]) -> float:
    """Aitken's limit of three values whose differences shrink by a constant factor.

    Raises ValueError where they do not shrink.
    """
    a, b, c = values
    first, second = b - a, c - b
    if abs(second) >= abs(first):
        raise ValueError(f"{a:.6g}, {b:.6g}, {c:.6g} do not converge")
    return c + second * second / (first - second)


def error(result: dict[str, Any], truth: dict[str, float]) -> float:
    """The larger of the relative errors."""
    return max(abs(result[name] / truth[name] - 1.0) for name in QUANTITIES)


@dataclass(frozen=True)
class Found:
    """How far up its ladder a solver had to go."""

    result: dict[str, Any]  # of the rung that counts, else of the most accurate
    error: float
    met: bool
    remark: str


def search(
    rungs: Sequence[dict[str, Any]],
    measure: Callable[[dict[str, Any], float], dict[str, Any]],
    truth: dict[str, float],
    seconds: float,
    clock: Callable[[], float] = time.perf_counter,
) -> Found:
    """Climb until a rung and the one after it are right, or the time or the ladder ends."""
    end = clock() + seconds
    tried: list[tuple[float, dict[str, Any]]] = []
    remark = "no finer setting was tried"
    for rung in rungs:
        left = end - clock()
        if left <= 0.0:
            remark = f"{seconds:.0f} s are over"
            break
        result = measure(rung, left)
        if "failed" in result:
            remark = f"{rung['n']:,} failed: {result['failed']}"
            if "no result within" in result["failed"]:
                break
            continue
        tried.append((error(result, truth), result))
        if len(tried) > 1 and max(tried[-1][0], tried[-2][0]) <= WITHIN:
            return Found(tried[-2][1], tried[-2][0], True, "")
    if tried and tried[-1][0] <= WITHIN:
        return Found(tried[-1][1], tried[-1][0], True, f"not confirmed: {remark}")
    if not tried:
        return Found({}, float("inf"), False, remark)
    best, result = min(tried, key=lambda t: t[0])
    return Found(result, best, False, f"not met: {remark}")


def reference(
    python: str, law: str, cores: list[int], seconds: float
) -> tuple[dict[str, float], list[str]]:
    """The extrapolated drop of a law, and lines that show how it converges.

    Raises SystemExit where a run fails.
    """
    runs = []
    for n in SIZES:
        job = {"kind": "drop", "n": n, "options": {"law": law}}
        runs.append(run(python, PEERS["gf-usd"], job, cores, seconds))
        if "failed" in runs[-1]:
            raise SystemExit(f"the reference with {n:,} particles failed: {runs[-1]['failed']}")
    truth = {name: converged([r[name] for r in runs]) for name in QUANTITIES}
    shown = {name: ", ".join(f"{r[name]:.4f}" for r in runs) for name in QUANTITIES}
    counts = ", ".join(f"{n:,}" for n in SIZES)
    line = (
        f"- {law}: least height {truth['squash']:.4f} (from {shown['squash']} at {counts}"
        f" particles), rebound {truth['rebound']:.4f} m (from {shown['rebound']})."
    )
    return truth, [line]


def table(pythons: dict[str, str], cores: list[int], seconds: float) -> list[str]:
    """The search for every solver that has a ladder, as Markdown."""
    began = time.perf_counter()
    lines, truths, rows = [], {}, []
    for law in dict.fromkeys(PEERS[key].law for key in pythons if key in RUNGS):
        truths[law], shown = reference(sys.executable, law, cores, seconds)
        lines += shown
    own: dict[str, float] = {}
    share = 0.0
    keys = [key for key in pythons if key in RUNGS]
    searches = [(key, PEERS[key].law) for key in keys]
    if "vbd" in keys and "gf-usd" in keys:
        searches.append(("gf-usd", PEERS["vbd"].law))
    searches.sort(key=lambda pair: (pair[0] != "gf-usd", pair[0] != "vbd"))
    for done, (key, law) in enumerate(searches):
        share = (seconds - (time.perf_counter() - began)) / (len(searches) - done)

        def measure(rung: dict[str, Any], left: float, key: str = key, law: str = law) -> Any:
            options = {"law": law} if PEERS[key].script.startswith("gf_usd") else {}
            job = {"kind": "drop", **rung, "options": options}
            result = run(pythons[key], PEERS[key], job, cores, left)
            outcome = result.get("failed") or f"error {100 * error(result, truths[law]):.1f} %"
            print(f"  {PEERS[key].name}, {rung['n']:,}: {outcome}", file=sys.stderr, flush=True)
            return result

        # what the first ones leave over goes to those that climb longest
        found = search(RUNGS[key], measure, truths[law], share)
        if key == "gf-usd" and found.met:
            own[law] = found.result["simulated"] / found.result["cpu"]
        rows.append(row(key, law, found, own))
    return [
        *lines,
        "",
        "| solver | law | particles | dt | error | simulated s a CPU second | a wall second"
        " | gf-usd is faster, CPU |",
        "|---|---|---:|---:|---:|---:|---:|---:|",
        *rows,
    ]


def row(key: str, law: str, found: Found, own: dict[str, float]) -> str:
    """A line of the table; a setting that is not right is a bound on the ratio."""
    if not found.result:
        return f"| {PEERS[key].name} | {law} | {found.remark} | | | | | |"
    r = found.result
    speed = r["simulated"] / r["cpu"]
    ratio = ""
    if law in own:
        ratio = f"{'' if found.met else 'more than '}{own[law] / speed:.1f} x"
    remark = f" ({found.remark})" if found.remark else ""
    return (
        f"| {PEERS[key].name} | {law} | {r['particles']:,.0f} | {1e3 * r['dt']:.2f} ms"
        f" | {100 * found.error:.1f} %{remark} | {speed:.3g} | {r['simulated'] / r['wall']:.3g}"
        f" | {ratio} |"
    )
