"""`gf_usd.Scene`: bodies, obstacles and pins from arrays, without a file."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gf_usd.core.asset import Surface
from gf_usd.core.errors import UsageError, counted
from gf_usd.core.materials.dimensionless import G0
from gf_usd.core.materials.presets import find_preset
from gf_usd.core.mesh.triangulation import triangulate
from gf_usd.core.stage import Collider, PhysicsMaterialSpec, Region, Triple
from gf_usd.core.units import STRONGEST
from gf_usd.prepare.options import values
from gf_usd.prepare.options.fields import upward_note
from gf_usd.prepare.options.texts import FASTEST

if TYPE_CHECKING:
    from gf_usd.core.materials.material import Material
    from gf_usd.pipeline.scene import SceneSpec

Array = NDArray[np.float64]
UP = {"Y": 1, "Z": 2}
THREE = "three numbers, such as (0, -9.81, 0)"
AXES = "three booleans, at least one of them True"

# Poses at the frames: (F, 4, 4) matrices, (F, V, 3) points, or a function of the time [s] that
# gives one of them.
Motion: TypeAlias = "ArrayLike | Callable[[float], ArrayLike]"


@dataclass(frozen=True, kw_only=True)
class _Moving:
    """Points of an obstacle or a pin, and how they move."""

    name: str
    points: Array
    triangles: NDArray[np.int64]
    motion: Any
    friction: float | None = None
    restitution: float | None = None
    axes: tuple[bool, bool, bool] = (True, True, True)


class Scene:
    """Soft bodies, obstacles and pins, built from arrays; `gf_usd.simulate` steps it.

    >>> scene = gf_usd.Scene(floor=0.0)
    >>> points = [[x, y, z] for x in (0, 1) for y in (1, 2) for z in (0, 1)]
    >>> faces = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    >>> scene.add_body(points, faces, material="jelly", velocity=(1.0, 0.0, 0.0))
    'body0'

    Everything is in SI and in one world frame; points are where they are at the start.

    Parameters
    ----------
    gravity : [m/s^2] downward, or a vector (3,).
    floor : height [m] of the floor; None: no floor.
    up : "Y" or "Z".
    """

    def __init__(
        self,
        *,
        gravity: float | values.Vector = G0,
        floor: float | None = None,
        up: Literal["Y", "Z"] = "Y",
    ) -> None:
        if not isinstance(up, str) or up not in UP:
            raise UsageError(f"up is {up!r}", "give 'Y' or 'Z'")
        self.up: str = up
        self.floor: float | None = None if floor is None else _finite("floor", floor)
        self._notes: tuple[str, ...] = ()
        vector: Any = gravity
        if values.is_number(gravity) or isinstance(gravity, str):
            number = values.real("gravity", gravity, f"{THREE}, or a number")
            self._notes = upward_note(number)
            vector = [0.0, 0.0, 0.0]
            vector[UP[up]] = -number
        self.gravity: Triple = _triple("gravity", vector, STRONGEST, "m/s^2")
        self._surfaces: list[Surface] = []
        self._materials: dict[str, str | Material] = {}
        self._velocities: dict[str, tuple[Triple, Triple]] = {}
        self._obstacles: list[_Moving] = []
        self._pins: list[_Moving] = []

    def __repr__(self) -> str:
        obstacles = tuple(one.name for one in self._obstacles)
        pins = tuple(one.name for one in self._pins)
        return f"Scene(bodies={self.bodies}, obstacles={obstacles}, pins={pins})"

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names of the bodies, in the order in which they were added."""
        return tuple(surface.path[1:] for surface in self._surfaces)

    def add_body(
        self,
        points: Any,
        faces: Any = None,
        *,
        material: str | Material = "rubber",
        name: str | None = None,
        velocity: values.Vector = (0.0, 0.0, 0.0),
        spin: values.Vector = (0.0, 0.0, 0.0),
    ) -> str:
        """Add a soft body, and return its name.

        Parameters
        ----------
        points : (V, 3) [m] of its closed surface, or a mesh of trimesh.
        faces : (T, 3) or (P, 4) indices of points, counter-clockwise seen from outside, or a list
            of polygons; None where points is a mesh.
        material : a preset, or a `gf_usd.Material`.
        name : letters, digits and _; None: body0, body1 and so on.
        velocity : [m/s] at the start; spin : [rad/s] about its middle, at the start.

        Raises UsageError if the arrays are not a mesh or the name is taken.
        """
        name = self._name(name, "body")
        points, counts, indices = _mesh(f"body {name}", points, faces)
        triangles, corners, _ = triangulate(points, counts, indices)
        if isinstance(material, str):
            made: str | Material = find_preset(material).name
        else:
            from gf_usd.core.materials.material import Material

            if not isinstance(material, Material):
                raise values.refuse("material", material, "a preset, or a gf_usd.Material")
            made = values.checked_material(material)
        path = f"/{name}"
        self._velocities[path] = (
            _triple("velocity", velocity, FASTEST, "m/s"),
            _triple("spin", spin, FASTEST, "rad/s"),
        )
        self._materials[path] = made
        self._surfaces.append(
            Surface(
                path=path, type_name="Mesh", points=points, face_counts=counts,
                face_indices=indices, triangles=triangles, triangle_corners=corners,
            )
        )  # fmt: skip
        return name

    def add_obstacle(
        self,
        points: Any,
        faces: Any = None,
        *,
        motion: Motion | None = None,
        friction: float | None = None,
        restitution: float | None = None,
        name: str | None = None,
    ) -> str:
        """Add a rigid or deforming obstacle that bodies collide with, and return its name.

        Parameters
        ----------
        points, faces : as of `add_body`; where it is at the start, or what `motion` moves.
        motion : (F, 4, 4) matrices, one per frame, with x = M[:3, :3] X + M[:3, 3]; or (F, V, 3)
            points; or a function of the time [s] that returns one of them.  None: it does not
            move.
        friction, restitution : instead of those of the bodies.

        Raises UsageError if the arrays are not a mesh or the name is taken.
        """
        name = self._name(name, "obstacle")
        points, counts, indices = _mesh(f"obstacle {name}", points, faces)
        for key, value, most in (("friction", friction, 100.0), ("restitution", restitution, 1.0)):
            if value is not None and not 0.0 <= values.real(key, value) <= most:
                raise UsageError(f"{key} is {value:g}", f"give a number from 0 to {most:g}")
        self._obstacles.append(
            _Moving(
                name=name, points=points, triangles=triangulate(points, counts, indices)[0],
                motion=motion, friction=friction, restitution=restitution,
            )
        )  # fmt: skip
        return name

    def pin(
        self,
        low: values.Vector,
        high: values.Vector,
        *,
        motion: Motion | None = None,
        axes: tuple[bool, bool, bool] = (True, True, True),
        name: str | None = None,
    ) -> str:
        """Fix or move the part of the bodies inside a box, and return the name of the pin.

        Parameters
        ----------
        low, high : (3,) [m] two opposite corners of the box at the start.
        motion : of the box, as for `add_obstacle`; None: it is fixed in place.
        axes : world axes along which it is pinned; it slides along the others.

        Raises UsageError if the box has no volume or the name is taken.
        """
        from gf_usd.geometry.regions import BOX_CORNERS, BOX_TRIANGLES

        name = self._name(name, "pin")
        one, other = np.array(_triple("low", low)), np.array(_triple("high", high))
        least, most = np.minimum(one, other), np.maximum(one, other)
        if (most - least).min() <= 0.0:
            raise UsageError(
                f"the pin {name} has no volume: its sides are {(most - least).tolist()}",
                "give two opposite corners that differ along every axis",
            )
        held = values.items("axes", axes, AXES)
        plain = all(isinstance(one, (bool, np.bool_, int, np.integer)) for one in held)
        if len(held) != 3 or not plain or not set(held) <= {0, 1} or not any(held):
            raise values.refuse("axes", axes, AXES)
        self._pins.append(
            _Moving(
                name=name, points=least + (most - least) * BOX_CORNERS, triangles=BOX_TRIANGLES,
                motion=motion, axes=(bool(held[0]), bool(held[1]), bool(held[2])),
            )
        )  # fmt: skip
        return name

    def _name(self, name: str | None, kind: str) -> str:
        taken = {*self.bodies, *(one.name for one in (*self._obstacles, *self._pins))}
        if name is None:
            return next(n for n in (f"{kind}{k}" for k in range(len(taken) + 1)) if n not in taken)
        if not isinstance(name, str) or not name.isidentifier():
            raise UsageError(f"name is {name!r}", "give letters, digits and _")
        if name in taken:
            raise UsageError(f"the scene already has a {name}", "give it another name")
        return name


