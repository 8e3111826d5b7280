"""A block on a slope: sticking below the angle of friction, Coulomb sliding above."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.frames.particles import SurfaceSamples
from gf_usd.core.materials.dimensionless import G0
from gf_usd.core.stage import Collider, ContactSetup, PhysicsMaterialSpec, Skin
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import FPS, GAUSS, block, elastic, iterate_states, settings
from gf_usd.verify.case import RELATIVE, Case, Measure

FRICTION = 0.5  # its angle is 26.6 degrees
ROLLING = 0.05  # as bakes have it by default
SECONDS = 2  # that are watched; the last of them is measured


def base(cells: int) -> SurfaceSamples:
    """Samples of the lower face of a cube of 1 m, each of the same area."""
    n = 2 * cells
    at = (np.arange(n) + 0.5) / n
    X = np.array([[x, 0.0, z] for x in at for z in at])
    down = np.tile([0.0, -1.0, 0.0], (len(X), 1))
    return SurfaceSamples(X=X, area=np.full(len(X), 1.0 / len(X)), normal=down)


def plane() -> Collider:
    """The half space below y = 0."""
    corners = np.array([[-1.0, 0.0, -1.0], [-1.0, 0.0, 1.0], [1.0, 0.0, 1.0], [1.0, 0.0, -1.0]])
    return Collider(
        path="/Slope", shape="plane", points=corners, triangles=np.array([[0, 1, 2], [0, 2, 3]]),
        linear=np.eye(3)[None], offset=np.zeros((1, 3)),
        spec=PhysicsMaterialSpec(dynamic_friction=FRICTION, restitution=None),
    )  # fmt: skip


def speeds(degrees: float, cells: int, obstacle: bool, device: str, rolling: float = 0.0) -> Floats:
    """Speed [m/s] down the slope at each frame of a block that is put on it.

    The slope is level and gravity leans.  obstacle : it is a collider instead of the floor.
    rolling : coefficient of rolling resistance; above 0 the block settles too, as in bakes.
    """
    lean = np.radians(degrees)
    s = settings(
        device, frames=int(SECONDS * FPS) + 1, floor=None if obstacle else 0.0,
        gravity=(G0 * np.sin(lean), -G0 * np.cos(lean), 0.0),
        rolling=rolling, settling=rolling > 0.0,
    )  # fmt: skip
    material = elastic(
        E=1e6, nu=0.3, density=1000.0, friction=FRICTION, restitution=0.1, damping_time=0.01
    )
    body = block(np.zeros(3), (cells,) * 3, 1.0 / cells, places=GAUSS)
    cube = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
    floor = np.array(
        [[0, 4, 5], [0, 5, 1]]
    )  # no body faces the block: a part of its skin is sufficient
    setup = ContactSetup(skins=(Skin(points=cube, triangles=floor),), colliders=(plane(),))
    solver = TotalLagrangian(
        body, [material], s, samples=base(cells), contact_setup=setup if obstacle else None
    )
    m = solver.body.stencil.mass
    return np.array([m @ now.v[:, 0] / m.sum() for _, now in iterate_states(solver)])


def friction(cells: Sequence[int]) -> Callable[[str], Iterator[Measure]]:
    """Blocks of so many cells along an edge, on the floor and on an obstacle."""

    def run(device: str) -> Iterator[Measure]:
        second = slice(-int(FPS) - 1, None)
        for n in cells:
            for obstacle in (False, True):
                what = f"{'obstacle' if obstacle else 'floor'}.{n}"
                free = G0 * np.sin(np.radians(20.0)) * (SECONDS - 0.5)
                creep = float(speeds(20.0, n, obstacle, device)[second].mean())
                yield Measure(
                    name=f"creep.{what}", value=abs(creep) / free, target=0.0, bound=1e-3,
                    why="below the angle of friction nothing moves; mean of the last second, over"
                    " the speed that gravity alone would give",
                )  # fmt: skip
                lean = np.radians(35.0)
                for rolling, name in ((0.0, "slide"), (ROLLING, "slide.rolling")):
                    v = speeds(35.0, n, obstacle, device, rolling)[second]
                    yield Measure(
                        name=f"{name}.{what}", value=float(v[-1] - v[0]),
                        target=float(G0 * (np.sin(lean) - FRICTION * np.cos(lean))), bound=1e-3,
                        kind=RELATIVE, unit="m/s^2",
                        why=(
                            "all samples slip, so that friction is mu times the normal force; the"
                            " block vibrates at w = pi / 2 sqrt(E / rho) / L = 50 /s at the"
                            " lowest, at first by g / w = 0.2 m/s and after a second of damping,"
                            " exp(-tau w^2 G / (lambda + 2 G) t), by 1e-4 of the speed that it"
                            " gained; a sliding block does not roll"
                        ),
                    )  # fmt: skip

    return run


CASES = (
    Case(
        name="slope",
        what=(
            "A block of 1 m with a friction of 0.5 is put on slopes of 20 and 35 degrees, floor and"
            " obstacle.  On the first it must not creep, on the second it must slide with"
            " Coulomb's acceleration, also with the rolling resistance and settling of bakes."
        ),
        source="Coulomb: a = g (sin - mu cos) above atan(mu), 0 below",
        quick=friction((3,)),
        full=friction((3, 6)),
    ),
)
