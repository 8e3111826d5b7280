"""What pins hold of tetrahedra, as PhysicsAttachment prims, and read back by another bake."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom

import gf_usd
from gf_usd.core.errors import InputError
from gf_usd.core.frames.frame import MeshPose
from gf_usd.core.frames.settings import sampled
from gf_usd.layers.check.run import check_file
from gf_usd.layers.stage import clock, open_source
from gf_usd.layers.tracks.tets.attachments import Attachments, not_in_source
from gf_usd.physics.grid.pins import Motion, PinConstraint, pinned_by
from gf_usd.pipeline.frames.attachments import tet_attachments
from gf_usd.prepare.plan import Plan
from gf_usd.prepare.prepare import prepare

FACES = [0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4, 1, 5, 7, 3]
BOX = "box:0,-10,90,33,40,140"
OTHER_BOX = "box:70,10,90,110,70,140"
FRAMES = 5
ROUNDING = 4 * np.finfo(np.float32).eps  # of the largest coordinate: places are single precision


def box(low: tuple[float, ...], high: tuple[float, ...]) -> list[tuple[float, float, float]]:
    xs, ys, zs = zip(low, high, strict=True)
    return [(x, y, z) for x in xs for y in ys for z in zs]


def stage(folder: Path, lines: str = "") -> Path:
    """A bar of 80 x 30 x 30 cm under a prim that turns, and a grip around its end that rises."""
    bar, grip = box((0, 0, 0), (80, 30, 30)), box((-10, -10, -10), (6, 40, 40))
    body = f"int[] faceVertexCounts = {[4] * 6}\nint[] faceVertexIndices = {FACES}\n"
    path = folder / "arm.usda"
    path.write_text(f"""#usda 1.0
( defaultPrim = "World"
  metersPerUnit = 0.01
  upAxis = "Z"
  startTimeCode = 1
  endTimeCode = {FRAMES}
  timeCodesPerSecond = 24 )
