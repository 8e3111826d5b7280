"""What a bake will cost, before it starts.

Measured in CPU seconds on two cores of an x86-64 server, with the duck and balls, 300 to 100k
particles, 1 kPa to 10 MPa, looks and physical presets: within a factor of two.  Memory is that of
``/usr/bin/time -v``.

Room on the disk and in memory: asked for before a bake, and watched while it runs.

A bake that is clearly too large is refused before any work.  One that meets a disk or a memory that
others fill ends before it is full, while there is room for what it had: its frames, a layer to open
them, and a report.
"""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, Any

import numpy as np

from gf_usd.core.errors import InputError, OutOfRoom
from gf_usd.core.frames import written
from gf_usd.prepare.plan import frame_bytes
from gf_usd.system.memory_and_disk import _swap, free_disk, free_memory

if TYPE_CHECKING:
    from gf_usd.prepare.plan import Plan


# [s] of a substep, and of each particle in it, by solver; free flight, measured
SUBSTEP_SECONDS = {"tl": (1.0e-5, 6.6e-8), "ul": (2e-6, 1.5e-7)}
CONTACT = 1.4  # longer with the contact of a shot, in the mean
START_SECONDS = 1.5  # imports
LAW_SECONDS = 2.5  # load the compiled kernels of a law; the very first bake compiles them
PARTICLE_SECONDS = 3e-5  # sample a particle and place it on the grid, once
VERTEX_SECONDS = 3e-5  # weld, measure and embed a vertex, once
# [s] of a frame, of a particle and of a vertex in it: skin, Gaussians, health, files, final check
FRAME_SECONDS = (5e-3, 7e-6, 4e-6)
PAIR_SECONDS = (6e-9, 1.5e-9)  # of a vertex and a particle under the paper's skin; weights kept


PROCESS_MEMORY = 320e6  # [bytes] Python, USD, Taichi and its compiler
# [s] of a substep, for each contact sample where bodies meet others: in the mean of a crash
MEETING_SECONDS = 1e-6
PARTICLE_MEMORY = 4400.0  # [bytes] a particle, mostly the rows of W and G
VERTEX_MEMORY = 2200.0  # [bytes] a vertex: the surface, its rows, a frame
MEETING_MEMORY = 9e3  # [bytes] a contact sample where bodies meet others


def estimate(plan: Plan) -> dict[str, Any]:
    """Substeps, seconds, disk and memory of each material and in all; frame of first contact.

    Materials are baked one after another: disk adds up, and seconds do but for what is started
    once.  Memory adds up as far as solvers wait for their bake (`plan.KEPT`).  The frame is None
    where the asset touches nothing within the bake.
    """
    from gf_usd.geometry.skinning import KEPT_BYTES
    from gf_usd.prepare.plan import KEPT

    frames, n, samples = plan.settings.frames, len(plan.particles), plan.settings.samples_per_frame
    vertices = sum(len(s.points if s.splats is None else s.splats) for s in plan.asset.surfaces)
    disk = written(plan.settings) * frame_bytes(plan.asset, n, plan.settings, plan.choices)
    waiting = min(len(plan.materials), max(1, KEPT // n))  # solvers, which are dear to build
    memory = PROCESS_MEMORY + PARTICLE_MEMORY * n * waiting + VERTEX_MEMORY * vertices
    fixed, each = SUBSTEP_SECONDS[plan.settings.solver]
    substep = CONTACT * (fixed + each * n)
    if plan.encounters is not None and plan.encounters.any:
        memory += MEETING_MEMORY * len(plan.samples.X)
        substep += MEETING_SECONDS * len(plan.samples.X)
    frame = FRAME_SECONDS[0] + FRAME_SECONDS[1] * n + FRAME_SECONDS[2] * vertices
    if plan.settings.skin == "paper":
        frame += vertices * n * PAIR_SECONDS[8 * vertices * n <= KEPT_BYTES]
    start = START_SECONDS + VERTEX_SECONDS * vertices
    rows = []
    for material in plan.materials:
        substeps = plan.substeps(material)
        seconds = start + LAW_SECONDS + PARTICLE_SECONDS * n
        seconds += frames * samples * frame + (frames - 1) * substeps * substep
        rows.append(
            {
                "name": material.name,
                "substeps_per_frame": substeps,
                "seconds": float(seconds),
                "disk_bytes": int(disk),
                "memory_bytes": int(memory),
            }
        )
    laws = len({material.law for material in plan.materials})
    shared = start * (len(rows) - 1) + LAW_SECONDS * (len(rows) - laws)
    return {
        "substeps_per_frame": {row["name"]: row["substeps_per_frame"] for row in rows},
        "estimated_seconds": sum(row["seconds"] for row in rows) - shared,
        "estimated_bytes": sum(row["disk_bytes"] for row in rows),
        "estimated_memory_bytes": int(memory),
        "first_contact_frame": _first_contact(plan),
        "per_material": rows,
    }


def require_affordable(plan: Plan, max_hours: float) -> None:
    """Raise InputError where a bake is estimated to take longer than max_hours [h]."""
    cost = estimate(plan)
    hours = cost["estimated_seconds"] / 3600.0
    if hours <= max_hours:
        return
    row = max(cost["per_material"], key=lambda row: row["seconds"])
    material = next(m for m in plan.materials if m.name == row["name"])
    dt = plan.settings.time_scale / plan.settings.fps / row["substeps_per_frame"]
    raise InputError(
        f"{plan.asset.facts.path}: the bake would take about {duration(cost['estimated_seconds'])}:"
        f" {len(plan.particles)} particles of {material.name} (Young's modulus"
        f" {material.youngs_modulus:.3g} Pa, damping time {material.damping_time:.3g} s), dropped"
        f" {plan.drop:.3g} m, need {row['substeps_per_frame']} substeps of {dt:.2g} s in each of"
        f" {plan.settings.frames} frames",
        "take a softer or less damped material, fewer --particles or --frames, or a lower --drop;"
        f" --max-hours {math.ceil(hours * 1.2)} lets it run",
    )


def duration(seconds: float) -> str:
    """A time for reading: seconds, minutes, hours or days, in two or three digits."""
    for size, unit in ((86400.0, "days"), (3600.0, "hours"), (60.0, "minutes")):
        if seconds >= 2.0 * size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds:.0f} s"


def _first_contact(plan: Plan) -> int | None:
    """Frames of free fall from rest, sqrt(2 drop / g), both along the floor's normal."""
    s = plan.settings
    g = -float(np.dot(s.gravity, s.normal))
    if g <= 0.0 or s.floor is None or plan.pins:
        return None
    drop = max(0.0, plan.drop) * float(np.dot(s.normal, s.up))
    frame = int(np.ceil(np.sqrt(2.0 * drop / g) * s.fps / s.time_scale))
    return frame if frame < s.frames else None


RESERVE = 2e6  # [bytes] for the root layer and the ends of files
REPORT_BYTES = 3e3  # of a frame, in the report and in the health of the cache
LEAST_MEMORY = 64e6  # [bytes] free: below it the system begins to end processes without a word
ASKED = 0.1  # [s] memory is asked for no more often: the system takes longer to say than to go on
DISK_HINT = "free some space, choose another -o, or write less: --frames, --half, --only"


def require_room(plan: Plan) -> None:
    """Raise InputError where a bake is estimated to need more disk or memory than is free.

    The estimates hold within some tenths.  What a bake that is gone on with has on the disk counts
    as done; what it replaces is there until the end, and does not count as free.
    """

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
        from gf_usd.prepare.plan import frame_bytes

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
