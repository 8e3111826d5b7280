"""Cost of a bake: the estimate, the check against the machine, and the guard while it runs.

Costs were measured in CPU seconds on two cores of an x86-64 server: ``python -m
tools.bench.estimates`` compares thirty pairs of an asset and a preset with what their bakes take,
of which nine in ten are within a factor of two (docs/performance.md).  Memory is that of
``/usr/bin/time -v``.

A bake that is clearly too large is refused before any work.  One that meets a disk or a memory that
others fill ends before it is full, while what it had still fits: its frames, a layer to open
them, and a report.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gf_usd.core.errors import InputError, OutOfResources
from gf_usd.core.frames import MIXED, Settings, written
from gf_usd.core.materials.dimensionless import time_scale
from gf_usd.core.materials.laws import LAWS
from gf_usd.core.materials.material import Material
from gf_usd.prepare.plan import Variant
from gf_usd.system.memory_and_disk import free_disk, free_memory, free_swap
from gf_usd.system.taichi_runtime import cores, epoch

if TYPE_CHECKING:
    from gf_usd.physics.frame_loop import Solver


KEPT = 200_000  # particles of solvers that wait for their bake, at 4 kB each


class Solvers:
    """The solvers of a bake's variants, each built once.

    A solver is dear to build, and it alone knows how many substeps a frame takes: the one that was
    built for the estimate also bakes.

    build : makes the solver of a variant, at its start.
    particles : of each.
    """

    def __init__(self, build: Callable[[Variant], Solver], particles: int) -> None:
        self._build, self._particles = build, particles
        self._substeps: dict[str, int] = {}
        self._damping: dict[str, float] = {}
        self._waiting: dict[str, tuple[Solver, int]] = {}  # with the epoch of Taichi

    def substeps(self, variant: Variant) -> int:
        """Substeps of a sample."""
        if variant.name not in self._substeps:
            solver = self._build(variant)
            if self._particles * (1 + len(self._substeps)) <= KEPT:
                self._waiting[variant.name] = solver, epoch()
            self._substeps[variant.name] = solver.substeps
            self._damping[variant.name] = solver.damping_ratio
        return self._substeps[variant.name]

    def damping(self, variant: Variant) -> float:
        """The ratio by which its material damps the stiffest vibration of the grid."""
        self.substeps(variant)
        return self._damping[variant.name]

    def take(self, variant: Variant) -> Solver:
        """A solver at its start, which is the caller's to move."""
        solver, made = self._waiting.pop(variant.name, (None, 0))
        if solver is not None and made == epoch():
            return solver
        return self._build(variant)


# [s] of a substep, and of each particle in it, by solver, on one thread; measured
SUBSTEP_SECONDS = {"tl": (1.0e-5, 6.6e-8), "ul": (2e-6, 1.5e-7), MIXED: (3e-4, 1.8e-7)}
GPU_SUBSTEP_SECONDS = (7e-5, 1.7e-10)  # the same on a GPU with 4.8 TB/s (tools/bench/gpu.py)
CONTACT = 1.4  # longer with the contact of a shot, in the mean
FLOW = 1.3  # longer where the law flows
ALONE = 1500  # particles for each thread: fewer threads share a substep of fewer particles
# More substeps than at rest where bodies land at m times their wave speed: 1 + STRAINED m^3, up to
# MOST; fitted to the pairs of `tools.bench.estimates`.
STRAINED, MOST = 1.3, 5.0
CROWD = 1.3  # times as many substeps where bodies fall on each other
START_SECONDS = 1.1  # imports: between those of a quiet machine and of a busy one
LAW_SECONDS = 0.9  # load the compiled kernels of a law; the very first bake compiles them
PARTICLE_SECONDS = 3e-5  # sample a particle and place it on the grid, once
VERTEX_SECONDS = 3e-5  # weld, measure and embed a vertex, once
# [s] of a frame, of a particle and of a vertex in it: skin, Gaussians, health, files
FRAME_SECONDS = (5e-3, 7e-6, 7e-6)
# T from the first contact until bodies are usually at rest, by whether their law flows.  Within a
# factor of two of the duck of 400 particles with eleven presets (`gf-usd bake samples/duck.usda
# --particles 400 --material NAME`: 25 to 54 T for six that do not flow, 7 to 20 T for five that
# do), and of the duck and balls of 8,000 particles (33 to 90 T, docs/guide.md).
RESTS = {False: 45.0, True: 12.0}
CHECK_SECONDS = 0.1  # of those of the frames, once they are simulated
PAIR_SECONDS = (6e-9, 1.5e-9)  # of a vertex and a particle under the paper's skin; weights kept
# [s] of a substep, for each contact sample where several bodies or obstacles meet: in the mean of
# a crash.  Self-contact is detected once in many substeps.
CONTACT_PAIR_SECONDS = 1e-6

