"""Every registered law, through the kernels that simulate with it."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.materials.laws import LAWS
from gf_usd.physics.total_lagrangian.energies import elastic_energy
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import GAUSS, block, elastic, put, settings, virial
from gf_usd.verify.case import Case, Measure

MU, LAM = 2.0, 3.0  # [Pa] of order one, and so are stresses
STEP = 1e-5  # of the central difference


class LawBench:
    """psi(F) and P(F) of a law as the solver has them: of a small block strained evenly."""

    def __init__(self, token: str, device: str) -> None:
        nu = LAM / (2.0 * (LAM + MU))
        made = elastic(E=2.0 * MU * (1.0 + nu), nu=nu, density=1.0, law=token)
        body = block((0.0, 0.0, 0.0), (1, 1, 1), 1.0, places=GAUSS)
        # A frame so short that no node moves while the force is felt.
        s = settings(device, fps=1e9, substeps=1, followers=False)
        self.solver = TotalLagrangian(body, [made], s, real=np.float64)

    def strain(self, F: Floats) -> None:
        put(self.solver, self.solver.body.stencil.node_X @ (F - np.eye(3)).T)

    def psi(self, F: Floats) -> float:
        """Energy [J/m^3] of rest volume."""
        self.strain(F)
        return elastic_energy(self.solver.body, self.solver.state) / float(
            self.solver.particles.V0.sum()
        )

    def P(self, F: Floats) -> Floats:
        """First Piola-Kirchhoff stress (3, 3) [Pa]."""
        self.strain(F)
        return virial(self.solver)


def rotation(rng: np.random.Generator) -> Floats:
    """(3, 3) a random rotation."""
    Q, R = np.linalg.qr(rng.normal(size=(3, 3)))
    Q *= np.sign(np.diag(R))
    return Q * np.sign(np.linalg.det(Q))


def gradients(rng: np.random.Generator) -> list[Floats]:
    """Eight upright, two nearly flat and two inverted gradients, turned at random.

    Stretches lie .2 apart or more, clear of the places where the nearest rotation jumps.
    """
    stretches = [np.sort(rng.uniform(0.4, 1.6, 3)) + [0.0, 0.2, 0.4] for _ in range(8)]
    stretches += [np.array([s, 0.9, 1.2]) for s in (0.05, 0.15, -0.4, -0.7)]
    return [rotation(rng) @ np.diag(s) @ rotation(rng) for s in stretches]


def relative(off: Floats, size: Floats) -> float:
    """Largest entry over the largest of `size`, or over mu where that has less."""
    return float(np.abs(off).max() / max(np.abs(size).max(), MU))


def check(token: str) -> Callable[[str], Iterator[Measure]]:
    """The four questions to one law."""

    def run(device: str) -> Iterator[Measure]:
        rng = np.random.default_rng(0)
        bench = LawBench(token, device)
        slope = turned = energy = 0.0
        for F in gradients(rng):
            P, psi = bench.P(F), bench.psi(F)
            numeric = np.zeros((3, 3))
            for at in np.ndindex(3, 3):
                bump = np.zeros((3, 3))
                bump[at] = STEP
                numeric[at] = (bench.psi(F + bump) - bench.psi(F - bump)) / (2.0 * STEP)
            slope = max(slope, relative(numeric - P, P))
            Q = rotation(rng)
            turned = max(turned, relative(bench.P(Q @ F) - Q @ P, P))
            energy = max(energy, relative(np.array(bench.psi(Q @ F) - psi), np.array(psi)))
        rest = [np.eye(3), *(rotation(rng) for _ in range(4))]
        still = max(relative(bench.P(Q), np.zeros(3)) for Q in rest)
        e = 1e-6 * rng.uniform(-1.0, 1.0, (3, 3))
        sym = 0.5 * (e + e.T)
        hooke = 2.0 * MU * sym + LAM * np.trace(sym) * np.eye(3)
        small = float(np.abs(bench.P(np.eye(3) + e) - hooke).max() / np.abs(hooke).max())
        figures = (
            (
                "gradient", slope, 5e-8,
                "central differences of psi with a step of 1e-5: step^2 / 6 of its third derivative"
                " (2e4 where ln J is continued, stress 70) is 5e-9, rounding 1e-16 / 1e-5 is 1e-11",
            ),
            (
                "objectivity", max(turned, energy), 2e-13,
                "P(Q F) = Q P(F) and psi(Q F) = psi(F) to rounding, 2e-16 times the 1 / J = 10 to"
                " which ln J' and the inverse grow, over some hundred operations",
            ),
            ("rest", still, 1e-13, "P(Q) = 0 to rounding of F, a sum of 27 terms"),
            (
                "hooke", small, 2e-5,
                "2 mu eps + lambda tr(eps) I up to the next order, some ten times the strain of"
                " 1e-6",
            ),
        )  # fmt: skip
        for name, value, bound, why in figures:
            yield Measure(name=name, value=value, target=0.0, bound=bound, why=why)

    return run


CASES = tuple(
    Case(
        name=f"law-{token}",
        what="A block is strained evenly, upright, nearly flat and inside out.  The stress that its"
        " nodes feel must be the gradient of the energy, turn with the body, vanish at rest however"
        " turned, and follow Hooke's law with the moduli asked for where strains are small.",
        source="finite differences, frame indifference, Hooke",
        quick=check(token),
        f64=True,
    )
    for token, row in LAWS.items()
    if not row.over
)
