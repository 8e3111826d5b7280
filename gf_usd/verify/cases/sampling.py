"""Particles as quadrature points: moments of the solid, equal bodies and mirror images."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import trimesh

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import Surface
from gf_usd.core.materials.dimensionless import FILTER_RATE, G0, time_scale
from gf_usd.geometry.sampling.contact_samples import sample_surface
from gf_usd.geometry.sampling.particles import sample_solid
from gf_usd.physics.solvers import make_solver
from gf_usd.verify.bodies import make_solid, preset_material, settings, sphere
from gf_usd.verify.case import AT_LEAST, Case, Measure

LENGTH, WIDTH = 1.0, 0.2  # [m] of the bar
ROUNDING = 1e-12
TRAVEL = 1e-3  # [r]


def surface_from_mesh(mesh: trimesh.Trimesh, path: str) -> Surface:
    """A mesh of triangles as a surface."""
    triangles = np.asarray(mesh.faces)
    return replace(
        sphere(), path=path, points=np.asarray(mesh.vertices, float), triangles=triangles,
        face_counts=np.full(len(triangles), 3), face_indices=triangles.ravel(),
        triangle_corners=np.arange(triangles.size).reshape(-1, 3),
    )  # fmt: skip


def slanted_bar() -> Surface:
    """A bar that lies across the grid."""
    mesh = trimesh.creation.box((LENGTH, WIDTH, WIDTH))
    mesh.apply_transform(trimesh.transformations.euler_matrix(0.3, 0.5, 0.7))
    return surface_from_mesh(mesh, "/Bar")


def torus() -> Surface:
    """A ring of radius 1 m and thickness 0.6 m, off the origin."""
    mesh = trimesh.creation.torus(1.0, 0.3)
    mesh.vertices = np.asarray(mesh.vertices) + [0.37, -0.21, 0.11]
    return surface_from_mesh(mesh, "/Ring")


def mesh_moments(points: Floats, triangles: Ints) -> tuple[float, Floats, Floats]:
    """Volume, first (3,) and second moments (3, 3) of what closed triangles hold.

    By tetrahedra to the origin: V = det / 6, V sum p / 4, V (sum p p^T + sum p sum p^T) / 20.
    """
    p = points[triangles]
    V = np.einsum("ti,ti->t", p[:, 0], np.cross(p[:, 1], p[:, 2])) / 6.0
    total = p.sum(1)
    C = np.einsum("t,tki,tkj->ij", V, p, p) + np.einsum("t,ti,tj->ij", V, total, total)
    return float(V.sum()), V @ total / 4.0, C / 20.0


def quadrature(*counts: int) -> Callable[[str], Iterator[Measure]]:
    """Moments of particles next to those of the mesh, and masses of equal bodies."""

    def run(device: str) -> Iterator[Measure]:
        bound = max(ROUNDING, max(counts) * float(np.finfo(float).eps))
        why = (
            "cut cells are integrated exactly up to second moments: a sum over particles, each"
            f" rounded to 2e-16, or {ROUNDING:g}"
        )
        bodies = {"ball": sphere(), "bar": slanted_bar(), "torus": torus()}
        for name, surface in bodies.items():
            solid = make_solid(surface)
            volume, center, second = mesh_moments(*solid.outward(0))
            size = float(np.linalg.norm(solid.high - solid.low))
            worst = np.zeros(3)
            for count in counts:
                body = sample_solid(solid, particles=count, spacing=None, seed=0)
                first, X = body.V0 @ body.X, body.X
                errors = (
                    abs(body.V0.sum() / volume - 1.0),
                    np.abs(first - center).max() / (volume * size),
                    np.abs(np.einsum("n,ni,nj->ij", body.V0, X, X) - second).max()
                    / (volume * size**2),
                )
                worst = np.maximum(worst, errors)
            for what, value in zip(("volume", "center", "inertia"), worst):
                yield Measure(
                    name=f"{name}.{what}", value=float(value), target=0.0, bound=bound, why=why
                )
        balls = [
            replace(sphere(), path=f"/B{k}", points=sphere().points + [2.37 * k, 0.61 * k, 0.0])
            for k in range(3)
        ]
        body = sample_solid(
            make_solid(*balls), particles=3 * 800, spacing=None, seed=0, bodies=np.arange(3)
        )
        mass = np.bincount(np.asarray(body.body), body.V0)
        yield Measure(
            name="equal-balls", value=float(np.ptp(mass) / mass.mean()), target=0.0,
            bound=ROUNDING,
            why="three balls of 800 particles, each on a grid of its own: the same particles",
        )  # fmt: skip

    return run


def pear() -> Surface:
    """A ball that is bent and drawn out so that x = 0 is its only mirror plane."""
    surface = sphere()
    x, y, z = surface.points.T
    points = np.stack([x * (1.0 - 0.25 * y), 1.2 * y, z + 0.3 * y * y - 0.2 * y], 1)
    return replace(surface, path="/Pear", points=points)


def sideways(count: int) -> Callable[[str], Iterator[Measure]]:
    """A body with one mirror plane falls and rebounds: where it goes across the plane."""

    def run(device: str) -> Iterator[Measure]:
        solid = make_solid(pear())
        body = sample_solid(solid, particles=count, spacing=None, seed=0)
        T, lowest = time_scale(body.radius), float(solid.low[1])
        s = settings(
            device, frames=96, fps=19.1 / T, gravity=(0.0, -G0, 0.0), floor=0.0,
            filter_rate=FILTER_RATE / T, lift=(0.0, 3.0 * body.radius - lowest, 0.0),
        )  # fmt: skip
        solver = make_solver(
            s, body, [preset_material("rubber", body)], samples=sample_surface(solid, body.spacing),
            embedded={"skin": solid.surfaces[0].points},
        )  # fmt: skip
        centers = np.array([frame.health.center for frame in solver.frames()])
        across, along = np.ptp(centers[:, [0, 2]], axis=0) / body.radius
        why = (
            "a mirror image has the same motion: the travel is float32 rounding, 6e-8, grown by the"
            " impact"
        )
        yield Measure(
            name="across", value=float(across), target=0.0, bound=TRAVEL, unit="r", why=why
        )
        yield Measure(
            name="along", value=float(along), target=10.0 * TRAVEL, bound=0.0, kind=AT_LEAST,
            unit="r", why="along its plane the body is not symmetric, so that it must move",
        )  # fmt: skip

    return run


CASES = (
    Case(
        name="quadrature",
        what="Volume, center and second moments of the particles of a ball, a slanted bar and a"
        " ring must be those of their meshes, and equal balls must have equal masses.",
        source="moments of a polyhedron, in closed form",
        quick=quadrature(300, 2000),
        full=quadrature(300, 2000, 20000, 200000),
    ),
    Case(
        name="symmetry",
        what="A body with one mirror plane falls on the floor and rebounds.  Its center must not"
        " leave the plane.",
        source="symmetry",
        quick=sideways(1000),
        full=sideways(8000),
    ),
)
