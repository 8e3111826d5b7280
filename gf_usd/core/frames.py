"""The immutable values that cross packages: SI, in the source stage's world frame and up axis.

Quaternions (w, x, y, z); linear Rec. 709.

The resolved output choices: what a bake writes, and in which form.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.materials.conversion import Conversion
from gf_usd.core.materials.keys import ValueKeys
from gf_usd.core.materials.material import Material
from gf_usd.core.units import Precision

if TYPE_CHECKING:
    from gf_usd.core.asset import SplatPose


@dataclass(frozen=True, kw_only=True)
class CellCopies:
    """Grid cells that a solid fills, with a copy for each connected part of the solid in a cell.

    Where limbs are near each other, cells and nodes have several copies (docs/physics.md).
    """

    h: float  # [m] edge of a cell; cells start at the corners of `Particles`
    cell: Ints  # (K, 3) cell of each copy, counted from there
    body: Ints  # (K,) as in Particles
    links: Ints  # (E, 2) copies of cells with a common face, across which the solid is connected
    of: Ints  # (N,) copy of each particle; some copies have none


@dataclass(frozen=True, kw_only=True)
class Particles:
    """Quadrature points of the solid and their rest Gaussians."""

    X: Floats  # (N, 3) [m] rest positions, world
    V0: Floats  # (N,) [m^3] rest volumes
    material: Ints  # (N,) into the materials of the bake
    orientation: Floats  # (N, 4) rest orientation; axis 0 is the surface normal
    scale: Floats  # (N, 3) [m] rest standard deviations (sigma_r, sigma_t, sigma_t)
    color: Floats  # (N, 3) linear
    opacity: Floats  # (N,)
    surface: Ints  # (N,) index of the nearest surface: where the particle came from
    spacing: float  # [m] mean distance s = (V / N)^(1/3), or `lattice` where that is longer
    volume: float  # [m^3] of the solid: the sum of V0
    lattice: float  # [m] half the edge of the cells the particles were made for
    corner: Floats  # (3,) [m] a corner of these cells: those of the solver's grid are laid along it
    corners: Floats | None = None  # (bodies, 3) [m] the same of each body; None: all have `corner`
    outside: int = 0  # particles outside the solid from which they were sampled
    body: Ints | None = None  # (N,) which of the bodies, from 0; None: all are one
    own: Mapping[str, Floats] | None = None  # (N,) instead of the material's, see own_values
    copies: CellCopies | None = None  # None: no limbs are near each other, every cell is one
    keys: ValueKeys | None = None  # None: no value of a material changes with time
    conversions: tuple[Conversion, ...] = ()  # of no two of them is the same particle
    scatter: Floats | None = None  # (N, 3) [m] at rest by which those with one are moved then

    def __len__(self) -> int:
        return len(self.X)

    @property
    def radius(self) -> float:
        """r = (3 V / 4 pi)^(1/3) [m]: the body's scale."""
        return float((3.0 * self.volume / (4.0 * np.pi)) ** (1.0 / 3.0))

    @property
    def radii(self) -> NDArray[np.float64]:
        """(bodies,) [m] the same of each body; 0 of one without particles."""
        return np.cbrt(0.75 / np.pi * np.bincount(self.body_of, np.asarray(self.V0, float)))

    @property
    def body_of(self) -> Ints:
        """(N,) the body of each; 0 where all are one."""
        return np.zeros(len(self), np.int64) if self.body is None else np.asarray(self.body)


@dataclass(frozen=True, kw_only=True)
class TetLattice:
    """Tetrahedra around a body, which move with it."""

    body: int  # as in Particles
    X: Floats  # (n, 3) [m] rest positions, world
    tets: Ints  # (m, 4) into X, each of positive volume
    copy: Ints | None = None  # (n,) into Particles.copies; None where that is

    @property
    def key(self) -> str:
        """Its name among the embedded points."""
        return f"tets:{self.body}"


@dataclass(frozen=True, kw_only=True)
class TetAttachment:
    """Points of a body's tetrahedra that are pinned."""

    pin: str  # name of the pin, as given
    body: int  # as in Particles
    points: Ints  # (n,) into TetLattice.X
    path: Floats  # (F, k, 3) [m] places known of the pin at each sample; F = 1: they stay


