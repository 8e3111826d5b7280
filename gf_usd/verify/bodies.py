"""Bodies, materials and settings of the cases, and access to the state of a solver."""

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
from gf_usd.core.frames.particles import Particles, SurfaceSamples
from gf_usd.core.frames.settings import Settings
from gf_usd.core.materials.dimensionless import DIMENSIONLESS
from gf_usd.core.materials.laws import LAWS
from gf_usd.core.materials.material import Material
from gf_usd.core.mesh.triangulation import triangulate
from gf_usd.core.stage import Pin
from gf_usd.core.units import StageUnits
from gf_usd.geometry.sampling.contact_samples import sample_surface
from gf_usd.geometry.sampling.particles import sample_solid
from gf_usd.geometry.solid import Solid, build_solid
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.physics.total_lagrangian.state import StateView

FPS = 24.0
MIDDLE = np.array([0.25, 0.75])  # of a cell: centers of its strata
GAUSS = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3.0)  # Gauss points, exact for cubics
SUBSAMPLES = 16  # along each edge of a stratum, to compute the area inside a figure


def sphere(radius: float = 1.0, subdivisions: int = 3) -> Surface:
    """A geodesic sphere about the origin with its vertices at the radius [m]."""
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
    """A comb: teeth side by side along x below a root at y = `length`; lengths [m].

    The first tooth begins at x = 0, the tips are at y = 0, and z is 0 to `depth`.
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
    """A ball [m] with about this number of particles, sampled as in a bake, and contact samples."""
    solid = make_solid(sphere(radius, subdivisions))
    body = sample_solid(solid, particles=particles, spacing=None, seed=seed, uniform=rejection)
    return body, sample_surface(solid, body.spacing)


def make_solid(*surfaces: Surface) -> Solid:
    """The solid inside closed surfaces [m]."""
    path = surfaces[0].path
    facts = StageFacts(
        path=Path(path[1:]), units=StageUnits(), up_axis="Y", time_codes_per_second=None,
        start_time_code=None, end_time_code=None, root_prims=(path,), default_prim=path,
    )  # fmt: skip
    return build_solid(Asset(facts=facts, surfaces=surfaces))


def block(low: Any, cells: Any, h: float, *, places: Floats = GAUSS) -> Particles:
    """A box of whole cells of edge h [m] with eight particles per cell.

    places : (2,) coordinates in a cell along each axis; a bake has GAUSS.
    """
    low, cells = np.asarray(low, float), np.asarray(cells)
    strata = np.stack(np.unravel_index(np.arange(8 * cells.prod()), tuple(2 * cells)), -1)
    at = strata // 2 + np.asarray(places)[strata % 2]
    return particles_at(
        low + h * at, volume=float(cells.prod()) * h**3, lattice=0.5 * h, corner=low
    )


def sample_strata(
    inside: Callable[[Floats, Floats], Any], counts: Any, h: float
) -> tuple[Floats, Floats]:
    """Points (n, 2) [m] of the strata inside a plane figure, and their areas (n,) [m^2].

    A stratum is a quarter of a cell of edge h [m]; there are `counts` cells along each axis from 0.
    A full stratum has its Gauss point, a cut one the centroid of its part inside the figure.
    inside : function of x and y [m].
    """
    a = 0.5 * h
    fine = (np.arange(SUBSAMPLES) + 0.5) / SUBSAMPLES * a
    places, fractions = [], []
    for i, j in np.ndindex(2 * counts[0], 2 * counts[1]):
        x, y = np.meshgrid(i * a + fine, j * a + fine, indexing="ij")
        inside_here = inside(x, y)
        if inside_here.all():
            places.append((h * (i // 2 + GAUSS[i % 2]), h * (j // 2 + GAUSS[j % 2])))
        elif inside_here.any():
            places.append((x[inside_here].mean(), y[inside_here].mean()))
        fractions.extend([inside_here.mean()] * bool(inside_here.any()))
    return np.array(places), np.array(fractions) * a * a


def plane_strain_slice(flat: Floats, area: Floats, h: float) -> Particles:
    """Particles of a slice of thickness h [m], from points and areas of `sample_strata`."""
    X = np.column_stack([np.repeat(flat, 2, axis=0), np.tile(h * GAUSS, len(flat))])
    V0 = np.repeat(area, 2) * 0.5 * h
    body = particles_at(X, volume=float(V0.sum()), lattice=0.5 * h, corner=np.zeros(3))
    return replace(body, V0=V0)


def box_particles(bounds: Sequence[tuple[Any, Any]], h: float, corner: Any) -> Particles:
    """Particles of disjoint boxes [m] that integrate cubics in every cell exactly.

    bounds : low and high corner of each box.   corner : of the grid of cells of edge h [m].
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
    body = particles_at(
        np.concatenate(X), volume=float(volume.sum()), lattice=0.5 * h, corner=np.asarray(corner)
    )
    return replace(body, V0=volume)


