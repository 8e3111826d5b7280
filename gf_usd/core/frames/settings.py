"""The settings of a solver, and the frames that they mean."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True)
class Field:
    """An acceleration in addition to gravity, the same for every mass.

    wind     `vector`
    radial   `strength` away from the center; below 0 toward it
    noise    swirls of a `length` that change at a `rate`, with `strength` as root mean square
    gravity  `values` at time codes `times`, interpolated linearly, instead of Settings.gravity

    If there is a radius, it is multiplied by exp(-|x - center|^2 / radius^2).
    """

    kind: str
    vector: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [m/s^2]
    strength: float = 0.0  # [m/s^2]
    center: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [m] world
    radius: float | None = None  # [m]; None: everywhere alike
    length: float = 1.0  # [m]
    rate: float = 0.0  # [1/s]
    times: tuple[float, ...] = ()
    values: tuple[tuple[float, float, float], ...] = ()  # [m/s^2]

    @property
    def most(self) -> float:
        """[m/s^2] that it hardly ever exceeds."""
        each = [float(np.linalg.norm(v)) for v in (self.vector, *self.values)]
        return max(*each, (3.0 if self.kind == "noise" else 1.0) * abs(self.strength))


CONSISTENT, LUMPED = "consistent", "lumped"


MIXED = "mixed"  # solver of a bake with solid and flowing bodies


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Everything that determines a bake, with all defaults resolved."""

    frames: int  # number of frames simulated; the last is written
    fps: float  # frames per second of playback
    time_codes_per_second: float  # of the output layers
    start: float  # time code of the first frame
    gravity: tuple[float, float, float]  # [m/s^2], world
    up: tuple[float, float, float]  # unit
    floor: float | None = 0.0  # distance of the floor from the origin along its normal [m]
    lift: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [m] rigid offset of the whole asset
    seed: int = 0
    filter_rate: float = 0.0  # APIC filter rate r [1/s]; inf = TL-APIC, 0 = Lagrangian limit
    drag: float = 0.0  # [1/s] linear drag on velocity
    safety: float = 0.5  # fraction of the stable step
    device: str = "cpu"  # cpu | cuda
    threads: int | None = None  # CPU threads; None: all
    time_scale: float = 1.0  # simulated seconds per second of playback
    substeps: int | None = None  # a frame; None: from the stable step
    cell: float | None = None  # [m] grid spacing h; None: two strata
    contact_rate: float | None = None  # [1/s^2] contact stiffness per mass; None: by formula
    sampling: str = "strata"  # strata | rejection
    followers: bool = True  # light nodes are dependent nodes; False: every node is free
    mass: str = CONSISTENT  # tl: consistent | lumped (`physics.grid.mass`)
    deformation_gradients: bool = False  # write F of every particle
    stress: bool = False  # write the von Mises stress of every particle
    internal: bool = False  # write the internal variables of laws, such as the plastic strain
    skin: str = "embed"  # embed | idw | paper: how meshes follow the body
    solver: str = "tl"  # tl: Total Lagrangian | ul: Updated Lagrangian MLS-MPM | MIXED: both
    floor_normal: tuple[float, float, float] | None = None  # unit; None: up
    wls: bool = False  # tl: recompute F once a frame from the positions (GaussianFlesh 3.2)
    procrustes: float = 0.0  # tl: strength of the shape correction a frame (GaussianFlesh 4.3)
    clamp: tuple[float, float] | None = None  # limits of the singular values of F
    stress_cap: float | None = None  # [Pa] largest Frobenius norm of P
    samples_per_frame: int = 1  # states written a frame, for motion blur
    first: int = 0  # frame that is written first; below 0 the rest pose is held
    shortcuts: bool = False  # tl: no substeps where all bodies fly freely or sleep
    mass_scaling: float = 1.0  # the moduli of materials that flow were divided by it
    fields: tuple[Field, ...] = ()  # tl: accelerations in addition to gravity
    rolling: float = 0.0  # tl: coefficient of rolling resistance on floor and obstacles
    settling: bool = False  # tl: damp small bounces, and motion too small to be seen

    def time_code(self, index: float) -> float:
        """Time code of a frame."""
        step = self.time_codes_per_second / self.fps
        if step.is_integer():  # 47 * 23.976 / 23.976 is not 47
            return self.start + index * step
        return self.start + index * self.time_codes_per_second / self.fps

    @property
    def frame_time(self) -> float:
        """[s] of simulated time between frames."""
        return self.time_scale / self.fps

    @property
    def settles(self) -> bool:
        """Whether rolling resistance or settling may take energy."""
        return self.settling or self.rolling > 0.0

    @property
    def pushes(self) -> float:
        """[m/s^2] sum of the strengths of all fields, which they rarely exceed."""
        return sum(field.most for field in self.fields)

    @property
    def normal(self) -> NDArray[np.float64]:
        """Unit vector (3,) out of the floor."""
        return np.asarray(self.up if self.floor_normal is None else self.floor_normal, float)


def sampled(settings: Settings) -> Settings:
    """The settings under which every sample is a frame: those of the solver and its inputs."""
    n = settings.samples_per_frame
    if n == 1:
        return settings
    return replace(
        settings,
        fps=settings.fps * n,
        frames=(settings.frames - 1) * n + 1,
        first=settings.first * n,
        samples_per_frame=1,
    )


def shortened(settings: Settings, skipped: int) -> Settings:
    """The settings of a bake that begins so many frames later and writes the same frames."""
    step = settings.time_codes_per_second / settings.fps
    return replace(
        settings,
        frames=settings.frames - skipped,
        first=settings.first - skipped,
        start=settings.start + skipped * step,
    )


def written(settings: Settings) -> int:
    """Number of frames written, those that hold the rest pose included."""
    return settings.frames - settings.first