@dataclass(frozen=True, kw_only=True)
class SurfaceSamples:
    """Points at which contact acts, spread over the surfaces about one spacing apart."""

    X: Floats  # (n, 3) [m] rest positions, world
    area: Floats  # (n,) [m^2] of surface that each represents
    normal: Floats | None = None  # (n, 3) unit, outward; None: they touch only the floor
    body: Ints | None = None  # (n,) as in Particles
    cell_copy: Ints | None = None  # (n,) into Particles.copies; None where that is

    def subset(self, rows: Ints) -> SurfaceSamples:
        """Some of the samples."""
        return SurfaceSamples(
            X=self.X[rows],
            area=self.area[rows],
            normal=None if self.normal is None else self.normal[rows],
            body=None if self.body is None else self.body[rows],
            cell_copy=None if self.cell_copy is None else self.cell_copy[rows],
        )

    def with_grains(self, particles: Particles, flows: Ints) -> SurfaceSamples:
        """Those of solid bodies, and every particle of the bodies (B,) that flow.

        The area of each particle is such that rho * area * spacing is its own mass.
        """
        of = np.zeros(len(self.X), np.int64) if self.body is None else np.asarray(self.body)
        shell, body = ~flows[of], particles.body_of
        grains = flows[body]
        count = int(grains.sum())
        normal = np.zeros_like(self.X) if self.normal is None else np.asarray(self.normal)
        copy = None if self.cell_copy is None else np.asarray(self.cell_copy)
        return SurfaceSamples(
            X=np.concatenate([self.X[shell], particles.X[grains]]),
            area=np.concatenate([self.area[shell], particles.V0[grains] / particles.spacing]),
            normal=np.concatenate([normal[shell], np.zeros((count, 3))]),
            body=np.concatenate([of[shell], body[grains]]),
            cell_copy=None
            if copy is None
            else np.concatenate([copy[shell], np.zeros(count, np.int64)]),
        )


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


@dataclass(frozen=True, kw_only=True)
class Pose:
    """A set of embedded points at one time."""

    x: Floats  # (n, 3) [m]
    v: Floats  # (n, 3) [m/s]
    F: Floats  # (n, 3, 3) deformation gradient


STRETCH = 4.0  # singular value of F: the share of a body with larger ones is measured


