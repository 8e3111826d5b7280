"""The add-on of integrations/blender: installed as a package, and driven without a window."""

from __future__ import annotations

import copy
import functools
import json
import os
import re
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from client_assets import world_points
from client_runs import PROBES, needs, programs, run
from pxr import Usd, UsdGeom

from tools.blender_addon import pack

pytestmark = [pytest.mark.clients, needs("blender")]

ADDON = Path(__file__).resolve().parents[2] / "integrations" / "blender" / "gf_usd_bake"
FRAMES = 5
NEAR = 1e-5  # of the size of the scene: positions and matrices are single precision in Blender
TOOL = "import bpy; print(bpy.utils.system_resource('SCRIPTS'))"


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The add-on, judged by Blender's own tool and packed by ours, with the files of Blender's."""
    python = programs("blender") / "python"
    scripts = Path(run([python, "-c", TOOL]).strip().splitlines()[-1])
    tool = scripts / "addons_core" / "bl_pkg" / "cli" / "blender_ext.py"
    run([python, tool, "validate", ADDON])
    folder = tmp_path_factory.mktemp("addon")
    theirs, ours = folder / "theirs", folder / "ours"
    theirs.mkdir()
    ours.mkdir()
    run([python, tool, "build", "--source-dir", ADDON, "--output-dir", theirs])
    (reference,) = theirs.glob("*.zip")
    made = pack(ours)
    assert made.name == reference.name
    with zipfile.ZipFile(made) as one, zipfile.ZipFile(reference) as other:
        assert sorted(one.namelist()) == sorted(other.namelist())
        assert all(one.read(name) == other.read(name) for name in one.namelist())
    first = made.read_bytes()
    assert pack(ours).read_bytes() == first
    return made


@pytest.fixture(scope="module")
def drive(
    package: Path, tmp_path_factory: pytest.TempPathFactory
) -> Callable[[str], dict[str, Any]]:
    """Run a case of the probe, once, and give its result with its vertices."""
    python = programs("blender") / "python"
    program = Path(sys.executable).with_name("gf-usd")

    @functools.cache
    def call(case: str) -> dict[str, Any]:
        user, out = tmp_path_factory.mktemp("user"), tmp_path_factory.mktemp(case)
        run(
            [python, PROBES / "blender_addon.py", package, program, case, out],
            BLENDER_USER_RESOURCES=str(user),
            PATH=os.pathsep.join([str(program.parent), os.environ["PATH"]]),
        )
        # next to the folder, which holds what the add-on left there
        result = json.loads(out.with_suffix(".json").read_text())
        with np.load(out.with_suffix(".npz")) as arrays:
            result["vertices"] = dict(arrays)
        return result

    return call


def off(result: dict[str, Any], *, unit: float = 1.0) -> float:
    """The largest distance of the results' vertices from the points of the stage, over its size."""
    (file,) = result["files"]
    ours = world_points(Path(file))  # [m]
    assert sorted(result["paths"].values()) == sorted(ours)
    size = max(float(np.abs(points).max()) for points in ours.values())
    return max(
        float(np.abs(result["vertices"][name] * unit - ours[path]).max())
        for name, path in result["paths"].items()
    ) / size  # fmt: skip


def test_a_result_is_a_cache_on_a_copy_of_the_object(drive: Callable[[str], Any]) -> None:
    result = drive("falls")
    assert result["ended"] == ["FINISHED"]
    assert result["objects"] == ["My Ball", "My Ball.soft"]
    assert result["selected"] == ["My Ball.soft"]
    assert result["hidden"]
    assert not result["render"]
    assert result["materials"] == {"My Ball.soft": ["My Ball paint"]}
    assert result["message"] == "My Ball.soft: 5 frames"
    points = result["vertices"]["My Ball.soft"]
    assert points.shape[0] == FRAMES
    assert off(result) < NEAR
    # it starts where it was put and falls as all things do: g t^2 / 2
    dropped = (points[0] - points[-1])[:, 2].mean()
    stage = Usd.Stage.Open(result["files"][0])
    assert stage.GetStartTimeCode() == 11
    seconds = (FRAMES - 1) / stage.GetTimeCodesPerSecond()
    # it touches the floor 0.1 m below within the last frame
    assert dropped == pytest.approx(9.81 * seconds**2 / 2, rel=0.05)


def test_units_parents_modifiers_and_mirrors(drive: Callable[[str], Any]) -> None:
    result = drive("in_centimeters")
    assert result["ended"] == ["FINISHED"]
    stage = Usd.Stage.Open(result["files"][0])
    assert UsdGeom.GetStageMetersPerUnit(stage) == pytest.approx(0.01)
    assert sorted(result["vertices"]) == ["1. Läufer.soft", "Right.soft"]
    assert sorted(result["paths"].values()) == ["/root/Right_soft", "/root/_1__L_ufer_soft"]
    assert off(result, unit=0.01) < NEAR
    # g is 981 units/s^2 here; nothing has come down yet
    seconds = (FRAMES - 1) / stage.GetTimeCodesPerSecond()
    for points in result["vertices"].values():
        dropped = (points[0] - points[-1])[:, 2].mean()
        assert dropped == pytest.approx(981 * seconds**2 / 2, rel=0.01)


def test_obstacles_follow_their_animation_and_are_not_baked(drive: Callable[[str], Any]) -> None:
    result = drive("onto_a_lift")
    assert result["ended"] == ["FINISHED"]
    assert result["objects"] == ["Ball", "Ball.soft", "Lift"]
    assert not result["lift"]
    lowest = result["vertices"]["Ball.soft"][..., 2].min(axis=1)
    seconds = np.arange(FRAMES) / 24.0
    top = 0.5 + 0.05 * np.arange(FRAMES)  # of the slab
    free = lowest[0] - 9.81 * seconds**2 / 2
    # by the third frame it would have fallen through; contact yields by less than a spacing
    assert free[-1] < top[-1] - 0.15
    spacing = (4 / 3 * np.pi * 0.5**3 / 300) ** (1 / 3)
    assert (lowest > top - spacing).all()
    assert lowest[-1] > top[-1] - spacing > free[-1]


