"""From --wls, --procrustes, --clamp, --stress-cap and --preset paper to settings."""

from __future__ import annotations

from typing import Any

import pytest
from solids import settings

from gf_usd.core.errors import UsageError
from gf_usd.core.frames.settings import Settings
from gf_usd.core.materials.dimensionless import DIMENSIONLESS, G0
from gf_usd.prepare.options.request import Request
from gf_usd.prepare.options.texts import NONE
from gf_usd.prepare.paper import notes, of_material
from gf_usd.prepare.plan import command_line

RADIUS = 0.05
CLAMP = "give two stretches about 1, such as 0.2:5, or none"
CAP = "give a stress above 0 [Pa], or none"

# options, message, hint
REFUSED = [
    ({"procrustes": -0.1}, "--procrustes is -0.1", "give a number from 0 to 1"),
    ({"procrustes": 1.5}, "--procrustes is 1.5", "give a number from 0 to 1"),
    ({"procrustes": float("nan")}, "--procrustes is nan", "give a number from 0 to 1"),
    ({"clamp": "0.2"}, "--clamp is '0.2'", CLAMP),
    ({"clamp": "0.2:5:6"}, "--clamp is '0.2:5:6'", CLAMP),
    ({"clamp": "low:high"}, "--clamp is 'low:high'", CLAMP),
    ({"clamp": "0:5"}, "--clamp is '0:5'", CLAMP),
    ({"clamp": "1.1:5"}, "--clamp is '1.1:5'", CLAMP),
    ({"clamp": "0.2:0.9"}, "--clamp is '0.2:0.9'", CLAMP),
    ({"clamp": "0.2:inf"}, "--clamp is '0.2:inf'", CLAMP),
    ({"stress_cap": "-1"}, "--stress-cap is '-1'", CAP),
    ({"stress_cap": "nan"}, "--stress-cap is 'nan'", CAP),
    ({"stress_cap": "2kPa"}, "--stress-cap is '2kPa'", CAP),
    (
        {"solver": "ul", "wls": True},
        "--solver ul does not support --wls",
        "leave --wls out, or use --solver tl",
    ),
    (
        {"solver": "ul", "procrustes": 0.1},
        "--solver ul does not support --procrustes",
        "leave --procrustes out, or use --solver tl",
    ),
    (
        {"pins": ("/Duck",), "procrustes": 0.1},
        "--procrustes 0.1 moves the body towards its rest shape about its mean, which"
        " conflicts with --pin",
        "leave one of the two out",
    ),
]


@pytest.mark.parametrize(("options", "message", "hint"), REFUSED)
def test_options_that_make_no_sense(options: dict, message: str, hint: str) -> None:
    with pytest.raises(UsageError) as caught:
        Request(**options).check()
    assert (caught.value.message, caught.value.hint) == (message, hint)


def test_sensible_options_pass() -> None:
    Request(wls=True, procrustes=1.0, clamp="0.5:2", stress_cap="2e4").check()
    Request(wls=False, procrustes=0.0, clamp=NONE, stress_cap=NONE, solver="ul").check()
    Request(procrustes=0.0, pins=("/Duck",)).check()


def made(look: str = "rubber", solver: str = "tl", **options: Any) -> Settings:
    material = DIMENSIONLESS[look].material(RADIUS)
    request = Request(solver=solver, **options)
    return of_material(
        settings(solver=solver), material, RADIUS, paper=request.preset == "paper",
        pinned=bool(request.pins), wls=request.wls, procrustes=request.procrustes,
        clamp=request.parsed["clamp"], stress_cap=request.parsed["stress_cap"],
        given=options,
    )  # fmt: skip


def of(made: Settings) -> tuple[Any, ...]:
    return made.wls, made.procrustes, made.clamp, made.stress_cap


def test_they_are_off_where_nothing_is_said() -> None:
    assert of(made()) == (False, 0.0, None, None)
    assert made() == settings()
    assert notes(made()) == ()


def test_each_is_what_was_asked_for() -> None:
    request = made(wls=True, procrustes=0.1, clamp="0.5:2", stress_cap="2e4")
    assert of(request) == (True, 0.1, (0.5, 2.0), 2e4)


@pytest.mark.parametrize(("look", "alpha"), [("rubber", 0.02), ("metal", 0.0), ("jelly", 0.0)])
def test_the_paper_has_them_all(look: str, alpha: float) -> None:
    wls, procrustes, clamp, cap = of(made(look, preset="paper"))
    assert (wls, procrustes, clamp) == (True, alpha, (0.2, 5.0))
    # tau = 100 where rubber has mu = 40, on any body: the ratio is the paper's.
    unit = DIMENSIONLESS[look].density * G0 * RADIUS
    assert cap / unit == pytest.approx(100.0 / 40.0 * DIMENSIONLESS["rubber"].mu, rel=2e-3)


def test_what_is_asked_for_overrides_the_preset() -> None:
    request = made(preset="paper", wls=False, procrustes=0.04, clamp=NONE, stress_cap=NONE)
    assert of(request) == (False, 0.04, None, None)


def test_the_other_solver_has_the_papers_clamp_and_cap_alone() -> None:
    wls, procrustes, clamp, cap = of(made(solver="ul", preset="paper"))
    assert (wls, procrustes, clamp) == (False, 0.0, (0.2, 5.0))
    assert cap == made(preset="paper").stress_cap


def test_pinned_rubber_has_no_shape_correction() -> None:
    assert made(preset="paper", pins=("/Duck",)).procrustes == 0.0


def test_every_option_is_noted() -> None:
    text = "\n".join(notes(made(preset="paper"), "rubber"))
    for expected in ("WLS", "2 % of the way", "0.2 .. 5", "3.526e+04 Pa", "the energy check skips"):
        assert expected in text
    assert all(line.startswith("rubber: ") for line in text.splitlines())


def test_the_command_says_no_where_it_was_said(tmp_path) -> None:
    line = command_line(tmp_path / "a.usda", preset="paper", wls=False, repair=False, clamp=NONE)
    assert line == "gf-usd bake a.usda --preset paper --no-wls --clamp none"
    assert command_line(tmp_path / "a.usda", wls=True) == "gf-usd bake a.usda --wls"
    assert command_line(tmp_path / "a.usda", wls=None) == "gf-usd bake a.usda"
