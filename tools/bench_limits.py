"""What the machine itself can do: bytes from memory and multiplications, in Taichi's own code."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from typing import Any

PROBE = r"""
import json, os, time
import taichi as ti
ti.init(arch=ti.cpu, cpu_max_num_threads=len(os.sched_getaffinity(0)), fast_math=True,
        log_level=ti.ERROR, offline_cache=False, real_matrix_scalarize=False)
v8 = ti.types.vector(8, ti.f32)
N, M = 1 << 25, 1 << 12
A, B, C = (ti.ndarray(ti.f32, N) for _ in range(3))
R = ti.ndarray(v8, M)
one = ti.types.ndarray(dtype=ti.f32, ndim=1)
eight = ti.types.ndarray(dtype=v8, ndim=1)

@ti.kernel
def triad(a: one, b: one, c: one, k: ti.f32):
    for i in range(N):
        a[i] = b[i] + k * c[i]

@ti.kernel
def chains(r: eight, k: ti.f32, n: ti.i32):
    for i in range(M):
        x0 = r[i]; x1 = x0 + 1.0; x2 = x0 + 2.0; x3 = x0 + 3.0
        x4 = x0 + 4.0; x5 = x0 + 5.0; x6 = x0 + 6.0; x7 = x0 + 7.0
        x8 = x0 + 8.0; x9 = x0 + 9.0
        for _ in range(n):
            x0 = x0 * k + 1.0; x1 = x1 * k + 1.0; x2 = x2 * k + 1.0; x3 = x3 * k + 1.0
            x4 = x4 * k + 1.0; x5 = x5 * k + 1.0; x6 = x6 * k + 1.0; x7 = x7 * k + 1.0
            x8 = x8 * k + 1.0; x9 = x9 * k + 1.0
        r[i] = x0 + x1 + x2 + x3 + x4 + x5 + x6 + x7 + x8 + x9

def best(f):
    f(); ti.sync(); took = []
    for _ in range(7):
        began = time.perf_counter(); f(); ti.sync(); took.append(time.perf_counter() - began)
    return min(took)

print(json.dumps({
    "bandwidth": 12.0 * N / best(lambda: triad(A, B, C, 0.5)),
    "fma": 2.0 * 8 * 10 * M * 2000 / best(lambda: chains(R, 0.5, 2000)),
}))
"""


def limits(cores: list[int]) -> dict[str, Any]:
    """Stream triad [byte/s] and fused multiply-adds [flop/s] of the cores, f32, best of seven."""
    done = subprocess.run(
        [sys.executable, "-c", f"import os; os.sched_setaffinity(0, {cores!r})\n{run_file()}"],
        capture_output=True, text=True, check=True, input=PROBE, env=dict(os.environ),
    )  # fmt: skip
    found = json.loads(done.stdout.strip().splitlines()[-1])
    text = f"triad {found['bandwidth'] / 1e9:.1f} GB/s, FMA {found['fma'] / 1e9:.0f} GFLOP/s"
    return {**found, "text": text}


def run_file() -> str:
    """Taichi reads a kernel's source from its file: the probe needs one."""
    return (
        "import runpy, sys, tempfile\n"
        "with tempfile.NamedTemporaryFile('w', suffix='.py') as f:\n"
        "    f.write(sys.stdin.read()); f.flush(); runpy.run_path(f.name)\n"
    )
