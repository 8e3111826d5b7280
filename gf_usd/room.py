"""Room on the disk and in memory: asked for before a bake, and watched while it runs.

A bake that is clearly too large is refused before any work.  One that meets a disk or a memory that
others fill ends before it is full, while there is room for what it had: its frames, a layer to open
them, and a report.
"""

from __future__ import annotations

import math
import os
import shutil
import time
from pathlib import Path
from typing import TYPE_CHECKING

from gf_usd.errors import InputError, OutOfRoom

if TYPE_CHECKING:
    from gf_usd.plan import Plan

RESERVE = 2e6  # [bytes] for the root layer and the ends of files
REPORT_BYTES = 3e3  # of a frame, in the report and in the health of the cache
LEAST_MEMORY = 64e6  # [bytes] free: below it the system begins to end processes without a word
ASKED = 0.1  # [s] memory is asked for no more often: the system takes longer to say than to go on
DISK_HINT = "free some space, choose another -o, or write less: --frames, --half, --only"


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


def require_room(plan: Plan) -> None:
    """Raise InputError where a bake is estimated to need more disk or memory than is free.

    The estimates hold within some tenths.  What a bake that is gone on with has on the disk counts
    as done; what it replaces is there until the end, and does not count as free.
    """
    from gf_usd.estimate import estimate

    cost = estimate(plan)
    path, folder = plan.asset.facts.path, plan.outputs.root.absolute().parent
    disk = sum(
        row["disk_bytes"] * (1.0 - _done(plan, number))
        for number, row in enumerate(cost["per_material"])
    ) * (2.0 if plan.outputs.flat else 1.0)  # the cache, and the file that is made of it
    free = free_disk(folder)
    if disk > free:
        raise InputError(
            f"{path}: the bake would write about {disk / 1e6:.3g} MB to {folder}, where"
            f" {free / 1e6:.3g} MB are free",
            DISK_HINT,
        )
    memory, left = cost["estimated_memory_bytes"], free_memory() + _swap()
    if memory > left:
        raise InputError(
            f"{path}: the bake would take about {memory / 1e9:.3g} GB of memory, and"
            f" {left / 1e9:.3g} GB are free",
            "take fewer --particles, bake one material at a time, or end other programs",
        )


def _done(plan: Plan, number: int) -> float:
    """Share of a look's samples that are on the disk already."""
    since = plan.standing[number] if plan.standing else None
    samples = plan.settings.frames * plan.settings.samples_per_frame
    return 0.0 if since is None else min(1.0, since.index / samples)


class RoomWatch:
    """Sees to it, sample by sample, that the next one has room."""

    def __init__(self, plan: Plan) -> None:
        from gf_usd.estimate import frame_bytes

        self._folder = plan.outputs.root.absolute().parent
        size = frame_bytes(plan.asset, len(plan.particles), plan.settings, plan.choices)
        self._sample = size / plan.settings.samples_per_frame
        self._reserve = RESERVE + REPORT_BYTES * plan.settings.frames
        self._clips = bool(plan.choices.clip_frames)
        self._asked = -math.inf

    def require(self, index: int, unsaved: int) -> None:
        """Raise OutOfRoom where the disk or the memory has not enough for one more sample.

        Memory is looked at once in ASKED seconds.
        index : of the sample; unsaved : samples that the cache still holds.
        """
        again = "the same command with --resume goes on" if self._clips else "bake again"
        need = self._reserve + (unsaved + 2) * self._sample
        free = free_disk(self._folder)
        if free < need:
            raise OutOfRoom(
                f"{self._folder} has {free / 1e6:.3g} MB left, and {need / 1e6:.3g} MB are wanted"
                " for the next frame, what is not yet written, and the report",
                f"free some space; {again}",
                frame=index,
            )
        now = time.monotonic()
        if now < self._asked + ASKED:
            return
        self._asked = now
        left = free_memory()
        if left < LEAST_MEMORY and (left := left + _swap()) < LEAST_MEMORY:
            raise OutOfRoom(
                f"{left / 1e6:.3g} MB of memory are left on this machine",
                f"end other programs, or take fewer --particles; {again}",
                frame=index,
            )


def _swap() -> float:
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
