"""--material auto through the command line, and the sample advisor against its stub server."""

from __future__ import annotations

import json
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from small_bakes import SAMPLES, SMALL, names, strict

from gf_usd.core.errors import UsageError
from gf_usd.pipeline.prepared import draw, prepare
from gf_usd.prepare.advice import advise
from gf_usd.prepare.advice.advisors import GROUP

VISION = SAMPLES / "vision_advisor"

CUBE = """
    def Cube "{name}" ({meta})
    {{
        double size = 0.5
        double3 xformOp:translate = ({x}, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
        {body}
    }}
"""
BINDS = 'prepend apiSchemas = ["MaterialBindingAPI"]'
MATERIALS = """
    def Material "Blinn" {}
    def Material "Stiff" (prepend apiSchemas = ["PhysicsMaterialAPI"])
    {
        float physics:density = 500
        float physics:youngsModulus = 40000
        float physics:poissonsRatio = 0.3
    }
    def Material "FoamContact" (prepend apiSchemas = ["PhysicsMaterialAPI"])
    {
        float physics:density = 77
        float physics:dynamicFriction = 0.25
    }
"""


def cube(name, x, body="", meta=""):
    return CUBE.format(name=name, x=x, body=body, meta=meta)


@pytest.fixture
def stage(tmp_path):
    """Write a stage of cubes, in meters."""

    def write(*prims: str, name: str = "things.usda") -> Path:
        path = tmp_path / name
        head = '#usda 1.0\n(\n    metersPerUnit = 1\n    upAxis = "Y"\n)\n'
        path.write_text(f'{head}def Xform "All"\n{{\n{"".join(prims)}}}\n', encoding="utf-8")
        return path

    return write


def advice_of(done):
    assert done.status == 0, done.err
    return {one["path"]: one for one in strict(done.out)["advice"]}


@pytest.mark.slow
def test_each_surface_has_the_material_of_its_name(gf_usd, here, stage):
    asset = stage(cube("SteelBlock", 0), cube("jelly_cube", 2), cube("Thing", 4))
    done = gf_usd("bake", asset, "-m", "auto", *SMALL, "--dry-run", "--json")
    advice = advice_of(done)
    assert [one["material"] for one in advice.values()] == ["metal", "jelly", "rubber"]
    assert [one["confidence"] for one in advice.values()] == [0.7, 0.7, 0.0]
    plan = strict(done.out)
    assert [m["name"] for m in plan["tables"][0]] == ["metal", "jelly", "rubber"]
    assert any(
        note == "</All/SteelBlock> is metal (0.70): its name 'SteelBlock' says 'steel'"
        for note in plan["notes"]
    )
    assert any("</All/Thing> is rubber (0.00): no name" in note for note in plan["notes"])
    assert names(here) == []


@pytest.mark.slow
def test_surfaces_of_one_body_keep_their_own_materials(gf_usd, here, stage):
    asset = stage(cube("SteelBlock", 0), cube("jelly_cube", 0.5))
    done = gf_usd("bake", asset, "-m", "auto", "--combine", *SMALL, "--dry-run", "--json")
    plan = strict(done.out)
    assert len(plan["separate_bodies"]) == 1
    assert [m["name"] for m in plan["tables"][0]] == ["metal", "jelly"]


@pytest.mark.slow
def test_what_the_stage_states_goes_before_its_names(gf_usd, here, stage):
    asset = stage(
        MATERIALS,
        cube("SteelA", 0, "rel material:binding:physics = </All/Stiff>", BINDS),
        cube("SteelB", 2, 'token gaussianFlesh:material = "jelly"'),
    )
    done = gf_usd("bake", asset, "-m", "auto", *SMALL, "--dry-run", "--json")
    advice = advice_of(done)
    assert [(a["material"], a["confidence"], a["by"]) for a in advice.values()] == [
        ("Stiff", 1.0, "stage"),
        ("jelly", 1.0, "stage"),
    ]
    stiff, jelly = strict(done.out)["tables"][0]
    # read as float32 out of the file
    assert stiff["youngs_modulus"] == pytest.approx(40000.0, rel=1e-6)
    assert jelly["name"] == "jelly"


