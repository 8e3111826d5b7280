"""One object in units of a millimeter, a meter and a kilometer, and far from the origin."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from compare_stages import with_variant, world_points
from pxr import Usd

import gf_usd

FRAMES = 10
FAR = 1e5  # units
SAME = 1e-4  # of the box's longest side, 1 m
CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.3, 0.3) for z in (-0.4, 0.4)])
FACES = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
CASES = {
    "millimeters": (1e-3, (0, 0, 0)),
    "kilometers": (1e3, (0, 0, 0)),
    "far along x": (1.0, (FAR, 0, 0)),
    "far along z": (1.0, (0, 0, -FAR)),
    "far up": (1.0, (0, FAR, 0)),
    "millimeters, far along all": (1e-3, (FAR, -FAR, FAR)),
    "kilometers, far along all": (1e3, (-FAR, FAR, FAR)),
}

Motion = tuple[np.ndarray, np.ndarray]


def write_box(path: Path, unit: float, at: tuple[float, ...], *, moves: bool = False) -> Path:
    """A tilted box of 1 m by 0.6 m by 0.8 m, its middle at `at` [stage units].

    moves : its transform is animated, which does not turn what falls out of it.
    """
    place = f"double3 xformOp:translate = {tuple(map(float, at))}"
    if moves:
        after = tuple(float(x) + (3.0 / unit if d == 0 else 0.0) for d, x in enumerate(at))
        samples = f"{{ 1: {tuple(map(float, at))}, {FRAMES}: {after} }}"
        place = f"double3 xformOp:translate.timeSamples = {samples}"
    points = ", ".join(str(tuple(map(float, corner / unit))) for corner in CORNERS)
    path.write_text(
        f"""#usda 1.0
