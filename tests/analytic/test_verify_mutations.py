"""Kernels broken on purpose: for each fault a case of `gf-usd verify` must fail."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import kernel_faults
import pytest
from kernel_faults import FAULTS
from slow_parameters import longest_but

import gf_usd

pytestmark = pytest.mark.slow  # each fault is compiled anew, some ten seconds
QUICKEST = (  # of a law, the transfers and the forces
    "2/h^2 for 4/h^2 in APIC",
    "half the shear modulus in the corotated stress",
    "no body force",
)


def verify(program: list[str], *cases: str) -> dict[str, bool]:
    """Whether each case passes, as `gf-usd verify` says."""
    arguments = [word for case in cases for word in ("--case", case)]
    done = subprocess.run(
        [sys.executable, *program, "verify", "--json", *arguments],
        env={
            **os.environ,
            "PYTHONPATH": str(Path(gf_usd.__file__).parents[1]),
            "ENABLE_TAICHI_HEADER_PRINT": "0",  # JSON alone on stdout
        },
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


@pytest.mark.acceptance  # a minute and more with the kernels of users; see test_verify
def test_without_a_fault_they_pass() -> None:
    cases = {fault.case for fault in FAULTS.values()}
    assert verify(["-m", "gf_usd"], *sorted(cases)) == dict.fromkeys(cases, True)


@pytest.mark.parametrize("name", longest_but(FAULTS, *QUICKEST))
def test_a_fault_is_seen(name: str) -> None:
    case = FAULTS[name].case
    assert verify([str(kernel_faults.__file__), name], case) == {case: False}