def at_frames(scene: Scene, times: Sequence[float], options: dict[str, Any]) -> SceneSpec:
    """A scene with its motions at the times [s] of the frames; options : fields of `Request`."""
    from gf_usd.pipeline.scene import SceneSpec

    return SceneSpec(
        surfaces=tuple(scene._surfaces),
        materials=dict(scene._materials),
        velocities=dict(scene._velocities),
        colliders=tuple(_collider(one, times) for one in scene._obstacles),
        pins=tuple((_region(one, times), one.axes) for one in scene._pins),
        gravity=scene.gravity,
        floor=scene.floor,
        up_axis=scene.up,
        options=options,
    )


def _finite(name: str, value: Any) -> float:
    number = values.real(name, value)
    if not np.isfinite(number):
        raise UsageError(f"{name} is {number}", "give a finite number")
    return number


def _triple(name: str, value: Any, most: float = math.inf, unit: str = "m") -> Triple:
    """Three finite numbers of at most `most` [unit]."""
    parts = values.triple(name, value, THREE)
    x, y, z = (float(part) for part in parts.split(","))
    if not np.isfinite([x, y, z]).all():
        raise UsageError(f"{name} is ({x}, {y}, {z})", "give finite numbers")
    if max(map(abs, (x, y, z))) > most:
        raise UsageError(f"{name} is ({x:g}, {y:g}, {z:g}) {unit}", f"give at most {most:g} {unit}")
    return x, y, z


