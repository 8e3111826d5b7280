"""Warnings about a bake's health, as text.

Energy that contact created is an error: the motion is wrong, although nothing else shows it. A
warning is for values that a correct bake does not have, so that ``--strict`` can stop a farm on
them. Events that the solver corrected, and normal ones, appear in the report only: a few frames
that were repeated, and contact at the friction limit, which is a sticking sample.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from gf_usd.core.errors import counted
from gf_usd.core.frames.frame import STRETCH
from gf_usd.core.materials.laws import LAWS
from gf_usd.core.units import code_text, length_text, percent_text, rounded_text

HealthSummary = Mapping[str, Any]

# Of the energy scale, in one frame.  Correct bakes with all presets stay below 1e-4 (measured);
# at 2e-2 the solver repeats the frame.
ENERGY_GAIN = 1e-3
# Of the energy scale, in a whole bake, added by new contact planes.  Arms that close at 6 m/s
# receive 1e-4 (measured).
PLANES_GAIN = 1e-3
REDONE = 0.1  # of the frames: more than one or two hard impacts cause
INSIDE = 0.01  # of the surface: limbs overlap visibly
OUTSIDE = 0.01  # of the particles: the mesh does not show the shape of the body
DEEP = 1.0  # [spacings] visible penetration
SEEN = 0.5  # [spacings] of an obstacle that comes out of a body
RESTING = (
    0.25  # [spacings] contact is designed for 0.08; a narrow foot penetrates deeper than a ball
)
# Of m v: float32 loses digits where a substep adds less to a velocity than its last digit holds.
DRIFT = 0.01
STILL = 1e-9  # of the energy scale: a body with less kinetic energy in all frames did not move
NOT_PERIODIC = 0.01  # of the radius: a visible jump from the end of a cycle to its start
# Deviation from the volume at rest of flowing bodies: 1 % by design of weakly compressible laws.
FLOW_VOLUME = 0.05
SPARSE = 2.0  # flowing particles per grid cell: a layer of one spacing has four
# Volume of a body over that at rest.  The bulk modulus of jelly is 3.7 rho g r, so that a fall from
# three radii, the default, squeezes a ball to 0.59, and it swings back to 1.33 (1.35 with three
# times the particles) without a gain of energy; its mesh has the same volumes.  From four radii it
# has 1.41, shaken by a pin with 3 g 1.48, and as gelatin of 1 kPa and 2 m wide 1.9; a duck of jelly
# that hangs by its head has 1.14, and 5 in single particles next to the pin (measured).
EXPANDED = 1.4
# Share of the volume of a body that is stretched more than STRETCH-fold.  Ducks of jelly that fall
# from 3 and 6 radii have none (their longest stretches are 3.2), one that hangs by its head has
# 0.2, and a leaf of jelly that hangs by its stem 0.9 (measured with 1500 and 3100 particles).
STRETCHED = 0.02
ALTERED = 0.01  # of the particle-frames: the material no longer behaves as specified


# A law without a term in ln J lets particles through J = 0 at a finite stress.
SAFER = {"corotated": "neoHookean", "vonMisesCorotated": "vonMisesNeoHookean"}
LAWS_OF, TIME_OF = "laws", "time_code"  # in a summary, for the rules

WARNING, ERROR = "warning", "error"
ERRORS = ("planes",)  # of RULES


@dataclass(frozen=True, kw_only=True)
class HealthWarning:
    """A value of a bake's health that a sound bake does not have.

    docs/guide/warnings-and-errors.md lists the warnings by their names.
    """

    about: str  # its name, such as "untouched"
    message: str  # the fault, with its numbers
    hint: str  # what to do about it
    level: str = WARNING  # warning | error: a bake with an error fails even without `strict`

    def as_json(self) -> dict[str, str]:
        """Plain values."""
        return asdict(self)


def health_warnings(
    health: HealthSummary,
    laws: Collection[str] = (),
    time_code: Callable[[float], float] | None = None,
) -> tuple[HealthWarning, ...]:
    """The warnings about a summary of `HealthLog`, in the order of RULES.

    laws : tokens of those that the materials have, for hints that name another.
    time_code : of each frame of the summary, that of the stage; None: not stated.
    """
    found = []
    known = {**health, LAWS_OF: laws, TIME_OF: time_code}
    for about, rule in RULES.items():
        if (text := rule(known)) is not None:
            level = ERROR if about in ERRORS else WARNING
            found.append(HealthWarning(about=about, message=text[0], hint=text[1], level=level))
    return tuple(found)


def plan_warnings(odd: str, heavy: str, stated: str) -> tuple[HealthWarning, ...]:
    """The warnings about a body of implausible size in a unit that the file does not state, and
    about a density that no solid has; "": there is none.

    stated : what of the stage gives that density.
    """
    found = []
    if odd:
        hint = "give the unit with --meters-per-unit"
        found.append(HealthWarning(about="size", message=odd, hint=hint))
    if heavy:
        hint = f"correct {stated} in the file, or give the unit of the stage: --meters-per-unit"
        found.append(HealthWarning(about="density", message=heavy, hint=hint))
    return tuple(found)


MessageAndHint = tuple[str, str] | None


def _gentler(h: HealthSummary) -> str:
    """Text: how to make the motion less violent; bodies moved by pins, bones or fields have no
    drop.
    """
    return "lower the impact (--drop)" if h["falls"] else "slow down what moves the body"


def _frame(h: HealthSummary, key: str) -> str:
    """Text: the frame of a summary, with its time code, which is what players show."""
    index, time_code = h[key], h[TIME_OF]
    return f"frame {index}" + (f" (time code {code_text(time_code(index))})" if time_code else "")


def _other_law(h: HealthSummary) -> str:
    """The option of a law that withstands more compression than those of the body; "": none."""
    better = [SAFER[law] for law in h[LAWS_OF] if law in SAFER]
    return f"--law {better[0]}" if better else ""


def _energy(h: HealthSummary) -> MessageAndHint:
    share = h["energy_gain_max_share"]
    if share <= ENERGY_GAIN:
        return None
    return (
        f"energy rose without a known cause: {h['energy_gain_max_J']:.3g} J in one frame,"
        f" {percent_text(share)} of the energy scale of the body",
        f"{_gentler(h)}, or use a softer material",
    )


def _inverted(h: HealthSummary) -> MessageAndHint:
    count = h["inverted_particle_frames"]
    if not count:
        return None
    left = h["inverted_at_end"]
    law = f"{_other_law(h)}, " if _other_law(h) else ""
    end = f"{left} still are at the end" if left else "none is at the end"
    return (
        f"particles turned inside out: up to {h['inverted_max']} at once, from"
        f" {_frame(h, 'first_inverted_frame')} on, down to J = {h['min_J']:.2g}; {end}",
        f"{_gentler(h)}, use {law}a stiffer material or more --particles",
    )


def _expanded(h: HealthSummary) -> MessageAndHint:
    volume = h.get("expanded_volume")
    if volume is None or volume <= EXPANDED or any(LAWS[law].unbounded for law in h[LAWS_OF]):
        return None
    return (
        f"<{h['expanded_body']}> expanded to {volume:.3g} times its volume in"
        f" {_frame(h, 'expanded_frame')}, single particles to {h['max_J']:.2g} times theirs;"
        " solids do not expand like this",
        f"{_gentler(h)}, use a stiffer material, or pin a larger region of what is pinned",
    )


def _stretched(h: HealthSummary) -> MessageAndHint:
    share = h.get("stretched_share")
    if share is None or share <= STRETCHED or any(LAWS[law].flows for law in h[LAWS_OF]):
        return None
    return (
        f"{percent_text(share)} of the volume of <{h['stretched_body']}> was stretched more than"
        f" {STRETCH:g}-fold in {_frame(h, 'stretched_frame')}, single particles"
        f" {h['max_stretch']:.3g}-fold; it is too soft for its own weight or its motion",
        f"use a stiffer material (a preset in pascals for thin parts), {_gentler(h)}, or"
        f" {_held_more(h)}",
    )


def _held_more(h: HealthSummary) -> str:
    """Text: how to hold more of a body that hangs from what is held."""
    if h.get("flesh"):
        return (
            "hold more of the flesh: by stiffer springs to its skinned pose (--goal-frequency 4 or"
            " more), a lower limit (--stretch 0.5 or less), or a larger --bone-radius"
        )
    return "pin a larger region of what is pinned"


def _rollbacks(h: HealthSummary) -> MessageAndHint:
    if h["rollbacks"] <= max(1.0, REDONE * h["frames"]):
        return None
    law = f", or use {_other_law(h)}" if _other_law(h) else ""
    return (
        f"the time step was too long {counted(h['rollbacks'], 'time')} in"
        f" {counted(h['frames'], 'frame')}; these frames were recomputed with half of it",
        f"{_gentler(h)}{law}",
    )


def _clamped(h: HealthSummary) -> MessageAndHint:
    if h["clamped_share"] <= ALTERED:
        return None
    return (
        f"stretches were clamped in {percent_text(h['clamped_share'])} of all particles and frames:"
        " there the material law does not hold",
        f"widen the limits (--clamp), or {_gentler(h)}",
    )


def _capped(h: HealthSummary) -> MessageAndHint:
    if h["stress_capped_share"] <= ALTERED:
        return None
    return (
        f"stress was capped in {percent_text(h['stress_capped_share'])} of all particles and"
        " frames: there the material law does not hold",
        f"raise --stress-cap, or {_gentler(h)}",
    )


def _injected(h: HealthSummary) -> MessageAndHint:
    given = h["injected_J"] - h["planes_J"]
    share = abs(given) / h["energy_scale_J"] if h["energy_scale_J"] else 0.0
    if share <= ALTERED:
        return None
    done = f"added {given:.3g} J to" if given > 0.0 else f"removed {-given:.3g} J from"
    return (
        f"shape corrections {done} the body, {percent_text(share)} of the energy scale of the body",
        "lower --procrustes, or use --no-wls",
    )


def _planes(h: HealthSummary) -> MessageAndHint:
    share = h["planes_gain_share"]
    if share < PLANES_GAIN:
        return None
    return (
        f"contact added {share * h['energy_scale_J']:.3g} J to the bodies,"
        f" {percent_text(share)} of their energy scale",
        f"{_gentler(h)}, or use more --particles; if bodies overlap at the start, move"
        " them apart in the asset",
    )


def _deep(h: HealthSummary) -> MessageAndHint:
    if h["deepest_penetration_spacings"] <= DEEP:
        return None
    return (
        f"the surface sank {rounded_text(h['deepest_penetration_spacings'])} spacings"
        f" ({length_text(h['deepest_penetration_m'])}) into the floor",
        f"{_gentler(h)}, or use a stiffer material",
    )


def _overlap(h: HealthSummary) -> MessageAndHint:
    if h["deepest_overlap_spacings"] <= DEEP:
        return None
    if h["deepest_overlap_m"] <= (h.get("pierced_max_m") or 0.0):
        return None  # see `_pierced`
    depth = (
        f"{rounded_text(h['deepest_overlap_spacings'])} spacings"
        f" ({length_text(h['deepest_overlap_m'])})"
    )
    if names := h.get("overlap_names"):
        fault = f"{names[0]} overlapped {names[1]} by {depth}"
    elif pair := h.get("overlap_pair"):  # of an edge or corner: a sentence
        fault = f"{pair}, {depth} deep"
    else:  # some solvers do not provide it
        fault = f"bodies or obstacles overlapped by {depth}"
    return (
        f"{fault} at {_frame(h, 'overlap_frame')}",
        f"{_gentler(h)}, or use more --particles; if bodies overlap at the start,"
        " move them apart in the asset",
    )


def _pierced(h: HealthSummary) -> MessageAndHint:
    depth, through = h.get("pierced_max_spacings"), h.get("pierced_through")
    if depth is None or depth <= (SEEN if through else DEEP):
        return None
    how = "and comes out on the other side, " if through else ""
    return (
        f"an edge or corner of {h['pierced_pair']}, {how}{rounded_text(depth)} spacings"
        f" ({length_text(h['pierced_max_m'])}) deep at {_frame(h, 'pierced_frame')}",
        "round the edges of the obstacle, make the body thicker, or use more --particles;"
        f" {_gentler(h)}",
    )


def _let_go(h: HealthSummary) -> MessageAndHint:
    if not h["released_max"]:
        return None
    return (
        f"contact points were released, {h['released_max']} at once, and bodies may overlap there:"
        " they were deeper in another surface than they can have moved, where it was folded or"
        " inverted, or an obstacle has more edges and corners in a body than contact can store",
        f"{_gentler(h)}, use a stiffer material, more --particles, or a smoother obstacle",
    )


def _inside(h: HealthSummary) -> MessageAndHint:
    share = h["inside_at_end_share"]
    if share is None or share <= INSIDE:
        return None
    # The faces of a coarse mesh cut through what its body bends around.  Where it is dented without
    # bulging elsewhere, as a foam is, no particle is outside; None: no mesh has long faces.
    coarse = h.get("outside_mesh_max_share") is not None
    first = "divide the faces of the coarse mesh (--max-edge-length auto); then " if coarse else ""
    return (
        f"{percent_text(share)} of the surface is half a spacing or more inside a body at the"
        f" end, up to {length_text(h['inside_at_end_m'])} deep",
        f"{first}use more --particles or a stiffer material,"
        f" {_gentler(h)}, and do not use --no-self-contact",
    )


def _outside(h: HealthSummary) -> MessageAndHint:
    share = h.get("outside_mesh_max_share")
    if share is None or share <= OUTSIDE:
        return None
    return (
        f"faces of {h['outside_mesh']} are too long to show how the body bends: in some frame"
        f" {percent_text(share)} of the particles are a spacing or more outside the mesh, up to"
        f" {length_text(h['outside_mesh_max_m'])}",
        "divide its faces (--max-edge-length auto); the particles and Gaussians show the true"
        " shape",
    )


def _resting(h: HealthSummary) -> MessageAndHint:
    depth = h["resting_penetration_spacings"]
    if depth is None or depth <= RESTING:
        return None
    return (
        f"at rest the surface lies {rounded_text(depth)} spacings deep in the floor",
        "use more --particles for a smaller spacing",
    )


def _drift(h: HealthSummary) -> MessageAndHint:
    linear, spin = h["momentum_drift"], h["angular_momentum_drift"]
    if linear is None or spin is None or max(linear, spin) <= DRIFT:
        return None
    return (
        f"momentum drifted in free flight: by {percent_text(linear)} of the momentum and"
        f" {percent_text(spin)} of the angular momentum of the fastest motion; with"
        f" {h['substeps_max_per_frame']} substeps a frame, rounding errors of single precision add"
        " up",
        "use a softer or less damped material, which allows longer time steps",
    )


def _untouched(h: HealthSummary) -> MessageAndHint:
    met = h["first_contact_frame"] is not None
    if not h["falls"] or met or h["frames"] < 2 or _still(h) is not None:
        return None
    return (
        f"the body touched nothing in {h['frames']} frames: it moved"
        f" {length_text(h['shift_max_m'])} and is still in the air",
        "use more --frames, a lower --drop, or check the unit of the asset (--meters-per-unit)",
    )


def _still(h: HealthSummary) -> MessageAndHint:
    if h["frames"] < 2 or h["kinetic_max_J"] > STILL * h["energy_scale_J"]:
        return None
    return (
        f"nothing moves in {h['frames']} frames",
        "give the body a cause of motion: "
        + ("a height (--drop), " if h["falls"] else "")
        + "gravity, moving pins or colliders",
    )


def _fallen(h: HealthSummary) -> MessageAndHint:
    count = h.get("fallen_bodies", 0)
    if not count:
        return None
    frame = _frame(h, "first_fallen_frame")
    if h["fallen_of"] == 1:
        message = f"the body fell past every obstacle by {frame}, and nothing is below it"
    else:
        message = (
            f"{count} of {h['fallen_of']} bodies fell past every obstacle, the first by {frame},"
            " and nothing is below them"
        )
    return (
        message,
        "add a floor (--floor HEIGHT), make the obstacles larger, or move the bodies over them",
    )


def _lost(h: HealthSummary) -> MessageAndHint:
    count = h.get("lost_particles", 0)
    if not count:
        return None
    are = f"{percent_text(h['lost_share'])} of all, {'is' if count == 1 else 'are'} below"
    return (
        f"{counted(count, 'flowing particle')}, {are} the floor or every obstacle in the last"
        f" frame, the first from {_frame(h, 'first_lost_frame')} on",
        "add a floor (--floor HEIGHT), make obstacles larger or thicker, or use more --particles",
    )


def _unconverted(h: HealthSummary) -> MessageAndHint:
    if h.get("converted_particles") != 0:
        return None
    return (
        "no particle passed the limit of a --conversion, so that everything stayed solid",
        "lower the limit, or simulate more --frames; --stress writes the stress of every particle",
    )


def _flow_volume(h: HealthSummary) -> MessageAndHint:
    low, high = h.get("flow_volume_min"), h.get("flow_volume_max")
    if low is None or high is None or max(1.0 - low, high - 1.0) <= FLOW_VOLUME:
        return None
    # A ball of wet sand of 2 m that falls 3 m has 92.9 % with 8000 particles as with 20000, and no
    # warning with --drop 1r.
    pressed = 1.0 - low > high - 1.0
    worst, hint = (
        (low, f"{_gentler(h)}, or use a larger Young's modulus in a material file")
        if pressed
        else (high, "more --particles resolve it better")
    )
    return f"flowing material has {100.0 * worst:.3g} % of its volume at rest in some frame", hint


def _thin_flow(h: HealthSummary) -> MessageAndHint:
    count = h.get("flow_per_cell_at_end")
    if count is None or count >= SPARSE:
        return None
    return (
        "flowing material is spread too thin for its particles, and looks like single drops or"
        f" grains: a cell of the grid holds {rounded_text(count)} at the end, and about 6 where it"
        " is deep",
        "use more --particles or fewer --frames, or hold it in a container",
    )


def _loop(h: HealthSummary) -> MessageAndHint:
    share = h.get("loop_difference_share", 0.0)
    if share <= NOT_PERIODIC:
        return None
    return (
        f"after {h['loop_cycles']} cycles, the last one differs from the one before by"
        f" {length_text(h['loop_difference_m'])}, {percent_text(share)} of the radius: the loop"
        f" has a visible jump",
        "damp the flesh (--goal-frequency, --damping-time), or repeat the cycle more often"
        f" (--loop {2 * h['loop_cycles']})",
    )


RULES: dict[str, Callable[[HealthSummary], MessageAndHint]] = {
    "untouched": _untouched,
    "still": _still,
    "fallen": _fallen,
    "lost": _lost,
    "unconverted": _unconverted,
    "flow-volume": _flow_volume,
    "thin-flow": _thin_flow,
    "energy": _energy,
    "inside-out": _inverted,
    "expanded": _expanded,
    "stretched": _stretched,
    "redone": _rollbacks,
    "clamp": _clamped,
    "stress-cap": _capped,
    "injected": _injected,
    "planes": _planes,
    "penetration": _deep,
    "overlap": _overlap,
    "pierced": _pierced,
    "let-go": _let_go,
    "inside": _inside,
    "coarse-mesh": _outside,
    "resting-depth": _resting,
    "free-flight": _drift,
    "loop": _loop,
}


def warnings_json(warnings: Sequence[tuple[str, HealthWarning]]) -> list[dict[str, str]]:
    """``[{variant, look, about, message, hint, level}]`` as reports hold it.

    `look` is the name of `variant` before; it stays until 1.0.
    """
    return [{"variant": name, "look": name, **one.as_json()} for name, one in warnings]