def test_a_vertex_group_pins_and_moves_with_its_object(drive: Callable[[str], Any]) -> None:
    result = drive("hung")
    assert result["ended"] == ["FINISHED"]
    assert (
        "no face of the selected objects is in the vertex group 'nowhere'" in result["messages"][0]
    )
    assert "there are the groups: hung up" in result["messages"][0]
    points = result["vertices"]["Bar.soft"]
    moved = (points[-1] - points[0])[result["top"]]
    # what is pinned moves with the object; a layer of particles follows the skin to a part of h
    np.testing.assert_allclose(moved[:, 0], 0.2, atol=0.02)
    np.testing.assert_allclose(moved[:, 2], 0.0, atol=0.02)
    rest = np.setdiff1d(np.arange(points.shape[1]), result["top"])
    below = rest[points[0][rest, 2] < 1.6]
    assert (points[-1] - points[0])[below, 2].mean() < 0.0
    assert (points[-1] - points[0])[below, 0].mean() < 0.15  # it lags behind


def test_gravity_is_that_of_the_scene_and_particles_are_chosen(drive: Callable[[str], Any]) -> None:
    result = drive("gravity_of_the_scene")
    assert result["ended"] == ["FINISHED"]
    points = result["vertices"]["Ball.soft"]
    fallen = (points[-1] - points[0]).mean(axis=0)
    seconds = (FRAMES - 1) / 24.0
    np.testing.assert_allclose(fallen, [3.0 * seconds**2 / 2, 0.0, 0.0], atol=1e-3)


def test_a_vertex_out_of_place_would_be_seen(drive: Callable[[str], Any]) -> None:
    result = copy.deepcopy(drive("falls"))
    result["vertices"]["My Ball.soft"][3, 17] += 1e-3
    assert off(result) > NEAR


def test_a_second_bake_takes_the_place_of_the_first(drive: Callable[[str], Any]) -> None:
    result = drive("twice")
    assert result["ended"] == ["FINISHED"]
    assert result["objects"] == ["Ball", "Ball.soft"]
    assert result["folders"] == ["Ball-001", "Ball-002"]
    assert [Path(file).parent.name for file in result["files"]] == ["Ball-002"]
    assert off(result) < NEAR


def test_errors_are_in_the_words_of_gf_usd(drive: Callable[[str], Any]) -> None:
    result = drive("refusals")
    messages = result["messages"]
    _, message, hint = messages["material"]
    assert message == "there is no material 'ruber'"
    assert hint.startswith("did you mean rubber?")
    # and both are shown
    assert message in messages["material"][0]
    assert hint in messages["material"][0]
    assert messages["option"][1] == "gf-usd bake has no option --nonsense"
    assert "'--friction" in messages["quotes"][1]
    assert re.match(r"the lowest vertex is at 0.5\d*, below the floor at 5", messages["floor"][1])
    assert messages["program"][1].endswith("nowhere is not a program")
    assert result["objects"] == ["Ball"]
    assert not result["running"]
    assert result["left"] == []


def test_a_bake_runs_in_parallel_to_the_window(drive: Callable[[str], Any]) -> None:
    result = drive("modal")
    assert result["started"] == ["RUNNING_MODAL"]
    assert not result["free"]
    assert result["elsewhere"] == ["PASS_THROUGH"]
    assert result["ended"] == ["FINISHED"]
    assert result["status"][0] == "gf-usd: filling the meshes (Esc stops it)"
    assert result["status"][-1] is None
    frame = r"gf-usd: frame \d of 5, about \d+ s left \(Esc stops it\)"
    assert any(re.fullmatch(frame, s) for s in result["status"][:-1])
    assert result["progress"] == sorted(result["progress"])
    assert result["timers"] == []
    assert result["objects"] == ["Ball", "Ball.soft"]
    assert off(result) < NEAR


def test_esc_ends_the_process_and_leaves_the_scene(drive: Callable[[str], Any]) -> None:
    result = drive("stopped")
    assert result["ended"] == ["CANCELLED"]
    assert result["status"] == 143  # it was terminated, and ended so
    assert result["reports"] == [["INFO", "gf-usd: canceled"]]
    assert result["timers"] == []
    assert result["objects"] == ["Ball"]
    assert not result["running"]
    assert result["left"] == []


def test_the_panel_says_what_can_be_done_and_what_went_wrong(drive: Callable[[str], Any]) -> None:
    result = drive("drawn")
    assert {
        "Material",
        "Particles",
        "Scene Range",
        "Floor",
        "Height",
        "From Where It Is",
        "Obstacles",
        "Pin Group",
        "More",
    } < {*result["before"]}
    assert "Select a mesh" in result["before"]
    assert "Bake 1 object" in result["ready"]
    assert "0.0 Esc stops it" in result["running_panel"]
    assert "there is no material 'ruber'" in result["after"]
    assert "Bake 1 object" in result["after"]


def test_materials_are_those_of_gf_usd_and_all_unregisters(drive: Callable[[str], Any]) -> None:
    result = drive("listed")
    from gf_usd.core.materials.dimensionless import DIMENSIONLESS
    from gf_usd.core.materials.physical import PHYSICAL

    assert result["materials"] == [*DIMENSIONLESS, *PHYSICAL]
    assert result["gone"]
    assert result["back"]
