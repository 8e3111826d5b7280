"""Kernels broken on purpose: for each fault a case of `gf-usd verify` must fail.

A copy of the package is changed by one line and run as a program, so that the fault is in the
source that Taichi compiles and nothing of it stays behind in this process.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

import gf_usd

PACKAGE = Path(gf_usd.__file__).parent
pytestmark = pytest.mark.slow  # each fault is compiled anew, some ten seconds


@dataclass(frozen=True)
class Fault:
    """One line of the solver as it is, as it must not be, and the case that sees it."""

    file: str
    right: str
    wrong: str
    case: str


FAULTS = {
    "slope of the spline turned round": Fault(
        "physics/total_lagrangian/kernels/simd.py",
        "b = let(q[k] - q[i])\n",
        "b = let(q[i] - q[k])\n",
        "patch",
    ),
    "2/h^2 for 4/h^2 in APIC": Fault(
        "physics/total_lagrangian/kernels/simd.py",
        "c1 = let(4.0 * m * dot(w[0], t1))",
        "c1 = let(2.0 * m * dot(w[0], t1))",
        "spin-apic",
    ),
    "no lambda in the Neo-Hookean stress": Fault(
        "physics/laws/neo_hookean.py",
        "p = (q[1] * log_extended(J) - mu) *",
        "p = (0.0 - mu) *",
        "law-neoHookean",
    ),
    "half the shear modulus in the corotated stress": Fault(
        "physics/laws/corotated.py", "m = 2.0 * q[0]", "m = q[0]", "law-corotated"
    ),
    "gravity upward": Fault(
        "physics/total_lagrangian/kernels/nodes.py",
        "body.inverse_mass[node] + g",
        "body.inverse_mass[node] - g",
        "free-fall",
    ),
    "a whole drift at the end of a frame": Fault(
        "physics/total_lagrangian/kernels/substep.py",
        "drift = 0.5 * dt",
        "drift = dt",
        "free-fall",
    ),
    "no damping in the floor": Fault(
        "physics/contact/kernels.py", " - body.sample_damping[s] * vn", "", "bounce"
    ),
    "pins mirror without the sign": Fault(
        "physics/grid/dependent_nodes.py", "-interpolation(", "interpolation(", "bar"
    ),
    "followers keep their forces": Fault(
        "physics/total_lagrangian/kernels/nodes.py",
        "return block_sum(body, node, plain) + leader_sum(body, node)",
        "return block_sum(body, node, plain)",
        "momentum",
    ),
    "no body force": Fault(
        "physics/total_lagrangian/kernels/nodes.py",
        "a[d] += body.acceleration[3 * node + d]",
        "a[d] += 0.0",
        "cantilever",
    ),
}  # fmt: skip


def verify(copy: Path, *cases: str) -> dict[str, bool]:
    """Whether each case passes, as `gf-usd verify` of a copy of the package says."""
    words = [word for case in cases for word in ("--case", case)]
    done = subprocess.run(
        [sys.executable, "-m", "gf_usd", "verify", "--json", *words],
        cwd=copy,
        env={**os.environ, "PYTHONPATH": str(copy)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout, done.stderr
    passed: dict[str, bool] = {}
    for row in json.loads(done.stdout)["cases"]:
        passed[row["case"]] = passed.get(row["case"], True) and row["pass"]
    assert done.returncode == (0 if all(passed.values()) else 1), done.stderr
    return passed


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A folder with a copy of the package."""
    shutil.copytree(PACKAGE, tmp_path / "gf_usd", ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path


def test_without_a_fault_the_copy_passes(copy: Path) -> None:
    cases = {fault.case for fault in FAULTS.values()}
    assert verify(copy, *sorted(cases)) == dict.fromkeys(cases, True)


@pytest.mark.parametrize("fault", FAULTS.values(), ids=FAULTS.keys())
def test_a_fault_is_seen(fault: Fault, copy: Path) -> None:
    path = copy / "gf_usd" / fault.file
    source = path.read_text("utf-8")
    assert source.count(fault.right) == 1, "the line is there, once"
    path.write_text(source.replace(fault.right, fault.wrong), "utf-8")
    assert verify(copy, fault.case) == {fault.case: False}
