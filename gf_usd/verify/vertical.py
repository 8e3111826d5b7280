"""A block that falls under its own weight while its top face is held: large, fast stretch."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from gf_usd.physics.solver import TotalLagrangian
from gf_usd.verify.bodies import GAUSS, block, elastic, settings
from gf_usd.verify.case import RELATIVE, Case, Curve, Measure
from gf_usd.verify.fit import lowest
from gf_usd.verify.hold import accelerate

E, NU, DENSITY, G = 1e6, 0.3, 1050.0, 1000.0  # [Pa], -, [kg/m^3], [m/s^2]
PUBLISHED, TIME = -1.7146, 0.0882  # [m], [s] lowest point of the bottom corner, by FEM
LIMIT = -1.751  # [m] the same by tools/vertical_reference.py
END, FRAMES = 0.1, 100  # [s] simulated


def stretch(cells: int, device: str) -> tuple[float, float]:
    """Time [s] and displacement [m] of the lowest point of the bottom corner.

    cells : along the edge of the cube.  Its top face may slide but not leave its plane.  That is
    the symmetry plane of a body twice as high whose halves are pulled apart, which is simulated.
    """
    h = 1.0 / cells
    body = block((-0.5, -1.0, -0.5), (cells, 2 * cells, cells), h, places=GAUSS)
    made = elastic(E=E, nu=NU, density=DENSITY, law="neoHookean")
    s = settings(device, frames=FRAMES + 1, fps=FRAMES / END)
    corner = np.array([[x, -1.0, z] for x in (-0.5, 0.5) for z in (-0.5, 0.5)])
    solver = TotalLagrangian(body, [made], s, riders={"corner": corner})
    # Weight at the particles, brought to the nodes: those at the plane hang on both halves.
    pull = np.zeros((len(body), 3))
    pull[:, 1] = solver.m * np.where(body.X[:, 1] < 0.0, -G, G)
    accelerate(solver, (solver.rows.W.T @ pull) / solver.stencil.mass[:, None])
    times, tips = [], []
    for frame in solver.frames():
        times.append(frame.time)
        tips.append(float((frame.riders["corner"].x - corner)[:, 1].mean()))
    return lowest(np.array(times), np.array(tips))


def hang(*cells: int, bound: float, late: float) -> Callable[[str], Iterator[Measure]]:
    """The tip at one or several resolutions."""

    def run(device: str) -> Iterator[Measure]:
        times, tips = np.transpose([stretch(n, device) for n in cells])
        yield Measure(
            name="tip", value=float(tips[-1]), target=LIMIT, bound=bound, kind=RELATIVE, unit="m",
            why=f"{cells[-1]} cells along the edge; the reference is what linear finite elements"
            " tend to on the same equations (tools/vertical_reference.py, 16 to 48 elements along"
            " the edge: -1.7571, -1.7519, -1.7519, -1.7511)",
            curve=Curve(
                title="vertical bar, lowest point of the tip", x_label="h [m]", y_label="tip [m]",
                x=tuple(1.0 / np.array(cells)), y=tuple(tips), logarithmic=False, target=LIMIT,
            ),
        )  # fmt: skip
        yield Measure(
            name="tip-published", value=float(tips[-1]), target=PUBLISHED, bound=0.021 + bound,
            kind=RELATIVE, unit="m",
            why="the published FEM figure lies 2.1 % from the limit of the finite elements of"
            " tools/vertical_reference.py, which cannot be resolved from here; published MPM is"
            " -1.741 to -1.85",
        )  # fmt: skip
        yield Measure(
            name="time", value=float(times[-1]), target=TIME, bound=late, kind=RELATIVE, unit="s",
            why="the corner shakes about the motion of the block with a period of .01 s, and stays"
            " within 1 % of its lowest for .008 s: on coarse grids a later wave is the deepest;"
            " 24 cells tell them apart",
        )  # fmt: skip

    return run


CASES = (
    Case(
        name="vertical",
        what="A cube of 1 m, Neo-Hookean, hangs by its top face, which may slide sideways, when a"
        " gravity of 1000 m/s^2 sets in.  It stretches to 2.7 times its length; how far the bottom"
        " corner comes down, and when.",
        source="published FEM tip -1.7146 m at 0.0882 s; our own FEM -1.751 m",
        quick=hang(8, bound=0.01, late=0.07),
        full=hang(8, 12, 16, 24, bound=0.01, late=0.01),
    ),
)