def _no_mesh(what: str, points: Any) -> UsageError:
    """The error for points without faces that are no mesh."""
    if isinstance(points, (str, Path)):
        name = str(points)
        return values.refuse(f"{what}: points", name, f"a mesh: trimesh.load_mesh({name!r})")
    if hasattr(points, "geometry") and hasattr(points, "to_mesh"):
        return UsageError(f"{what}: points is a Scene of trimesh", "give one mesh: scene.to_mesh()")
    return UsageError(f"{what} has points but no faces", "give both, or a mesh of trimesh: (mesh)")


def _mesh(what: str, points: Any, faces: Any) -> tuple[Array, NDArray[np.int64], NDArray[np.int64]]:
    """(V, 3) points, (P,) counts and (C,) indices.  Raises UsageError for an invalid mesh."""
    if faces is None:
        if not (hasattr(points, "vertices") and hasattr(points, "faces")):
            raise _no_mesh(what, points)
        points, faces = points.vertices, points.faces
    if np.iscomplexobj(points):
        raise values.refuse(f"{what}: points", points, "real numbers")
    try:
        xyz = np.array(points, np.float64)
    except (TypeError, ValueError):
        xyz = np.zeros(0)
    if xyz.shape[1:] != (3,) or len(xyz) < 4:
        raise UsageError(
            f"{what}: points is an array of shape {xyz.shape}", "give (V, 3) numbers, V at least 4"
        )
    if not np.isfinite(xyz).all():
        lost = int((~np.isfinite(xyz)).any(axis=1).sum())
        raise UsageError(f"{what}: {lost} of {len(xyz)} points are not finite", "repair them")
    rings = [_ring(what, ring) for ring in values.items(what, faces, "a list of faces")]
    counts = np.array([len(ring) for ring in rings], np.int64)
    fewest = min(map(len, rings), default=0)
    if fewest < 3:
        raise UsageError(
            f"{what} has {counted(len(counts), 'face')}, the smallest with {fewest} corners",
            "give faces with at least three corners",
        )
    indices = np.concatenate(rings)
    if indices.min() < 0 or indices.max() >= len(xyz):
        wrong = indices[(indices < 0) | (indices >= len(xyz))][0]
        raise UsageError(
            f"{what}: a face refers to point {wrong}, but there are {len(xyz)}",
            f"number the points from 0 to {len(xyz) - 1}",
        )
    return xyz, counts, indices


