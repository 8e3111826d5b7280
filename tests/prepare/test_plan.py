"""What a bake says before and after: the plan, the result, and their JSON."""

from __future__ import annotations

import hashlib
import json
import math
import pickle
import shlex
from dataclasses import FrozenInstanceError, asdict, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arm import arm, booted, cached, write
from physics_stages import head, mesh
from planned import at
from solids import asset, facts, fill, preset_material, settings, solid, sphere

import gf_usd
from gf_usd.core.frames.settings import Settings
from gf_usd.core.materials.material import Material
from gf_usd.pipeline.prepared import Prepared, prepare
from gf_usd.pipeline.result import BakeResult, VariantResult
from gf_usd.prepare.outputs.outputs import outputs
from gf_usd.prepare.plan import Plan, command_line, describe, input_hash, settings_json

PATH = "/World/Ball"


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("plan") / "my ball.usda"
    path.write_text("#usda 1.0\n", encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def plan(source: Path) -> Plan:
    """A ball of two materials with a mesh that is not filled."""
    shape = sphere(0.5, path=PATH)
    particles, samples = fill(solid(shape), 200)
    return Plan(
        asset=replace(asset(shape), facts=facts(path=source)),
        particles=particles,
        samples=samples,
        materials=(preset_material("rubber", particles), preset_material("jelly", particles)),
        settings=settings(frames=5, fps=30.0, seed=3, gravity=(0.0, -9.81, 0.0)),
        outputs=outputs(source, ["rubber", "jelly"], "out/"),
        source=source,
        embedded=(("/World/Hat", "open"),),
        drop=1.5,
        notes=("a note",),
    )


def result(plan: Plan, **changes) -> BakeResult:
    looks = tuple(
        VariantResult(
            variant=m.name,
            cache=cache,
            material=m,
            frames=5,
            health={"restitution": None},
            per_frame=[{"kinetic": 0.0}],
        )
        for m, cache in zip(plan.materials, plan.outputs.caches)
    )
    values = {
        "root": plan.outputs.root,
        "report": plan.outputs.report,
        "bakes": looks,
        "particles": len(plan.particles),
        "seconds": 1.25,
        "settings": plan.settings,
        "notes": ("a note",),
        "findings": ({"rule": "finite", "prim": "/A", "message": "m", "fix": "f"},),
    }
    return BakeResult(**{**values, **changes})


def strict(values: object) -> object:
    """Through JSON as its standard has it, without Infinity and NaN."""
    return json.loads(json.dumps(values, allow_nan=False))


def plain(material: Material) -> dict[str, Any]:
    """The fields of a material of a law without parameters of its own."""
    return {name: value for name, value in asdict(material).items() if name != "parameters"}


def test_a_description_answers_what_a_dry_run_is_asked(plan: Plan, source: Path) -> None:
    d = describe(plan)
    assert strict(d)["bodies"] == [PATH]
    assert d["source"] == str(source)
    assert (
        d["input_sha256"] == hashlib.sha256(source.read_bytes()).hexdigest() == input_hash(source)
    )
    assert d["version"] == gf_usd.__version__
    assert d["riders"] == [["/World/Hat", "open"]]
    assert d["particles"] == len(plan.particles)
    assert d["spacing_m"] == plan.particles.spacing
    # The ball's volume: an icosphere of 642 points lacks 1 % of 4/3 pi r^3.
    assert d["volume_m3"] == pytest.approx(4.0 / 3.0 * math.pi * 0.125, rel=0.02)
    assert d["radius_m"] == pytest.approx(0.5, rel=0.01)
    assert [m["name"] for m in d["materials"]] == ["rubber", "jelly"]
    assert d["materials"][0] == plain(plan.materials[0])
    assert (d["frames"], d["fps"], d["start"], d["drop_m"]) == (5, 30.0, 1.0, 1.5)
    assert d["outputs"] == [
        "out/my ball.rubber-jelly.usda",
        "out/my ball.rubber-jelly.rubber.cache.usdc",
        "out/my ball.rubber-jelly.jelly.cache.usdc",
        "out/my ball.rubber-jelly.report.json",
    ]
    assert d["notes"] == ["a note"]


def test_the_command_is_one_for_a_shell() -> None:
    command = command_line(
        Path("a folder/my ball.usda"), material="rubber,jelly", frames=5, fps=30.0, drop=None,
        stress=True, repair=False, time_scale="auto", gravity="0,-1.5,0",
    )  # fmt: skip
    assert shlex.split(command) == [
        *("gf-usd", "bake", "my ball.usda", "--material", "rubber,jelly", "--frames", "5"),
        *("--fps", "30", "--stress", "--time-scale", "auto", "--gravity", "0,-1.5,0"),
    ]


def test_the_command_has_every_digit() -> None:
    # Six digits of a spacing are another number of particles.
    options = {"spacing": 0.123456789, "fps": 24000 / 1001, "drag": 0.0, "filter_rate": math.inf}
    arguments = shlex.split(command_line(Path("a.usda"), **options))
    assert arguments[3::2] == ["--spacing", "--fps", "--drag", "--filter-rate"]
    assert [float(word) for word in arguments[4::2]] == list(options.values())


def test_a_solver_carries_the_meshes_where_the_skin_is_embedded(plan: Plan) -> None:
    solver = Prepared(plan=plan).solvers.take(plan.variants[1])
    assert solver.body.embedded.keys() == plan.points.keys() == {PATH}
    assert solver.settings is plan.settings
    alone = replace(plan, settings=replace(plan.settings, skin="idw"))
    assert Prepared(plan=alone).solvers.take(alone.variants[0]).body.embedded == {}


def test_a_result_has_the_documented_keys(plan: Plan) -> None:
    out = strict(result(plan).as_json())
    assert list(out) == [
        "root", "report", "particles", "frames", "seconds", "settings", "bakes",
        "warnings", "outputs", "notes", "check",
    ]  # fmt: skip
    assert out["root"] == "out/my ball.rubber-jelly.usda"
    assert out["report"] == "out/my ball.rubber-jelly.report.json"
    assert out["settings"].keys() == Settings.__dataclass_fields__.keys()
    assert [list(b) for b in out["bakes"]] == [
        ["variant", "look", "cache", "material", "frames", "at_rest", "health"]
    ] * 2
    assert out["bakes"][1]["material"] == plain(plan.materials[1])
    assert out["check"] == [{"rule": "finite", "prim": "/A", "message": "m", "fix": "f"}]


def test_frames_are_listed_on_request(plan: Plan) -> None:
    bake = result(plan).bakes[0]
    assert bake.as_json(frames=True) == {**bake.as_json(), "per_frame": [{"kinetic": 0.0}]}


def test_an_infinite_rate_is_a_word_in_json() -> None:
    # --preset paper has one; Infinity is no JSON, and most readers refuse the whole file.
    s = settings(filter_rate=math.inf, drag=0.25)
    out = strict(settings_json(s))
    assert out["filter_rate"] == "inf"
    assert float(out["filter_rate"]) == math.inf
    assert (out["drag"], out["floor"], out["up"]) == (0.25, None, [0.0, 1.0, 0.0])


def test_a_result_with_an_infinite_rate_is_json(plan: Plan) -> None:
    done = result(plan, settings=replace(plan.settings, filter_rate=math.inf))
    assert strict(done.as_json())["settings"]["filter_rate"] == "inf"


def test_the_first_material_stands_for_the_bake(plan: Plan) -> None:
    done = result(plan)
    assert (done.cache, done.health, done.frames) == (
        plan.outputs.caches[0],
        {"restitution": None},
        5,
    )


def test_a_plan_is_values_alone(tmp_path: Path) -> None:
    """No closure, no open file, no solver: what cannot be written down is not in it."""
    source = tmp_path / "two.usda"
    moving = "float3 physics:velocity = (1, 0, 0)\nfloat3 physics:angularVelocity = (0, 90, 0)"
    apis = ("PhysicsRigidBodyAPI",)
    prims = mesh("One", moving, apis=apis) + mesh("Two", at(3.0))
    source.write_text(head() + prims, encoding="utf-8")
    made = prepare(
        source, output=tmp_path / "out.usda", particles=200, frames=3, material="rubber,jelly",
        pins=("box:-1,-1,-1,9,0.3,9",),
    ).plan  # fmt: skip
    again = pickle.loads(pickle.dumps(made))
    assert describe(again) == describe(made)
    assert again.variants == made.variants
    X = made.particles.X[:5]
    for one, other in zip(made.velocity, again.velocity, strict=True):
        if callable(one):
            np.testing.assert_array_equal(one(X), other(X))
    assert any(callable(one) for one in made.velocity)
    for field in fields(made):
        with pytest.raises(FrozenInstanceError):
            setattr(made, field.name, None)


GOAL = "float primvars:gaussianFlesh:goal.timeSamples = { 1: 0.2, 13: 0.8 }"
FOREARM = """def GeomSubset "Forearm"
{
    uniform token elementType = "face"
    int[] indices = [1, 18, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28, 29, 30, 31, 32, 33]
}"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("more", "options"),
    [
        ("", {"flesh": True, "goal_frequency": 3.0, "squish": 0.75, "stretch": 0.4}),
        (GOAL, {"flesh": True, "goal_frequency": 3.0}),
        (FOREARM, {"rigid": ["/Arm/Skin/Forearm"]}),
        ("cached", {"flesh": True, "goal_frequency": 3.0}),
        ("booted", {"flesh": True, "rigid": ["/Arm/Boot"]}),
    ],
    ids=["limits", "goals over time", "rigid patch", "animated points", "rigid mesh"],
)
def test_plans_of_flesh_can_be_pickled(tmp_path: Path, more: str, options: dict[str, Any]) -> None:
    """Their functions were closures, which processes of other programs cannot be sent."""
    named = more in ("cached", "booted")
    path = (
        booted(tmp_path) if more == "booted" else write(tmp_path, arm(more="" if named else more))
    )
    if more == "cached":
        path.write_text(cached(path), encoding="utf-8")
    made = prepare(path, output=tmp_path / "out.usda", particles=300, **options).plan
    again = pickle.loads(pickle.dumps(made))
    assert describe(again) == describe(made)
    X, frame = made.particles.X, made.settings.frames - 1.0

    def results(plan: Plan) -> list[Any]:
        out = [(pin.inside(X), pin.nearest(X)) for pin in plan.pins]
        if (goals := plan.goals) is not None:
            out.append((goals.pose(X)(frame), goals.rate(X)))
            out += [goals.rates(X)(frame)] if goals.rates else []
            out += [goals.limits.carried(X)(frame)[0]] if goals.limits else []
            out += [(goals.limits.toward(X), goals.limits.away(X))] if goals.limits else []
        return out

    assert len(made.pins) > 0
    assert (made.goals is not None) == ("goal_frequency" in options)
    for one, other in zip(results(again), results(made), strict=True):
        np.testing.assert_equal(one, other)
