"""--conversion, from the command to the layers: what is shown when, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mixed_stages import body, scene
from pxr import Usd, UsdGeom
from resumed import require_same

import gf_usd
from gf_usd.core.errors import InputError, Unfinished, UsageError

SMALL: dict[str, Any] = {"particles": 300, "drop": 0, "gravity": 9.81}
FLOW, MESH = "/World/GaussianFlesh/Flow", "/World/Block"


def two_blocks(folder: Path) -> Path:
    """Two blocks of rubber, a meter apart."""
    return scene(folder, body("Block", "rubber", "0, 0.1, 0"), body("Other", "rubber", "1, 0.1, 0"))


@pytest.fixture
def blocks(tmp_path: Path) -> Path:
    return two_blocks(tmp_path)


@pytest.fixture(scope="module")
def half_sand(tmp_path_factory: pytest.TempPathFactory) -> gf_usd.BakeResult:
    """Of two blocks, one is sand from the fourth of six frames on."""
    folder = tmp_path_factory.mktemp("half")
    return gf_usd.bake(
        two_blocks(folder), frames=6, output=folder / "out.usda",
        conversions="/World/Block=dry-sand@time:3", **SMALL,
    )  # fmt: skip


def shown(stage: Usd.Stage, path: str, code: float) -> bool:
    image = UsdGeom.Imageable(stage.GetPrimAtPath(path))
    return image.ComputeVisibility(code) != "invisible"


def count(stage: Usd.Stage, path: str, code: float) -> int:
    return len(UsdGeom.Points(stage.GetPrimAtPath(path)).GetPointsAttr().Get(code))


@pytest.mark.slow
@pytest.mark.acceptance
def test_particles_are_shown_instead_of_the_mesh_from_the_first_converted_on(
    blocks: Path, tmp_path: Path
) -> None:
    done = gf_usd.bake(
        blocks, frames=8, output=tmp_path / "out.usda",
        conversions=["/World/Block=dry-sand@time:3", "/World/Other=honey@time:6"], **SMALL,
    )  # fmt: skip
    assert not done.findings
    stage = Usd.Stage.Open(str(done.root))
    half = done.particles // 2
    for code, block, other in ((1, 0, 0), (3, 0, 0), (4, 1, 0), (6, 1, 0), (7, 1, 1), (8, 1, 1)):
        assert shown(stage, MESH, code) == (not block)
        assert shown(stage, "/World/Other", code) == (not other)
        assert shown(stage, FLOW, code) == bool(block)
        assert count(stage, FLOW, code) == half * (block + other)
    points = UsdGeom.Points(stage.GetPrimAtPath(FLOW))
    for code in (4.0, 8.0):
        n = count(stage, FLOW, code)
        assert len(points.GetWidthsAttr().Get(code)) == len(points.GetIdsAttr().Get(code)) == n
    (bake,) = done.bakes
    assert bake.health["converted_particles"] == done.particles
    assert bake.health["first_converted_frame"] == 3
    assert bake.health["conversion_dissipation_J"] >= 0.0


@pytest.mark.slow
@pytest.mark.acceptance
def test_a_surface_is_drawn_around_what_was_converted(blocks: Path, tmp_path: Path) -> None:
    done = gf_usd.bake(
        blocks, frames=6, output=tmp_path / "out.usda", surface=True,
        conversions="/World/Block=dry-sand@time:3", **SMALL,
    )  # fmt: skip
    assert not done.findings
    stage = Usd.Stage.Open(str(done.root))
    surface = UsdGeom.Mesh(stage.GetPrimAtPath("/World/GaussianFlesh/Surface"))
    counts = [len(surface.GetPointsAttr().Get(code)) for code in (1.0, 3.0, 4.0, 6.0)]
    assert counts[:2] == [0, 0]
    assert min(counts[2:]) > 100
    assert [shown(stage, str(surface.GetPath()), code) for code in (3, 4)] == [False, True]
    assert shown(stage, "/World/Other", 6.0)
    box = UsdGeom.BBoxCache(1.0, ["default", "render"]).ComputeWorldBound(
        stage.GetPrimAtPath("/World")
    )
    assert box.ComputeAlignedRange().GetMin()[1] == pytest.approx(0.0, abs=0.02)


@pytest.mark.slow
def test_a_box_means_the_particles_in_it(tmp_path: Path) -> None:
    path = scene(tmp_path, body("Block", "rubber", "0, 0.1, 0"))
    done = gf_usd.bake(
        path, frames=4, output=tmp_path / "out.usda",
        conversions="-1,0.1,-1,1,1,1=dry-sand@time:2", **SMALL,
    )  # fmt: skip
    (bake,) = done.bakes
    assert bake.health["converted_share"] == pytest.approx(0.5, abs=0.05)


def test_a_limit_that_nothing_passes_is_warned_of(blocks: Path, tmp_path: Path) -> None:
    done = gf_usd.bake(
        blocks, frames=4, output=tmp_path / "out.usda", conversions="dry-sand@stress:1e9", **SMALL
    )
    assert [w.about for _, w in done.warnings] == ["unconverted"]
    stage = Usd.Stage.Open(str(done.root))
    assert shown(stage, MESH, 4.0)
    assert not shown(stage, FLOW, 4.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "becomes", ["dry-sand", pytest.param("powder-snow", marks=pytest.mark.acceptance)]
)
def test_a_bake_that_was_ended_continues_identically(
    blocks: Path, tmp_path: Path, becomes: str
) -> None:
    options = {"conversions": f"/World/Block={becomes}@time:4", "frames": 8, "clip_frames": 3}
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    whole.mkdir()
    parts.mkdir()
    gf_usd.bake(blocks, output=whole / "out.usda", **options, **SMALL)
    for more in ({}, {"resume": True}, {"resume": True}):
        try:
            gf_usd.bake(blocks, output=parts / "out.usda", slice=1, **options, **SMALL, **more)
        except Unfinished:
            continue
        break
    require_same(whole, parts)


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [
        pytest.param(
            {"precision": 0.005, "adaptive_samples": True, "no_velocities": True},
            marks=pytest.mark.slow,
        ),
        {"precision": 0.005, "adaptive_samples": True, "clip_frames": 3, "surface": True},
        pytest.param({"samples_per_frame": 2, "flatten": True}, marks=pytest.mark.slow),
        pytest.param(
            {"internal": True, "stress": True, "deformation_gradients": True},
            marks=pytest.mark.slow,
        ),
        {"only": "gaussians"},
        pytest.param({"only": "mesh"}, marks=pytest.mark.slow),
        {"only": "mesh", "surface": True},
        pytest.param({"solver": "ul"}, marks=pytest.mark.acceptance),
    ],
    ids="-".join,
)
def test_it_can_be_combined_with_other_output_options(
    blocks: Path, tmp_path: Path, options: dict[str, Any]
) -> None:
    name = "out.usdc" if options.get("flatten") else "out.usda"
    done = gf_usd.bake(
        blocks, frames=7, output=tmp_path / name,
        conversions="/World/Block=dry-sand@time:3", **SMALL, **options,
    )  # fmt: skip
    assert not done.findings
    assert done.bakes[0].health["converted_particles"] == done.particles // 2
    if options.get("only") == "gaussians":
        return
    stage = Usd.Stage.Open(str(done.root))
    assert [shown(stage, MESH, code) for code in (2, 3, 5, 6)] == [True, True, False, False]
    if "surface" not in options:
        # with --solver ul all is one body, so that particles stand for all of it
        share = 1 if "solver" in options else 2
        assert count(stage, FLOW, 5.0) == done.particles // share
        assert shown(stage, "/World/Other", 5.0) == (share == 2)


@pytest.mark.slow
@pytest.mark.acceptance
def test_solids_that_overlap_stay_one_body_of_which_a_part_is_converted(tmp_path: Path) -> None:
    """They were torn apart, since only one of them can be converted."""
    path = scene(
        tmp_path, body("Block", "rubber", "0, 0.1, 0"), body("Next", "rubber", "0.15, 0.1, 0"),
        body("Far", "rubber", "2, 0.1, 0"),
    )  # fmt: skip
    options = {"conversions": "/World/Block=dry-sand@time:3", **SMALL}
    plan = gf_usd.inspect(path, **options).plan
    assert plan.bodies.surfaces == (("/World/Block", "/World/Next"), ("/World/Far",))
    assert set(plan.choices.converting) == {("/World/Block", 0), ("/World/Next", 0)}
    done = gf_usd.bake(path, frames=5, output=tmp_path / "out.usda", **options)
    assert done.bakes[0].health["max_J"] < 1.2
    assert done.bakes[0].health["deepest_overlap_spacings"] < 0.1


def test_what_flows_does_not_take_in_a_solid_that_it_touches(tmp_path: Path) -> None:
    path = scene(
        tmp_path, body("Sand", "dry-sand", "0, 0.1, 0"), body("Block", "rubber", "0, 0.3005, 0")
    )
    plan = gf_usd.inspect(path, conversions="/World/Block=honey@time:9", **SMALL).plan
    assert plan.bodies.count == 2
    assert plan.choices.flowing == ("/World/Sand",)
    assert [path for path, _ in plan.choices.converting] == ["/World/Block"]
    ul = gf_usd.inspect(path, conversions="/World/Block=honey@time:9", solver="ul", **SMALL).plan
    assert ul.choices.mesh, "the block is solid at first"
    assert set(ul.choices.flowing) == {"/World/Sand", "/World/Block"}, "of one body, a part flows"


@pytest.mark.slow
def test_a_body_that_passes_through_an_obstacle_does_so_alone(tmp_path: Path) -> None:
    """All did once the last was converted."""
    tray = """    def Cube "Tray" (prepend apiSchemas = ["PhysicsCollisionAPI"])
    {
        double size = 4
        double3 xformOp:translate = (0, -2, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
"""
    ghost = body("Ghost", "rubber", "1, 0.1, 0").replace(
        '"GaussianFleshBakeAPI"', '"GaussianFleshBakeAPI", "PhysicsFilteredPairsAPI"'
    )
    ghost = ghost.replace("{\n", "{\n        rel physics:filteredPairs = </World/Tray>\n", 1)
    path = scene(tmp_path, tray, body("Block", "rubber", "0, 0.1, 0"), ghost)
    done = gf_usd.bake(
        path, frames=12, output=tmp_path / "out.usda", conversions="dry-sand@time:3", **SMALL
    )
    stage = Usd.Stage.Open(str(done.root))
    points = UsdGeom.Points(stage.GetPrimAtPath("/World/GaussianFlesh/Points"))
    x = np.asarray(points.GetPointsAttr().Get(12.0))
    block = x[:, 0] < 0.5
    assert x[block, 1].min() > -0.02
    assert x[~block, 1].max() < 0.0


@pytest.mark.slow
def test_a_box_without_a_vertex_in_it_converts_what_it_holds(tmp_path: Path) -> None:
    """The prim was taken for one that stays solid."""
    corners = np.array([(x, y, z) for x in (0, 2) for y in (0.0, 0.1) for z in (0.0, 0.1)])
    turn = np.array([[0.8, 0.0, -0.6], [0.0, 1.0, 0.0], [0.6, 0.0, 0.8]])
    points = ", ".join(f"({x:.4f}, {y:.4f}, {z:.4f})" for x, y, z in corners @ turn.T)
    beam = f"""    def Mesh "Beam"
    {{
        int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
        int[] faceVertexIndices = [0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4,
            1, 5, 7, 3]
        point3f[] points = [{points}]
        uniform token subdivisionScheme = "none"
    }}
"""
    done = gf_usd.bake(
        scene(tmp_path, beam), material="rubber", frames=4, output=tmp_path / "out.usda",
        conversions="0.70,-1,0.4,0.72,1,1=dry-sand@time:2", **{**SMALL, "particles": 3000},
    )  # fmt: skip
    assert done.bakes[0].health["converted_particles"] > 0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("honey", "is not a material and a limit"),
        ("honey@melt:3", "is not a material and a limit"),
        ("honey@strain:-1", "is not a material and a limit"),
        ("rubber@time:3", "does not flow without limit"),
        ("1,2=honey@time:3", "is not a preset and a box"),
        ("marmalade@time:3", "no material 'marmalade'"),
    ],
)
def test_invalid_texts_are_refused(blocks: Path, text: str, message: str) -> None:
    with pytest.raises(UsageError, match=f"(?i){message}"):
        gf_usd.inspect(blocks, conversions=text, **SMALL)


def test_conversions_without_particles_are_refused_by_name(blocks: Path, tmp_path: Path) -> None:
    for texts, error, message in (
        ("/World/Nobody=honey@time:3", InputError, "selects none of the"),
        (["honey@time:3", "water@time:4"], InputError, "later ones override it for all"),
    ):
        with pytest.raises(error, match=message):
            gf_usd.bake(blocks, output=tmp_path / "out.usda", conversions=texts, **SMALL)
    with pytest.raises(UsageError, match="cannot be combined with certify"):
        gf_usd.bake(blocks, conversions="honey@time:3", certify=True, **SMALL)
    sand = scene(tmp_path, body("Sand", "dry-sand", "0, 0.1, 0"))
    with pytest.raises(InputError, match="flow from the start"):
        gf_usd.bake(sand, output=tmp_path / "out.usda", conversions="honey@time:3", **SMALL)


@pytest.mark.parametrize(
    ("surface", "ending"),
    [(False, "particles are shown"), (True, "a surface around the particles is shown")],
)
def test_a_note_says_what_is_shown(blocks: Path, surface: bool, ending: str) -> None:
    plan = gf_usd.inspect(blocks, conversions="honey@time:3", surface=surface, **SMALL)
    (note,) = [one for one in plan.notes if "become honey" in one]
    assert note.endswith(f"from the first of them on {ending}, not the mesh")


def test_a_picture_shows_what_is_visible_then(half_sand: gf_usd.BakeResult) -> None:
    from gf_usd.readers.pictures.recording import BakedMotion
    from gf_usd.readers.pictures.scene import read_scene

    done = half_sand
    before, after = (read_scene(done.root, code) for code in (3.0, 5.0))
    assert {mesh.name for mesh in before.meshes} == {MESH, "/World/Other"}
    assert not before.ellipsoids
    assert {mesh.name for mesh in after.meshes} == {"/World/Other"}
    assert len(after.ellipsoids[0].positions) == done.particles // 2
    motion = BakedMotion(done.root)
    assert motion.recording().vanishing == (MESH,)
    names = [mesh.name for mesh in motion.recording().meshes]
    frames = list(motion.frames())
    for code, extent in ((0, 0.2), (5, 0.0)):
        points = frames[code].meshes[names.index(MESH)]
        assert np.ptp(points, axis=0).max() == pytest.approx(extent, abs=0.02)


def test_the_curves_of_a_report_are_those_of_the_particles(half_sand: gf_usd.BakeResult) -> None:
    """The hidden mesh has no extent, and counted as the highest and the lowest of the body."""
    from gf_usd.readers.pictures.recording import BakedMotion
    from gf_usd.view.report.motion import collect

    source = BakedMotion(half_sand.root)
    curves = collect(source.recording(), source.frames(), 500, 500).curves
    stage = Usd.Stage.Open(str(half_sand.root))
    points = UsdGeom.Points(stage.GetPrimAtPath("/World/GaussianFlesh/Points"))
    for k in range(6):
        y = np.asarray(points.GetPointsAttr().Get(k + 1.0))[:, 1]
        assert curves["highest"][k] == pytest.approx(y.max(), abs=1e-6)
        assert curves["lowest"][k] == pytest.approx(y.min(), abs=1e-6)
    assert "surface_max" not in curves
