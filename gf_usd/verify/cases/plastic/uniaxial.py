"""Loading beyond the yield stress, unloading and springback of a bar."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import GAUSS, block, elastic, mean_stress, set_state, settings
from gf_usd.verify.case import RELATIVE, Case, Measure

E, NU = 1e4, 0.3  # [Pa]
YIELD, LINEAR, VOCE, RATE = 200.0, 300.0, 100.0, 20.0  # [Pa], ..., of saturation per strain
OWN = {"yield_stress": YIELD, "hardening": LINEAR, "saturation": VOCE, "saturation_rate": RATE}


def history(solver: TotalLagrangian, name: str) -> Floats:
    """(N,) an internal variable of the particles."""
    results = np.asarray(solver.state.save()["history"], float)
    return solver.body.law.internal(results.reshape(len(solver.particles), -1))[name]


def bearable(a: float) -> float:
    """Y(a) [Pa] of OWN."""
    return YIELD + LINEAR * a + VOCE * (1.0 - float(np.exp(-RATE * a)))


def pulled(a: float, stress: float) -> Floats:
    """F of a bar with plastic strain a along x and uniaxial Kirchhoff stress [Pa]."""
    e, across = stress / E + a, -NU * stress / E - 0.5 * a
    return np.diag(np.exp([e, across, across]))


def uniaxial(device: str) -> Iterator[Measure]:
    """Kirchhoff stress of a block that is strained as a bar under tension is."""
    material = elastic(E=E, nu=NU, density=1e9, law="vonMises", parameters=OWN)
    body = block((0.0, 0.0, 0.0), (1, 1, 1), 1.0, places=GAUSS)
    s = settings(device, fps=1e9, substeps=1, followers=False)
    solver = TotalLagrangian(body, [material], s, real=np.float64)
    why = "the return is radial along this path, and so exact: rounding, and the square of 1e-5 of"
    why += " the excess that Newton's iteration leaves"

    def stress(F: Floats) -> tuple[float, float]:
        set_state(solver, solver.body.stencil.node_X @ (F - np.eye(3)).T)
        tau = mean_stress(solver) @ F.T
        return float(tau[0, 0]), float(abs(tau[1, 1]))

    for a in (0.01, 0.05, 0.2):
        along, across = stress(pulled(a, bearable(a)))
        yield Measure(
            name=f"stress-at-{a:g}", value=along, target=bearable(a), bound=1e-8, kind=RELATIVE,
            unit="Pa", why=why,
        )  # fmt: skip
        yield Measure(
            name=f"across-at-{a:g}", value=across / YIELD, target=0.0, bound=1e-8,
            why=f"a free side has no stress; {why}",
        )  # fmt: skip
    half = 0.5 * bearable(0.2)
    unloaded = stress(pulled(0.2, half))[0]
    yield Measure(
        name="springback", value=(bearable(0.2) - unloaded) / half, target=1.0, bound=1e-8,
        why=f"unloading is elastic, with the slope E; {why}",
    )  # fmt: skip
    yield Measure(
        name="plastic-strain", value=float(history(solver, "plastic_strain").mean()), target=0.2,
        bound=1e-8, kind=RELATIVE, why=f"the permanent strain after unloading; {why}",
    )  # fmt: skip


CASES = (
    Case(
        name="uniaxial",
        what="A block is strained as a bar under tension beyond its yield stress, and back: stress,"
        " free sides, springback and plastic strain with linear and saturating hardening.",
        source="closed form (logarithmic strain, radial return)",
        quick=uniaxial,
        f64=True,
    ),
)
