"""The immutable values that cross rooms: SI, in the source stage's world frame and up axis.

Quaternions (w, x, y, z); linear Rec. 709.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gf_usd.units import StageUnits

if TYPE_CHECKING:
    from gf_usd.splats import SplatPose, Splats
    from gf_usd.surface_material import SurfaceMaterial

Floats = NDArray[Any]  # of any width: files hold float32, the solver's bookkeeping float64
Ints = NDArray[Any]
AXES = {"X": 0, "Y": 1, "Z": 2}


@dataclass(frozen=True, kw_only=True)
class StageFacts:
    """What the source says of itself."""

    path: Path  # the file as the user named it
    units: StageUnits
    up_axis: str  # "Y" or "Z"
    time_codes_per_second: float | None  # None where the source authors none
    start_time_code: float | None
    end_time_code: float | None
    root_prims: tuple[str, ...]  # every root prim path, in order
    default_prim: str | None
    animated: bool = False  # a layer of it holds time samples
    says_physics: bool = False  # a UsdPhysics scene or API is authored on the stage
    notes: tuple[str, ...] = ()  # what was assumed or left alone, in words

    @property
    def up(self) -> NDArray[np.float64]:
        """Unit vector (3,) of the up axis."""
        return np.eye(3)[AXES[self.up_axis]]


@dataclass(frozen=True, kw_only=True)
class Texture:
    """A colour texture as stored in its file."""

    pixels: NDArray[np.uint8]  # (H, W, 3), row 0 at the top
    srgb: bool  # True: pixels are sRGB-encoded; False: linear
    wrap_s: str = "repeat"  # repeat | clamp | mirror | black
    wrap_t: str = "repeat"


@dataclass(frozen=True, kw_only=True)
class Surface:
    """One mesh of the asset, posed at the first frame."""

    path: str  # prim path in the source
    type_name: str  # "Mesh", "Sphere", ...; anything but Mesh is an implicit shape
    points: Floats  # (V, 3) [m], world
    face_counts: Ints  # (P,) as authored
    face_indices: Ints  # (C,) as authored
    triangles: Ints  # (T, 3) into points, right-handed whatever the authored orientation
    triangle_corners: Ints  # (T, 3) into face_indices: the corner each triangle vertex came from
    normals: Floats | None = None  # (K, 3) authored normals, world, unit; None where none
    normals_interpolation: str = ""  # vertex | varying | faceVarying | uniform | ""
    normal_points: Ints | None = None  # (K,) the point whose deformation carries each normal
    triangle_colours: Floats | None = None  # (T, 3, 3) displayColor at triangle corners, linear
    triangle_uvs: Floats | None = None  # (T, 3, 2) of the primvar that the texture reads
    triangle_materials: Ints | None = None  # (T,) into materials; -1 where nothing is bound
    materials: tuple[SurfaceMaterial, ...] = ()
    skinned: bool = False  # posed by UsdSkel: the cache must not let it be skinned again
    splats: Splats | None = None  # captured Gaussians that this surface was put around: they show


@dataclass(frozen=True, kw_only=True)
class Asset:
    """What a reader makes of a file."""

    facts: StageFacts
    surfaces: tuple[Surface, ...]
    skipped: tuple[tuple[str, str], ...] = ()  # (prim path, reason) of what is left as it is
    splats: tuple[Splats, ...] = ()  # captured Gaussians, not yet given a surface


@dataclass(frozen=True, kw_only=True)
class Material:
    """A constitutive law with its numbers, absolute (SI)."""

    name: str
    law: str  # a row of gf_usd.physics.laws.LAWS
    density: float  # [kg/m^3]
    youngs_modulus: float  # [Pa]
    poissons_ratio: float
    damping_time: float = 0.0  # Kelvin-Voigt tau [s]
    friction: float = 0.8  # Coulomb
    restitution: float = 0.85  # enters the contact damping ratio

    @property
    def mu(self) -> float:
        """Shear modulus E / (2 (1 + nu)) [Pa]."""
        return self.youngs_modulus / (2.0 * (1.0 + self.poissons_ratio))

    @property
    def lam(self) -> float:
        """Lame's first parameter E nu / ((1 + nu) (1 - 2 nu)) [Pa]."""
        nu = self.poissons_ratio
        return self.youngs_modulus * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))

    @property
    def wave_speed(self) -> float:
        """c = sqrt((lam + 2 mu) / rho) [m/s] of pressure waves at rest."""
        return float(np.sqrt((self.lam + 2.0 * self.mu) / self.density))


@dataclass(frozen=True, kw_only=True)
class Particles:
    """Quadrature points of the solid and their rest Gaussians."""

    X: Floats  # (N, 3) [m] rest positions, world
    V0: Floats  # (N,) [m^3] rest volumes
    material: Ints  # (N,) into the materials of the bake
    orientation: Floats  # (N, 4) rest orientation; axis 0 is the surface normal
    scale: Floats  # (N, 3) [m] rest standard deviations (sigma_r, sigma_t, sigma_t)
    colour: Floats  # (N, 3) linear
    opacity: Floats  # (N,)
    surface: Ints  # (N,) index of the nearest surface: where the particle came from
    spacing: float  # [m] mean distance s = (V / N)^(1/3)
    volume: float  # [m^3] of the solid
    lattice: float  # [m] edge of the strata the particles were drawn from
    corner: Floats  # (3,) [m] a corner of the lattice: grid cells are laid along it
    body: Ints | None = None  # (N,) which of the bodies, from 0; None: all are one
    own: Mapping[str, Floats] | None = None  # (N,) in place of the material's, see own_values

    def __len__(self) -> int:
        return len(self.X)

    @property
    def radius(self) -> float:
        """r = (3 V / 4 pi)^(1/3) [m]: the body's scale."""
        return float((3.0 * self.volume / (4.0 * np.pi)) ** (1.0 / 3.0))


