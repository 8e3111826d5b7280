"""What holds of the return mapping of any law that flows, as a list of what does not.

Of a trial gradient F with logarithmic strain e* that returns to E with e in the axes of F:

    the stress of E is on the yield surface, or F = E inside it
    e* - e = l dQ/dtau, l >= 0                       (associated flow)
    the work of flow is tau : (e* - e) >= 0
    psi(F) - psi(E) is that and psi(e* - e), with Hencky's energy, a quadratic form in e

Over another energy flow goes along the deviator of e, and psi(F) - psi(E) is between tau : (e* - e)
and the same of the trial stress.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from lane_kernels import flow_with_loss
from random_turns import random_turns

from gf_usd.core.arrays import Floats

MU, LAM, CAP, TENSILE = 2.0, 3.0, 2.12, 0.4  # [Pa], [Pa], and shape of the crushable law
BULK = LAM + 2.0 / 3.0 * MU
# Size of the strains and yield stress [Pa]: by principal stretches, and by the series near 1.
REGIMES = {"large": (0.3, 0.05), "small": (3e-3, 5e-4)}
OWN = {
    "vonMises": {"hardening": 0.2, "saturation": 0.04, "saturation_rate": 15.0},
    "crushable": {"hardening": 0.3, "cap_shape": CAP, "tensile_yield_ratio": TENSILE},
}
OVER = {"vonMisesNeoHookean": "neoHookean", "vonMisesCorotated": "corotated"}
OWN |= dict.fromkeys(OVER, OWN["vonMises"])
N = 64
ROUNDING = 1e-13  # of stresses of order 1, in f64: some dozen operations with stretches to 1.4
SOLVED = 1e-9  # of the yield stress: the square of what Newton's iteration leaves before its last
SECANT = 1e-10  # of the stress: what the secant method may leave, (1e-15)^(3/4), and some


@dataclass(frozen=True, kw_only=True)
class Returned:
    """Trial and returned states of N particles."""

    F: Floats  # (N, 3, 3)
    E: Floats  # (N, 3, 3)
    before: Floats  # (N,) internal variable
    after: Floats  # (N,)
    loss: Floats  # (N,) [J/m^3]


def turns(seed: int) -> Floats:
    """(N, 3, 3) rotations."""
    return random_turns(N, seed)


def flow(token: str, F: Floats, a: Floats, yields: float) -> Returned:
    """The law's return mapping of F (N, 3, 3) and a (N,)."""
    own: dict[str, Any] = {"yield_stress": yields, **OWN[token]}
    E, after, loss = flow_with_loss(token, F, a[:, None], MU, LAM, **own)
    return Returned(F=F, E=E, before=a, after=after[:, 0], loss=loss)


def surface(token: str, e: Floats, tau: Floats, a: Floats, yields: float) -> tuple[Floats, Floats]:
    """Q - Y (n,) [Pa] of principal strains and Kirchhoff stresses (n, 3), by the source.

    And the direction of flow (n, 3): dQ/dtau, or along e.
    """
    p = -tau.mean(1)
    s = tau + p[:, None]
    shear = np.sqrt(1.5) * np.linalg.norm(s, axis=1)
    if token == "crushable":
        scale = 1.0 + CAP**2 / 9.0
        cap = np.where(p < 0.0, CAP / TENSILE, CAP) ** 2
        Q = np.sqrt((shear**2 + cap * p**2) / scale)
        slope = (1.5 * s - (cap * p)[:, None] / 3.0) / (scale * Q[:, None])
        return Q - yields - 0.3 * a, slope
    assert token in ("vonMises", *OVER)
    Y = yields + 0.2 * a + 0.04 * (1.0 - np.exp(-15.0 * a))
    return shear - Y, e - e.mean(1)[:, None] if token in OVER else 1.5 * s / shear[:, None]


