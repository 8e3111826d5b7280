"""Cores, free memory and free disk space, within the limits of a container."""

from __future__ import annotations

import math
import os
import shutil
from pathlib import Path

CPU_LIMIT = "/sys/fs/cgroup/cpu.max"


def cores() -> int:
    """Number of cores that this process may use, within the limit of its control group."""
    if hasattr(os, "sched_getaffinity"):
        found = len(os.sched_getaffinity(0))
    else:
        found = os.cpu_count() or 1
    quota, _, period = system_file(CPU_LIMIT).partition(" ")  # [us] of CPU in a period [us], or max
    if quota.isdigit() and period.isdigit():
        found = min(found, math.ceil(int(quota) / int(period)))
    return found


def free_memory() -> float:
    """[bytes] of free memory, within the limit of this process's control group, if any."""
    system = float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE")
    system = _of_system("MemAvailable:", system)
    limit = system_file("/sys/fs/cgroup/memory.max")
    if not limit.isdigit():
        return system
    used = system_file("/sys/fs/cgroup/memory.current")
    if used.isdigit():
        # the page cache counts as free, because the system reclaims it
        rows = (line.split() for line in system_file("/sys/fs/cgroup/memory.stat").splitlines())
        kept = sum(float(n) for name, n in rows if name in ("inactive_file", "active_file"))
        return min(system, float(limit) - max(0.0, float(used) - kept))
    return system


def free_disk(folder: Path) -> float:
    """[bytes] free to this user on the disk of a folder, which may not exist yet."""
    while True:
        try:
            return float(shutil.disk_usage(folder).free)
        except FileNotFoundError:
            folder = folder.absolute()
            if folder == folder.parent:
                raise
            folder = folder.parent


def free_swap() -> float:
    """[bytes] of free swap; 0 under the limit of a control group."""
    if system_file("/sys/fs/cgroup/memory.max").isdigit():
        return 0.0
    return _of_system("SwapFree:", 0.0)


def _of_system(name: str, unknown: float) -> float:
    """[bytes] of a kind of memory, as the system reports it."""
    found = system_file("/proc/meminfo").partition(name)[2].split(maxsplit=1)
    return float(found[0]) * 1024.0 if found else unknown


def system_file(path: str) -> str:
    """The contents of a file of the kernel; "" where there is none."""
    try:
        with open(path, "rb", buffering=0) as file:  # called for every sample
            return file.readall().decode("ascii").strip()
    except OSError:
        return ""
