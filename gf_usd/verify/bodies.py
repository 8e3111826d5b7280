"""The bodies and settings of the cases.

Setting and reading the state of a solver from outside.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from gf_usd.core.arrays import Floats
from gf_usd.core.asset import Asset, StageFacts, Surface
from gf_usd.core.errors import SolverError
from gf_usd.core.frames import Particles, Settings, SurfaceSamples
from gf_usd.core.materials.dimensionless import DIMENSIONLESS
from gf_usd.core.materials.laws import LAWS
from gf_usd.core.materials.material import Material
from gf_usd.core.mesh import triangulate
from gf_usd.core.stage import Pin
from gf_usd.core.units import StageUnits
from gf_usd.geometry.sampling.contact_samples import sample_surface
from gf_usd.geometry.sampling.particles import sample_solid
from gf_usd.geometry.solid import Solid, build_solid
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.physics.total_lagrangian.state import StateView

FPS = 24.0
MIDDLE = np.array([0.25, 0.75])  # of a cell: where strata have their middles
GAUSS = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3.0)  # exact for cubics on a cell
FINE = 16  # points along the edge of a stratum, of which its share in a figure is counted


def sphere(radius: float = 1.0, subdivisions: int = 3) -> Surface:
    """A geodesic sphere about the origin, its vertices at the radius [m]."""
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    triangles = np.asarray(mesh.faces)
    return Surface(
        path="/Ball",
        type_name="Mesh",
        points=np.asarray(mesh.vertices),
        face_counts=np.full(len(triangles), 3),
        face_indices=triangles.ravel(),
        triangles=triangles,
        triangle_corners=np.arange(triangles.size).reshape(-1, 3),
    )


def comb(teeth: int, width: float, gap: float, length: float, root: float, depth: float) -> Surface:
    """Teeth side by side along x, which hang from a root at y = `length`; lengths [m].

    The first begins at x = 0, all end at y = 0, and z goes from 0 to `depth`.
    """
    step = width + gap
    tooth = np.array([[0.0, length], [0.0, 0.0], [width, 0.0], [width, length]])
    outline = np.concatenate([tooth + [k * step, 0.0] for k in range(teeth)])[1:-1]
    right, top = (teeth - 1) * step + width, length + root
    outline = np.concatenate([outline, [[right, top], [0.0, top]]])
    n = len(outline)
    points = np.concatenate([np.c_[outline, np.full(n, z)] for z in (depth, 0.0)])
    front, after = np.arange(n), np.roll(np.arange(n), -1)
    sides = np.stack([front + n, after + n, after, front], 1)
    counts = np.concatenate([[n, n], np.full(n, 4)])
    indices = np.concatenate([front, front[::-1] + n, sides.ravel()])
    triangles, corners, _ = triangulate(points, counts, indices)
    return Surface(
        path="/Comb",
        type_name="Mesh",
        points=points,
        face_counts=counts,
        face_indices=indices,
        triangles=triangles,
        triangle_corners=corners,
    )


def ball(
    particles: int,
    radius: float = 1.0,
    *,
    seed: int = 0,
    rejection: bool = False,
    subdivisions: int = 3,
) -> tuple[Particles, SurfaceSamples]:
    """About so many particles of production sampling in a ball, and its contact samples."""
    solid = solid_of(sphere(radius, subdivisions))
    made = sample_solid(solid, particles=particles, spacing=None, seed=seed, uniform=rejection)
    return made, sample_surface(solid, made.spacing)


def solid_of(*surfaces: Surface) -> Solid:
    """What surfaces in meters enclose."""
    path = surfaces[0].path
    facts = StageFacts(
        path=Path(path[1:]), units=StageUnits(), up_axis="Y", time_codes_per_second=None,
        start_time_code=None, end_time_code=None, root_prims=(path,), default_prim=path,
    )  # fmt: skip
    return build_solid(Asset(facts=facts, surfaces=surfaces))


def block(low: Any, cells: Any, h: float, *, places: Floats = GAUSS) -> Particles:
    """A box of whole cells of edge h [m], eight particles in each.

    places : (2,) of a cell along each axis; GAUSS is where a bake has them.
    """
    low, cells = np.asarray(low, float), np.asarray(cells)
    strata = np.stack(np.unravel_index(np.arange(8 * cells.prod()), tuple(2 * cells)), -1)
    at = strata // 2 + np.asarray(places)[strata % 2]
    return cloud(low + h * at, volume=float(cells.prod()) * h**3, lattice=0.5 * h, corner=low)


def strata(inside: Callable[[Floats, Floats], Any], counts: Any, h: float) -> tuple[Floats, Floats]:
    """Points (n, 2) [m] for the strata that a plane figure fills, and their areas (n,) [m^2].

    A stratum is a quarter of a cell of edge h [m]; `counts` cells stand along each axis from 0.  A
    full one has its Gauss point, one that the figure cuts the middle of what is inside.
    inside : of x and y [m].
    """
    a = 0.5 * h
    fine = (np.arange(FINE) + 0.5) / FINE * a
    places, share = [], []
    for i, j in np.ndindex(2 * counts[0], 2 * counts[1]):
        x, y = np.meshgrid(i * a + fine, j * a + fine, indexing="ij")
        here = inside(x, y)
        if here.all():
            places.append((h * (i // 2 + GAUSS[i % 2]), h * (j // 2 + GAUSS[j % 2])))
        elif here.any():
            places.append((x[here].mean(), y[here].mean()))
        share.extend([here.mean()] * bool(here.any()))
    return np.array(places), np.array(share) * a * a


def slice_of(flat: Floats, area: Floats, h: float) -> Particles:
    """The points (n, 2) of `strata` with their areas (n,) [m^2], one cell of edge h [m] thick."""
    X = np.column_stack([np.repeat(flat, 2, axis=0), np.tile(h * GAUSS, len(flat))])
    V0 = np.repeat(area, 2) * 0.5 * h
    body = cloud(X, volume=float(V0.sum()), lattice=0.5 * h, corner=np.zeros(3))
    return replace(body, V0=V0)


def boxes(bounds: Sequence[tuple[Any, Any]], h: float, corner: Any) -> Particles:
    """Boxes [m] that do not overlap, with particles that integrate cubics in every cell exactly.

    bounds : the lowest and the highest corner of each; corner : of the grid, cells of edge h [m].
    """
    X, V0 = [], []
    for low, high in bounds:
        lines, weights = [], []
        for axis in range(3):
            a, b = (float(end[axis]) - float(corner[axis]) for end in (low, high))
            planes = h * np.arange(np.ceil(a / h + 1e-9), np.floor(b / h - 1e-9) + 1)
            ends = np.concatenate([[a], planes, [b]])
            size = np.diff(ends)
            lines.append((ends[:-1, None] + size[:, None] * GAUSS).ravel() + float(corner[axis]))
            weights.append(np.repeat(0.5 * size, 2))
        X.append(np.stack(np.meshgrid(*lines, indexing="ij"), -1).reshape(-1, 3))
        V0.append(np.einsum("i,j,k->ijk", *weights).ravel())
    volume = np.concatenate(V0)
    made = cloud(
        np.concatenate(X), volume=float(volume.sum()), lattice=0.5 * h, corner=np.asarray(corner)
    )
    return replace(made, V0=volume)


def cloud(X: Floats, *, volume: float, lattice: float, corner: Floats) -> Particles:
    """Particles at X (n, 3) [m] that share a volume [m^3]; their Gaussians do not matter here."""
    n = len(X)
    return Particles(
        X=X,
        V0=np.full(n, volume / n),
        material=np.zeros(n, np.int64),
        orientation=np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),
        scale=np.ones((n, 3)),
        color=np.zeros((n, 3)),
        opacity=np.ones(n),
        surface=np.zeros(n, np.int64),
        spacing=float(np.cbrt(volume / n)),
        volume=volume,
        lattice=lattice,
        corner=np.asarray(corner, float),
    )


def clamp(axis: int, at: float) -> Pin:
    """A pin that holds all that lies under a coordinate [m]."""

    def inside(X: Floats) -> Floats:
        return X[:, axis] < at

    def nearest(X: Floats) -> Floats:
        b = X.copy()
        b[:, axis] = at
        return b

    anchors = at * np.eye(3)[axis] + np.vstack([np.zeros(3), np.eye(3)])
    return Pin(name="clamp", inside=inside, nearest=nearest, anchors=anchors, path=anchors[None])


def mirror_plane(axis: int, at: float) -> Pin:
    """A symmetry plane: what lies above a coordinate [m] slides along it."""
    x, y, z = (axis == a for a in range(3))
    return replace(clamp(axis, at), name="plane", axes=(x, y, z))


def plane_strain(h: float) -> tuple[Pin, Pin]:
    """Symmetry planes at z = 0 and z = h [m]."""
    above = replace(mirror_plane(2, h), name="above", inside=lambda at: at[:, 2] > h)
    return mirror_plane(2, 0.0), above


FIRM = 1e9  # [Pa] of cohesion, and of what else keeps a law elastic
BEARS = ("cohesion", "critical_compression", "critical_stretch", "cavitation", "viscosity")


def firm(law: str) -> dict[str, float]:
    """Parameters with which a law is elastic in tension too."""
    return {p.name: FIRM for p in LAWS[law].parameters if p.name in BEARS}


def look(name: str, body: Particles, **changes: Any) -> Material:
    """A preset on a body, one that bears tension; changes replace fields of the material."""
    made = DIMENSIONLESS[name].material(body.radius)
    own = {"parameters": {**made.parameters, **firm(changes.get("law", made.law))}}
    return Material(**{**vars(made), **own, **changes})


def elastic(
    *, E: float, nu: float, density: float, law: str = "corotated", **more: Any
) -> Material:
    """A material without damping that bears tension; E [Pa], density [kg/m^3]."""
    more = {"parameters": firm(law), **more}
    return Material(
        name="elastic", law=law, density=density, youngs_modulus=E, poissons_ratio=nu, **more
    )


def settings(device: str, **changes: Any) -> Settings:
    """Free flight without gravity and without any filter or damping, at 24 frames per second."""
    said: dict[str, Any] = {
        "frames": 10,
        "fps": FPS,
        "time_codes_per_second": FPS,
        "start": 1.0,
        "gravity": (0.0, 0.0, 0.0),
        "up": (0.0, 1.0, 0.0),
        "floor": None,
        "device": device,
    }
    return Settings(**{**said, **changes})


def motion(solver: TotalLagrangian) -> Iterator[tuple[float, StateView]]:
    """Time [s] and state of a body that hardly strains, at each of its frames.

    With the substeps of `frames()`, but without what a frame tells of itself, which takes as long
    as moving a small body does.  Raises SolverError for what is no number.
    """
    yield solver.state.time, solver.state.view()
    for index in range(1, solver.settings.frames):
        solver.advance(index, solver.coarse)
        particle, fault = solver.not_finite()
        if fault:
            raise SolverError(
                f"frame {index}: {fault}", "the step is that at rest", frame=index,
                particle=particle,
            )  # fmt: skip
        yield solver.state.time, solver.state.view()


def put(solver: TotalLagrangian, u: Floats, v: Floats | None = None) -> None:
    """Set displacement u and velocity v (M, 3) [m], [m/s] of all nodes; v None: at rest."""
    still = np.zeros_like(u) if v is None else v
    start = {"u": u, "v": still, "offset": np.zeros(3), "time": 0.0, "done": 0}
    solver.state.load({**solver.state.save(), **start})


def force(solver: TotalLagrangian) -> Floats:
    """Force (free, 3) [N] on the free nodes where they are, by the kick of one substep.

    The solver has to be at rest; it moves on by a frame.
    """
    before = solver.state.view().v
    solver.advance(1, 1)
    kick = solver.state.view().v - before
    return solver.body.mass.momentum(kick) / solver.frame_time


def virial(solver: TotalLagrangian) -> Floats:
    """P (3, 3) [Pa] of a body that is strained evenly, from the forces on its nodes.

    With every node free sum_i X_i (x) G_ip = I, and so -sum_i f_i (x) X_i = sum_p V0_p P.
    """
    f = force(solver)
    return -f.T @ solver.body.stencil.free_X / float(solver.particles.V0.sum())
