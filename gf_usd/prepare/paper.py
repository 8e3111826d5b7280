"""The paper's options: `--wls`, `--procrustes`, `--clamp` and `--stress-cap`.

All are off except in the preset `paper`, which has them as in GaussianFlesh sections 3.2 and 4.3.
Two of its values depend on the material, so settings are completed for each material: shape
correction is for rubber only, and the cap is tau = 100 in the units in which rubber has mu = 40,
which are mu = 26.1 rho g0 r here (`materials`).
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

from gf_usd.core.frames.settings import Settings
from gf_usd.core.materials.dimensionless import G0
from gf_usd.core.materials.material import Material

PAPER_CLAMP = (0.2, 5.0)
PAPER_CAP = 100.0 / 0.156 / G0  # [rho g0 r] tau = 100 where r = 1 and, as fitted, rho = 0.156
PAPER_PROCRUSTES = {"rubber": 0.02}


def of_material(
    settings: Settings,
    material: Material,
    radius: float,
    *,
    paper: bool,
    pinned: bool,
    wls: bool | None,
    procrustes: float | None,
    clamp: tuple[float, float] | None,
    stress_cap: float | None,
    given: Collection[str],
) -> Settings:
    """The settings of a bake with one material, with its options.

    radius : r = (3 V / 4 pi)^(1/3) [m] of the body; paper : use the preset's clamp and stress_cap
        unless they are `given`; their value may be None.
    """
    total_lagrangian = settings.solver == "tl"
    if paper and procrustes is None and total_lagrangian and not pinned:
        procrustes = PAPER_PROCRUSTES.get(material.name, 0.0)
    if paper and "clamp" not in given:
        clamp = PAPER_CLAMP
    if paper and "stress_cap" not in given:
        stress_cap = PAPER_CAP * material.density * G0 * radius
    if wls is None:
        wls = paper and total_lagrangian
    return replace(
        settings, wls=wls, procrustes=procrustes or 0.0, clamp=clamp, stress_cap=stress_cap
    )


def notes(settings: Settings, material: str = "") -> tuple[str, ...]:
    """What the options do to a bake, as text; material: whose, where there are several."""
    lines = []
    if settings.wls:
        lines.append(
            "F is recomputed once per frame from the positions of the particles (WLS,"
            " GaussianFlesh 3.2): this adds energy to the body, which the report counts"
        )
    if settings.procrustes:
        lines.append(
            f"once a frame the body is moved {100.0 * settings.procrustes:g} % of the way to its"
            " rest shape in its current orientation (Procrustes, GaussianFlesh 4.3): it cannot"
            " turn freely"
        )
    if settings.clamp:
        low, high = settings.clamp
        lines.append(f"stress is evaluated at F with its stretches clamped to {low:g} .. {high:g}")
    if settings.stress_cap:
        lines.append(f"stress is capped at |P| = {settings.stress_cap:.4g} Pa")
    if settings.clamp or settings.stress_cap:
        lines.append(
            "the energy check skips frames in which stretch was clamped or stress was capped"
        )
    return tuple(f"{material}: {line}" if material else line for line in lines)
