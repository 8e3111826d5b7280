"""Stress, energy and small-strain limit of every registered law, evaluated by the solver."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.materials.laws import LAWS
from gf_usd.physics.total_lagrangian.energies import elastic_energy
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import GAUSS, block, elastic, mean_stress, set_state, settings
from gf_usd.verify.case import Case, Measure

MU, LAM = 2.0, 3.0  # [Pa] of order one, and so are stresses
STEP = 1e-5  # of the central difference


class StrainedBlock:
    """psi(F) and P(F) of a law, evaluated by the solver for a uniformly strained block."""

    def __init__(self, token: str, device: str) -> None:
        nu = LAM / (2.0 * (LAM + MU))
        material = elastic(E=2.0 * MU * (1.0 + nu), nu=nu, density=1.0, law=token)
        body = block((0.0, 0.0, 0.0), (1, 1, 1), 1.0, places=GAUSS)
        # a frame so short that the displacement of nodes is negligible
        s = settings(device, fps=1e9, substeps=1, followers=False)
        self.solver = TotalLagrangian(body, [material], s, real=np.float64)

    def strain(self, F: Floats) -> None:
        set_state(self.solver, self.solver.body.stencil.node_X @ (F - np.eye(3)).T)

    def psi(self, F: Floats) -> float:
        """Energy [J/m^3] of rest volume."""
        self.strain(F)
        return elastic_energy(self.solver.body, self.solver.state) / float(
            self.solver.particles.V0.sum()
        )

    def P(self, F: Floats) -> Floats:
        """First Piola-Kirchhoff stress (3, 3) [Pa]."""
        self.strain(F)
        return mean_stress(self.solver)


def random_rotation(rng: np.random.Generator) -> Floats:
    """A random rotation (3, 3)."""
    Q, R = np.linalg.qr(rng.normal(size=(3, 3)))
    Q *= np.sign(np.diag(R))
    return Q * np.sign(np.linalg.det(Q))


def random_gradients(rng: np.random.Generator) -> list[Floats]:
    """Eight regular, two nearly flat and two inverted gradients with random rotations.

    Stretches differ by 0.2 or more: the polar decomposition is discontinuous where two coincide.
    """
    stretches = [np.sort(rng.uniform(0.4, 1.6, 3)) + [0.0, 0.2, 0.4] for _ in range(8)]
    stretches += [np.array([s, 0.9, 1.2]) for s in (0.05, 0.15, -0.4, -0.7)]
    return [random_rotation(rng) @ np.diag(s) @ random_rotation(rng) for s in stretches]


def relative_error(error: Floats, size: Floats) -> float:
    """Largest absolute entry over that of `size`, or over mu if larger."""
    return float(np.abs(error).max() / max(np.abs(size).max(), MU))


def check_law(token: str) -> Callable[[str], Iterator[Measure]]:
    """The four properties of one law: gradient, objectivity, rest state, Hooke's law."""

    def run(device: str) -> Iterator[Measure]:
        rng = np.random.default_rng(0)
        bench = StrainedBlock(token, device)
        gradient_error = stress_error = energy_error = 0.0
        for F in random_gradients(rng):
            P, psi = bench.P(F), bench.psi(F)
            numeric = np.zeros((3, 3))
            for at in np.ndindex(3, 3):
                perturbation = np.zeros((3, 3))
                perturbation[at] = STEP
                numeric[at] = (bench.psi(F + perturbation) - bench.psi(F - perturbation)) / (
                    2.0 * STEP
                )
            gradient_error = max(gradient_error, relative_error(numeric - P, P))
            Q = random_rotation(rng)
            stress_error = max(stress_error, relative_error(bench.P(Q @ F) - Q @ P, P))
            energy_error = max(
                energy_error, relative_error(np.array(bench.psi(Q @ F) - psi), np.array(psi))
            )
        rest = [np.eye(3), *(random_rotation(rng) for _ in range(4))]
        rest_error = max(relative_error(bench.P(Q), np.zeros(3)) for Q in rest)
        e = 1e-6 * rng.uniform(-1.0, 1.0, (3, 3))
        sym = 0.5 * (e + e.T)
        hooke = 2.0 * MU * sym + LAM * np.trace(sym) * np.eye(3)
        hooke_error = float(np.abs(bench.P(np.eye(3) + e) - hooke).max() / np.abs(hooke).max())
        measured = (
            (
                "gradient", gradient_error, 5e-8,
                "central differences of psi with a step of 1e-5: step^2 / 6 of its third derivative"
                " (2e4 where ln J is continued, stress 70) is 5e-9, rounding 1e-16 / 1e-5 is 1e-11",
            ),
            (
                "objectivity", max(stress_error, energy_error), 2e-13,
                "P(Q F) = Q P(F) and psi(Q F) = psi(F) to rounding, 2e-16 times the 1 / J = 10 to"
                " which ln J' and the inverse grow, over some hundred operations",
            ),
            ("rest", rest_error, 1e-13, "P(Q) = 0 to rounding of F, a sum of 27 terms"),
            (
                "hooke", hooke_error, 2e-5,
                "2 mu eps + lambda tr(eps) I up to the next order, some ten times the strain of"
                " 1e-6",
            ),
        )  # fmt: skip
        for name, value, bound, why in measured:
            yield Measure(name=name, value=value, target=0.0, bound=bound, why=why)

    return run


CASES = tuple(
    Case(
        name=f"law-{token}",
        what=(
            "A block is strained uniformly, with a volume ratio J that is positive, nearly zero"
            " and negative.  The stress computed from its nodal forces must be the gradient of the"
            " energy, rotate with the body, vanish in every unstrained orientation, and follow"
            " Hooke's law with the given moduli where strains are small."
        ),
        source="finite differences, frame indifference, Hooke",
        quick=check_law(token),
        f64=True,
    )
    for token, row in LAWS.items()
    if not row.over
)
