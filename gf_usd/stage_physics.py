"""What a stage says of physics and of its own bake: gravity, obstacles, bodies, settings.

SI, world frame of the source, row per point: as in `gf_usd.model`.  A prim path names where a
value comes from; None: the stage says nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from gf_usd.model import Floats, Ints, Material
from gf_usd.vocabulary import MaterialWords

Triple = tuple[float, float, float]

RIGID = 1e-5  # how far a motion may stretch space and still count as rigid: float32 matrices


@dataclass(frozen=True, kw_only=True)
class Collider:
    """An obstacle that the bodies meet: posed at rest, and where it is at each frame.

    At frame f a point x of the rest pose is at ``linear[f] @ x + offset[f]``, unless `deformed`
    gives the points outright.
    """

    path: str  # prim path
    shape: str  # "mesh", or "plane": the half space behind its two triangles, without end
    points: Floats  # (V, 3) [m] at rest
    triangles: Ints  # (T, 3) into points, counter-clockwise seen from outside
    linear: Floats  # (F, 3, 3); F = 1: it stays where it is at rest
    offset: Floats  # (F, 3) [m]
    deformed: Floats | None = None  # (F, V, 3) [m] at each frame, of points that move by themselves
    words: MaterialWords = field(default_factory=MaterialWords)  # friction, restitution
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
    words: MaterialWords
    material: Material | None  # None: says nothing of elasticity

    def resolve(self, base: Material, density: float | None = None) -> Material:
        """The material of these faces; arguments as in `BodyPhysics.resolve`."""
        made = self.material or self.words.over(base)
        return made if density is None else replace(made, density=density)


@dataclass(frozen=True, kw_only=True)
class BodyPhysics:
    """What the stage says of one surface that is baked."""

    path: str  # Surface.path
    role: str = ""  # "" | static | kinematic | dynamic, as in UsdPhysics
    owner: str = ""  # the rigid or deformable body prim that it belongs to; empty: none
    collides: bool = True  # False: its own collision is switched off
    mass: float | None = None  # [kg] of all baked surfaces with the same mass_of together
    mass_of: str = ""  # the prim that states the mass
    density: float | None = None  # [kg/m^3] of PhysicsMassAPI: goes before the material's
    velocity: Triple | None = None  # [m/s] of the center of mass
    angular_velocity: Triple | None = None  # [rad/s]
    center: Triple | None = None  # [m] of mass, as authored; None: that of the volume
    moving: Floats | None = None  # (V, 3) [m/s of playback] of the animation that ends at rest
    words: MaterialWords = field(default_factory=MaterialWords)  # of the bound physics material
    material: Material | None = None  # None: nothing is said of elasticity
    subsets: tuple[SubsetMaterial, ...] = ()

    def resolve(self, base: Material) -> Material:
        """The body's material: what is stated, and the rest from `base`.

        An elastic material of the stage stands alone (`material`); of one that is not, density,
        friction and restitution go over those of `base`.  The mass is not in it.
        """
        made = self.material or self.words.over(base)
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
    colliders: tuple[Collider, ...] = ()
    bodies: tuple[BodyPhysics, ...] = ()  # one for each baked surface, in their order
    ignored: tuple[tuple[str, str], ...] = ()  # (body, body or collider): they pass through
    notes: tuple[str, ...] = ()  # what was assumed or left alone, in words


@dataclass(frozen=True, kw_only=True)
class PrimBake:
    """The bake settings that hold for one prim: its own or those of the nearest prim above."""

    path: str
    enabled: bool | None = None
    material: str | None = None  # name of a preset
    spacing: float | None = None  # [m]; never beside particles
    particles: int | None = None  # of all prims with the same particles_of together
    particles_of: str = ""  # the prim that states it
    seed: int | None = None
    solver: str | None = None  # tl | ul, as in Settings
    role: str = ""  # "" | static | kinematic | dynamic, as in UsdPhysics

    @property
    def obstacle(self) -> bool:
        """UsdPhysics has it as a collider that no force moves, and no bake is asked for here."""
        return self.role in ("static", "kinematic") and not self.enabled
