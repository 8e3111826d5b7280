"""The physics and bake settings of a stage: gravity, obstacles, bodies, materials, pins.

SI, world frame of the source, row per point: as in `gf_usd.core.frames`.  A prim path names the
source of a value; None: the stage does not state it.

Bodies may collide with the floor, with obstacles, with each other and with themselves.  Regions are
parts of the body at rest; pins are regions with prescribed motion.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.materials.laws import flowing_law
from gf_usd.core.materials.material import Material

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

Triple = tuple[float, float, float]

RIGID = 1e-5  # strain up to which a motion counts as rigid: float32 matrices


WATER = 1000.0  # [kg/m^3] the default density of UsdPhysics
DEFAULT_LAW = "neoHookean"
FRICTION, RESTITUTION = 0.8, 0.85  # of an elastic material without them


@dataclass(frozen=True, kw_only=True)
class PhysicsMaterialSpec:
    """The values that a physics material states; None: not stated."""

    path: str = ""  # of the Material prim; empty where none is bound
    density: float | None = None  # [kg/m^3]
    youngs_modulus: float | None = None  # [Pa]
    poissons_ratio: float | None = None  # None also where no Young's modulus is stated
    static_friction: float | None = None  # Coulomb
    dynamic_friction: float | None = None  # Coulomb
    restitution: float | None = None
    law: str | None = None
    damping_time: float | None = None  # Kelvin-Voigt tau [s]
    parameters: Mapping[str, float] = field(default_factory=dict)  # of laws, by name, in SI
    density_attribute: str = field(default="", compare=False)  # that states the density

    @property
    def elastic(self) -> bool:
        """Whether its stiffness is stated."""
        return self.youngs_modulus is not None

    @property
    def friction(self) -> float | None:
        """The dynamic friction; where only the static one is stated, that."""
        return self.static_friction if self.dynamic_friction is None else self.dynamic_friction

    def whole(self, density: float = WATER) -> Material | None:
        """The material, None where it is not elastic; density [kg/m^3]: where none is stated."""
        if self.youngs_modulus is None or self.poissons_ratio is None:
            return None
        return Material(
            name=self.path.rpartition("/")[2],
            law=self.law or flowing_law(self.parameters, DEFAULT_LAW),
            density=_or(self.density, density),
            youngs_modulus=self.youngs_modulus,
            poissons_ratio=self.poissons_ratio,
            damping_time=_or(self.damping_time, 0.0),
            friction=_or(self.friction, FRICTION),
            restitution=_or(self.restitution, RESTITUTION),
            parameters=self.parameters,
        )

    def over(self, base: Material) -> Material:
        """`base` with the stated values; if it is elastic, the whole material."""
        return self.whole(base.density) or Material(
            name=base.name,
            law=self.law or flowing_law(self.parameters, base.law),
            density=_or(self.density, base.density),
            youngs_modulus=base.youngs_modulus,
            poissons_ratio=base.poissons_ratio,
            damping_time=_or(self.damping_time, base.damping_time),
            friction=_or(self.friction, base.friction),
            restitution=_or(self.restitution, base.restitution),
            parameters={**base.parameters, **self.parameters},
        )


@dataclass(frozen=True, kw_only=True)
class Collider:
    """An obstacle that the bodies collide with: its rest pose, and its motion.

    At frame f a point x of the rest pose is at ``linear[f] @ x + offset[f]``, unless `deformed`
    gives the points outright.
    """

    path: str  # prim path
    shape: str  # "mesh", or "plane": the infinite half space behind its two triangles
    points: Floats  # (V, 3) [m] at rest
    triangles: Ints  # (T, 3) into points, counter-clockwise seen from outside
    linear: Floats  # (F, 3, 3); F = 1: it stays where it is at rest
    offset: Floats  # (F, 3) [m]
    deformed: Floats | None = None  # (F, V, 3) [m] at each frame, of points that move by themselves
    spec: PhysicsMaterialSpec = field(default_factory=PhysicsMaterialSpec)  # friction, restitution
    approximation: str = "none"  # of UsdPhysics, as authored
    role: str = "static"  # static | kinematic | dynamic: what UsdPhysics would do with it

    @property
    def frames(self) -> int:
        """F: number of frames; 1: it stays."""
        return len(self.linear if self.deformed is None else self.deformed)

    @property
    def moves(self) -> bool:
        """Whether any frame differs from another."""
        return self.frames > 1

    @property
    def still_from(self) -> int:
        """Frame from which on it stays where it is."""
        if self.deformed is not None:
            return self.frames - 1
        moves = (self.linear != self.linear[-1]).any((1, 2)) | (self.offset != self.offset[-1]).any(
            1
        )
        return int(np.flatnonzero(moves)[-1]) + 1 if moves.any() else 0

    @property
    def rigid(self) -> bool:
        """Whether all distances in it stay as at rest, so that one distance field does."""
        if self.deformed is not None:
            return False
        gram = np.swapaxes(self.linear, 1, 2) @ self.linear
        return bool(
            np.abs(gram - np.eye(3)).max() <= RIGID and np.linalg.det(self.linear).min() > 0
        )

    def positions(self, frame: int) -> NDArray[np.float64]:
        """Points (V, 3) [m] at a frame; one that stays has every frame."""
        k = min(frame, self.frames - 1) if self.frames == 1 else frame
        if self.deformed is not None:
            return np.asarray(self.deformed[k], np.float64)
        return self.points @ self.linear[k].T + self.offset[k]


@dataclass(frozen=True, kw_only=True)
class SubsetMaterial:
    """The physics material of some faces of a body."""

    path: str  # of the GeomSubset
    faces: Ints  # (n,) sorted, into Surface.face_counts
    spec: PhysicsMaterialSpec
    material: Material | None  # None: no elasticity is stated

    def resolve(self, base: Material, density: float | None = None) -> Material:
        """The material of these faces; arguments as in `BodyPhysics.resolve`."""
        made = self.material or self.spec.over(base)
        return made if density is None else replace(made, density=density)


@dataclass(frozen=True, kw_only=True)
class BodyPhysics:
    """What the stage states about a surface that is baked."""

    path: str  # Surface.path
    role: str = ""  # "" | static | kinematic | dynamic, as in UsdPhysics
    owner: str = ""  # the rigid or deformable body prim that it belongs to; empty: none
    collider: bool = field(default=False, compare=False)  # it is an enabled collider itself
    collides: bool = True  # False: its own collision is disabled
    mass: float | None = None  # [kg] of all baked surfaces with the same mass_of together
    mass_of: str = ""  # the prim that states the mass
    mass_attribute: str = field(default="", compare=False)  # of that prim
    density: float | None = None  # [kg/m^3] of PhysicsMassAPI: goes before the material's
    density_of: str = ""  # the prim that states that density, by physics:density
    velocity: Triple | None = None  # [m/s] of the center of mass
    angular_velocity: Triple | None = None  # [rad/s]
    center: Triple | None = None  # [m] of mass, as authored; None: that of the volume
    moving: Floats | None = None  # (V, 3) [m/s of playback] of the animation that ends at rest
    carried: bool = False  # an animated transform, its own or one above, moves it after that
    spec: PhysicsMaterialSpec = field(
        default_factory=PhysicsMaterialSpec
    )  # of the bound physics material
    material: Material | None = None  # None: no elasticity is stated
    subsets: tuple[SubsetMaterial, ...] = ()

    def resolve(self, base: Material) -> Material:
        """The body's material: the stated values, and the others from `base`.

        An elastic material of the stage is used as a whole (`material`); of any other, density,
        friction and restitution replace those of `base`. The mass is not considered.
        """
        made = self.material or self.spec.over(base)
        return made if self.density is None else replace(made, density=self.density)

    def initial_velocities(self, points: Floats, center: Floats) -> NDArray[np.float64] | None:
        """(n, 3) [m/s] of points (n, 3) [m] by the rigid velocities; None where none are stated.

        center : (3,) [m] of mass, taken where the stage gives none.
        """
        if self.velocity is None and self.angular_velocity is None:
            return None
        arm = np.asarray(points) - np.asarray(center if self.center is None else self.center)
        turning = np.cross(np.asarray(self.angular_velocity or (0.0, 0.0, 0.0)), arm)
        return turning + np.asarray(self.velocity or (0.0, 0.0, 0.0))


@dataclass(frozen=True, kw_only=True)
class StagePhysics:
    """All of UsdPhysics that concerns a bake."""

    gravity: Triple | None = None  # [m/s^2] world; None: there is no scene
    scene: str = ""  # path of the PhysicsScene that gave it
    attachments: tuple[str, ...] = ()  # paths of those that pin points of the bodies
    soft_attachments: tuple[str, ...] = ()  # paths of those that draw points by springs
    fields: tuple[str, ...] = ()  # of the scene, as texts of --field
    gravity_keys: tuple[tuple[float, Triple], ...] = ()  # time codes, where it changes
    colliders: tuple[Collider, ...] = ()
    of_files: tuple[Collider, ...] = ()  # obstacles of other files, which are no part of the stage
    bodies: tuple[BodyPhysics, ...] = ()  # one for each baked surface, in their order
    ignored: tuple[tuple[str, str], ...] = ()  # (body, body or collider): they pass through
    notes: tuple[str, ...] = ()  # assumptions and omissions, as text

    @property
    def obstacles(self) -> tuple[Collider, ...]:
        """What bodies collide with, other than each other and the floor."""
        return (*self.colliders, *self.of_files)


@dataclass(frozen=True, kw_only=True)
class PrimBake:
    """The bake settings of a prim: its own, or those of its nearest ancestor."""

    path: str
    enabled: bool | None = None
    material: str | None = None  # name of a preset
    spacing: float | None = None  # [m]; never next to particles
    particles: int | None = None  # of all prims with the same particles_of together
    particles_of: str = ""  # the prim that states it
    seed: int | None = None
    solver: str | None = None  # tl | ul, as in Settings
    role: str = ""  # "" | static | kinematic | dynamic, as in UsdPhysics

    @property
    def obstacle(self) -> bool:
        """Whether it is a collider in UsdPhysics that no force moves, and is not to be baked."""
        return self.role in ("static", "kinematic") and not self.enabled


@dataclass(frozen=True, kw_only=True)
class Subject:
    """The names and labels of a surface to bake."""

    path: str  # prim path
    looks: tuple[str, ...] = ()  # paths of the bound materials, that of most faces first
    labels: tuple[str, ...] = ()  # of UsdSemantics, on the prim itself
    labels_above: tuple[str, ...] = ()  # on the prims above it, nearest first


@dataclass(frozen=True, kw_only=True)
class Advice:
    """The material that an advisor suggests for a surface."""

    path: str  # prim path
    material: str  # name of a preset; of a material of the stage where `by` is "stage"
    confidence: float  # 0 to 1
    reason: str
    by: str = "names"  # names | stage | name of an advisor

    @property
    def chosen(self) -> str:
        """The material and why, without the prim, as a text for a person."""
        how = f"{self.confidence:.2f}" + ("" if self.by == "names" else f", by {self.by}")
        return f"{self.material} ({how}): {self.reason}"


@dataclass(frozen=True, kw_only=True)
class Skin:
    """The closed surface of a body that other bodies collide with."""

    points: Floats  # (V, 3) [m] at rest
    triangles: Ints  # (T, 3) into points, counter-clockwise seen from outside
    cell_copy: Ints | None = None  # (V,) into Particles.copies; None where that is
    path: str = ""  # prim path of the body's first mesh


@dataclass(frozen=True, kw_only=True)
class ContactSetup:
    """Which bodies and obstacles can collide."""

    skins: tuple[Skin, ...]  # one a body
    colliders: tuple[Collider, ...] = ()
    through: frozenset[tuple[int, int]] = frozenset()  # (body, body) that pass through each other
    through_colliders: frozenset[tuple[int, int]] = frozenset()  # (body, collider)
    self_contact: frozenset[int] = frozenset()  # bodies with self-contact
    flows: bool = False  # whether bodies touch flowing bodies
    # There is no contact between bodies before this frame: characters may overlap in their bind
    # poses.
    meet_from: int = 0

    def lowest(self, normal: Floats) -> float:
        """[m] of the lowest obstacle with an end along a normal (3,); inf where there is none."""
        ends = [c for c in self.colliders if c.shape != "plane"]
        return min((float((c.positions(0) @ normal).min()) for c in ends), default=float("inf"))

    def bottom(self, up: Floats) -> float | None:
        """[m] of the lowest point of the obstacles along a direction, over all frames.

        None where there is no obstacle, or one without an end.
        """
        if not self.colliders or any(one.shape == "plane" for one in self.colliders):
            return None
        return min(
            float((one.positions(f) @ up).min())
            for one in self.colliders
            for f in range(one.frames)
        )

    def pair_names(self, body: int, other: int) -> tuple[str, str]:
        """A body, and an obstacle or, with numbers after those, a body, by their prim paths."""
        mine, walls = self.skins[body].path, len(self.colliders)
        if other < walls:
            return f"<{mine}>", f"the obstacle <{self.colliders[other].path}>"
        theirs = "itself" if other - walls == body else f"<{self.skins[other - walls].path}>"
        return f"<{mine}>", theirs

    @property
    def any(self) -> bool:
        """Whether there can be contact."""
        several = len(self.skins) > 1
        return several or bool(self.colliders) or bool(self.self_contact) or self.flows


@dataclass(frozen=True, kw_only=True)
class Region:
    """A part of space bounded by triangles, and the motion of its points."""

    name: str  # as given
    kind: str  # "volume": what the triangles enclose; "patch": a part of a body's surface
    points: Floats  # (V, 3) [m] at rest, world
    triangles: Ints  # (T, 3) into points
    path: Floats  # (F, V, 3) [m] at each frame; F = 1: they stay
    body: str = ""  # of a patch: prim path of the mesh it is a part of


@dataclass(frozen=True, kw_only=True)
class Bone:
    """A joint's part of a skeleton: its position in the rest body, and its motion."""

    name: str  # path of the skeleton and joint, e.g. "/Hero/Skel:hips/spine"
    segments: Floats  # (s, 2, 3) [m] from the joint to where each segment ends, at rest, world
    free: tuple[bool, ...]  # (s,) whether a segment ends in flesh, and not at another joint
    anchors: Floats  # (4, 3) [m] at rest, world: corners of a tetrahedron that moves with the joint
    path: Floats  # (F, 4, 3) [m] where they are at each frame