PROCESS_MEMORY = 320e6  # [bytes] Python, USD, Taichi and its compiler
# [bytes] a particle, by solver, measured with 100,000 to 10 million of them: 1,880 to 1,615
PARTICLE_MEMORY = {"tl": 1900.0, "ul": 3000.0, MIXED: 3000.0}
ROWS_MEMORY = 1000.0  # [bytes] a particle of W and G, which are kept where a GPU computes
VERTEX_MEMORY = 2200.0  # [bytes] a vertex: the surface, its nodes, a frame
CONTACT_PAIR_MEMORY = 9e3  # [bytes] a contact sample where bodies meet others


def estimate(
    settings: Settings,
    materials: Sequence[Material],
    substeps: Sequence[int],
    *,
    particles: int,
    vertices: int,
    paired: int,
    frame_bytes: float,
    first_contact: int | None,
    flying: int = 0,
    fall: float = 0.0,
    crowd: bool = True,
    damping: Sequence[float] = (),
    usual: Sequence[int] = (),
    ends_early: bool = False,
) -> dict[str, Any]:
    """Substeps, seconds, disk and memory of each material and in all; frame of first contact.

    Materials are baked one after another: disk adds up, and seconds do but for what is started
    once.  Memory adds up as far as solvers wait for their bake (KEPT).  Seconds are those of a
    machine that does nothing else, with kernels that were compiled before.

    substeps : of a frame of each material, all samples together.
    vertices : of meshes and captured Gaussians.
    paired : contact samples where bodies meet others or themselves; 0 where none does.
    frame_bytes : on the disk.
    flying : frames at the start without substeps; fall : [m] that bodies fall before they land.
    crowd : several bodies or obstacles meet.
    damping : ratio of each material, of `Solvers.damping`; (): not known.
    usual : frames of each material after which a bake that ends at rest usually ends, of
        `usual_rest`; its seconds are then told besides those of all frames.  (): all frames.
    ends_early : the frames are as many as there may be, not as many as there will be.
    """
    from gf_usd.geometry.skinning import KEPT_BYTES

    n, frames, samples = particles, settings.frames, settings.samples_per_frame
    disk = written(settings) * frame_bytes
    waiting = min(len(materials), max(1, KEPT // n))  # solvers, which are dear to build
    on_gpu = settings.solver == "tl" and settings.device == "cuda"
    particle = PARTICLE_MEMORY[settings.solver] + (ROWS_MEMORY if on_gpu else 0.0)
    memory = PROCESS_MEMORY + particle * n * waiting + VERTEX_MEMORY * vertices
    fixed, each = GPU_SUBSTEP_SECONDS if on_gpu else SUBSTEP_SECONDS[settings.solver]
    substep = CONTACT * (fixed + each * n)
    if paired:
        memory += CONTACT_PAIR_MEMORY * paired
        substep += CONTACT_PAIR_SECONDS * paired * crowd
    if settings.solver == "tl" and settings.device == "cpu":
        substep /= max(1, min(settings.threads or cores(), n // ALONE))
    frame = FRAME_SECONDS[0] + FRAME_SECONDS[1] * n + FRAME_SECONDS[2] * vertices
    if settings.skin == "paper":
        frame += vertices * n * PAIR_SECONDS[8 * vertices * n <= KEPT_BYTES]
    start = START_SECONDS + VERTEX_SECONDS * vertices
    moving = max(0, frames - 1 - flying)
    rows = []
    ratios = damping or [0.0] * len(materials)
    ends = [min(frames, one) for one in usual] or [frames] * len(materials)
    for material, count, ratio, last in zip(materials, substeps, ratios, ends, strict=True):
        many = float(count)
        if not settings.substeps:
            many *= strained(material, settings, fall) * (CROWD if paired and crowd else 1.0)
        work = many * substep * (FLOW if LAWS[material.law].flows else 1.0)
        end = CHECK_SECONDS * frames * samples * frame
        seconds = start + LAW_SECONDS + PARTICLE_SECONDS * n + end
        seconds += frames * samples * frame + moving * work
        less = (1.0 - last / frames) * (frames * samples * frame + end)
        less += (moving - max(0, last - 1 - flying)) * work
        rows.append(
            {
                "name": material.name,
                "substeps_per_frame": count,
                "substeps_per_sample": count / samples,
                "damping_ratio": ratio,
                "substeps": round(moving * many),
                "flying_samples": flying * samples,
                "sample_seconds": frame,
                "moving_seconds": frame + work / samples,
                "end_seconds": end,
                "seconds": float(seconds),
                "usual_seconds": float(seconds - less),
                "disk_bytes": int(disk),
                "memory_bytes": int(memory),
            }
        )
    laws = len({material.law for material in materials})
    shared = start * (len(rows) - 1) + LAW_SECONDS * (len(rows) - laws)
    return {
        "substeps_per_frame": {row["name"]: row["substeps_per_frame"] for row in rows},
        "estimated_seconds": sum(row["seconds"] for row in rows) - shared,
        "usual_seconds": sum(row["usual_seconds"] for row in rows) - shared,
        "ends_early": ends_early,
        "usual_frames": max(ends),
        "estimated_bytes": sum(row["disk_bytes"] for row in rows),
        "estimated_memory_bytes": int(memory),
        "first_contact_frame": first_contact,
        "per_material": rows,
    }


def strained(material: Material, settings: Settings, fall: float) -> float:
    """Substeps of a body that fell over those at rest, in the mean of what follows.

    It lands at the Mach number m = sqrt(2 g h) / c of its waves at rest, and is strained by about
    as much.  fall : h [m].
    """
    g = float(np.linalg.norm(settings.gravity))
    mach = math.sqrt(2.0 * g * fall) / material.wave_speed
    return min(MOST, 1.0 + STRAINED * mach**3)


def first_contact(settings: Settings, drop: float) -> int | None:
    """Frames of free fall from rest, sqrt(2 drop / g), both along the floor's normal.

    drop : [m] along the up axis.  None where the floor is not touched within the bake.
    """
    g = -float(np.dot(settings.gravity, settings.normal))
    if g <= 0.0 or settings.floor is None:
        return None
    height = max(0.0, drop) * float(np.dot(settings.normal, settings.up))
    frame = int(np.ceil(np.sqrt(2.0 * height / g) * settings.fps / settings.time_scale))
    return frame if frame < settings.frames else None


def usual_rest(settings: Settings, material: Material, radius: float, contact: int | None) -> int:
    """Frames until bodies of a material are usually at rest.

    radius : [m] of a ball of their volume; contact : frame of the first contact, None: the first.
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
    particles: int,
    drop: float,
) -> None:
    """Raise InputError where a bake is estimated to take longer than max_hours [h]."""
    hours = cost["estimated_seconds"] / 3600.0
    if hours <= max_hours:
        return
    row = max(cost["per_material"], key=lambda row: row["seconds"])
    material = next(m for m in materials if m.name == row["name"])
    dt = settings.time_scale / settings.fps / row["substeps_per_frame"]
    raise InputError(
        f"{path}: the bake would take about {duration(cost['estimated_seconds'])}:"
        f" {particles} particles of {material.name} (Young's modulus"
        f" {material.youngs_modulus:.3g} Pa, damping time {material.damping_time:.3g} s), dropped"
        f" {drop:.3g} m, need {row['substeps_per_frame']} substeps of {dt:.2g} s in each of"
        f" {settings.frames} frames",
        "take a softer or less damped material, fewer --particles or --frames, or a lower --drop;"
        + "".join(f" {line};" for line in shortcuts({**cost, "per_material": [row]}, materials))
        + f" --max-hours {math.ceil(hours * 1.2)} allows it",
    )


LONG = 300.0  # [s] from where a bake of a material that flows is told how it could be shorter
ELASTIC = 0.02  # of strain at yield: more is seen as springback


OVERDAMPED = 3.0  # ratio of the stiffest vibration from where damping alone makes steps short
DAMPED = 30.0  # [s] from where a bake is told so


def less_damped(row: Mapping[str, Any], material: Material) -> str:
    """What a shorter damping time would save; "" where that is little.

    The step is that of `time_step`, (2 / w) (sqrt(1 + z^2) - z), with z proportional to the damping
    time: at z = 1 the stiffest vibration of the grid is damped as fast as can be.
    """
    z = float(row.get("damping_ratio", 0.0))
    if z < OVERDAMPED or row["seconds"] < DAMPED or not material.damping_time:
        return ""
    gain = (math.sqrt(2.0) - 1.0) / (math.sqrt(1.0 + z * z) - z)
    return (
        f"--damping-time {material.damping_time / z:.2g} would bake {material.name} in"
        f" {row['substeps_per_frame'] / gain:.0f} substeps a frame: its damping time of"
        f" {material.damping_time:.3g} s takes {row['substeps_per_frame']}"
    )


def shortcuts(cost: Cost, materials: Sequence[Material]) -> tuple[str, ...]:
    """What a shorter damping time, or --mass-scaling, would save of long bakes.

    The mass scaling is the largest factor with which a material that flows is strained elastically
    by no more than ELASTIC when it yields, in two digits.
    """
    found = []
    for row in cost["per_material"]:
        material = next(m for m in materials if m.name == row["name"])
        if less := less_damped(row, material):
            found.append(less)
        strain = material.yield_strain
        if row["seconds"] < LONG or strain is None or not 0.0 < strain <= ELASTIC / 4.0:
            continue
        digit = 10.0 ** (math.floor(math.log10(ELASTIC / strain)) - 1)
        factor = math.floor(ELASTIC / strain / digit) * digit
        found.append(
            f"--mass-scaling {factor:g} would bake {material.name}, in which waves run at"
            f" {material.wave_speed:.3g} m/s, in about {duration(row['seconds'] / factor**0.5)} and"
            f" dent it alike: it springs back by up to {100.0 * factor * strain:.2g} % instead of"
            f" {100.0 * strain:.2g} %"
        )
    return tuple(found)


def duration(seconds: float) -> str:
    """A time for reading: seconds, minutes, hours or days, in two or three digits."""
    for size, unit in ((86400.0, "days"), (3600.0, "hours"), (60.0, "minutes")):
        if seconds >= 2.0 * size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds:.0f} s"


RESERVE = 2e6  # [bytes] for the root layer and the ends of files
REPORT_BYTES = 3e3  # of a frame, in the report and in the health of the cache
LEAST_MEMORY = 64e6  # [bytes] free: below it the system begins to end processes without a word
ASKED = 0.1  # [s] memory is asked for no more often: the system takes longer to say than to go on
DISK_HINT = "free some space, choose another -o, or write less: --frames, --half, --only"


def reserve(frames: int) -> float:
    """[bytes] that are wanted on the disk besides the samples of a bake."""
    return RESERVE + REPORT_BYTES * frames


def require_resources(
    cost: Cost, *, path: Path, folder: Path, frames: int, done: Sequence[float], copies: int
) -> None:
    """Raise InputError where a bake is estimated to need more disk or memory than is free.

    The estimates hold within some tenths.  What a bake replaces is there until the end, and does
    not count as free.

    folder : of the results; frames : of each material.
    done : share of each material's samples that is on the disk already.
    copies : 2 where one file is made of the caches at the end, else 1.
    """
    rows = zip(cost["per_material"], done, strict=True)
    disk = sum(row["disk_bytes"] * (1.0 - share) for row, share in rows) * copies
    disk += reserve(frames)  # as before each frame: what is refused there is refused here
    free = free_disk(folder)
    if disk > free:
        raise InputError(
            f"{path}: the bake needs about {disk / 1e6:.3g} MB in {folder}, where"
            f" {free / 1e6:.3g} MB are free",
            DISK_HINT,
        )
    memory, left = cost["estimated_memory_bytes"], free_memory() + free_swap()
    if memory > left:
        raise InputError(
            f"{path}: the bake would take about {memory / 1e9:.3g} GB of memory, and"
            f" {left / 1e9:.3g} GB are free",
            "take fewer --particles, bake one material at a time, or end other programs",
        )


class ResourceGuard:
    """Ends a bake before the disk or the memory is full.

    folder : of the results.
    sample_bytes : on the disk, of one sample.
    reserve : [bytes] that stay free for the rest of the files.
    again : what to do once there is enough of either, in words.
    """

    def __init__(self, folder: Path, sample_bytes: float, reserve: float, again: str) -> None:
        self._folder, self._sample = folder, sample_bytes
        self._reserve, self._again = reserve, again
        self._asked = -math.inf

    def require(self, index: int, unsaved: int) -> None:
        """Raise OutOfResources where the disk or the memory has not enough for one more sample.

        Memory is asked for once in ASKED seconds.
        index : of the sample; unsaved : samples that the cache still holds.
        """
        need = self._reserve + (unsaved + 2) * self._sample
        free = free_disk(self._folder)
        if free < need:
            raise OutOfResources(
                f"{self._folder} has {free / 1e6:.3g} MB left, and {need / 1e6:.3g} MB are wanted"
                " for the next frame, what is not yet written, and the report",
                f"free some space; {self._again}",
                frame=index,
            )
        now = time.monotonic()
        if now < self._asked + ASKED:
            return
        self._asked = now
        left = free_memory()
        if left < LEAST_MEMORY and (left := left + free_swap()) < LEAST_MEMORY:
            raise OutOfResources(
                f"{left / 1e6:.3g} MB of memory are left on this machine",
                f"end other programs, or take fewer --particles; {self._again}",
                frame=index,
            )
