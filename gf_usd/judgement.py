"""What of a bake's health deserves a warning, in plain words.

A warning is for numbers that a sound bake does not have, so that ``--strict`` may stop a farm on
them.  What the solver met and mended, or what is usual, is told in the report and warned of by
nobody: a few frames that were redone, and friction at its limit, which is how a sample sticks.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from gf_usd.errors import UnhealthyError

if TYPE_CHECKING:
    from gf_usd.plan import BakeResult

Health = Mapping[str, Any]

# Of the energy scale, in one frame.  Sound bakes of all looks stay under 1e-4 (measured); at 2e-2
# the solver redoes the frame.
ENERGY_GAIN = 1e-3
REDONE = 0.1  # of the frames: more often than at a hard landing or two
DEEP = 1.0  # [spacings] the surface visibly sinks in
RESTING = (
    0.25  # [spacings] the contact is laid out for 0.08; a narrow foot sinks deeper than a ball
)
# Of m v: float32 loses digits where a substep adds less to a velocity than its last digit holds.
DRIFT = 0.01
ALTERED = 0.01  # of the particle-frames: the material is no longer the one that was asked for


@dataclass(frozen=True, kw_only=True)
class Caution:
    """One warning."""

    about: str  # the row of RULES that it came from
    message: str
    hint: str

    def as_json(self) -> dict[str, str]:
        """Plain values."""
        return asdict(self)


def judge(health: Health) -> tuple[Caution, ...]:
    """The warnings that a summary of `HealthLog` deserves, in the order of RULES."""
    found = []
    for about, rule in RULES.items():
        if (said := rule(health)) is not None:
            found.append(Caution(about=about, message=said[0], hint=said[1]))
    return tuple(found)


def require_healthy(result: BakeResult) -> None:
    """Raise UnhealthyError where a finished bake has warnings; its files are there and stay."""
    warnings = result.warnings
    if not warnings:
        return
    lines = "".join(f"\n  {look}: {caution.message}" for look, caution in warnings)
    hints = list(dict.fromkeys(caution.hint for _, caution in warnings))
    count = "a warning" if len(warnings) == 1 else f"{len(warnings)} warnings"
    raise UnhealthyError(
        f"{result.root}: the bake is complete and its files are written, but it has {count}:"
        f"{lines}",
        "; ".join(hints) + "; without --strict this is no error",
        warnings=tuple(caution for _, caution in warnings),
        result=result,
    )


Said = tuple[str, str] | None


def _energy(h: Health) -> Said:
    share = h["energy_gain_max_share"]
    if share <= ENERGY_GAIN:
        return None
    return (
        f"energy was made out of nothing: {h['energy_gain_max_J']:.3g} J in one frame,"
        f" {100.0 * share:.2g} % of what the body has to move and strain with",
        "lower the impact (--drop), or take a softer material",
    )


def _inverted(h: Health) -> Said:
    count = h["inverted_particle_frames"]
    if not count:
        return None
    left = h["inverted_at_end"]
    end = f"{left} still are at the end" if left else "none is at the end"
    return (
        f"particles were turned inside out: up to {h['inverted_max']} at once, from frame"
        f" {h['first_inverted_frame']} on, down to J = {h['min_J']:.2g}; {end}",
        "lower the impact (--drop), use --law neoHookean, a stiffer material or more --particles",
    )


def _rollbacks(h: Health) -> Said:
    if h["rollbacks"] <= max(1.0, REDONE * h["frames"]):
        return None
    return (
        f"the step was too long {h['rollbacks']} times in {h['frames']} frames, which were redone"
        " with half of it",
        "lower the impact (--drop), or use --law neoHookean",
    )


def _clamped(h: Health) -> Said:
    if h["clamped_share"] <= ALTERED:
        return None
    return (
        f"stretches were clamped in {100.0 * h['clamped_share']:.2g} % of all particles and frames:"
        " there the body is not of the material asked for",
        "widen the limits (--clamp), or lower the impact (--drop)",
    )


def _capped(h: Health) -> Said:
    if h["stress_capped_share"] <= ALTERED:
        return None
    return (
        f"stress was cut in {100.0 * h['stress_capped_share']:.2g} % of all particles and frames:"
        " there the body is not of the material asked for",
        "raise --stress-cap, or lower the impact (--drop)",
    )


def _injected(h: Health) -> Said:
    share = abs(h["injected_J"]) / h["energy_scale_J"] if h["energy_scale_J"] else 0.0
    if share <= ALTERED:
        return None
    joules = abs(h["injected_J"])
    done = f"put {joules:.3g} J into" if h["injected_J"] > 0.0 else f"took {joules:.3g} J out of"
    return (
        f"corrections of the shape and new contact planes {done} the body,"
        f" {100.0 * share:.2g} % of what it has to move and strain with",
        "where bodies crash, lower the impact (--drop) or take more --particles; else lower"
        " --procrustes, or use --no-wls",
    )


def _deep(h: Health) -> Said:
    if h["deepest_penetration_spacings"] <= DEEP:
        return None
    return (
        f"the surface sank {h['deepest_penetration_spacings']:.2g} spacings"
        f" ({h['deepest_penetration_m']:.3g} m) into the floor",
        "lower the impact (--drop)",
    )


def _overlap(h: Health) -> Said:
    if h["deepest_overlap_spacings"] <= DEEP:
        return None
    return (
        f"bodies or obstacles overlapped by {h['deepest_overlap_spacings']:.2g} spacings"
        f" ({h['deepest_overlap_m']:.3g} m)",
        "lower the impact (--drop), or take more --particles; bodies that overlap at the start are"
        " moved apart in the asset",
    )


def _let_go(h: Health) -> Said:
    if not h["let_go_max"]:
        return None
    return (
        f"{h['let_go_max']} contact points at once seemed deeper in another surface than they can"
        " have come, where it was folded or turned inside out, and were let go: there the bodies"
        " may stand in each other",
        "lower the impact (--drop), take a stiffer material, or more --particles",
    )


def _resting(h: Health) -> Said:
    depth = h["resting_penetration_spacings"]
    if depth is None or depth <= RESTING:
        return None
    return (
        f"at rest the surface lies {depth:.2g} spacings deep in the floor",
        "more --particles make a spacing smaller",
    )


def _drift(h: Health) -> Said:
    linear, spin = h["momentum_drift"], h["angular_momentum_drift"]
    if linear is None or spin is None or max(linear, spin) <= DRIFT:
        return None
    return (
        f"the free flight is off: by {100.0 * linear:.2g} % of the momentum and"
        f" {100.0 * spin:.2g} % of the angular momentum of the fastest motion; with"
        f" {h['substeps_max_per_frame']} substeps a frame single precision loses digits",
        "a softer or less damped material takes longer steps",
    )


RULES: dict[str, Callable[[Health], Said]] = {
    "energy": _energy,
    "inside-out": _inverted,
    "redone": _rollbacks,
    "clamp": _clamped,
    "stress-cap": _capped,
    "injected": _injected,
    "penetration": _deep,
    "overlap": _overlap,
    "let-go": _let_go,
    "resting-depth": _resting,
    "free-flight": _drift,
}


def cautions_json(warnings: Sequence[tuple[str, Caution]]) -> list[dict[str, str]]:
    """``[{look, about, message, hint}]`` as reports hold it."""
    return [{"look": look, **caution.as_json()} for look, caution in warnings]