@dataclass(frozen=True, kw_only=True)
class SampledSkin:
    """The skin of a character, sampled at points of its surface."""

    weights: csr_matrix  # (n, bones) rows sum to 1
    offsets: Sequence[Floats]  # (n, 3) [m] at each frame, in addition to the skinning


@dataclass(frozen=True, kw_only=True)
class Skeleton:
    """The bones of a character, and the skin that they pose."""

    bones: tuple[Bone, ...]
    # (V, bones) of each posed surface, by path; rows sum to 1
    weights: Mapping[str, csr_matrix] = field(default_factory=dict)
    samples: SampledSkin | None = None  # instead of the weights


@dataclass(frozen=True, kw_only=True)
class BlendShapes:
    """Blend shapes of a surface whose weights change in the animation.

    Its points are at X + sum_k w_k D_k of the rest shape, which has the weights of the first frame.
    """

    names: tuple[str, ...]
    offsets: csr_matrix  # (3 V, K) [m] D of the points, in the rest pose, world
    weights: Floats  # (F, K) w at each frame, less those of the first frame of the animation


@dataclass(frozen=True, kw_only=True)
class Pin:
    """A region with prescribed motion: fixed, or following the animation of the source.

    The anchors of the region are points whose positions are known at every frame; between them it
    moves by an affine fit.  If only some axes are held, its boundary is a symmetry plane: the body
    slides along it without friction, and the part behind it is its mirror image, without mass and
    stress.
    """

    name: str  # as requested, e.g. "/Duck/mesh:feet"
    inside: Callable[[Floats], Floats]  # X (n, 3) [m] at rest -> (n,) bool: held
    nearest: Callable[[Floats], Floats]  # X (n, 3) [m] -> (n, 3) on the boundary of the region
    anchors: Floats  # (k, 3) [m] at rest, world
    path: Floats  # (T, k, 3) [m] positions of the anchors at each frame; T = 1: fixed
    axes: tuple[bool, bool, bool] = (True, True, True)  # world axes that are held
    # Whether the body is pinned at the region's boundary.  If not, nodes inside it are pinned, and
    # the particles there are as elastic as any: a core in a solid.
    sharp: bool = True
    rigid: bool = False  # whether it moves as a rigid body by the forces on it, and not as given
    patch: bool = False  # part of a surface: where no node is inside, the nearest ones are pinned
    body: int | None = None  # the only body that it pins; None: any that is in the region
    bodies: frozenset[int] = frozenset()  # whose meshes the prim of the region is, or contains
    meshes: frozenset[str] = frozenset()  # prim paths of meshes all of whose points move with it

    def holds(self, X: Floats, body: Ints | None) -> NDArray[np.bool_]:
        """(n,) which points X (n, 3) [m] at rest it holds; body : (n,) of each, None: all are 0."""
        held = np.asarray(self.inside(X), bool)
        if self.body is None:
            return held
        return held & (self.body == (np.zeros(len(X), np.int64) if body is None else body))


