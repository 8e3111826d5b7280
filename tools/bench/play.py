"""Runs the job of a solver of `tools/bench/peers`, in the environment of that solver.

A script hands `main` a class.  Its instances are made from (n, dt, threads), hold the ball just
above the floor, and have

    advance(k)     k substeps of length dt, finished when it returns
    positions()    (n, 3) [m], height over the floor in column 1

The job is one JSON object on the command line, the result one JSON line on stdout:

    speed    {"n", "seconds"}: substeps for so long, after a warm-up, from the start again and again
    drop     {"n"}: the drop once, frame by frame: peak squash, rebound and what they cost
    motion   {"n", "frames", "to"}: positions in every frame, in the file `to` (.npz)
"""

from __future__ import annotations

import json
import os
import resource
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from tools.bench import scene


def chunk(dt: float) -> int:
    """Substeps in a frame of `FPS`."""
    return max(1, round(1.0 / (scene.FPS * dt)))


def main(solver: Any, versions: dict[str, str]) -> None:
    """Do the job of the command line with a solver class."""
    job = json.loads(sys.argv[1])
    n, threads = int(job["n"]), len(os.sched_getaffinity(0))
    dt = float(job.get("dt") or getattr(solver, "STEP", 1.0) * scene.step(n))
    given = job.get("options", {})
    body = solver(n, dt, threads, **given)
    body.advance(chunk(dt))
    out: dict[str, Any] = {
        "versions": versions,
        "particles": len(body.positions()),
        "dt": dt,
        "start_up_cpu": time.process_time(),
        "start_up": time.time() - float(job["began"]),
    }
    if job["kind"] == "speed":
        out |= speed(partial(solver, n, dt, threads, **given), body, dt, float(job["seconds"]))
    elif job["kind"] == "drop":
        out |= drop(solver(n, dt, threads, **given), dt)
    else:
        out |= motion(solver(n, dt, threads, **given), dt, int(job["frames"]), job["to"])
    out["memory"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    print("\n" + json.dumps(out), flush=True)


def speed(made: Callable[[], Any], body: Any, dt: float, seconds: float) -> dict[str, float]:
    """Seconds per substep, wall and CPU, along the drop, `body` first and then others like it."""
    frame = 2 * chunk(dt)  # a frame of 60 Hz
    body.advance(frame)  # whatever is still made at the first call
    at = chunk(dt) + frame
    done, wall, cpu = 0, 0.0, 0.0
    while wall < seconds:
        if at * dt >= scene.SECONDS:
            body, at = made(), 0
        # a frame of substeps a call, as a program would request them
        began, began_cpu = time.perf_counter(), time.process_time()
        while at * dt < scene.SECONDS and wall + time.perf_counter() - began < seconds:
            body.advance(frame)
            at += frame
            done += frame
        wall += time.perf_counter() - began
        cpu += time.process_time() - began_cpu
    return {"wall": wall / done, "cpu": cpu / done, "frame": frame}


def drop(body: Any, dt: float) -> dict[str, Any]:
    """Least height of the ball over its height at rest, and the top of the rebound [m]."""
    every = chunk(dt)
    heights, centers = [], []
    wall, cpu = 0.0, 0.0
    rest = float(np.ptp(body.positions()[:, 1]))
    for _ in range(int(np.ceil(scene.SECONDS / (every * dt)))):
        began, began_cpu = time.perf_counter(), time.process_time()
        body.advance(every)
        wall += time.perf_counter() - began
        cpu += time.process_time() - began_cpu
        x = body.positions()
        if not np.isfinite(x).all():
            return {"failed": "positions that are no longer finite"}
        heights.append(float(np.ptp(x[:, 1])) / rest)
        centers.append(float(x[:, 1].mean()))
    low = int(np.argmin(centers))
    return {
        "squash": peak(-np.array(heights)) * -1.0,
        "rebound": peak(np.array(centers[low:])) - scene.RADIUS,
        "simulated": len(centers) * every * dt,
        "wall": wall,
        "cpu": cpu,
    }


def motion(body: Any, dt: float, frames: int, to: str) -> dict[str, Any]:
    """Write x (1 + frames, n, 3) [m] from the start on, and their times [s]."""
    every = chunk(dt)
    x = [body.positions()]
    for _ in range(frames):
        body.advance(every)
        x.append(body.positions())
    times = every * dt * np.arange(len(x))
    np.savez(to, x=np.asarray(x, np.float32), times=times)
    return {"simulated": float(times[-1])}


def peak(y: np.ndarray) -> float:
    """The top of the parabola through the largest value and its neighbors."""
    k = int(np.argmax(y))
    if k in (0, len(y) - 1):
        return float(y[k])
    a, b, c = y[k - 1 : k + 2]
    bend = a - 2.0 * b + c
    return float(b - (c - a) ** 2 / (8.0 * bend)) if bend < 0.0 else float(b)
