"""Which numbers of a bake deserve a warning: each rule on both sides of its limit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from solids import ball, preset_material, settings

from gf_usd.core.errors import UnhealthyError
from gf_usd.core.frames.frame import Health
from gf_usd.pipeline.health import warnings as rules
from gf_usd.pipeline.health.log import HealthLog
from gf_usd.pipeline.health.warnings import RULES, health_warnings
from gf_usd.pipeline.result import BakeResult, VariantResult, require_healthy


def summary(*frames: Health, **changes: Any) -> dict[str, Any]:
    """Of a body of 1 kg and half a meter, 100 particles a tenth apart; 10 J are its scale."""
    log = HealthLog(
        settings(gravity=(0.0, -9.81, 0.0)), spacing=0.1, drop=1.0, radius=0.5, particles=100
    )
    for frame in (Health(mass=1.0, elastic=10.0), *frames):
        log.add(frame)
    return {**log.summary(), "falls": False, "kinetic_max_J": 10.0, **changes}


FLYING = {"momentum_drift": 0.0, "angular_momentum_drift": 0.0}  # of frames that do not move


def many(count: int, **changes: Any) -> list[Health]:
    return [Health(mass=1.0, **changes)] * count


# rule -> (just sound, just not, a piece of the words with the number)
CASES: dict[str, tuple[dict[str, Any], dict[str, Any], str]] = {
    "untouched": (
        summary(*many(3), **FLYING, falls=True, first_contact_frame=3),
        summary(*many(3), **FLYING, falls=True, shift_max_m=0.25),
        "the body touched nothing in 4 frames: it moved 25 cm",
    ),
    "still": (
        summary(*many(3), **FLYING, kinetic_max_J=2e-8),
        summary(*many(3), **FLYING, kinetic_max_J=0.0, falls=True),
        "nothing moves in 4 frames",
    ),
    "energy": (
        summary(Health(elastic=10.009)),
        summary(Health(elastic=10.2)),
        "0.2 J in one frame, 2 % of the energy scale",
    ),
    "inside-out": (
        summary(Health(min_J=0.01)),
        summary(Health(inverted=3, min_J=-0.5), Health(inverted=1, min_J=-0.1)),
        "up to 3 at once, from frame 1 on, down to J = -0.5; 1 still are at the end",
    ),
    "expanded": (
        summary(Health(max_J=3.7, expanded=1.4, expanded_body="/A")),
        summary(Health(max_J=5.0, expanded=1.5, expanded_body="/A")),
        "</A> expanded to 1.5 times its volume in frame 1, single particles to 5 times theirs",
    ),
    "stretched": (
        summary(Health(max_stretch=21.0, stretched=0.02, stretched_body="/A")),
        summary(Health(max_stretch=21.0, stretched=0.4, stretched_body="/A")),
        "40 % of the volume of </A> was stretched more than 4-fold in frame 1, single particles"
        " 21-fold; it is too soft",
    ),
    "redone": (
        summary(*many(18), *many(2, rollbacks=1), **FLYING),
        summary(*many(17), *many(3, rollbacks=1), **FLYING),
        "3 times in 21 frames",
    ),
    "clamp": (
        summary(Health(clamped=2)),
        summary(Health(clamped=3)),
        "clamped in 1.5 % of all particles and frames",
    ),
    "stress-cap": (
        summary(Health(stress_capped=2)),
        summary(Health(stress_capped=3)),
        "capped in 1.5 % of all particles and frames",
    ),
    "injected": (
        summary(Health(elastic=10.0, injected=0.09)),
        summary(Health(elastic=10.0, injected=0.11)),
        "added 0.11 J to the body, 1.1 %",
    ),
    "planes": (
        summary(Health(elastic=10.0, injected=0.0099, planes=0.0099), Health(planes=-0.1)),
        summary(Health(elastic=10.0, injected=0.01, planes=0.01), Health(planes=-0.1)),
        "added 0.01 J to the bodies, 0.1 % of",
    ),
    "penetration": (
        summary(Health(penetration=0.099, kinetic=5.0)),
        summary(Health(penetration=0.101, kinetic=5.0)),
        "sank 1 spacings (10.1 cm) into the floor",
    ),
    "overlap": (
        summary(Health(overlap=0.099)),
        summary(
            Health(overlap=0.101, overlap_names=("</A>", "the obstacle </B>")),
            Health(overlap=0.05, overlap_names=("</C>", "</D>")),
        ),
        "</A> overlapped the obstacle </B> by 1 spacings (10.1 cm) at frame 1",
    ),
    "pierced": (
        summary(
            Health(pierced=0.049, pierced_through=True, pierced_pair="the obstacle </A> is in </B>")
        ),
        summary(
            Health(
                pierced=0.08, pierced_through=False, pierced_pair="the obstacle </A> is in </C>"
            ),
            Health(
                pierced=0.051, pierced_through=True, pierced_pair="the obstacle </A> is in </B>"
            ),
        ),
        "an edge or corner of the obstacle </A> is in </B>, and comes out on the other side,"
        " 0.51 spacings (5.1 cm) deep at frame 2",
    ),
    "let-go": (
        summary(Health(let_go=0)),
        summary(Health(let_go=3)),
        "released, 3 at once",
    ),
    "inside": (
        summary(Health(inside_share=0.01, inside_depth=0.02)),
        summary(Health(inside_share=0.02, inside_depth=0.03)),
        "is half a spacing or more inside a body at the end, up to 3 cm deep",
    ),
    "coarse-mesh": (
        summary(Health(outside_share=0.01, outside_depth=0.02, outside_mesh="</Box>")),
        summary(Health(outside_share=0.02, outside_depth=0.03, outside_mesh="</Box>")),
        "faces of </Box> are too long to show how the body bends: in some frame 2 % of the"
        " particles are a spacing or more outside the mesh, up to 3 cm",
    ),
    "resting-depth": (
        summary(Health(penetration=0.024)),
        summary(Health(penetration=0.026)),
        "lies 0.26 spacings deep in the floor",
    ),
    "free-flight": (
        summary(momentum_drift=0.009, angular_momentum_drift=0.009),
        summary(momentum_drift=0.001, angular_momentum_drift=0.011),
        "by 0.1 % of the momentum and 1.1 % of the angular momentum",
    ),
    "fallen": (
        summary(Health(fallen=0, fallen_kinetic=0.0)),
        summary(Health(fallen=0), Health(fallen=1), Health(fallen=1)),
        "the body fell past every obstacle by frame 2, and nothing is below it",
    ),
    "lost": (
        summary(Health(lost=0, flow_volume=1.0)),
        summary(Health(lost=0), Health(lost=3, flow_volume=1.0)),
        "are below the floor or every obstacle in the last frame, the first from frame 2 on",
    ),
    "unconverted": (
        summary(Health(converted=0), Health(converted=1)),
        summary(Health(converted=0), Health(converted=0)),
        "no particle passed the limit of a --conversion",
    ),
    "flow-volume": (
        summary(Health(lost=0, flow_volume=0.951)),
        summary(Health(lost=0, flow_volume=0.94), Health(lost=0, flow_volume=1.01)),
        "flowing material has 94 % of its volume at rest",
    ),
    "thin-flow": (
        summary(Health(lost=0, flow_per_cell=1.0), Health(lost=0, flow_per_cell=2.0)),
        summary(Health(lost=0, flow_per_cell=6.0), Health(lost=0, flow_per_cell=1.25)),
        "looks like single drops or grains: a cell of the grid holds 1.2 at the end",
    ),
    "loop": (
        summary(loop_cycles=4, loop_difference_m=0.005, loop_difference_share=0.01),
        summary(loop_cycles=16, loop_difference_m=0.006, loop_difference_share=0.012),
        "after 16 cycles, the last one differs from the one before by 6 mm, 1.2 % of the radius",
    ),
}


def test_every_rule_has_its_case() -> None:
    assert set(CASES) == set(RULES)


def test_a_frame_has_the_time_code_that_players_show() -> None:
    (warning,) = health_warnings(CASES["inside-out"][1], time_code=lambda frame: 1001.0 + frame)
    assert "up to 3 at once, from frame 1 (time code 1002) on, down to" in warning.message


def test_flesh_that_hangs_is_held_by_its_own_options() -> None:
    """A character has no --pin: the hint named a larger pinned region."""
    stretched = CASES["stretched"][1]
    (warning,) = health_warnings({**stretched, "flesh": True})
    assert "--goal-frequency 4" in warning.hint
    assert "--stretch 0.5" in warning.hint
    assert "pin" not in warning.hint
    (other,) = health_warnings(stretched)
    assert "pin a larger region" in other.hint


@pytest.mark.parametrize("about", CASES)
def test_both_sides_of_a_limit(about: str) -> None:
    sound, unsound, message = CASES[about]
    assert health_warnings(sound) == ()
    (warning,) = health_warnings(unsound)
    assert warning.about == about
    assert message in warning.message
    assert warning.hint
    assert warning.as_json() == {
        "about": about, "message": warning.message, "hint": warning.hint,
        "level": "error" if about == "planes" else "warning",
    }  # fmt: skip


@pytest.mark.parametrize("about", CASES)
def test_only_what_falls_is_to_fall_from_a_lower_height(about: str) -> None:
    """A body that bones or pins hold has no drop: --flesh refuses one."""
    (held,) = health_warnings({**CASES[about][1], "falls": False}) or (None,)
    assert held is None or "--drop" not in held.hint
    if about in ("energy", "penetration", "overlap", "pierced", "inside", "clamp", "flow-volume"):
        falls = {**CASES[about][1], "falls": True, "first_contact_frame": 1}
        (warning,) = health_warnings(falls)
        assert "lower the impact (--drop)" in warning.hint


def test_faces_that_are_too_coarse_are_to_be_divided_before_anything_else() -> None:
    """Of dominoes of 12 faces each 20 % were inside others, of the same with divided faces nothing:
    the hint proposed more particles.
    """
    coarse = Health(inside_share=0.2, inside_depth=0.01, outside_share=0.14, outside_mesh="</D>")
    inside, _ = health_warnings(summary(coarse))
    assert inside.about == "inside"
    assert inside.hint.startswith("divide the faces of the coarse mesh (--max-edge-length auto)")
    # A ball that dents a cushion of styrofoam of 6 faces: none of its particles is outside.
    (inside,) = health_warnings(summary(replace(coarse, outside_share=0.0)))
    assert inside.hint.startswith("divide the faces of the coarse mesh (--max-edge-length auto)")
    fine = replace(coarse, outside_share=None, outside_mesh=None)
    (inside,) = health_warnings(summary(fine))
    assert inside.hint.startswith("use more --particles")


@pytest.mark.parametrize("about", ["inside-out", "redone"])
def test_a_law_is_named_only_to_those_that_do_not_have_it(about: str) -> None:
    """The presets are Neo-Hookean already: "use --law neoHookean" did not apply to them."""
    unsound = CASES[about][1]
    (corotated,) = health_warnings(unsound, ["neoHookean", "corotated"])
    assert "use --law neoHookean" in corotated.hint
    (flowing,) = health_warnings(unsound, ["vonMisesCorotated"])
    assert "use --law vonMisesNeoHookean" in flowing.hint
    (there,) = health_warnings(unsound, ["neoHookean", "vonMises"])
    assert "--law" not in there.hint


def test_what_flows_without_limit_may_expand() -> None:
    wide = summary(Health(max_J=5.0, expanded=1.5, expanded_body="/A"))
    assert [w.about for w in health_warnings(wide, ["neoHookean"])] == ["expanded"]
    assert health_warnings(wide, ["neoHookean", "snow"]) == ()


def test_what_is_plastic_may_stretch() -> None:
    """Its F includes the flow, which stores no energy."""
    long = summary(Health(max_stretch=21.0, stretched=0.4, stretched_body="/A"))
    assert [w.about for w in health_warnings(long, ["neoHookean"])] == ["stretched"]
    assert health_warnings(long, ["vonMises"]) == ()


def test_lengths_of_large_bodies_are_in_meters() -> None:
    """A tractor read in the wrong unit had "2.69e+04 mm"."""
    large = summary(Health(outside_share=0.02, outside_depth=26.9, outside_mesh="</Box>"))
    (warning,) = health_warnings(large)
    assert warning.message.endswith("up to 26.9 m")


def test_friction_at_its_limit_is_how_a_sample_sticks() -> None:
    assert health_warnings(summary(Health(friction_capped=10**9))) == ()


def test_what_is_not_known_is_not_warned_of() -> None:
    assert summary(Health(mass=1.0))["momentum_drift"] is not None
    unknown = summary(momentum_drift=None, angular_momentum_drift=None)
    assert health_warnings(unknown) == ()


def test_a_hard_landing_may_be_redone() -> None:
    # one of two frames: a share says little of a short bake
    assert health_warnings(summary(Health(rollbacks=1))) == ()
    assert health_warnings(summary(Health(rollbacks=2))) != ()


def result(*healths: dict[str, Any]) -> BakeResult:
    material = preset_material("rubber", ball(100)[0])
    bakes = [
        VariantResult(
            variant=f"look{i}", cache=Path("c.usdc"), material=material, frames=2, health=health,
            warnings=health_warnings(health),
        )
        for i, health in enumerate(healths)
    ]  # fmt: skip
    return BakeResult(
        root=Path("out/duck.usda"), report=Path("r.json"), bakes=tuple(bakes), particles=100,
        seconds=1.0, settings=settings(),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("known", "sentence"),
    [
        ({"overlap_names": ("</A>", "itself")}, "</A> overlapped itself by 2 spacings (20 cm) at"),
        ({}, "bodies or obstacles overlapped by 2 spacings (20 cm) at"),
        (
            {"overlap_pair": "the obstacle </B> is in </A>"},
            "the obstacle </B> is in </A>, 2 spacings (20 cm) deep at",
        ),
    ],
)
def test_the_sentence_on_an_overlap_names_what_is_known(
    known: dict[str, Any], sentence: str
) -> None:
    (warning,) = health_warnings(summary(Health(overlap=0.2, **known)))
    assert warning.message.startswith(sentence)


def test_strict_passes_what_is_sound() -> None:
    require_healthy(result(summary()), strict=True)


def test_strict_names_every_warning_and_says_that_the_files_are_there() -> None:
    twice = Health(inverted=3, min_J=-0.5, penetration=0.2, kinetic=5.0)
    once = replace(twice, inverted=0, min_J=1.0)
    unsound = result(summary(), summary(twice, falls=True), summary(once, falls=True))
    with pytest.raises(UnhealthyError) as caught:
        require_healthy(unsound, strict=True)
    error = caught.value
    assert error.exit_status == 4
    assert error.result is unsound
    assert [c.about for c in error.warnings] == ["inside-out", "penetration", "penetration"]
    first, *lines = error.message.splitlines()
    assert first == (
        "out/duck.usda: the bake is complete and its files are written, but it has 3 warnings:"
    )
    expected = [
        text
        for name, one in unsound.warnings
        for text in (f"  {name}: {one.message} [{one.about}]", f"    hint: {one.hint}")
    ]
    assert [*lines] == expected, "each warning has its own hint"
    assert error.hint == "see that of each warning; without --strict this is not an error"


def test_one_warning_is_one() -> None:
    sunk = result(summary(Health(penetration=0.2, kinetic=5.0)))
    with pytest.raises(UnhealthyError, match="but it has a warning:") as caught:
        require_healthy(sunk, strict=True)
    (hint,) = (one.hint for _, one in sunk.warnings)
    assert "hint" not in caught.value.message
    assert caught.value.hint == f"{hint}; without --strict this is not an error"


def test_energy_that_contact_made_is_an_error_without_strict() -> None:
    made = Health(elastic=10.0, injected=0.01, planes=0.01)
    sunk = Health(penetration=0.2, kinetic=5.0)
    require_healthy(result(summary(sunk)), strict=False)
    with pytest.raises(UnhealthyError, match="but it has an error:") as caught:
        require_healthy(result(summary(sunk), summary(made)), strict=False)
    assert [c.about for c in caught.value.warnings] == ["planes"]
    assert "--strict" not in caught.value.hint


def test_limits_have_a_margin_to_sound_bakes() -> None:
    # The solver redoes a frame that gains more than `physics.guard.GAIN`: a limit above it would
    # never be met.
    from gf_usd.physics.frame_loop import GAIN

    assert rules.ENERGY_GAIN < GAIN


def test_the_hint_on_the_volume_of_what_flows_is_for_its_direction() -> None:
    """More particles leave the compression of a fall as it is."""
    met = {"falls": True, "first_contact_frame": 1}
    (pressed,), (swollen,) = (
        health_warnings(summary(Health(lost=0, flow_volume=volume)) | met)
        for volume in (0.93, 1.09)
    )
    assert pressed.message.startswith("flowing material has 93 %")
    assert pressed.hint.startswith("lower the impact (--drop), or use a larger Young's modulus")
    assert swollen.message.startswith("flowing material has 109 %")
    assert swollen.hint == "more --particles resolve it better"


def test_of_several_bodies_the_number_that_fell_is_named() -> None:
    (found,) = health_warnings(summary(fallen_bodies=2, fallen_of=5, first_fallen_frame=3))
    assert found.message.startswith("2 of 5 bodies fell past every obstacle, the first by frame 3")
