"""A frame of a simulation: poses, health, and what is written of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.frames.settings import Settings
from gf_usd.core.materials.material import Material

if TYPE_CHECKING:
    from gf_usd.core.asset import SplatPose


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
    # files of obstacles, which the layers do not contain, and sha256 of each
    colliders: Mapping[Path, str] = field(default_factory=dict)
