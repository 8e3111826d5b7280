"""What holds of the return mapping of any law that flows, as a list of what does not.

Of a trial gradient F with logarithmic strain e* that returns to E with e in the axes of F:

    the stress of E is on the yield surface, or F = E inside it
    e* - e = l dQ/dtau, l >= 0                       (associated flow)
    the work of flow is tau : (e* - e) >= 0, and psi(F) - psi(E) = that + psi(e* - e)

All laws here have Hencky's energy, a quadratic form in e, which makes the last line exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from lane_kernels import flow_with_loss
from scipy.stats import special_ortho_group

from gf_usd.core.arrays import Floats

MU, LAM, CAP = 2.0, 3.0, 2.12  # [Pa]
BULK = LAM + 2.0 / 3.0 * MU
# Size of the strains and yield stress [Pa]: by principal stretches, and by the series near 1.
REGIMES = {"large": (0.3, 0.05), "small": (3e-3, 5e-4)}
OWN = {
    "vonMises": {"hardening": 0.2, "saturation": 0.04, "saturation_rate": 15.0},
    "crushable": {"hardening": 0.3, "cap_shape": CAP},
}
N = 64
ROUNDING = 1e-13  # of stresses of order 1, in f64: some dozen operations with stretches to 1.4
SOLVED = 1e-9  # of the yield stress: the square of what Newton's iteration leaves before its last


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
    return special_ortho_group.rvs(3, N, random_state=seed)


def flow(token: str, F: Floats, a: Floats, yields: float) -> Returned:
    """The law's return mapping of F (N, 3, 3) and a (N,)."""
    own: dict[str, Any] = {"yield_stress": yields, **OWN[token]}
    E, after, loss = flow_with_loss(token, F, a[:, None], MU, LAM, **own)
    return Returned(F=F, E=E, before=a, after=after[:, 0], loss=loss)


def surface(token: str, tau: Floats, a: Floats, yields: float) -> tuple[Floats, Floats]:
    """Q - Y (n,) [Pa] of principal Kirchhoff stresses (n, 3), and dQ/dtau (n, 3), by the source."""
    p = -tau.mean(1)
    s = tau + p[:, None]
    shear = np.sqrt(1.5) * np.linalg.norm(s, axis=1)
    if token == "crushable":
        scale = 1.0 + CAP**2 / 9.0
        Q = np.sqrt((shear**2 + CAP**2 * p**2) / scale)
        slope = (1.5 * s - CAP**2 * p[:, None] / 3.0) / (scale * Q[:, None])
        return Q - yields - 0.3 * a, slope
    assert token == "vonMises"
    Y = yields + 0.2 * a + 0.04 * (1.0 - np.exp(-15.0 * a))
    return shear - Y, 1.5 * s / shear[:, None]


def hencky(e: Floats) -> tuple[Floats, Floats]:
    """tau (n, 3) and psi (n,) of principal logarithmic strains (n, 3)."""
    trace = e.sum(1)
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
    beyond = surface(token, hencky(e_trial)[0], seen.before, yields)[0] > 0.0
    assert 0.3 * N < beyond.sum() < N
    tau, psi = hencky(e)
    excess, slope = surface(token, tau, seen.after, yields)
    step = e_trial - e
    length = np.linalg.norm(step, axis=1)
    along = slope / np.linalg.norm(slope, axis=1)[:, None]
    normal = np.abs(step - length[:, None] * along).max(1)
    work = (tau * step).sum(1)
    quadratic = hencky(e_trial)[1] - psi - work - hencky(step)[1]
    again = flow(token, seen.E, seen.after, yields)
    Q = turns(3)
    turned = flow(token, Q @ F @ Q.swapaxes(1, 2), seen.before, yields)
    near = ROUNDING + SOLVED * yields
    grown = {
        "vonMises": np.sqrt(2.0 / 3.0) * length,
        "crushable": np.maximum(-step.sum(1), 0.0),
    }[token]
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
        "energy goes down by it": bool(np.abs(quadratic).max() < near),
        "idempotent": bool(np.abs(again.E - seen.E).max() < near),
        "turns with the body and the material": bool(
            np.abs(turned.E - Q @ seen.E @ Q.swapaxes(1, 2)).max() < near
        ),
        "keeps the volume": bool(
            token != "vonMises" or np.abs(e.sum(1) - e_trial.sum(1)).max() < ROUNDING
        ),
    }