def Xform "World"
{{
    double3 xformOp:translate = (30, 0, 100)
    float xformOp:rotateZ = 30
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateZ"]
    def Xform "Lift"
    {{
        double3 xformOp:translate.timeSamples = {{ 1: (0, 0, 0), {FRAMES}: (0, 2, 5) }}
        uniform token[] xformOpOrder = ["xformOp:translate"]
        def Mesh "Grip"
        {{
            uniform token purpose = "guide"
            point3f[] points = {grip}
            float3[] extent = [(-10, -10, -10), (6, 40, 40)]
            {body}
        }}
    }}
    def Mesh "Bar"
    {{
        point3f[] points = {bar}
        float3[] extent = [(0, 0, 0), (80, 30, 30)]
        {body}
        uniform token subdivisionScheme = "none"
        def GeomSubset "root"
        {{
            uniform token elementType = "face"
            uniform token familyName = "part"
            int[] indices = [0]
        }}
    }}
    {lines}
}}
""")
    return path


def waving(folder: Path) -> Path:
    """The same bar, whose end bends as its points do."""
    path = stage(folder)
    bar = box((0, 0, 0), (80, 30, 30))
    bent = [*bar[:3], (0, 33, 33), *bar[4:]]
    still = f"point3f[] points = {bar}"
    assert still in path.read_text()
    moving = f"point3f[] points.timeSamples = {{ 1: {bar}, {FRAMES}: {bent} }}"
    path.write_text(path.read_text().replace(still, moving))
    return path


OPTIONS: dict[str, Any] = {"particles": 150, "frames": FRAMES, "floor": "none"}


def plan_of(path: Path, **options: Any) -> Plan:
    output = path.parent / "out.usda"
    request: dict[str, Any] = {"draw": None, "tets": True, "output": output, **OPTIONS, **options}
    return prepare(path, **request)[0]


def written(plan: Plan, folder: Path) -> Path:
    """A layer with what a bake would say of its attachments, over the source."""
    (lattice,) = plan.tets
    found = tet_attachments(plan.pins, plan.tets, plan.particles)
    layer = Sdf.Layer.CreateNew(str(folder / "held.usda"))
    made, source = Usd.Stage.Open(layer), open_source(plan.source)
    scope = Sdf.Path("/World/GaussianFlesh")
    tets = UsdGeom.TetMesh.Define(made, scope.AppendChild("Tets")).GetPath()
    line = clock(source, plan.settings)
    writer = Attachments(
        made, scope.AppendChild("Attachments"), source, found, {0: (lattice, tets)},
        plan.asset, plan.settings, line, np.zeros(3),
    )  # fmt: skip
    root = UsdGeom.XformCache().GetLocalToWorldTransform(source.GetPrimAtPath("/World"))
    UsdGeom.Xformable(writer.prim).AddTransformOp().Set(root.GetInverse())
    every = sampled(plan.settings)
    constraint = PinConstraint(plan.pins, plan.particles.X)
    for index in range(every.frames):
        x, _ = constraint.pose(pinned_by(plan.pins, lattice.X), lattice.X, index)
        pose = MeshPose(points=x, velocities=np.zeros_like(x))
        writer.write({lattice.key: pose}, every.time_code(index))
    made.Save()
    stacked = Usd.Stage.CreateNew(str(folder / "setup.usda"))
    stacked.GetRootLayer().TransferContent(Sdf.Layer.FindOrOpen(str(plan.source)))
    only = stacked.GetRootLayer()
    del only.rootPrims["World"]
    only.subLayerPaths[:] = ["./held.usda", "./arm.usda"]
    stacked.Save()
    return folder / "setup.usda"


def test_attachments_of_the_same_name_are_numbered_from_2(tmp_path: Path) -> None:
    """As other prims; they were numbered from 1."""
    plan = plan_of(stage(tmp_path), pins=[BOX, OTHER_BOX])
    scene = Usd.Stage.Open(str(written(plan, tmp_path)))
    prims = scene.GetPrimAtPath("/World/GaussianFlesh/Attachments").GetChildren()
    assert [prim.GetName() for prim in prims] == ["box", "box_2"]


@pytest.mark.parametrize(
    ("pin", "carrier", "moves"),
    [
        ("/World/Bar/root", "/World/Bar", False),
        ("/World/Lift/Grip", "/World/Lift/Grip", False),
        (BOX, "/World/GaussianFlesh/Attachments", False),
        ("/World/Bar/root", "/World/GaussianFlesh/Attachments", True),
    ],
)
def test_a_pin_is_written_and_read_again(
    tmp_path: Path, pin: str, carrier: str, moves: bool
) -> None:
    plan = plan_of(waving(tmp_path) if moves else stage(tmp_path), pins=[pin])
    setup = written(plan, tmp_path)
    scene = Usd.Stage.Open(str(setup))
    (prim,) = scene.GetPrimAtPath("/World/GaussianFlesh/Attachments").GetChildren()
    assert prim.GetTypeName() == "PhysicsAttachment"

    def value(name: str, time: float = 1.0) -> Any:
        return prim.GetAttribute(name).Get(time)

    assert (value("physics:type0"), value("physics:type1")) == ("point", "xform")
    assert value("physics:stiffness") == np.inf
    assert value("gaussianFlesh:pin") == pin
    assert prim.GetRelationship("physics:src0").GetTargets() == ["/World/GaussianFlesh/Tets"]
    assert prim.GetRelationship("physics:src1").GetTargets() == [carrier]
    # each point of the tetrahedra that the region holds, where it is at the first frame
    (lattice,) = plan.tets
    points = np.array(value("physics:indices0"))
    inside = np.flatnonzero(plan.pins[0].inside(lattice.X))
    assert len(inside)
    assert set(inside) <= set(points)
    to_world = np.array(UsdGeom.XformCache(1.0).GetLocalToWorldTransform(
        scene.GetPrimAtPath(carrier)
    ))  # fmt: skip
    places = np.array(value("physics:coords1"), float) @ to_world[:3, :3] + to_world[3, :3]
    far = ROUNDING * np.abs(lattice.X).max()
    np.testing.assert_allclose(0.01 * places, lattice.X[points], atol=far)
    assert prim.GetAttribute("physics:coords1").GetNumTimeSamples() == (FRAMES if moves else 0)
    # another bake holds the same, without an option
    again = plan_of(setup, prims=["/World/Bar"])
    (before,), (after,) = plan.pins, again.pins
    assert after.name == str(prim.GetPath())
    X = np.random.default_rng(1).uniform(-0.2, 1.6, (200, 3))
    np.testing.assert_array_equal(before.inside(X), after.inside(X))
    np.testing.assert_array_equal(before.nearest(X), after.nearest(X))
    assert len(after.path) == (FRAMES if moves or "Lift" in pin else 1)
    one, other = (Motion(p.anchors, p.path) for p in (before, after))
    held = lattice.X[inside]
    for frame in range(FRAMES):
        np.testing.assert_allclose(
            one.at(held, frame)[0], other.at(held, frame)[0], atol=20 * far
        )  # a fit through 24 anchors about as far apart as it is from them


def test_an_attachment_of_the_stage_is_not_written_again(tmp_path: Path) -> None:
    hook = """def PhysicsAttachment "Hook"
    {
        rel physics:src0 = </World/Bar>
        rel physics:src1 = </World/Lift>
        uniform token physics:type0 = "point"
        uniform token physics:type1 = "xform"
        int[] physics:indices0 = [0, 1, 2, 3]
        vector3f[] physics:coords1 = [(0, 0, 0), (0, 0, 30), (0, 30, 0), (0, 30, 30)]
    }"""
    plan = plan_of(stage(tmp_path, hook))
    assert [pin.name for pin in plan.pins] == ["/World/Hook"]
    found = tet_attachments(plan.pins, plan.tets, plan.particles)
    assert [one.pin for one in found] == ["/World/Hook"]
    assert not not_in_source(open_source(plan.source), found)


def test_an_attachment_of_what_is_not_baked_holds_nothing(tmp_path: Path) -> None:
    setup = written(plan_of(stage(tmp_path), pins=[BOX]), tmp_path)
    text = (tmp_path / "held.usda").read_text()
    assert "sourceMeshes = </World/Bar>" in text
    (tmp_path / "held.usda").write_text(
        text.replace("sourceMeshes = </World/Bar>", "sourceMeshes = </World/Lift/Grip>")
    )
    assert not plan_of(setup, prims=["/World/Bar"]).pins


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (f'gaussianFlesh:pin = "{BOX}"', 'gaussianFlesh:pin = ""', "gaussianFlesh:pin is ''"),
        (f'gaussianFlesh:pin = "{BOX}"', 'gaussianFlesh:pin = "/World/Gone"', "/World/Gone"),
        ("physics:coords1", "physics:coords2", "physics:coords1 is []"),
    ],
)
def test_an_attachment_that_was_broken_is_refused(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    setup = written(plan_of(stage(tmp_path), pins=[BOX]), tmp_path)
    text = (tmp_path / "held.usda").read_text()
    assert old in text
    (tmp_path / "held.usda").write_text(text.replace(old, new))
    with pytest.raises(InputError) as caught:
        plan_of(setup, prims=["/World/Bar"])
    assert message in caught.value.message
    assert "/World/GaussianFlesh/Attachments/box" in caught.value.message
    assert caught.value.hint


def positions(root: Path) -> np.ndarray:
    """(F, n, 3) [stage units] of the last Gaussians of a bake."""
    scene = Usd.Stage.Open(str(root))
    prims = [p for p in scene.Traverse() if p.GetTypeName() == "ParticleField3DGaussianSplat"]
    attribute = prims[-1].GetAttribute("positions")
    return np.array([attribute.Get(code) for code in attribute.GetTimeSamples()])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pin", "moves", "far"),
    [
        ("/World/Bar/root", False, 0.0),
        ("/World/Lift/Grip", False, 1e-3),
        (BOX, False, 0.0),
        ("/World/Bar/root", True, 1e-3),
    ],
)
def test_a_bake_with_attachments_is_the_bake_with_the_pin(
    tmp_path: Path, pin: str, moves: bool, far: float
) -> None:
    """To the bit where the pin stays; else to the rounding of places, 1e-5 cm, as it grows."""
    source = waving(tmp_path) if moves else stage(tmp_path)
    options: dict[str, Any] = {"material": "jelly", **OPTIONS}
    only: dict[str, Any] = {"tets": True, "only": "gaussians"}
    first = tmp_path / "first.usda"
    gf_usd.bake(source, output=first, pins=[pin], **only, **options)
    assert not check_file(first).findings
    scene = Usd.Stage.Open(str(first))
    tets = scene.GetPrimAtPath("/World/GaussianFlesh/Tets")
    bind = tets.GetAttribute("physics:deformablePose:bind:points").Get()
    np.testing.assert_array_equal(bind, tets.GetAttribute("physics:restShapePoints").Get())
    setup = tmp_path / "setup.usda"
    text = source.read_text()
    head = text[: text.index("def Xform")]
    layers = "subLayers = [@first.cache.usdc@, @arm.usda@]"
    setup.write_text(head.replace("( defaultPrim", f"( {layers}\n  defaultPrim"))
    again = tmp_path / "again.usda"
    gf_usd.bake(setup, output=again, prims=["/World/Bar"], **only, **options)
    a, b = positions(first), positions(again)
    assert np.abs(a - a[0]).max() > 5.0  # it hangs from the pin
    np.testing.assert_allclose(a, b, rtol=0.0, atol=far)
    assert not Usd.Stage.Open(str(again)).GetPrimAtPath("/World/GaussianFlesh_2/Attachments")
