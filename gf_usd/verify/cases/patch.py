"""The patch test: uniform strain in all particles, and rigid rotation of embedded meshes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.materials.laws import LAWS
from gf_usd.geometry.skinning import make_skin
from gf_usd.physics.laws.registry import convergence
from gf_usd.physics.total_lagrangian import energies
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import ball, mean_stress, preset_material, set_state, settings, sphere
from gf_usd.verify.case import Case, Measure

A = np.array([[1.35, 0.40, -0.20], [0.10, 0.70, 0.30], [-0.15, 0.25, 1.20]])
SHIFT = np.array([0.3, -0.2, 0.1])  # [m]
BASIC = tuple(token for token, row in LAWS.items() if not row.over)
QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def corotated(F: Floats, mu: float, lam: float) -> Floats:
    """P = 2 mu (F - R) + lam (J - 1) J F^-T, with an SVD for the rotation."""
    J = np.linalg.det(F)
    U, _, Vt = np.linalg.svd(F)
    return 2.0 * mu * (F - U @ Vt) + lam * (J - 1.0) * J * np.linalg.inv(F).T


def neo_hookean(F: Floats, mu: float, lam: float) -> Floats:
    """P = mu (F - F^-T) + lam ln(J) F^-T."""
    inverse = np.linalg.inv(F).T
    return mu * (F - inverse) + lam * np.log(np.linalg.det(F)) * inverse


def hencky(F: Floats, mu: float, lam: float) -> Floats:
    """P = U diag((2 mu e_i + lam sum e) / s_i) V^T, e = ln s, with an SVD."""
    U, s, Vt = np.linalg.svd(F)
    e = np.log(s)
    return U @ np.diag((2.0 * mu * e + lam * e.sum()) / s) @ Vt


def tait(F: Floats, mu: float, lam: float) -> Floats:
    """P = U diag(2 mu dev e_i / s_i) V^T - p J F^-T, p = K / 7 (J^-7 - 1), with an SVD."""
    U, s, Vt = np.linalg.svd(F)
    e, J = np.log(s), float(np.prod(s))
    p = (lam + 2.0 / 3.0 * mu) / 7.0 * (J**-7.0 - 1.0)
    return U @ np.diag((2.0 * mu * (e - e.mean()) - p * J) / s) @ Vt


# P(F) of each law as its source has it, with parameters of its own at their defaults: independent
# of the kernels.  A law without a row here is an error, not another law.
REFERENCE: dict[str, Callable[[Floats, float, float], Floats]] = {
    "corotated": corotated,
    "neoHookean": neo_hookean,
    "vonMises": hencky,  # far below its yield stress
    "crushable": hencky,
    "paste": hencky,
    "druckerPrager": hencky,  # within the cone
    "fluid": tait,
    "snow": corotated,  # within its critical stretches
    "vonMisesNeoHookean": neo_hookean,
    "vonMisesCorotated": corotated,
}


def stress(token: str, F: Floats, mu: float, lam: float) -> Floats:
    """P(F) by the law's reference formula.  Raises ValueError where there is none."""
    if token not in REFERENCE:
        raise ValueError(f"the law {token} has no reference formula in {__name__}.REFERENCE")
    return REFERENCE[token](F, mu, lam)


def von_mises(P: Floats, F: Floats) -> float:
    """sqrt(3/2 s:s) of the deviator of P F^T / J."""
    sigma = P @ F.T / np.linalg.det(F)
    s = sigma - np.trace(sigma) / 3.0 * np.eye(3)
    return float(np.sqrt(1.5 * (s * s).sum()))


def sensitivity(of: Callable[[Floats], Floats | float], F: Floats, step: float = 1e-6) -> float:
    """sum_ab |d of / d F_ab| at F, by central differences, over the largest value of `of`: the most
    that errors of the entries of F up to 1 change the result, relative to it.
    """
    slopes = np.zeros(np.shape(of(F)))
    for entry in np.eye(9).reshape(9, 3, 3):
        slopes += np.abs(np.subtract(of(F + step * entry), of(F - step * entry))) / (2.0 * step)
    return float(slopes.max() / np.abs(of(F)).max())


