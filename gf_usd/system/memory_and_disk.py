"""Free memory and free disk space, within the limits of a container."""

from __future__ import annotations

import os
import shutil
from pathlib import Path


def free_memory() -> float:
    """[bytes] that are free, for this process's control group where it has a limit."""
    system = float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE")
    system = _of_system("MemAvailable:", system)
    limit = system_file("/sys/fs/cgroup/memory.max")
    if not limit.isdigit():
        return system
    used = system_file("/sys/fs/cgroup/memory.current")
    if used.isdigit():
        # what files left in the cache of the system is given back when it is wanted
        rows = (line.split() for line in system_file("/sys/fs/cgroup/memory.stat").splitlines())
        kept = sum(float(n) for name, n in rows if name in ("inactive_file", "active_file"))
        return min(system, float(limit) - max(0.0, float(used) - kept))
    return system


def free_disk(folder: Path) -> float:
    """[bytes] free for this user where a folder is, or will be."""
    while True:
        try:
            return float(shutil.disk_usage(folder).free)
        except FileNotFoundError:
            folder = folder.absolute()
            if folder == folder.parent:
                raise
            folder = folder.parent


def free_swap() -> float:
    """[bytes] of free swap; none is counted under the limit of a control group."""
    if system_file("/sys/fs/cgroup/memory.max").isdigit():
        return 0.0
    return _of_system("SwapFree:", 0.0)


def _of_system(name: str, unknown: float) -> float:
    """[bytes] that the system says of a kind of memory."""
    found = system_file("/proc/meminfo").partition(name)[2].split(maxsplit=1)
    return float(found[0]) * 1024.0 if found else unknown


def system_file(path: str) -> str:
    """What a file of the kernel says; "" where there is none."""
    try:
        with open(path, "rb", buffering=0) as file:  # asked for at every sample
            return file.readall().decode("ascii").strip()
    except OSError:
        return ""
