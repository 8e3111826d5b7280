"""Messages of Python name its keywords, and nothing that a function cannot be given."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import gf_usd
from gf_usd.api.call import BAKE
from gf_usd.api.simulate import KEYWORDS

SPHERE = Path(__file__).parents[2] / "samples" / "sphere.usda"
UNIT = np.array([[x, y, z] for x in (0, 1) for y in (1, 2) for z in (0, 1)], float)
FACES = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
FASTEST = "give at most 1e+09 m/s"


def scene(faces: Any = FACES, **options: Any) -> gf_usd.Scene:
    made = gf_usd.Scene(**options)
    made.add_body(UNIT, faces)
    return made


@pytest.mark.parametrize(
    ("hint", "of_a_bake", "of_a_scene"),
    [
        (
            "close the holes; --repair makes sheets one spacing thick",
            "close the holes; repair=True makes sheets one spacing thick",
            "close the holes",
        ),
        (
            "check the unit (--meters-per-unit), the material, --drop and --gravity",
            "check the unit (meters_per_unit), the material, drop and gravity",
            "check the unit, the material",
        ),
        ("lower --particles or raise --spacing", "lower particles or raise spacing", None),
        ("leave out --pin", "leave out pins", "leave out scene.pin()"),
        ("add --overwrite", "add overwrite=True", None),
        ("use --no-shortcuts", "use no_shortcuts=True", "use shortcuts=False"),
    ],
)
def test_a_hint_leaves_out_what_cannot_be_given(
    hint: str, of_a_bake: str, of_a_scene: str | None
) -> None:
    assert BAKE.hint(hint) == of_a_bake
    assert KEYWORDS.hint(hint) == (hint if "overwrite" in hint else of_a_scene or of_a_bake)


@pytest.mark.parametrize(
    ("text", "keywords"),
    [
        ("give --max-edge-length auto", "give max_edge_length='auto'"),
        ("give --particles 2000, or less", "give particles=2000, or less"),
        ("--spacing 0.1 is small", "spacing=0.1 is small"),
        ("give --range 1:20", "give range 1:20"),
        ("--gravity 0,-9.81,0", "gravity 0,-9.81,0"),
        ("--slice 2/4", "slice 2/4"),
        ("--floor -0.5 puts the floor under it", "floor=-0.5 puts the floor under it"),
        ("use --floor none, or --stress-cap none", "use floor=False, or stress_cap=False"),
        ("--only none", "only none"),
        ("do not use --no-self-contact", "do not use self_contact=False"),
    ],
)
def test_values_of_options_are_those_of_keywords(text: str, keywords: str) -> None:
    assert BAKE.text(text) == keywords


@pytest.mark.parametrize(
    "name",
    [
        "/tmp/a -m 3 /x.usda",
        "/shots/run --frames 12/duck.usdc",
        "'/tmp/x --prim 1/duck.xyz'",
        '"my file -o out.ply"',
        "</World/A -m 3>",
        "@textures/wood -m 2.png@",
        "/tmp/--prim/a.usda",
        "/tmp/a.--pin.usda",
    ],
)
def test_names_are_not_taken_for_options(name: str) -> None:
    assert BAKE.text(f"{name} is small: --particles 10") == f"{name} is small: particles=10"


def test_options_next_to_names_are_keywords() -> None:
    text = "the body's mesh: give --prim /World/A or -m rubber for /tmp/a.usda, the file's unit"
    assert BAKE.text(text) == text.replace("--prim", "prims").replace("-m", "material")


def test_errors_keep_the_name_of_the_file(tmp_path: Path) -> None:
    """As it is given: nothing shows where an unquoted name begins."""
    file = tmp_path / "my file -m 3 --prim x"
    file.write_text("nothing")
    with pytest.raises(gf_usd.InputError) as caught:
        gf_usd.bake(file, particles=100)
    assert str(file) in str(caught.value)
    missing = tmp_path / "a -m 3.usda"
    with pytest.raises(gf_usd.InputError, match=r"a -m 3\.usda"):
        gf_usd.bake(path=missing)


def test_repairs_are_not_suggested_for_a_scene() -> None:
    with pytest.raises(gf_usd.InputError) as caught:
        gf_usd.simulate(scene(FACES[:4]), particles=100)
    assert caught.value.hint == "close the holes or give the mesh thickness"
    inside_out = scene([face[::-1] for face in FACES])
    winding, coarse = gf_usd.simulate(inside_out, frames=1, particles=100).notes
    assert winding == "</body0> is filled despite 1 of 1 shell inside out"
    assert coarse.startswith("faces of </body0> (edges up to 6.6 spacings")
    assert coarse.endswith("and only the particles and Gaussians show its shape")


@pytest.mark.slow
def test_notes_and_warnings_of_a_bake_name_keywords(tmp_path: Path) -> None:
    path = tmp_path / "two.usda"
    body = f'prepend apiSchemas = ["PhysicsRigidBodyAPI"]\nreferences = @{SPHERE}@'
    place = 'uniform token[] xformOpOrder = ["xformOp:translate"]\ndouble3 xformOp:translate'
    path.write_text(
        '#usda 1.0\n(\ndefaultPrim = "W"\nmetersPerUnit = 1\nupAxis = "Y"\n)\ndef Xform "W"\n{\n'
        + "".join(f'def "B{k}" (\n{body}\n)\n{{\n{place} = ({3 * k}, 2, 0)\n}}\n' for k in (0, 1))
        + "}\n",
        encoding="utf-8",
    )
    result = gf_usd.bake(path, particles=200, frames=3, output=tmp_path / "out")
    assert any("combine=True makes them one body" in note for note in result.notes)
    seen = gf_usd.inspect(path, particles=200)
    assert any("combine=True makes them one body" in note for note in seen.notes)
    assert "--" not in " ".join((*result.notes, *seen.notes, *seen.warnings))
    assert "--combine" in result.report.read_text(encoding="utf-8"), "as of the command line"
    short = gf_usd.bake(SPHERE.with_name("duck.usda"), particles=200, frames=3, output=tmp_path)
    ((_, untouched),) = short.warnings
    assert untouched.about == "untouched"
    assert untouched.hint == (
        "use more frames, a lower drop, or check the unit of the asset (meters_per_unit)"
    )


@pytest.mark.parametrize(
    ("act", "message", "hint"),
    [
        (lambda s: s.set_velocities((1e30, 0, 0)), "velocities: the largest component is", FASTEST),
        (lambda s: s.accelerate((0, -2e9, 0)), "acceleration: the largest", f"{FASTEST}^2"),
        (lambda s: s.push(np.full((len(s.particles), 3), 1e30)), "by forces", f"{FASTEST}^2"),
    ],
)
def test_what_no_step_can_follow_is_refused(
    act: Callable[[gf_usd.Simulation], None], message: str, hint: str
) -> None:
    simulation = gf_usd.simulate(scene(), frames=3, particles=100)
    next(simulation)
    with pytest.raises(gf_usd.UsageError, match=message) as caught:
        act(simulation)
    assert caught.value.hint == hint
    simulation.set_velocities((1.0, 0, 0))
    assert next(simulation).velocities[:, 0].mean() == pytest.approx(1.0), "as it was before"


@pytest.mark.parametrize(
    ("value", "message", "hint"),
    [
        ("9.81", "gravity is '9.81'", "or a number, without quotes: gravity=9.81"),
        ("down", "gravity is 'down'", "give three numbers, such as (0, -9.81, 0), or a number"),
        (1e30, "gravity is (0, -1e+30, 0) m/s^2", f"{FASTEST}^2"),
    ],
)
def test_a_gravity_that_is_none_is_refused_with_what_fits(
    value: Any, message: str, hint: str
) -> None:
    with pytest.raises(gf_usd.UsageError) as caught:
        gf_usd.Scene(gravity=value)
    assert message in caught.value.message
    assert hint in caught.value.hint


@pytest.mark.parametrize(("name", "unit"), [("velocity", "m/s"), ("spin", "rad/s")])
def test_a_body_that_is_too_fast_is_refused(name: str, unit: str) -> None:
    fast: Any = {name: (1e30, 0, 0)}
    with pytest.raises(gf_usd.UsageError, match=rf"^{name} is \(1e\+30, 0, 0\) {unit}\n") as caught:
        gf_usd.Scene().add_body(UNIT, FACES, **fast)
    assert caught.value.hint == f"give at most 1e+09 {unit}"


def test_a_name_that_a_bake_does_not_have_is_answered_with_those_it_has(tmp_path: Path) -> None:
    result = gf_usd.bake(
        SPHERE, particles=100, frames=2, only="mesh", flatten=True, output=tmp_path / "one.usda"
    )
    bake = gf_usd.read(result.root)
    for name in ("x", 0.5):
        with pytest.raises(gf_usd.UsageError, match=f"from 0 to 1, and no {name!r}") as wrong:
            bake[name]  # pyright: ignore[reportArgumentType, reportCallIssue]
        assert "positions, velocities" in wrong.value.hint
        assert "rest, particles, settings, health, report" in wrong.value.hint
    with pytest.raises(KeyError) as caught:
        bake.health["kinetics"]
    assert isinstance(caught.value, gf_usd.UsageError)
    assert caught.value.hint.startswith("did you mean kinetic? there are")
    with pytest.raises(gf_usd.UsageError, match=r"^meshes: there is no '/nothing'"):
        bake[0].meshes["/nothing"]
    again = pickle.loads(pickle.dumps(bake[0].meshes))
    assert list(again) == list(bake[0].meshes)
    with pytest.raises(gf_usd.InputError) as bare:
        _ = bake.rest
    assert "--" not in bare.value.hint
    first = next(gf_usd.simulate(scene(), frames=1, particles=100))
    with pytest.raises(gf_usd.UsageError, match="no 'body1'"):
        first.meshes["body1"]


def test_notes_of_other_functions_name_keywords(tmp_path: Path) -> None:
    """They were those of the command line: "--keys cannot retime it; --speed can"."""
    from gf_usd.api.call import keywords
    from gf_usd.delivery.retime import Retimed

    notes = ("its animation is inside an instance, where --keys cannot retime it; --speed can",)
    made = Retimed(path=tmp_path, caches=(), frames=1, start=1.0, end=1.0, notes=notes)
    with keywords("speed", "keys") as words:
        (note,) = words.in_notes(made).notes
    assert note.endswith("where keys cannot retime it; speed can")
    path = tmp_path / "moving.usda"
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("gf_usd.api.deliver.run_here_or_separately", lambda *_: (made, ""))
        assert gf_usd.retime(path, tmp_path / "slow.usda", speed=2.0).notes == (note,)


def test_hints_of_an_inspection_name_keywords(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gf_usd.pipeline.cost.shortcuts.DAMPED", 0.0)
    seen = gf_usd.inspect(SPHERE, particles=100, frames=4, damping_time=0.1)
    (line,) = seen.shortcuts
    assert line.startswith("damping_time=")
