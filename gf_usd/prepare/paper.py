"""The paper's options: what was asked of `--wls`, `--procrustes`, `--clamp` and `--stress-cap`.

All are off but in the preset `paper`, which has them as GaussianFlesh sections 3.2 and 4.3 do.  Two
of its numbers hang on the material, so that settings are completed for each: the shape correction
is rubber's alone, and the cap is tau = 100 in the units in which rubber has mu = 40, which are
mu = 26.1 rho g0 r here (`materials`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gf_usd.core.errors import UsageError
from gf_usd.core.frames import Settings
from gf_usd.core.materials import G0, Material

PAPER_CLAMP = (0.2, 5.0)
PAPER_CAP = 100.0 / 0.156 / G0  # [rho g0 r] tau = 100 where r = 1 and, as fitted, rho = 0.156
PAPER_PROCRUSTES = {"rubber": 0.02}
NONE = "none"


def check(
    wls: bool | None,
    procrustes: float | None,
    clamp: str | None,
    stress_cap: str | None,
    *,
    solver: str | None,
    pinned: bool,
) -> None:
    """Raise UsageError for values that make no sense, or that the solver asked for cannot do."""
    alpha = procrustes
    if alpha is not None and not 0.0 <= alpha <= 1.0:
        raise UsageError(f"--procrustes is {alpha:g}", "give a number from 0 to 1")
    parse_clamp(clamp)
    parse_cap(stress_cap)
    if solver == "ul":
        for option, given in (("--wls", wls), ("--procrustes", alpha)):
            if given:
                raise UsageError(
                    f"--solver ul does not know {option}",
                    f"leave {option} out, or use --solver tl",
                )
    if alpha and pinned:
        raise UsageError(
            f"--procrustes {alpha:g} moves the body towards its rest shape about its mean, and"
            " --pin holds it elsewhere",
            "leave one of the two out",
        )


def parse_clamp(text: str | None) -> tuple[float, float] | None:
    """Limits of the singular values of F, of "0.2:5"; None for "none" and where nothing is said."""
    if text is None or text == NONE:
        return None
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        low = high = float("nan")
    if not 0.0 < low < 1.0 < high < np.inf:
        raise UsageError(
            f"--clamp is {text!r}", "give two stretches about 1, such as 0.2:5, or none"
        )
    return low, high


def parse_cap(text: str | None) -> float | None:
    """[Pa] of "2e4"; None for "none" and where nothing is said."""
    if text is None or text == NONE:
        return None
    try:
        cap = float(text)
    except ValueError:
        cap = float("nan")
    if not 0.0 < cap < np.inf:
        raise UsageError(f"--stress-cap is {text!r}", "give a stress above 0 [Pa], or none")
    return cap


def of_material(
    settings: Settings,
    material: Material,
    radius: float,
    *,
    paper: bool,
    pinned: bool,
    wls: bool | None,
    procrustes: float | None,
    clamp: str | None,
    stress_cap: str | None,
) -> Settings:
    """The settings of one material's bake, its options filled in.

    radius : r = (3 V / 4 pi)^(1/3) [m] of the body; paper : by the preset, where None is said.
    """
    total_lagrangian = settings.solver == "tl"
    stretches, cap = parse_clamp(clamp), parse_cap(stress_cap)
    if paper and procrustes is None and total_lagrangian and not pinned:
        procrustes = PAPER_PROCRUSTES.get(material.name, 0.0)
    if paper and clamp is None:
        stretches = PAPER_CLAMP
    if paper and stress_cap is None:
        cap = PAPER_CAP * material.density * G0 * radius
    if wls is None:
        wls = paper and total_lagrangian
    return replace(settings, wls=wls, procrustes=procrustes or 0.0, clamp=stretches, stress_cap=cap)


def notes(settings: Settings, material: str = "") -> tuple[str, ...]:
    """What the options do to a bake, in words; material: whose, where there are several."""
    said = []
    if settings.wls:
        said.append(
            "F is computed anew once a frame from the places of the particles (WLS, GaussianFlesh"
            " 3.2): this gives energy to the body, which the report counts"
        )
    if settings.procrustes:
        said.append(
            f"once a frame the body is moved {100.0 * settings.procrustes:g} % of the way to its"
            " rest shape as it lies (Procrustes, GaussianFlesh 4.3): it cannot turn freely"
        )
    if settings.clamp:
        low, high = settings.clamp
        said.append(f"stress is taken of F with its stretches clipped to {low:g} .. {high:g}")
    if settings.stress_cap:
        said.append(f"stress is cut to |P| = {settings.stress_cap:.4g} Pa")
    if settings.clamp or settings.stress_cap:
        said.append("frames in which stretch or stress was cut are not judged by their energy")
    return tuple(f"{material}: {line}" if material else line for line in said)