def patch(real: type, laws: Sequence[str] = BASIC) -> Callable[[str], Iterator[Measure]]:
    """The affine patch test in one precision."""

    def run(device: str) -> Iterator[Measure]:
        for token in laws:
            body, _ = ball(500)
            material = preset_material("rubber", body, law=token, damping_time=0.0)
            s = settings(device, fps=1e6, substeps=1, followers=False)
            solver = TotalLagrangian(body, [material], s, real=real)
            stencil = solver.body.stencil
            u = stencil.node_X @ (A - np.eye(3)).T + SHIFT
            set_state(solver, u)

            def P_of(F: Floats, token=token, mu=material.mu, lam=material.lam) -> Floats:
                return stress(token, F, mu, lam)

            def vm_of(F: Floats, P_of=P_of) -> float:
                return von_mises(P_of(F), F)

            P = P_of(A)
            results, expected = energies.von_mises(solver.body, solver.state), von_mises(P, A)
            mean = mean_stress(solver)
            # sum_i |dw_i| = 2 / h along an axis, and u is rounded to half of eps
            eps, reach = float(np.finfo(real).eps), float(np.abs(stencil.node_X).max())
            dF = eps * float(np.abs(u).max()) / stencil.h + convergence(real)
            # a node adds up to 27 cells, a cell some 8 particles, whose rounding errors are random
            sums = 0.5 * eps * np.sqrt(27 * 8) * 2.0 * reach / stencil.h
            why = (
                f"dF = eps max |u| / h + c = {dF:.1e} from nodal displacements rounded to eps / 2"
                " and rotations iterated to changes of c; times sum |d / dF_ab| of the result"
            )
            yield Measure(
                name=f"{token}.uniform",
                value=float(np.abs(results / expected - 1.0).max()),
                target=0.0,
                bound=dF * sensitivity(vm_of, A),
                why=f"worst particle of von Mises / exact - 1: {why}",
            )
            relaxed = material.mu * s.frame_time / material.parameters.get("viscosity", np.inf)
            yield Measure(
                name=f"{token}.force",
                value=float(np.abs(mean - P).max() / np.abs(P).max()),
                target=0.0,
                bound=dF * sensitivity(P_of, A) + sums + relaxed,
                why=f"P from the nodal forces, -sum f (x) X / V: {why}; sums rounded to {sums:.1e}"
                + (f"; the deviator relaxes by mu dt / viscosity = {relaxed:.1e}" * bool(relaxed)),
            )

    return run


def turn(device: str) -> Iterator[Measure]:
    """A rigid quarter turn, carried by the embedding and by the idw skin."""
    body, _ = ball(500)
    skin = sphere()
    solver = TotalLagrangian(
        body, [preset_material("rubber", body)], settings(device), embedded={"skin": skin.points}
    )
    set_state(solver, solver.body.stencil.node_X @ (QUARTER - np.eye(3)).T)
    frame = next(iter(solver.frames()))
    exact = skin.points @ QUARTER.T
    why = (
        "offsets are material vectors turned by F, so a rigid rotation is exact; nodal"
        " displacements are rounded to 6e-8 of a radius and F to 1e-7 r / h"
    )
    idw = make_skin("idw", skin.points, body.X)
    for name, pose in (("embed", frame.embedded["skin"]), ("idw", idw.pose(frame.particles))):
        yield Measure(
            name=name, value=float(np.abs(pose.x - exact).max()), target=0.0, bound=1e-6,
            unit="r", why=why,
        )  # fmt: skip


CASES = (
    Case(
        name="patch",
        what=(
            "Nodes are displaced by one affine map.  Every particle must see exactly that gradient"
            " and the stress that the law gives it, wherever it lies in its cell, and the nodal"
            " forces must correspond to the same stress."
        ),
        source="closed form: the patch test of finite elements",
        quick=patch(np.float32),
    ),
    Case(
        name="skin-turn",
        what="The body is turned rigidly by 90 degrees.  The vertices of its mesh must be turned"
        " with it, by the embedding and by the idw skin.",
        source="closed form",
        quick=turn,
    ),
    Case(
        name="patch-f64",
        what=(
            "The patch test in double precision: the remaining error is that of rounding, not of"
            " the method."
        ),
        source="closed form: the patch test of finite elements",
        quick=patch(np.float64, ("corotated", "neoHookean")),
        full=patch(np.float64),
        f64=True,
    ),
)
