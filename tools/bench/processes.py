"""The solvers that `tools/bench.py` compares, each in its own process.

Peers are installed from PyPI into environments of their own, once.  POSIX only: sched_setaffinity
restricts a process to its cores.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tools import clients

ROOT = Path(__file__).resolve().parents[2]
SCRIPTS = ROOT / "tools" / "bench" / "peers"


@dataclass(frozen=True)
class Peer:
    """A solver: a script, and what it needs; no requirements: this environment."""

    script: str
    name: str
    requirements: tuple[str, ...] = ()
    sizes: tuple[int, ...] = (1_000, 10_000, 100_000)  # that its time allows
    options: dict[str, Any] = field(default_factory=dict)
    law: str = "corotated"  # constitutive law; gf-usd's name of it, empty where it has none
    remark: str = ""


NEWTON = ("newton>=1.8,<2", "scipy")  # scipy: Delaunay's tetrahedra
PEERS = {
    "gf-usd": Peer(
        "gf_usd_solver.py", "gf-usd", sizes=(120, 1_000, 10_000, 100_000, 1_000_000)
    ),
    "ul": Peer(
        "gf_usd_solver.py", "gf-usd, `--solver ul`", options={"solver": "ul"},
        remark="Updated Lagrangian MLS-MPM, the baseline",
    ),
    "taichi": Peer(
        "taichi_mpm.py", "Taichi's stock MLS-MPM", ("taichi>=1.7.4,<2", "numpy>=2"),
        remark="as its examples write it, jelly only",
    ),
    "genesis": Peer("genesis_mpm.py", "genesis-world MPM", ("genesis-world==1.4.5", "torch")),
    "vbd": Peer(
        "newton_vbd.py", "newton VBD", NEWTON, sizes=(1_000, 10_000), law="stableNeoHookean",
        remark="implicit, 10 iterations; a particle is a vertex, tetrahedra are six times as many",
    ),
    "implicit": Peer(
        "newton_implicit_mpm.py", "newton implicit MPM", NEWTON, sizes=(1_000, 10_000), law="",
        remark="implicit, steps ten times as long; made for granular media",
    ),
}  # fmt: skip
# BLAS threads spin for 25 ms after a product that one alone does as fast: CPU time of no use.
ALONE = {"OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
ALIKE = {"taichi": "taichi", "genesis": "genesis", "vbd": "newton", "implicit": "newton"}
MEGABYTES = {"taichi": 280, "genesis": 8_640, "newton": 720}  # of their environments


def interpreter(key: str, into: Path) -> str:
    """The Python of a peer; installs what is missing.

    Raises clients.NotInstalled where pip fails.
    """
    peer = PEERS[key]
    if not peer.requirements:
        return sys.executable
    package = ALIKE[key]
    name = f"bench-{package}"
    clients.CLIENTS[name] = clients.Client(
        peer.requirements, f"import {package}", MEGABYTES[package]
    )
    print(f"{key}: {clients.set_up(name, into, [])}", file=sys.stderr, flush=True)
    return str(into.resolve() / name / "bin" / "python")


def interpreters(keys: Sequence[str], into: Path) -> dict[str, str]:
    """The Pythons of the peers that could be installed; the others are announced on stderr."""
    found = {}
    for key in keys:
        try:
            found[key] = interpreter(key, into)
        except clients.NotInstalled as error:
            print(f"{key}: not installed: {error}", file=sys.stderr, flush=True)
    return found


def run(
    python: str, peer: Peer, job: dict[str, Any], cores: list[int], seconds: float
) -> dict[str, Any]:
    """One process of at most `seconds`: its result, or {"failed": why}."""
    job = {**job, "options": peer.options | job.get("options", {}), "began": time.time()}
    command = [python, "-W", "ignore", str(SCRIPTS / peer.script), json.dumps(job)]
    # gf-usd is the one that lies next to this file, not another that may be installed
    environment = {**os.environ, **ALONE}
    if not peer.requirements:
        environment["PYTHONPATH"] = str(ROOT)
    pin: Callable[[], None] = lambda: os.sched_setaffinity(0, cores)  # noqa: E731
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=seconds, check=False,
            env=environment, preexec_fn=pin,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return {"failed": f"no result within {seconds:.0f} s"}
    lines = (done.stdout.strip() or " ").splitlines()
    if done.returncode or not lines[-1].startswith("{"):
        message = (done.stderr or done.stdout).strip().splitlines()[-1:]
        return {"failed": " ".join(message) or f"exit status {done.returncode}"}
    return json.loads(lines[-1])


def middle(runs: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Medians of the numbers of the runs that succeeded; the first failure where none did.

    "runs" is how many succeeded.
    """
    good = [r for r in runs if "failed" not in r]
    if not good:
        return dict(runs[0])
    return {
        key: statistics.median(r[key] for r in good) if isinstance(value, int | float) else value
        for key, value in good[0].items()
    } | {"runs": len(good)}
