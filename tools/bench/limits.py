"""Limits of the machine: memory bandwidth and multiplications, measured in Taichi.

The triad a = b + k c runs over three arrays of 64 MiB, beyond any cache here, eight numbers at a
time: number by number Taichi's loop is bound by its indices, not by memory (measured: 9 GB/s where
this reaches 22 and C 30).  12 bytes an element are counted, as STREAM does; the cache reads a line
before it is written, so that 16 are transferred. Time is CPU time over the number of cores: on a
busy machine, wall time would include the work of other programs.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from typing import Any

PROBE = r"""
import json, os, time
import taichi as ti
N, M, CORES = 1 << 21, 1 << 12, len(os.sched_getaffinity(0))
ti.init(arch=ti.cpu, cpu_max_num_threads=CORES, fast_math=True,
        log_level=ti.ERROR, offline_cache=False, real_matrix_scalarize=False)
v8 = ti.types.vector(8, ti.f32)
A, B, C = (ti.ndarray(v8, N) for _ in range(3))
for array in (A, B, C):
    array.fill(1.0)  # a page that was never written is not in memory
R = ti.ndarray(v8, M)
eight = ti.types.ndarray(dtype=v8, ndim=1)

@ti.kernel
def triad(a: eight, b: eight, c: eight, k: ti.f32):
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
    for _ in range(30):
        began = time.process_time(); f(); ti.sync()
        took.append((time.process_time() - began) / CORES)
    return min(took)

print(json.dumps({
    "bandwidth": 12.0 * 8 * N / best(lambda: triad(A, B, C, 0.5)),
    "fma": 2.0 * 8 * 10 * M * 500 / best(lambda: chains(R, 0.5, 500)),
}))
"""


def limits(cores: list[int]) -> dict[str, Any]:
    """Stream triad [byte/s] and fused multiply-adds [flop/s] of the cores, f32, best of 30."""
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