@dataclass(frozen=True, kw_only=True)
class Health:
    """What the solver measured during one frame."""

    substeps: int = 0
    kinetic: float = 0.0  # [J]
    elastic: float = 0.0  # [J]
    potential: float = 0.0  # [J] of gravity, relative to the floor (or the origin)
    contact: float = 0.0  # [J] stored in the penalty springs
    mass: float = 0.0  # [kg]
    center: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [m] center of mass
    momentum: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [kg m/s]
    angular_momentum: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [kg m^2/s] about the origin
    min_J: float = 1.0  # smallest volume ratio det F of a particle
    max_J: float = 1.0  # largest
    min_stretch: float = 1.0  # smallest singular value of F
    max_stretch: float = 1.0  # largest
    inverted: int = 0  # particles with J <= 0
    penetration: float = 0.0  # [m] deepest contact sample in the floor during the frame
    overlap: float = 0.0  # [m] deepest contact sample in a body or obstacle; at least `pierced`
    overlap_pair: str | None = None  # text on the body and what it overlapped; None: unknown
    overlap_names: tuple[str, str] | None = None  # names of both; None also where an edge is deeper
    let_go: int = 0  # most contact samples released at the same time
    friction_capped: int = 0  # contact samples that crept at the stability limit (paper friction)
    rollbacks: int = 0  # times the frame was recomputed with half the step
    work: float = 0.0  # [J] done on the body by pins, goals, fields, obstacles and new moduli
    clamped: int = 0  # particles whose singular values of F were clipped during the frame
    stress_capped: int = 0  # particles whose stress was cut during the frame
    flying: int = 0  # bodies in free flight, in a frame without substeps
    sleeping: int = 0  # bodies asleep, in a frame without substeps
    injected: float = 0.0  # [J] added between substeps: WLS, shape correction, new contact planes
    planes: float = 0.0  # [J] of `injected`, from new contact planes
    plastic_dissipation: float | None = None  # [J] lost to flow in the frame; None: no law flows
    converted: int | None = None  # particles converted so far; None: none can be
    conversion_dissipation: float | None = None  # [J] of `plastic_dissipation`, by conversion
    # [J] lost to rolling resistance and settling in the frame; None: neither acts
    settling_dissipation: float | None = None
    fallen: int | None = None  # bodies below every obstacle; None: not measured
    # [J] of the motion of these bodies, or of flowing particles there; None: not measured
    fallen_kinetic: float | None = None
    # Flowing particles below the floor or every obstacle; None: nothing flows without limit
    lost: int | None = None
    flow_volume: float | None = None  # volume of the other flowing particles over that at rest
    flow_per_cell: float | None = None  # their mean number in grid cells that have any
    # [m] depth of the deepest edge or corner of an obstacle in a body; None: not measured
    pierced: float | None = None
    pierced_through: bool | None = None  # whether it comes out on the other side
    pierced_pair: str | None = None  # text on the obstacle and the body
    inside_share: float | None = None  # share of the surface deep in a body; None: not measured
    inside_depth: float | None = None  # [m] greatest depth of the surface
    outside_share: float | None = None  # share of particles far out of the mesh; None: not measured
    outside_depth: float | None = None  # [m] largest distance of these particles
    outside_mesh: str | None = None  # text on the mesh with the longest edges
    # largest volume of a body over that at rest; None: no particle has twice its volume
    expanded: float | None = None
    expanded_body: str | None = None  # prim path of that body
    stretched: float | None = None  # largest share of a body's volume stretched above STRETCH
    stretched_body: str | None = None  # prim path of that body; None: nothing is stretched so

    @property
    def energy(self) -> float:
        """[J] kinetic, elastic, potential and of contact."""
        return self.kinetic + self.elastic + self.potential + self.contact

    @property
    def dissipation(self) -> float:
        """[J] dissipated in the frame by plastic flow and settling, which are measured."""
        return (self.plastic_dissipation or 0.0) + (self.settling_dissipation or 0.0)


# Of m g0 r: bodies with less kinetic energy for T = sqrt(r / g0) are at rest.  That is a speed of
# 4.5e-4 sqrt(g0 r), 1.4 mm/s for a ball of 1 m.
AT_REST = 1e-7


def pierced_weight(depth: float, through: bool) -> float:
    """[m] by which depths of obstacles are compared: what has come through, and is seen, counts
    twice.
    """
    return (2.0 if through else 1.0) * depth


@dataclass(frozen=True, kw_only=True)
class Frame:
    """One frame from a solver."""

    index: int  # 0 for the first
    time: float  # [s] simulated
    particles: Pose
    embedded: Mapping[str, Pose] = field(default_factory=dict)  # one per named set of points
    stress: Floats | None = None  # (N,) [Pa] von Mises of the particles, if requested
    # (N,) of each internal variable of the laws, if requested; NaN where a law does not have it
    internal: Mapping[str, Floats] = field(default_factory=dict)
    converted: NDArray[np.bool_] | None = None  # (N,) which particles were; None: none can be
    health: Health = field(default_factory=Health)


@dataclass(frozen=True, kw_only=True)
class MeshPose:
    """A deformed mesh, world."""

    points: Floats  # (V, 3) [m]
    velocities: Floats  # (V, 3) [m/s of playback]
    normals: Floats | None = None  # (K, 3) unit


@dataclass(frozen=True, kw_only=True)
class SurfacePose:
    """The surface of flowing particles, world; the topology differs in every frame."""

    points: Floats  # (V, 3) [m]
    velocities: Floats  # (V, 3) [m/s of playback]
    normals: Floats  # (V, 3) unit, outward
    colors: Floats  # (V, 3) linear
    triangles: Ints  # (T, 3) counter-clockwise seen from outside