def test_density_and_friction_of_the_stage_go_over_the_preset_of_the_name(gf_usd, here, stage):
    body = "rel material:binding:physics = </All/FoamContact>"
    asset = stage(MATERIALS, cube("Part", 0, body, BINDS))
    done = gf_usd("bake", asset, "-m", "auto", *SMALL, "--dry-run", "--json")
    (advice,) = advice_of(done).values()
    assert (advice["material"], advice["confidence"]) == ("foam", 0.8)
    (made,) = strict(done.out)["tables"][0]
    # 0.25 and 77 are exact in float32; 1.7 MPa is that of the preset
    assert (made["density"], made["friction"], made["youngs_modulus"]) == (77.0, 0.25, 1.7e6)


@pytest.mark.slow
def test_a_bake_is_named_auto_and_its_report_has_the_reasons(gf_usd, here, stage):
    asset = stage(cube("jello", 0))
    done = gf_usd("bake", asset, "-m", "auto", "--particles", 100, "--frames", 2, "-q")
    assert done.status == 0, done.err
    assert names(here) == ["things.auto.cache.usdc", "things.auto.report.json", "things.auto.usda"]
    report = json.loads((here / "things.auto.report.json").read_text(encoding="utf-8"))
    assert "--material auto" in report["command"]
    assert report["advice"] == [
        {
            "path": "/All/jello", "material": "jelly", "confidence": 0.7,
            "reason": "its name 'jello' says 'jello'", "by": "names",
        }
    ]  # fmt: skip


def test_the_page_of_inspect_shows_confidence_and_reason_once(gf_usd, here, stage):
    done = gf_usd("inspect", stage(cube("jello", 0)), "-m", "auto", *SMALL)
    assert done.status == 0, done.err
    [row] = [line for line in done.out.splitlines() if "says 'jello'" in line]
    assert row.split()[:4] == ["/All/jello", "jelly", "0.70", "names"]


def test_a_mesh_file_is_judged_by_its_materials(gf_usd, here, tmp_path):
    corners = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    faces = ["1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4"]
    lines = [f"v {x} {y} {z}" for x, y, z in corners]
    lines += ["mtllib box.mtl", "usemtl SoftFoam", *(f"f {face}" for face in faces)]
    (tmp_path / "box.obj").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (tmp_path / "box.mtl").write_text("newmtl SoftFoam\nKd 1 0 0\n", encoding="utf-8")
    for command in (["bake", "--dry-run"], ["inspect"]):
        done = gf_usd(
            command[0], tmp_path / "box.obj", "-m", "auto", *SMALL, "--json", *command[1:]
        )
        [one] = advice_of(done).values()
        assert (one["material"], one["confidence"]) == ("foam", 0.8)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["-m", "auto,rubber"], "auto is in a list"),
        (["-m", "rubber,auto:x"], "auto:x is in a list"),
        (["-m", "auto", "--preset", "paper"], "--preset paper and --material auto"),
        (["-m", "auto:nobody"], "there is no material advisor 'nobody'"),
        (["-m", "auto:"], "there is no material advisor ''"),
    ],
)
def test_what_makes_no_sense_is_refused_in_words(gf_usd, here, stage, arguments, message):
    done = gf_usd("bake", stage(cube("a", 0)), *arguments, *SMALL)
    assert done.status == 2
    assert message in done.err
    assert names(here) == []


@pytest.fixture
def server(monkeypatch):
    """The stub server, running; its requests are in `requests`."""
    monkeypatch.syspath_prepend(str(VISION))
    import stub_server

    requests = []
    reply = stub_server.reply_to
    monkeypatch.setattr(stub_server, "reply_to", lambda r: (requests.append(r), reply(r))[1])
    running = stub_server.serve()
    running.requests = requests
    thread = threading.Thread(target=running.serve_forever, daemon=True)
    thread.start()
    monkeypatch.setenv("VISION_ADVISOR_URL", f"http://127.0.0.1:{running.server_port}/v1")
    yield running
    running.shutdown()
    running.server_close()
    for module in ("stub_server", "vision_advisor"):
        sys.modules.pop(module, None)