@dataclass(frozen=True, kw_only=True)
class SurfaceSamples:
    """Points that feel contact, spread over the surfaces about one spacing apart."""

    X: Floats  # (n, 3) [m] rest positions, world
    area: Floats  # (n,) [m^2] of surface that each stands for
    normal: Floats | None = None  # (n, 3) unit, outward; None: they meet nothing but the floor
    body: Ints | None = None  # (n,) as in Particles


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Everything that decides a bake, resolved: no None is left to interpret."""

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
    followers: bool = True  # light nodes follow the others; False: every node is free
    deformation_gradients: bool = False  # write F of every particle
    stress: bool = False  # write the von Mises stress of every particle
    skin: str = "embed"  # embed | idw | paper: how meshes follow the body
    solver: str = "tl"  # tl: Total Lagrangian | ul: Updated Lagrangian MLS-MPM
    floor_normal: tuple[float, float, float] | None = None  # unit; None: up
    wls: bool = False  # tl: recompute F once a frame from the positions (GaussianFlesh 3.2)
    procrustes: float = 0.0  # tl: strength of the shape correction a frame (GaussianFlesh 4.3)
    clamp: tuple[float, float] | None = None  # limits of the singular values of F
    stress_cap: float | None = None  # [Pa] largest Frobenius norm of P
    samples_per_frame: int = 1  # states written a frame, for motion blur
    first: int = 0  # frame that is written first; below 0 the rest pose is held
    shortcuts: bool = False  # tl: no substeps where all bodies fly freely or sleep

    def time_code(self, index: float) -> float:
        """Time code of a frame."""
        return self.start + index * self.time_codes_per_second / self.fps

    @property
    def normal(self) -> NDArray[np.float64]:
        """Unit vector (3,) out of the floor."""
        return np.asarray(self.up if self.floor_normal is None else self.floor_normal, float)


@dataclass(frozen=True, kw_only=True)
class Pose:
    """A set of points that rides on the body, at one time."""

    x: Floats  # (n, 3) [m]
    v: Floats  # (n, 3) [m/s]
    F: Floats  # (n, 3, 3) deformation gradient


@dataclass(frozen=True, kw_only=True)
class Health:
    """What the solver measured during one frame."""

    substeps: int = 0
    kinetic: float = 0.0  # [J]
    elastic: float = 0.0  # [J]
    potential: float = 0.0  # [J] of gravity, relative to the floor (or the origin)
    contact: float = 0.0  # [J] stored in the penalty springs
    mass: float = 0.0  # [kg]
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [m] centre of mass
    momentum: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [kg m/s]
    angular_momentum: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [kg m^2/s] about the origin
    min_J: float = 1.0
    max_J: float = 1.0
    min_stretch: float = 1.0  # smallest singular value of F
    max_stretch: float = 1.0
    inverted: int = 0  # particles with J <= 0
    penetration: float = 0.0  # [m] deepest of a contact sample in the floor during the frame
    overlap: float = 0.0  # [m] deepest of a contact sample in another body or an obstacle
    let_go: int = 0  # contact samples at once that seemed deeper than they can have come
    friction_capped: int = 0  # contact samples whose friction met its stability limit
    rollbacks: int = 0  # times the frame was redone with half the step
    work: float = 0.0  # [J] done on the body by pins and moving obstacles during the frame
    clamped: int = 0  # particles whose singular values of F were clipped during the frame
    stress_capped: int = 0  # particles whose stress was cut during the frame
    flying: int = 0  # bodies that flew by the closed form, in a frame without substeps
    sleeping: int = 0  # bodies that slept, in a frame without substeps
    injected: float = 0.0  # [J] given between substeps: WLS, shape correction, new contact planes


@dataclass(frozen=True, kw_only=True)
class Frame:
    """One frame out of a solver."""

    index: int  # 0 for the first
    time: float  # [s] simulated
    particles: Pose
    riders: Mapping[str, Pose] = field(default_factory=dict)  # one per named set of points
    stress: Floats | None = None  # (N,) [Pa] von Mises of the particles, where asked for
    health: Health = field(default_factory=Health)


@dataclass(frozen=True, kw_only=True)
class MeshPose:
    """A deformed mesh, world."""

    points: Floats  # (V, 3) [m]
    velocities: Floats  # (V, 3) [m/s of playback]
    normals: Floats | None = None  # (K, 3) unit


@dataclass(frozen=True, kw_only=True)
class GaussianPose:
    """Deformed Gaussians, world."""

    positions: Floats  # (N, 3) [m]
    velocities: Floats  # (N, 3) [m/s of playback]
    orientations: Floats  # (N, 4) unit, continuous in time
    scales: Floats  # (N, 3) [m] standard deviations
    F: Floats | None = None  # (N, 3, 3) deformation gradient, where asked for
    stress: Floats | None = None  # (N,) [Pa] von Mises, where asked for


@dataclass(frozen=True, kw_only=True)
class BakedFrame:
    """What the cache writer receives, one at a time."""

    index: int
    time_code: float
    meshes: Mapping[str, MeshPose]  # by Surface.path
    gaussians: GaussianPose
    health: Health
    splats: Mapping[str, SplatPose] = field(default_factory=dict)  # by Surface.path


@dataclass(frozen=True, kw_only=True)
class BakeInfo:
    """What a bake says of itself in its layers and its report."""

    look: str  # variant name, e.g. "rubber"
    materials: tuple[Material, ...]
    settings: Settings
    command: str
    version: str
    input_hash: str  # sha256 of the source file