@dataclass(frozen=True, kw_only=True)
class FleshLimits:
    """The limits of flesh: toward its bone, and away from the pose of its springs.

    carried : X (n, 3) [m] at rest -> (frame -> (n, 3) [m] positions by the motion of the bone
    alone, and (n, 3) unit directions from the bone to these).
    toward, away : X (n, 3) [m] at rest -> (n,) [m] from `carried` against that direction, and from
    the pose of the goals; inf: any distance.
    """

    carried: Callable[[Floats], Callable[[float], tuple[Floats, Floats]]]
    toward: Callable[[Floats], Floats]
    away: Callable[[Floats], Floats]


@dataclass(frozen=True, kw_only=True)
class AttachedPoints:
    """Points of bodies, each with its own spring and damper."""

    X: Floats  # (n, 3) [m] at rest, world
    path: Floats  # (F, n, 3) [m] targets of the springs at each frame; F = 1: fixed
    stiffness: Floats  # (n,) [N/m]
    damping: Floats  # (n,) [N s/m]
    body: Ints  # (n,) as in Particles
    cell_copy: Ints | None = None  # (n,) into Particles.copies; None where that is


@dataclass(frozen=True, kw_only=True)
class Goals:
    """Springs that pull a body to a pose: per mass, w^2 times the offset and 2 zeta w times its
    rate.

    pose : X (n, 3) [m] at rest -> (frame -> (n, 3) [m] where these points are to be).
    rate : X (n, 3) [m] at rest -> w (n,) [rad/s]; 0: free, inf: as good as keyframed.
    rates : the same over time, X -> (frame -> w); None: w stays.
    """

    pose: Callable[[Floats], Callable[[float], Floats]]
    rate: Callable[[Floats], Floats]
    rates: Callable[[Floats], Callable[[float], Floats]] | None = None
    damping: float = 0.5  # zeta, of the springs: 1 is critical
    moving: bool = True  # whether the pose changes
    limits: FleshLimits | None = None
    attached: AttachedPoints | None = None  # springs of single points, in addition
    # Bodies with their own pose, rates and limits, by number. All have limits, or none has.
    of_body: Mapping[int, Goals] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class StageSpec:
    """What the stage states; empty for an asset that is not a USD file."""

    bakes: dict[str, PrimBake] = field(default_factory=dict)  # by prim path of a surface
    physics: StagePhysics = field(default_factory=StagePhysics)
    advice: dict[str, Advice] = field(default_factory=dict)  # of --material auto, by prim path
    painted: dict[str, dict[str, Floats]] = field(default_factory=dict)  # see `read_painted`

    @property
    def bodies(self) -> dict[str, BodyPhysics]:
        """By prim path of a surface."""
        return {body.path: body for body in self.physics.bodies}

    @property
    def says_material(self) -> bool:
        """Whether any prim has a material of its own."""
        named = any(bake.material for bake in self.bakes.values())
        bound = any(
            body.material or any(subset.material for subset in body.subsets)
            for body in self.physics.bodies
        )
        return named or bound or bool(self.painted)


def _or(value: float | None, otherwise: float) -> float:
    return otherwise if value is None else value