@dataclass(frozen=True, kw_only=True)
class GaussianPose:
    """Deformed Gaussians, world."""

    positions: Floats  # (N, 3) [m]
    velocities: Floats  # (N, 3) [m/s of playback]
    orientations: Floats  # (N, 4) unit, continuous in time
    scales: Floats  # (N, 3) [m] standard deviations
    F: Floats | None = None  # (N, 3, 3) deformation gradient, if requested
    stress: Floats | None = None  # (N,) [Pa] von Mises, if requested
    internal: Mapping[str, Floats] = field(default_factory=dict)  # as in Frame


@dataclass(frozen=True, kw_only=True)
class BakedFrame:
    """What the cache writer receives for each frame."""

    index: int
    time_code: float
    meshes: Mapping[str, MeshPose]  # by Surface.path
    gaussians: GaussianPose
    health: Health
    splats: Mapping[str, SplatPose] = field(default_factory=dict)  # by Surface.path
    tets: Mapping[str, MeshPose] = field(default_factory=dict)  # by TetLattice.key
    flows: Mapping[int, SurfacePose] = field(default_factory=dict)  # by body, as in Particles
    converted: frozenset[int] = frozenset()  # bodies of `Choices.converting` that begin to flow


@dataclass(frozen=True, kw_only=True)
class BakeInfo:
    """What a bake records about itself in its layers and its report."""

    look: str  # variant name, e.g. "rubber"
    materials: tuple[Material, ...]
    settings: Settings
    command: str
    version: str
    input_hash: str  # sha256 of the source file


SHAPES = ("mesh", "gaussians", "points")

# Caches above LARGE bytes are split into value clips of about CLIP bytes unasked: a file of tens of
# gigabytes can neither be copied in parts nor resumed.
LARGE = 2_000_000_000

CLIP = 500_000_000


@dataclass(frozen=True, kw_only=True)
class Choices:
    """Output choices of a bake, resolved."""

    shapes: tuple[str, ...] = SHAPES  # of SHAPES, in that order: what the cache holds
    half: bool = False  # half precision where the schema has it and it is safe
    precision: Precision | None = None  # tolerance of stored values; None: single precision
    adaptive: bool = False  # samples are left out where that is within `precision`
    velocities: bool = True  # they are written
    clip_frames: int = 0  # frames of a value clip; 0: the cache is one file
    flat: bool = False  # one file instead of layers
    settled: bool = False  # one pose, that at rest, without time samples
    tets: bool = False  # tetrahedra of each body
    until_rest: bool = False  # the last frame is the first at rest
    open_end: bool = False  # because no option states the length
    certify: bool = False  # the figures are to have intervals
    flows: tuple[int, ...] = ()  # bodies of which the surface of what flows is written
    flowing: tuple[str, ...] = ()  # meshes replaced by surfaces or particles of flowing bodies
    # the same, and the body of each: once the first particle of that is converted
    converting: tuple[tuple[str, int], ...] = ()

    @property
    def mesh(self) -> bool:
        """Whether the meshes move."""
        return "mesh" in self.shapes

    def drawn(self, path: str) -> bool:
        """Whether the mesh at a prim path moves."""
        return self.mesh and path not in self.flowing

    @property
    def replaced(self) -> tuple[str, ...]:
        """Meshes that surfaces or particles of flowing bodies replace, from the start or later."""
        return (*self.flowing, *(path for path, _ in self.converting))

    @property
    def particles(self) -> bool:
        """Whether any form of the particles is written, or tetrahedra, or flowing particles in
        addition to meshes.
        """
        both = bool({"gaussians", "points"} & set(self.shapes))
        return both or self.tets or bool(self.flowing or self.converting or self.flows)


def clip_length(requested: int | None, frame_bytes: float, frames: int) -> int:
    """Frames of a clip: as requested, or by the size of the cache; 0: one file.

    frame_bytes : of one frame with all its samples; frames : how many are written.
    """
    if requested is not None:
        return requested
    if frame_bytes * frames <= LARGE:
        return 0
    return max(1, int(CLIP / frame_bytes))


SOURCE_VARIANT = "none"  # taken: usd.variants calls the asset without a bake so


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