def particles_at(X: Floats, *, volume: float, lattice: float, corner: Floats) -> Particles:
    """Particles at X (n, 3) [m] of equal parts of a volume [m^3], with unit Gaussians."""
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
    """A pin of all points below a coordinate [m]."""

    def inside(X: Floats) -> Floats:
        return X[:, axis] < at

    def nearest(X: Floats) -> Floats:
        b = X.copy()
        b[:, axis] = at
        return b

    anchors = at * np.eye(3)[axis] + np.vstack([np.zeros(3), np.eye(3)])
    return Pin(name="clamp", inside=inside, nearest=nearest, anchors=anchors, path=anchors[None])


def mirror_plane(axis: int, at: float) -> Pin:
    """A symmetry plane at a coordinate [m]: a sliding pin of one axis."""
    x, y, z = (axis == a for a in range(3))
    return replace(clamp(axis, at), name="plane", axes=(x, y, z))


def plane_strain(h: float) -> tuple[Pin, Pin]:
    """Symmetry planes at z = 0 and z = h [m]."""
    above = replace(mirror_plane(2, h), name="above", inside=lambda at: at[:, 2] > h)
    return mirror_plane(2, 0.0), above


TENSION_STRENGTH = 1e9  # [Pa] of cohesion and other strength parameters
TENSION_PARAMETERS = (
    "cohesion",
    "critical_compression",
    "critical_stretch",
    "cavitation",
    "viscosity",
)


def tension_parameters(law: str) -> dict[str, float]:
    """Strength parameters with which a law is elastic in tension too."""
    return {p.name: TENSION_STRENGTH for p in LAWS[law].parameters if p.name in TENSION_PARAMETERS}


def preset_material(name: str, body: Particles, **changes: Any) -> Material:
    """The material of a preset for a body, elastic in tension; changes replace its fields."""
    preset = DIMENSIONLESS[name].material(body.radius)
    parameters = {**preset.parameters, **tension_parameters(changes.get("law", preset.law))}
    return replace(preset, **{"parameters": parameters, **changes})


def elastic(
    *, E: float, nu: float, density: float, law: str = "corotated", **more: Any
) -> Material:
    """An undamped material, elastic in tension; E [Pa], density [kg/m^3]."""
    more = {"parameters": tension_parameters(law), **more}
    return Material(
        name="elastic", law=law, density=density, youngs_modulus=E, poissons_ratio=nu, **more
    )


def settings(device: str, **changes: Any) -> Settings:
    """Settings without gravity, floor, filter and damping, at 24 frames per second."""
    defaults: dict[str, Any] = {
        "frames": 10,
        "fps": FPS,
        "time_codes_per_second": FPS,
        "start": 1.0,
        "gravity": (0.0, 0.0, 0.0),
        "up": (0.0, 1.0, 0.0),
        "floor": None,
        "device": device,
    }
    return Settings(**{**defaults, **changes})


def iterate_states(solver: TotalLagrangian) -> Iterator[tuple[float, StateView]]:
    """Time [s] and state of a slightly strained body at each frame.

    As `frames()`, but without the data of a frame, whose evaluation takes as long as the substeps
    of a small body.  Raises SolverError for values that are not finite.
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


def set_state(solver: TotalLagrangian, u: Floats, v: Floats | None = None) -> None:
    """Set displacement u and velocity v (M, 3) [m], [m/s] of all nodes; v None: at rest."""
    still = np.zeros_like(u) if v is None else v
    start = {"u": u, "v": still, "offset": np.zeros(3), "time": 0.0, "done": 0}
    solver.state.load({**solver.state.save(), **start})


def nodal_forces(solver: TotalLagrangian) -> Floats:
    """Forces (free, 3) [N] on the free nodes, from the momentum change of one substep.

    The solver must be at rest; it advances by a frame.
    """
    v_before = solver.state.view().v
    solver.advance(1, 1)
    kick = solver.state.view().v - v_before
    return solver.body.mass.momentum(kick) / solver.frame_time


def mean_stress(solver: TotalLagrangian) -> Floats:
    """P (3, 3) [Pa] of a uniformly strained body, from its nodal forces.

    If all nodes are free, sum_i X_i (x) G_ip = I, hence -sum_i f_i (x) X_i = sum_p V0_p P.
    """
    f = nodal_forces(solver)
    return -f.T @ solver.body.stencil.free_X / float(solver.particles.V0.sum())