@pytest.fixture
def vision(tmp_path, monkeypatch):
    """The sample advisor as its pyproject.toml installs it."""
    import tomllib

    project = tomllib.loads((VISION / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    points = project["entry-points"][GROUP]
    info = tmp_path / "site" / "vision_advisor-0.1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: vision-advisor\nVersion: 0.1.0\n")
    lines = "".join(f"{name} = {value}\n" for name, value in points.items())
    (info / "entry_points.txt").write_text(f"[{GROUP}]\n{lines}")
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    monkeypatch.syspath_prepend(str(VISION))


def test_a_batch_takes_auto_and_asks_no_advisor(vision):
    from gf_usd.batch.manifest import _materials

    assert _materials("auto", Path()) == "auto"
    with pytest.raises(UsageError, match="a batch does not use an advisor"):
        _materials("auto:vision", Path())


@pytest.mark.slow
def test_the_sample_advisor_asks_the_stub_server(gf_usd, here, stage, server, vision):
    authored = cube("Said", 4, "rel material:binding:physics = </All/Stiff>", BINDS)
    asset = stage(MATERIALS, cube("SteelBlock", 0), cube("Other", 2), authored)
    done = gf_usd("bake", asset, "-m", "auto:vision", *SMALL, "--dry-run", "--json")
    advice = advice_of(done)
    assert [(a["material"], a["by"]) for a in advice.values()] == [
        ("jelly", "vision"),
        ("jelly", "vision"),
        ("Stiff", "stage"),
    ]
    assert strict(done.out)["outputs"][0].endswith("things.auto.usda")
    [request] = server.requests
    text = request["messages"][-1]["content"][0]["text"]
    assert "- /All/SteelBlock (materials: none; labels: none)" in text
    assert "/All/Said" not in text  # the stage has the word there


def test_no_server_is_asked_without_its_name(gf_usd, here, stage, server, vision):
    done = gf_usd("bake", stage(cube("a", 0)), "-m", "auto", *SMALL, "--dry-run", "--json")
    assert done.status == 0
    assert server.requests == []


@pytest.mark.slow
def test_a_server_that_is_not_there_is_an_error(gf_usd, here, stage, server, vision, monkeypatch):
    server.shutdown()
    server.server_close()
    done = gf_usd("bake", stage(cube("a", 0)), "-m", "auto:vision", *SMALL)
    assert done.status == 1
    assert "the material advisor 'vision' failed: http://127.0.0.1" in done.err
    assert "start the server" in done.err
    assert names(here) == []


@pytest.mark.slow
def test_a_model_that_babbles_is_an_error(gf_usd, here, stage, server, vision, monkeypatch):
    babble = {"choices": [{"message": {"content": "I think it is a cube."}}]}
    monkeypatch.setattr(sys.modules["stub_server"], "reply_to", lambda request: babble)
    done = gf_usd("bake", stage(cube("a", 0)), "-m", "auto:vision", *SMALL)
    assert done.status == 1
    assert "the model's reply is not the JSON that was asked for" in done.err


@pytest.mark.slow
def test_the_picture_is_a_png_of_the_asset(tmp_path):
    plan = prepare(SAMPLES / "duck.usda", output=str(tmp_path) + "/", particles=100).plan
    path = tmp_path / "duck.png"
    path.write_bytes(advise.picture(plan.asset, draw))
    with Image.open(path) as picture:
        assert (picture.format, picture.size) == ("PNG", advise.PICTURE)
        # A duck, and no empty backdrop, which has no color: yellow in a good part of the picture.
        red, _, blue = np.moveaxis(np.asarray(picture.convert("RGB"), float), 2, 0)
    assert 0.1 < (red > blue + 60.0).mean() < 0.8