def _ring(what: str, ring: Any) -> NDArray[np.int64]:
    if isinstance(ring, Iterable):
        found = np.asarray(list(ring))
        if found.ndim == 1 and np.issubdtype(found.dtype, np.integer):
            return found.astype(np.int64)
    raise UsageError(f"{what}: a face is {ring!r}", "give integers, one per corner")


def _poses(one: _Moving, times: Sequence[float]) -> Array | None:
    """(F, 4, 4) or (F, V, 3) at the times; None where it stays."""
    if one.motion is None:
        return None
    if callable(one.motion):
        found: Any = [one.motion(time) for time in times]
    else:
        found = one.motion
    try:
        poses = np.array(found, np.float64)
    except (TypeError, ValueError):
        poses = np.zeros(0)
    if poses.shape[1:] not in ((4, 4), one.points.shape):
        raise UsageError(
            f"{one.name}: its motion is an array of shape {poses.shape}",
            f"give (F, 4, 4) matrices or (F, {len(one.points)}, 3) points, one per frame, or a "
            f"function of the time that returns one of them",
        )
    if len(poses) < len(times):
        has = counted(len(poses), "frame")
        raise UsageError(
            f"{one.name}: its motion has {has}, but {len(times)} are simulated",
            "give one for each simulated frame",
        )
    if not np.isfinite(poses).all():
        raise UsageError(f"{one.name}: its motion is not finite", "repair it")
    if poses.shape[1:] == (4, 4):
        wrong = np.flatnonzero((poses[:, 3] != (0.0, 0.0, 0.0, 1.0)).any(axis=1))
        if len(wrong):
            row = ", ".join(f"{value:g}" for value in poses[wrong[0], 3])
            raise UsageError(
                f"{one.name}: the last row of its matrix {wrong[0]} is ({row}), not (0, 0, 0, 1)",
                "give matrices that act on columns, x = M[:3, :3] X + M[:3, 3]: those of USD are"
                " transposed",
            )
    return poses[: len(times)]


def _collider(one: _Moving, times: Sequence[float]) -> Collider:
    poses = _poses(one, times)
    points, deformed = one.points, None
    linear, offset = np.eye(3)[None], np.zeros((1, 3))
    if poses is not None and poses.shape[1:] == (4, 4):
        linear, offset = poses[:, :3, :3], poses[:, :3, 3]
    elif poses is not None:
        deformed = poses
    return Collider(
        path=f"/{one.name}", shape="mesh", points=points, triangles=one.triangles, linear=linear,
        offset=offset, deformed=deformed,
        spec=PhysicsMaterialSpec(dynamic_friction=one.friction, restitution=one.restitution),
    )  # fmt: skip


def _region(one: _Moving, times: Sequence[float]) -> Region:
    poses = _poses(one, times)
    if poses is None:
        path = one.points[None]
    elif poses.shape[1:] == (4, 4):
        path = one.points @ poses[:, :3, :3].swapaxes(1, 2) + poses[:, None, :3, 3]
    else:
        path = poses
    return Region(
        name=one.name, kind="volume", points=one.points, triangles=one.triangles, path=path
    )
