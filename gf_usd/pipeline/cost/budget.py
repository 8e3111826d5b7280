"""Cost of a bake: the estimate, the check against the machine, and the guard while it runs.

Costs were measured in CPU seconds on two cores of an x86-64 server, and are scaled by the speed of
this one's (`cpu`): ``python -m tools.bench.estimates`` compares pairs of an asset and a preset
with what their bakes take, of which nine in ten are within a factor of two (docs/performance.md).
Memory is that of ``/usr/bin/time -v``.

A bake that needs too much is refused before it starts.  A bake during which other programs fill
the disk or the memory ends while there is still space for its results: the frames so far, a layer
that opens them, and a report.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gf_usd.core.errors import InputError, OutOfResources, counted
from gf_usd.core.frames.settings import MIXED, Settings, written
from gf_usd.core.materials.dimensionless import time_scale
from gf_usd.core.materials.laws import LAWS
from gf_usd.core.materials.material import Material
from gf_usd.core.units import bytes_text, length_text
from gf_usd.pipeline.cost.hanging import Hanging
from gf_usd.pipeline.cost.limbs import Limbs
from gf_usd.pipeline.cost.solvers import KEPT, Demand
from gf_usd.system.resources import cores, free_disk, free_memory, free_swap

# [s] of a substep, and of each particle in it, by solver, on one thread; measured
SUBSTEP_SECONDS = {"tl": (5e-6, 3.6e-8), "ul": (2e-6, 1.5e-7), MIXED: (3e-4, 1.8e-7)}
GPU_SUBSTEP_SECONDS = (7e-5, 1.7e-10)  # the same on a GPU with 4.8 TB/s (tools/bench/gpu.py)
CONTACT = 1.4  # longer with the contact of a shot, in the mean
FLOW = 1.3  # longer where the law flows
ALONE = 1500  # particles for each thread: fewer threads share a substep of fewer particles
# More substeps than at rest where bodies sag by their weight: 1 + SAG rho g r / E, up to MOST.
# Fitted, with CROWD, to 38 bakes of one to ten bodies of 1 kPa to 200 GPa (docs/performance.md).
SAG, MOST = 0.7, 3.0
CROWD = 1.3  # times as many substeps where bodies fall on each other
LIMBS = 1.7  # the same where a body falls onto its own limbs, in the mean of 1.1 to 2.2
START_SECONDS = 1.1  # imports: between the times on an idle and on a busy machine
LAW_SECONDS = 0.9  # load the compiled kernels of a law; the very first bake compiles them
PARTICLE_SECONDS = 3e-5  # sample a particle and place it on the grid, once
VERTEX_SECONDS = 3e-5  # weld, measure and embed a vertex, once
# [s] of a frame, of a particle and of a vertex in it: skin, Gaussians, health, files
FRAME_SECONDS = (3e-3, 4e-6, 3.5e-6)
# T from the first contact until bodies are usually at rest, by whether their law flows.  Within a
# factor of two of the duck of 400 particles with eleven presets (`gf-usd bake samples/duck.usda
# --particles 400 --material NAME`: 25 to 54 T for six that do not flow, 7 to 20 T for five that
# do), and of the duck and balls of 8,000 particles (33 to 92 T, docs/guide/frames.md).
RESTS = {False: 45.0, True: 12.0}
CHECK_SECONDS = 0.1  # of those of the frames, once they are simulated
PAIR_SECONDS = (6e-9, 1.5e-9)  # of a vertex and a particle under the paper's skin; weights kept
# [s] of a substep, for each contact sample where there are several bodies or obstacles: the samples
# that can touch are few, and are detected once in many substeps.
CONTACT_PAIR_SECONDS = 6e-8
# The same for each sample of limbs: in kernels, as most of them are near the floor or each other,
# and in detections, which one thread makes.
LIMB_SECONDS = (7e-8, 1.3e-7)
NO_LIMBS = Limbs()

PROCESS_MEMORY = 320e6  # [bytes] Python, USD, Taichi and its compiler
# [bytes] a particle, by solver, measured with 100,000 to 10 million of them: 1,880 to 1,615
PARTICLE_MEMORY = {"tl": 1900.0, "ul": 3000.0, MIXED: 3000.0}
ROWS_MEMORY = 1000.0  # [bytes] a particle of W and G, which are kept where a GPU computes
VERTEX_MEMORY = 2200.0  # [bytes] a vertex: the surface, its nodes, a frame
CONTACT_PAIR_MEMORY = 9e3  # [bytes] a contact sample where bodies can touch others


def estimate(
    settings: Settings,
    materials: Sequence[Material],
    substeps: Sequence[int],
    *,
    tables: Sequence[Sequence[Material]] = (),
    particles: int,
    vertices: int,
    paired: int,
    frame_bytes: float,
    first_contact: int | None,
    flying: int = 0,
    radius: float = 0.0,
    crowd: bool = True,
    limbs: Limbs = NO_LIMBS,
    demands: Sequence[Demand] = (),
    hangings: Sequence[Hanging] = (),
    usual: Sequence[int] = (),
    ends_early: bool = False,
    cpu_ratio: float = 1.0,
) -> dict[str, Any]:
    """Estimated substeps, seconds, disk and memory, per material and in total.

    Materials are baked one after another. Disk is the sum over all materials; seconds too, except
    for the start-up, which is paid once. Memory counts every solver that is kept until its bake
    (KEPT). Seconds assume compiled kernels, and an idle machine with the CPU of `cpu_ratio`.
    Those called most are of bodies that touch wherever they have a surface, for as much of the time
    as neighbors do, or are stretched all the time as much as they ever are: what happens between
    the two is only known at the end.

    substeps : of one frame of each material, all samples together.
    tables : the materials of all bodies, for each of `materials`; (): all bodies have that one.
    vertices : of meshes and captured Gaussians.
    paired : contact samples of bodies that can touch others or themselves; 0: none can.
    frame_bytes : bytes on the disk per frame.
    first_contact : frame of the first contact; None: unknown or none.
    flying : frames at the start without substeps.
    radius : [m] of a ball of the volume of all bodies, where they bear their weight; 0: they are
        held.
    crowd : several bodies or obstacles can touch.
    limbs : of bodies that can touch themselves.
    demands : of the solver of each material, and hangings : of its bodies; (): unknown.
    usual : frames after which each material is typically at rest (`typical_rest`), for a bake that
        ends there; the seconds up to that frame are reported in addition. (): all frames are
        simulated.
    ends_early : the number of frames is an upper limit.
    cpu_ratio : CPU time that this machine needs, relative to the one on which the constants were
        measured (`cpu.cpu_time_ratio`). It scales all seconds but those of a GPU.
    """
    n, frames, samples = particles, settings.frames, settings.samples_per_frame
    disk = written(settings) * frame_bytes
    waiting = min(len(materials), max(1, KEPT // n))  # solvers, which are expensive to build
    memory = _memory(settings, n * waiting, vertices, paired)
    substep, detection = _substep_seconds(settings, n, paired * crowd, limbs, cpu_ratio)
    frame = cpu_ratio * _frame_seconds(settings, n, vertices)
    start = cpu_ratio * (START_SECONDS + VERTEX_SECONDS * vertices)
    law = cpu_ratio * LAW_SECONDS
    fill = cpu_ratio * PARTICLE_SECONDS * n
    moving = max(0, frames - 1 - flying)
    rows = []
    each_demand = demands or [Demand(substeps=count) for count in substeps]
    each_hanging = hangings or [Hanging()] * len(materials)
    ends = [min(frames, one) for one in usual] or [frames] * len(materials)
    each_table = tables or [(material,) for material in materials]
    for material, table, count, demand, hanging, last in zip(
        materials, each_table, substeps, each_demand, each_hanging, ends, strict=True
    ):
        many = detected = float(count)
        most, profile = 1.0, []
        if not settings.substeps:
            apart = CROWD if paired and crowd else 1.0
            folds = 1.0 + (LIMBS - 1.0) * limbs.share
            contact = demand.expected(apart, folds)
            if max(apart, folds) > 1.0:
                most = demand.most
            profile = hanging.profile(demand.step, settings.frame_time * max(1, frames - 1))
            stretched = float(np.mean(profile)) if profile else 1.0
            sag = sag_factor(table, settings, radius)
            expected = max(sag * contact, stretched)
            most = max(1.0, max([sag * most, *profile]) / expected)
            many *= expected
            # limbs are searched as often however contact or a stretch divides the substeps
            detected *= sag * max(apart, folds)
        kernels = many * substep * (FLOW if LAWS[material.law].flows else 1.0)
        work = kernels + detected * detection
        end = CHECK_SECONDS * frames * samples * frame
        seconds = start + law + fill + end
        seconds += frames * samples * frame + moving * work
        less = (1.0 - last / frames) * (frames * samples * frame + end)
        less += (moving - max(0, last - 1 - flying)) * work
        rows.append(
            {
                "name": material.name,
                "substeps_per_frame": count,
                "substeps_per_sample": count / samples,
                "damping_ratio": demand.damping,
                "critical_damping_time": critical_damping_time(
                    settings, table, count, demand.damping, demand.contact
                ),
                "contact_factor": demand.contact,
                "substeps": round(moving * many),
                "most_substeps": round(moving * many * most),
                "strain_profile": profile,
                "flying_samples": flying * samples,
                "sample_seconds": frame,
                "moving_seconds": frame + work / samples,
                "end_seconds": end,
                "seconds": float(seconds),
                "usual_seconds": float(seconds - less),
                "most_seconds": float(seconds + (most - 1.0) * moving * kernels),
                "usual_most_seconds": float(
                    seconds - less + (most - 1.0) * max(0, min(moving, last - 1 - flying)) * kernels
                ),
                "disk_bytes": int(disk),
                "memory_bytes": int(memory),
            }
        )
    laws = len({material.law for material in materials})
    shared = start * (len(rows) - 1) + law * (len(rows) - laws)
    return {
        "substeps_per_frame": {row["name"]: row["substeps_per_frame"] for row in rows},
        "estimated_seconds": sum(row["seconds"] for row in rows) - shared,
        "usual_seconds": sum(row["usual_seconds"] for row in rows) - shared,
        "most_seconds": sum(row["most_seconds"] for row in rows) - shared,
        "usual_most_seconds": sum(row["usual_most_seconds"] for row in rows) - shared,
        "ends_early": ends_early,
        "cpu_ratio": cpu_ratio,
        "usual_frames": max(ends),
        "estimated_bytes": sum(row["disk_bytes"] for row in rows),
        "estimated_memory_bytes": int(memory),
        "first_contact_frame": first_contact,
        "per_material": rows,
    }


def _memory(settings: Settings, particles: int, vertices: int, paired: int) -> float:
    """[bytes] of a bake; particles : of all solvers that are kept; see `estimate`."""
    particle = PARTICLE_MEMORY[settings.solver] + (ROWS_MEMORY if _on_gpu(settings) else 0.0)
    memory = PROCESS_MEMORY + particle * particles + VERTEX_MEMORY * vertices
    return memory + CONTACT_PAIR_MEMORY * paired


def _substep_seconds(
    settings: Settings, particles: int, paired: int, limbs: Limbs, cpu_ratio: float
) -> tuple[float, float]:
    """[s] of a substep in contact: in kernels and in detections of limbs.

    paired : samples of bodies that can touch others, which the CPU detects; limbs, cpu_ratio : see
    `estimate`.
    """
    kernels, detection = (cpu_ratio * each * limbs.samples for each in LIMB_SECONDS)
    gpu = _on_gpu(settings)
    fixed, each = GPU_SUBSTEP_SECONDS if gpu else SUBSTEP_SECONDS[settings.solver]
    seconds = (1.0 if gpu else cpu_ratio) * CONTACT * (fixed + each * particles)
    seconds += cpu_ratio * CONTACT_PAIR_SECONDS * paired + (0.0 if gpu else kernels)
    if settings.solver == "tl" and settings.device == "cpu":
        seconds /= max(1, min(settings.threads or cores(), particles // ALONE))
    return seconds, detection


def _frame_seconds(settings: Settings, particles: int, vertices: int) -> float:
    """[s] of the poses of a frame."""
    from gf_usd.geometry.skinning import KEPT_BYTES

    seconds = FRAME_SECONDS[0] + FRAME_SECONDS[1] * particles + FRAME_SECONDS[2] * vertices
    if settings.skin == "paper":
        seconds += vertices * particles * PAIR_SECONDS[8 * vertices * particles <= KEPT_BYTES]
    return seconds


def _on_gpu(settings: Settings) -> bool:
    return settings.solver == "tl" and settings.device == "cuda"


def sag_factor(table: Sequence[Material], settings: Settings, radius: float) -> float:
    """Mean substeps of bodies that bear their weight, relative to those at rest without it.

    It is 1 + SAG rho g r / E, at most MOST: the strain by which a body sags. The height of a fall
    is not in it, as contact springs that stop a fast body determine the substeps at rest already.
    All bodies have the same substeps, those of the fastest waves: soft bodies that are strained
    matter only where their waves become as fast.

    table : the materials of the bodies; radius : r [m], see `estimate`.
    """
    gravity = float(np.linalg.norm(settings.gravity))
    sags = [one.density * gravity * radius / one.youngs_modulus for one in table]
    waves = [one.wave_speed for one in table]
    strained = [c * min(MOST, 1.0 + SAG * sag) for c, sag in zip(waves, sags, strict=True)]
    return max(strained) / max(waves)


def fall_frames(settings: Settings, drop: float) -> int | None:
    """Frames of free fall from rest, sqrt(2 drop / g), both along the floor's normal.

    drop : [m] along the up axis.  None where there is no floor below.
    """
    g = -float(np.dot(settings.gravity, settings.normal))
    if g <= 0.0 or settings.floor is None:
        return None
    height = max(0.0, drop) * float(np.dot(settings.normal, settings.up))
    return int(np.ceil(np.sqrt(2.0 * height / g) * settings.fps / settings.time_scale))


def first_contact(settings: Settings, drop: float) -> int | None:
    """The frame of `fall_frames`; None where the floor is not touched within the bake."""
    frame = fall_frames(settings, drop)
    return frame if frame is not None and frame < settings.frames else None


def typical_rest(settings: Settings, material: Material, radius: float, contact: int | None) -> int:
    """Frame by which bodies of a material are typically at rest.

    radius : [m] of a ball of their volume; contact : frame of the first contact, None: the first
        frame.
    """
    after = (
        RESTS[LAWS[material.law].flows] * time_scale(radius) * settings.fps / settings.time_scale
    )
    return min(settings.frames, (contact or 0) + math.ceil(after) + 1)


Cost = Mapping[str, Any]  # of `estimate`


def require_affordable(
    cost: Cost,
    max_hours: float,
    *,
    path: Path,
    settings: Settings,
    materials: Sequence[Material],
    tables: Sequence[Sequence[Material]] = (),
    particles: int,
    drop: float,
    shortcuts: Callable[[], Sequence[str]] = tuple,
) -> None:
    """Raise InputError where a bake is estimated to take longer than max_hours [h].

    tables : see `estimate`.  shortcuts : gives the hints of `cost.shortcuts`.
    """
    hours = cost["estimated_seconds"] / 3600.0
    if hours <= max_hours:
        return
    row = max(cost["per_material"], key=lambda row: row["seconds"])
    number = next(k for k, m in enumerate(materials) if m.name == row["name"])
    table = tables[number] if tables else materials[number : number + 1]
    stiffest = max(table, key=lambda one: one.wave_speed)  # that needs the substeps
    which = f"{stiffest.name}, the stiffest of {len(table)}: " if len(table) > 1 else ""
    dt = settings.time_scale / settings.fps / row["substeps_per_frame"]
    raise InputError(
        f"{path}: the bake would take about {duration(cost['estimated_seconds'])}:"
        f" {particles} particles of {row['name']} ({which}Young's modulus"
        f" {stiffest.youngs_modulus:.3g} Pa, damping time {stiffest.damping_time:.3g} s), dropped"
        f" {length_text(drop)}, need {row['substeps_per_frame']} substeps of {dt:.2g} s in each of"
        f" {counted(settings.frames, 'frame')}",
        "use a softer or less damped material, fewer --particles or --frames, or a lower --drop;"
        + "".join(f" {line};" for line in shortcuts())
        + f" --max-hours {math.ceil(hours * 1.2)} allows it",
    )


def critical_damping_time(
    settings: Settings, table: Sequence[Material], substeps: float, ratio: float, contact: float
) -> float:
    """[s] damping time of all materials that damps the stiffest vibration of the grid critically;
    0 where the material of the fastest waves is a fluid, which has no such damping, and without
    substeps.

    The frequency w of that vibration follows from the time step, (2 / w) (sqrt(1 + z^2) - z).

    substeps : of a frame, at rest; ratio : z; contact : how many times as many contact takes.
    """
    stiffest = max(table, key=lambda one: one.wave_speed)
    if not substeps or not stiffest.mu:
        return 0.0
    dt = settings.time_scale / settings.fps / substeps * contact
    w = 2.0 * settings.safety * (math.sqrt(1.0 + ratio * ratio) - ratio) / dt
    return (stiffest.lam + 2.0 * stiffest.mu) / (w * stiffest.mu)


WIDE = 1.5  # times an estimate, from where its largest value is stated as well
UNITS = ((86400.0, "days"), (3600.0, "hours"), (60.0, "minutes"))  # [s]


def duration(seconds: float) -> str:
    """A time as text: seconds, minutes, hours or days, with two or three digits."""
    count, unit = _in_units(seconds)
    return f"{count:.3g} {unit}" if unit != "s" else f"{count:.0f} s"


def rough_duration(seconds: float) -> str:
    """An estimate as text: like `duration`, with a fraction only below ten."""
    count, unit = _in_units(seconds)
    return f"{count:.2g} {unit}" if unit != "s" and count < 9.95 else f"{count:.0f} {unit}"


def rough_range(seconds: float, most: float) -> str:
    """An estimate and its largest value as text: the former alone where they are close."""
    low, high = rough_duration(seconds), rough_duration(most)
    if most < WIDE * seconds or low == high:
        return low
    number, unit = low.split()
    return f"{number if high.endswith(f' {unit}') else low} to {high}"


def _in_units(seconds: float) -> tuple[float, str]:
    """A time in the largest unit of which it has at least two, or in seconds."""
    return next(
        ((seconds / size, unit) for size, unit in UNITS if seconds >= 2.0 * size), (seconds, "s")
    )


RESERVE = 2e6  # [bytes] for the root layer and the ends of files
REPORT_BYTES = 3e3  # of a frame, in the report and in the health of the cache
LEAST_MEMORY = 64e6  # [bytes] free: below it the system starts to kill processes
MEMORY_INTERVAL = 0.1  # [s] between two queries of the free memory, which are slow
DISK_HINT = "free some space, choose another -o, or write less: --frames, --half, --only"


def reserve(frames: int) -> float:
    """[bytes] that a bake needs on the disk in addition to its samples."""
    return RESERVE + REPORT_BYTES * frames


def require_resources(
    cost: Cost, *, path: Path, folder: Path, frames: int, done: Sequence[float], copies: int
) -> None:
    """Raise InputError where a bake is estimated to need more disk or memory than is free.

    The estimates are accurate to some 10 %. Files that the bake will replace exist until its end,
    so their space does not count as free.

    folder : of the results; frames : of each material.
    done : share of each material's samples that is on the disk already.
    copies : 2 where the caches are flattened into one file at the end, else 1.
    """
    rows = zip(cost["per_material"], done, strict=True)
    disk = sum(row["disk_bytes"] * (1.0 - share) for row, share in rows) * copies
    disk += reserve(frames)  # the check before each frame requires the same
    free = free_disk(folder)
    if disk > free:
        raise InputError(
            f"{path}: the bake needs about {bytes_text(disk)} in {folder}, where {bytes_text(free)}"
            " are free",
            DISK_HINT,
        )
    memory, left = cost["estimated_memory_bytes"], free_memory() + free_swap()
    if memory > left:
        raise InputError(
            f"{path}: the bake would take about {bytes_text(memory)} of memory, and"
            f" {bytes_text(left)} are free",
            "use fewer --particles, bake one material at a time, or end other programs",
        )


class ResourceGuard:
    """Ends a bake before the disk or the memory is full.

    folder : of the results.
    sample_bytes : on the disk, of one sample.
    reserve : [bytes] that must stay free for the other files.
    resume_hint : how to continue once there is enough of either.
    """

    def __init__(self, folder: Path, sample_bytes: float, reserve: float, resume_hint: str) -> None:
        self._folder, self._sample = folder, sample_bytes
        self._reserve, self._resume_hint = reserve, resume_hint
        self._queried = -math.inf

    def require(self, index: int, unsaved: int) -> None:
        """Raise OutOfResources where disk or memory do not suffice for one more sample.

        The free memory is queried at most once per MEMORY_INTERVAL.
        index : of the sample; unsaved : samples that the cache has not yet written.
        """
        need = self._reserve + (unsaved + 2) * self._sample
        free = free_disk(self._folder)
        if free < need:
            raise OutOfResources(
                f"{self._folder} has {bytes_text(free)} left, and {bytes_text(need)} are needed"
                " for the next frame, unwritten data, and the report",
                f"free some space; {self._resume_hint}",
                frame=index,
            )
        now = time.monotonic()
        if now < self._queried + MEMORY_INTERVAL:
            return
        self._queried = now
        left = free_memory()
        if left < LEAST_MEMORY and (left := left + free_swap()) < LEAST_MEMORY:
            raise OutOfResources(
                f"{bytes_text(left)} of memory are left on this machine",
                f"end other programs, or use fewer --particles; {self._resume_hint}",
                frame=index,
            )
