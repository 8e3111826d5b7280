"""Small solids, made of values instead of files, and changes that break them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from gf_usd.core.asset import Asset, StageFacts, Surface
from gf_usd.core.frames.frame import Pose
from gf_usd.core.frames.particles import Particles, SurfaceSamples
from gf_usd.core.frames.settings import Settings
from gf_usd.core.materials.dimensionless import DIMENSIONLESS
from gf_usd.core.materials.material import Material
from gf_usd.core.mesh.measures import signed_volume
from gf_usd.core.mesh.topology import weld
from gf_usd.core.units import StageUnits
from gf_usd.geometry.sampling.contact_samples import sample_surface
from gf_usd.geometry.sampling.particles import sample_solid
from gf_usd.geometry.solid import Solid, build_solid
from gf_usd.verify.bodies import tension_parameters

# Corners are numbered x + 2 y + 4 z; faces look outward.
CUBE_POINTS = np.array([[x, y, z] for z in (0.0, 1.0) for y in (0.0, 1.0) for x in (0.0, 1.0)])
CUBE_TRIANGLES = np.array(
    [
        [0, 2, 3], [0, 3, 1], [4, 5, 7], [4, 7, 6], [0, 1, 5], [0, 5, 4],
        [2, 6, 7], [2, 7, 3], [0, 4, 6], [0, 6, 2], [1, 3, 7], [1, 7, 5],
    ]
)  # fmt: skip


def facts(**changes: Any) -> StageFacts:
    """A stage in meters, Y up, that says nothing else."""
    values: dict[str, Any] = {
        "path": Path("asset.usda"),
        "units": StageUnits(),
        "up_axis": "Y",
        "time_codes_per_second": None,
        "start_time_code": None,
        "end_time_code": None,
        "root_prims": ("/Root",),
        "default_prim": "/Root",
    }
    return StageFacts(**{**values, **changes})


def surface(points: np.ndarray, triangles: np.ndarray, path: str = "/Body", **more: Any) -> Surface:
    """A mesh of triangles only."""
    triangles = np.asarray(triangles)
    return Surface(
        path=path,
        type_name="Mesh",
        points=np.asarray(points, float),
        face_counts=np.full(len(triangles), 3),
        face_indices=triangles.ravel(),
        triangles=triangles,
        triangle_corners=np.arange(triangles.size).reshape(-1, 3),
        **more,
    )


def cube(low: Any = (0.0, 0.0, 0.0), edge: Any = 1.0, **more: Any) -> Surface:
    """A box of twelve triangles; edge [m], one or three numbers."""
    return surface(np.asarray(low) + np.asarray(edge) * CUBE_POINTS, CUBE_TRIANGLES, **more)


def sphere(
    radius: float = 1.0, center: Any = (0.0, 0.0, 0.0), subdivisions: int = 3, **more: Any
) -> Surface:
    """A geodesic sphere whose vertices lie on the radius [m]."""
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return surface(np.asarray(center) + mesh.vertices, np.asarray(mesh.faces), **more)


def moebius(turned: Any = ()) -> Surface:
    """A band of 80 triangles with half a twist, without consistent winding; turned : of them, those
    whose winding is reversed."""
    n = 40
    t = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
    across = np.stack([np.cos(t / 2) * np.cos(t), np.cos(t / 2) * np.sin(t), np.sin(t / 2)], axis=1)
    middle = np.stack([np.cos(t), np.sin(t), 0.0 * t], axis=1)
    points = np.concatenate([middle - 0.2 * across, middle + 0.2 * across])
    faces = []
    for i in range(n):
        j = (i + 1) % n
        low, high = (j, j + n) if j else (n, 0)
        faces += [[i, low, high], [i, high, i + n]]
    triangles = np.array(faces)
    triangles[list(turned)] = triangles[list(turned), ::-1]
    return surface(points, triangles)


def needle(length: float, width: float, *, mirrored: bool = False, **more: Any) -> Surface:
    """A long thin tetrahedron along a diagonal of its box, from a corner; lengths in m."""
    points = length * np.array([[0.0] * 3, [1.0] * 3, [1.0] * 3, [1.0] * 3])
    points[1:] += width * np.diag([1.0, 1.0, 3.0])
    if mirrored:
        points[:, 0] = length - points[:, 0]
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    return surface(points, faces[:, ::-1] if mirrored else faces, **more)


def asset(*surfaces: Surface) -> Asset:
    """Surfaces as a reader would hand them over."""
    return Asset(facts=facts(), surfaces=surfaces)


def solid(*surfaces: Surface) -> Solid:
    """The solid that surfaces enclose."""
    return build_solid(asset(*surfaces))


def fill(body: Solid, particles: int, seed: int = 0) -> tuple[Particles, SurfaceSamples]:
    """About so many particles, and the contact samples that go with them."""
    made = sample_solid(body, particles=particles, spacing=None, seed=seed)
    return made, sample_surface(body, made.spacing)


def ball(particles: int, radius: float = 1.0, seed: int = 0) -> tuple[Particles, SurfaceSamples]:
    """A ball about the origin."""
    return fill(solid(sphere(radius)), particles, seed)


def preset_material(name: str, particles: Particles, **changes: Any) -> Material:
    """A preset on a body; changes replace fields of the material."""
    made = DIMENSIONLESS[name].material(particles.radius)
    own = {"parameters": {**made.parameters, **tension_parameters(changes.get("law", made.law))}}
    return Material(**{**made.__dict__, **own, **changes})


def settings(**changes: Any) -> Settings:
    """Free flight without gravity at 24 fps, threads as the machine has them."""
    values: dict[str, Any] = {
        "frames": 10,
        "fps": 24.0,
        "time_codes_per_second": 24.0,
        "start": 1.0,
        "gravity": (0.0, 0.0, 0.0),
        "up": (0.0, 1.0, 0.0),
        "floor": None,
    }
    return Settings(**{**values, **changes})


def without(body, rows):
    """A surface that lacks some of its triangles."""
    kept = np.delete(body.triangles, rows, axis=0)
    return surface(body.points, kept)


def turned(body, rows):
    """A surface with some triangles turned over."""
    triangles = body.triangles.copy()
    triangles[rows] = triangles[rows, ::-1]
    return surface(body.points, triangles)


def joined(*bodies):
    """Several surfaces as the shells of one."""
    first = np.cumsum([0, *(len(b.points) for b in bodies)])
    triangles = [b.triangles + o for b, o in zip(bodies, first)]
    return surface(np.concatenate([b.points for b in bodies]), np.concatenate(triangles))


def volume(body) -> float:
    """Signed volume of the welded triangles."""
    return signed_volume(body.points, weld(body.points)[0][body.triangles])


def around(body, vertex: int) -> np.ndarray:
    """Rows of the triangles about a vertex."""
    return np.flatnonzero((body.triangles == vertex).any(1))


def resting_pose(points: Any) -> Pose:
    """The pose of undeformed points (n, 3) [m] at rest."""
    n = len(points)
    return Pose(x=np.asarray(points, float), v=np.zeros((n, 3)), F=np.tile(np.eye(3), (n, 1, 1)))