(
    metersPerUnit = {unit}
    upAxis = "Y"
    defaultPrim = "Box"
)
def Xform "Box"
{{
    {place}
    float3 xformOp:rotateXYZ = (20, 30, 0)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ"]
    def Mesh "Mesh"
    {{
        point3f[] points = [{points}]
        int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
        int[] faceVertexIndices = {[corner for face in FACES for corner in face]}
        uniform token subdivisionScheme = "none"
    }}
}}
""",
        encoding="utf-8",
    )
    return path


def bake(folder: Path, unit: float, at: tuple[float, ...], *, moves: bool = False) -> Path:
    """The root layer of a bake in which the box hits a floor 0.6 m below its middle."""
    box = write_box(folder / "box.usda", unit, at, moves=moves)
    return gf_usd.bake(
        box, output=folder / "out.usda", material="rubber", particles=150, frames=FRAMES,
        start=1, floor=repr(at[1] - 1.0 / unit), drop=repr(0.15 / unit),
    ).root  # fmt: skip


def motion(root: Path, unit: float, at: tuple[float, ...]) -> Motion:
    """[m] of the mesh (FRAMES, 8, 3) and the Gaussians (FRAMES, N, 3), seen from `at`."""
    stage = with_variant(root, "rubber")
    mesh, gaussians = [], []
    for frame in range(FRAMES):
        mesh.append(world_points(stage, "/Box/Mesh", 1.0 + frame))
        gaussians.append(in_world(stage, 1.0 + frame))
    middle = np.asarray(at, float)
    return (np.array(mesh) - middle) * unit, (np.array(gaussians) - middle) * unit


def in_world(stage: Usd.Stage, time_code: float) -> np.ndarray:
    """(N, 3) positions of the Gaussians, stage units."""
    from pxr import UsdGeom

    prim = stage.GetPrimAtPath("/Box/GaussianFlesh/Gaussians")
    rows = np.array(UsdGeom.XformCache(time_code).GetLocalToWorldTransform(prim))
    return (
        np.array(prim.GetAttribute("positions").Get(time_code), float) @ rows[:3, :3] + rows[3, :3]
    )


@pytest.fixture(name="meters", scope="module")
def meters_fixture(tmp_path_factory: pytest.TempPathFactory) -> Motion:
    at = (0.0, 0.0, 0.0)
    return motion(bake(tmp_path_factory.mktemp("meters"), 1.0, at), 1.0, at)


@pytest.mark.parametrize("name", CASES)
def test_the_motion_is_the_same_at_any_scale_and_place(
    name: str, meters: Motion, tmp_path: Path
) -> None:
    unit, at = CASES[name]
    for here, there in zip(motion(bake(tmp_path, unit, at), unit, at), meters):
        np.testing.assert_allclose(here, there, rtol=0, atol=SAME)
    rest, end = meters[0][0], meters[0][-1]
    deformed = np.linalg.norm(end[0] - end[-1]) / np.linalg.norm(rest[0] - rest[-1])
    assert abs(deformed - 1.0) > 10.0 * SAME  # it hit the floor


def test_the_motion_is_the_same_with_z_up(meters: Motion, tmp_path: Path) -> None:
    """The same box, turned with the axis: (x, y, z) is (x, -z, y).

    Samples are the same to the last digit, and a light node follows all nodes that are as near to
    it as the 24th.
    """
    box = write_box(tmp_path / "box.usda", 1.0, (0.0, 0.0, 0.0))
    turned = box.read_text(encoding="utf-8").replace('upAxis = "Y"', 'upAxis = "Z"')
    turned = turned.replace("    float3", "    double xformOp:rotateX:up = 90\n    float3", 1)
    turned = turned.replace(
        '["xformOp:translate", ', '["xformOp:translate", "xformOp:rotateX:up", ', 1
    )
    box.write_text(turned, encoding="utf-8")
    root = gf_usd.bake(
        box, output=tmp_path / "out.usda", material="rubber", particles=150, frames=FRAMES,
        start=1, floor="-1", drop="0.15",
    ).root  # fmt: skip
    for here, there in zip(motion(root, 1.0, (0.0, 0.0, 0.0)), meters):
        as_y_up = here[..., [0, 2, 1]] * (1.0, 1.0, -1.0)
        np.testing.assert_allclose(as_y_up[:3], there[:3], rtol=0, atol=1e-6)  # until it lands
        np.testing.assert_allclose(as_y_up, there, rtol=0, atol=SAME)


@pytest.mark.slow
def test_gaussians_far_out_follow_a_root_that_moves(tmp_path: Path) -> None:
    at = (FAR, 0.0, FAR)
    near = motion(bake_in(tmp_path / "near", (0.0, 0.0, 0.0)), 1.0, (0.0, 0.0, 0.0))
    for here, there in zip(motion(bake_in(tmp_path / "far", at), 1.0, at), near):
        np.testing.assert_allclose(here, there, rtol=0, atol=SAME)


def bake_in(folder: Path, at: tuple[float, ...]) -> Path:
    """A bake in meters of a box whose root prim moves."""
    folder.mkdir()
    return bake(folder, 1.0, at, moves=True)


@pytest.mark.slow
def test_near_the_origin_particles_stand_in_the_world(tmp_path: Path) -> None:
    from pxr import UsdGeom

    for at, own in ((10.0, False), (FAR, True)):
        folder = tmp_path / f"{at:g}"
        folder.mkdir()
        stage = with_variant(bake(folder, 1.0, (at, 0.0, 0.0)), "rubber")
        posed, rest = (
            np.array(
                stage.GetPrimAtPath("/Box/GaussianFlesh/Gaussians").GetAttribute(name).Get(1.0)
            )
            for name in ("positions", "gaussianFlesh:restPositions")
        )
        assert (np.abs(posed).max() < 2.0) == own
        # the box stands where it rests, but for the fall
        np.testing.assert_allclose(posed[:, [0, 2]], rest[:, [0, 2]], rtol=0, atol=1e-5)
        extent = UsdGeom.BBoxCache(1.0, [UsdGeom.Tokens.default_]).ComputeWorldBound(
            stage.GetPrimAtPath("/Box")
        )
        assert abs(extent.ComputeAlignedRange().GetMidpoint()[0] - at) < 0.1