def principal(token: str, e: Floats) -> tuple[Floats, Floats]:
    """tau (n, 3) and psi (n,) of principal logarithmic strains (n, 3), by the source."""
    trace, s = e.sum(1), np.exp(e)
    J = np.exp(trace)
    if OVER.get(token) == "neoHookean":
        psi = 0.5 * MU * ((s * s).sum(1) - 3.0) - MU * trace + 0.5 * LAM * trace**2
        return MU * (s * s - 1.0) + LAM * trace[:, None], psi
    if OVER.get(token) == "corotated":
        psi = MU * ((s - 1.0) ** 2).sum(1) + 0.5 * LAM * (J - 1.0) ** 2
        return 2.0 * MU * (s - 1.0) * s + (LAM * (J - 1.0) * J)[:, None], psi
    return 2.0 * MU * e + LAM * trace[:, None], MU * (e * e).sum(1) + 0.5 * LAM * trace**2


def faults(token: str) -> list[str]:
    """What does not hold, empty where all does."""
    return [
        f"{name}, {regime} strains"
        for regime, (size, yields) in REGIMES.items()
        for name, holds in checks(token, size, yields).items()
        if not holds
    ]


def checks(token: str, size: float, yields: float) -> dict[str, bool]:
    """Each property by name."""
    random = np.random.default_rng(0)
    e_trial = random.uniform(-size, size, (N, 3))
    # Half of them inside and on both sides of what hardening adds.
    e_trial[: N // 2] *= np.linspace(0.002, 0.2, N // 2)[:, None]
    U, V = turns(1), turns(2)
    F = (U * np.exp(e_trial)[:, None, :]) @ V.swapaxes(1, 2)
    seen = flow(token, F, random.uniform(0.0, size / 3.0, N), yields)
    # E in the axes of F: diagonal, where flow is coaxial.
    inner = U.swapaxes(1, 2) @ seen.E @ V
    s = np.einsum("nii->ni", inner)
    off = np.abs(inner - s[:, :, None] * np.eye(3)).max()
    e = np.log(np.maximum(s, 1e-9))
    tau_trial, psi_trial = principal(token, e_trial)
    beyond = surface(token, e_trial, tau_trial, seen.before, yields)[0] > 0.0
    assert 0.3 * N < beyond.sum() < N
    tau, psi = principal(token, e)
    excess, slope = surface(token, e, tau, seen.after, yields)
    step = e_trial - e
    length = np.linalg.norm(step, axis=1)
    along = slope / np.linalg.norm(slope, axis=1)[:, None]
    normal = np.abs(step - length[:, None] * along).max(1)
    work = (tau * step).sum(1)
    less = psi_trial - psi
    quadratic = less - work - principal("vonMises", step)[1]
    near = ROUNDING + (SECANT * np.abs(tau_trial).max() if token in OVER else SOLVED * yields)
    most = (tau_trial * step).sum(1)
    bounded = ((less > work - ROUNDING) & (less < most + ROUNDING)).all()
    lessened = bounded if token in OVER else np.abs(quadratic).max() < near
    again = flow(token, seen.E, seen.after, yields)
    Q = turns(3)
    turned = flow(token, Q @ F @ Q.swapaxes(1, 2), seen.before, yields)
    crushed = np.maximum(-step.sum(1), 0.0)
    grown = crushed if token == "crushable" else np.sqrt(2.0 / 3.0) * length
    return {
        "inside nothing changes": bool(
            np.array_equal(seen.E[~beyond], F[~beyond])
            and np.array_equal(seen.after[~beyond], seen.before[~beyond])
            and (seen.loss[~beyond] == 0.0).all()
        ),
        "coaxial": bool(off < ROUNDING),
        "lands on the surface": bool(np.abs(excess[beyond]).max() < near),
        "along the normal": bool(normal[beyond].max() < near),
        "the internal variable is the flow": bool(
            np.abs(seen.after - seen.before - grown)[beyond].max() < near
        ),
        "dissipation is the work of what remains": bool(
            np.abs(seen.loss - work)[beyond].max() < near
        ),
        "dissipation is not negative": bool((seen.loss >= 0.0).all()),
        "energy goes down by it": bool(lessened),
        "idempotent": bool(np.abs(again.E - seen.E).max() < near),
        "turns with the body and the material": bool(
            np.abs(turned.E - Q @ seen.E @ Q.swapaxes(1, 2)).max() < near
        ),
        "keeps the volume": bool(
            token == "crushable" or np.abs(e.sum(1) - e_trial.sum(1)).max() < ROUNDING
        ),
    }
