"""Gaussians in delivered files, read by a reader that shares no code with the writer."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from captures import Y_0, ball, write_ply
from moving_splats import FRAMES, KHR, Glb, moving_splats, upright, world_splats
from pxr import Usd, UsdSkel
from scipy.spatial.transform import Rotation

import gf_usd
from gf_usd.core.errors import InputError, UsageError
from gf_usd.core.neighbors import kd_tree
from gf_usd.core.radiance import basis
from gf_usd.delivery.deliver import Delivered, deliver

ERROR = 0.02
ToGltf = Callable[[Path, str], Delivered]
SINGLE = 1e-5  # of the size of the scene: single precision, and rotations of 16 bits


@pytest.fixture(scope="module")
def over_mesh(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return moving_splats(tmp_path_factory.mktemp("over") / "ball.usdc", particles=True)


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return moving_splats(tmp_path_factory.mktemp("alone") / "ball.usdc", mesh=False, degree=3)


@pytest.fixture(scope="module")
def to_gltf(tmp_path_factory: pytest.TempPathFactory) -> ToGltf:
    """`deliver` of a file as .glb of a kind, once for all tests, which only read what it writes."""
    return cache(
        lambda source, kind: deliver(
            source, tmp_path_factory.mktemp("out") / "out.glb", error=ERROR, kind=kind
        )
    )


def measured(source: Path, done: Delivered, name: str, radius: float) -> tuple[float, np.ndarray]:
    """Largest distance [radii], and the relative error of every covariance in every frame."""
    file = Glb.read(done.path)
    ((node, primitive),) = [
        one for one in file.splats() if file.tree["nodes"][one[0]]["name"] == name.split("/")[-1]
    ]
    far, shapes = 0.0, []
    for frame in range(FRAMES):
        at, found = file.posed(node, primitive, frame)
        wanted_at, wanted = upright(*world_splats(source, name, 1.0 + frame))
        far = max(far, np.linalg.norm(at - wanted_at, axis=1).max())
        gap = np.linalg.norm(found - wanted, axis=(1, 2))
        shapes.append(gap / np.linalg.norm(wanted, axis=(1, 2)))
    return far / radius, np.concatenate(shapes)


@pytest.mark.parametrize("kind", ["joints", "shapes"])
@pytest.mark.parametrize("source", ["over_mesh", "alone"])
def test_gltf_positions_and_covariances_are_within_the_stated_errors(
    source: str, kind: str, request: pytest.FixtureRequest, to_gltf: ToGltf
) -> None:
    path: Path = request.getfixturevalue(source)
    done = to_gltf(path, kind)
    (cloud,) = done.splats
    (body,) = done.bodies
    assert cloud.path == "/Ball/Splats"
    assert cloud.count == 200
    assert body.splats == ("/Ball/Splats",)
    assert bool(body.meshes) == (source == "over_mesh")
    far, shapes = measured(path, done, cloud.path, body.radius)
    assert far == pytest.approx(cloud.position, abs=SINGLE)
    assert 0.0 < cloud.position <= done.error <= ERROR
    statistics = (np.median(shapes), np.percentile(shapes, 99), shapes.max())
    assert cloud.covariance == pytest.approx(statistics, rel=1e-3, abs=1e-4)
    assert cloud.covariance[0] > 0.01  # the ball is squashed: this error is there


@pytest.mark.slow
@pytest.mark.parametrize("source", ["over_mesh", "alone"])
def test_on_nodes_any_loader_moves_them(
    source: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    """Each Gaussian stands below one joint: nodes alone place it, turn its light, and shape it."""
    path: Path = request.getfixturevalue(source)
    done = deliver(path, tmp_path / "out.glb", error=ERROR, bind_splats="nodes")
    (cloud,) = done.splats
    (body,) = done.bodies
    file = Glb.read(done.path)
    parts = file.splats()
    assert 1 < len(parts) <= body.joints + 1
    assert sum("skin" in file.tree["nodes"][node] for node, _ in parts) == 0
    far = 0.0
    for frame in range(FRAMES):
        placed = [file.posed(node, primitive, frame, skins=False) for node, primitive in parts]
        at = np.concatenate([one[0] for one in placed])
        ours, _ = upright(*world_splats(path, cloud.path, 1.0 + frame))
        if frame == 0:
            # they are sorted by joint: each is the Gaussian that it coincides with at first
            gap, of = kd_tree(ours).query(at)
            assert sorted(of) == list(range(200))
            assert gap.max() < SINGLE
        far = max(far, np.linalg.norm(at - ours[of], axis=1).max())
    assert far / body.radius == pytest.approx(cloud.position, abs=SINGLE)
    assert done.error == cloud.position > ERROR  # what one joint can do
    assert cloud.position < 0.25


@pytest.mark.slow
def test_the_radius_of_a_capture_is_that_of_its_hull(alone: Path, to_gltf: ToGltf) -> None:
    done = to_gltf(alone, "auto")
    # a ball of half a unit, of which 200 corners are a little less
    assert done.bodies[0].radius == pytest.approx(0.005, rel=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["joints", "shapes"])
def test_a_loader_without_skins_shows_the_first_frame(
    alone: Path, to_gltf: ToGltf, kind: str
) -> None:
    done = to_gltf(alone, kind)
    file = Glb.read(done.path)
    ((node, primitive),) = file.splats()
    at, shapes = file.posed(node, primitive, None, skins=False)
    wanted_at, wanted = upright(*world_splats(alone, "/Ball/Splats", 1.0))
    if kind == "shapes":  # under the animated root, which gives the rigid motion of a frame
        at, shapes = file.posed(node, primitive, 0, skins=False)
    np.testing.assert_allclose(at, wanted_at, atol=SINGLE)
    gap = np.linalg.norm(shapes - wanted, axis=(1, 2)) / np.linalg.norm(wanted, axis=(1, 2))
    assert gap.max() < 1e-3  # rotations of 16 bits


@pytest.mark.slow
def test_the_primitive_is_as_the_extension_says(alone: Path, to_gltf: ToGltf) -> None:
    done = to_gltf(alone, "auto")
    file = Glb.read(done.path)
    assert file.tree["extensionsUsed"] == [KHR]
    assert "extensionsRequired" not in file.tree
    ((_, primitive),) = file.splats()
    assert primitive["mode"] == 0
    assert primitive["extensions"][KHR] == {
        "kernel": "ellipse",
        "colorSpace": "srgb_rec709_display",
        "projection": "perspective",
        "sortingMethod": "cameraDistance",
    }
    named = primitive["attributes"]
    lights = [f"{KHR}:SH_DEGREE_{d}_COEF_{n}" for d in range(4) for n in range(2 * d + 1)]
    rest = {"POSITION", "COLOR_0", *(f"{KHR}:{name}" for name in ("ROTATION", "SCALE", "OPACITY"))}
    assert set(named) - {"JOINTS_0", "WEIGHTS_0"} == rest | set(lights)
    assert len({file.tree["accessors"][number]["count"] for number in named.values()}) == 1
    opacities = np.linspace(0.2, 1.0, 200)
    np.testing.assert_allclose(file.array(named[f"{KHR}:OPACITY"])[:, 0], opacities, atol=1e-6)
    color = file.array(named["COLOR_0"])
    np.testing.assert_allclose(color[:, 3], opacities, atol=0.5 / 255)
    # COLOR_0 is linear
    encoded = 0.5 + Y_0 * file.array(named[lights[0]])
    linear = ((encoded + 0.055) / 1.055) ** 2.4
    np.testing.assert_allclose(color[:, :3], linear, atol=0.5 / 255)
    assert file.array(named[f"{KHR}:SCALE"]).min() > 0.0


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["joints", "shapes"])
def test_light_turns_with_the_axes_of_the_file(alone: Path, to_gltf: ToGltf, kind: str) -> None:
    """The radiance at a direction of the scene is that of the source at the same direction."""
    done = to_gltf(alone, kind)
    file = Glb.read(done.path)
    ((node, primitive),) = file.splats()
    coefficients = np.stack(
        [
            file.array(primitive["attributes"][f"{KHR}:SH_DEGREE_{d}_COEF_{n}"])
            for d in range(4)
            for n in range(2 * d + 1)
        ],
        axis=1,
    )
    stage = Usd.Stage.Open(str(alone))
    prim = stage.GetPrimAtPath("/Ball/Splats")
    light = prim.GetAttribute("radiance:sphericalHarmonicsCoefficients").Get()
    source = np.array(light, float).reshape(200, 16, 3)
    looks = np.array([[0.0, 0.6, 0.8], [0.36, 0.48, -0.8], [-1.0, 0.0, 0.0]])
    in_prim = Rotation.from_rotvec([0, 0, np.radians(30)]).inv().apply(looks)
    upward = looks @ np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]).T
    in_node = upward @ file.worlds(0)[node][:3, :3]
    theirs = np.einsum("jk,nkc->njc", basis(in_node), coefficients)
    ours = np.einsum("jk,nkc->njc", basis(in_prim), source)
    np.testing.assert_allclose(theirs, ours, atol=2e-4)


@pytest.mark.slow
def test_which_gaussians_are_written(over_mesh: Path, tmp_path: Path) -> None:
    written = {}
    for splats in ("captured", "all", "only", "none"):
        done = deliver(over_mesh, tmp_path / "out.glb", error=ERROR, splats=splats)
        assert tuple(one.path for one in done.splats) == tuple(
            dict.fromkeys(path for body in done.bodies for path in body.splats)
        )
        meshes = {path for body in done.bodies for path in body.meshes}
        written[splats] = ({one.path for one in done.splats}, meshes)
        names = {mesh["name"] for mesh in Glb.read(done.path).tree["meshes"]}
        assert names == {path.split("/")[-1] for path in set.union(*written[splats])}
    captured, particles, skin = "/Ball/Splats", "/Ball/GaussianFlesh/Gaussians", "/Ball/Skin"
    assert written == {
        "captured": ({captured}, {skin}),
        "all": ({captured, particles}, {skin}),
        "only": ({captured}, set()),
        "none": (set(), {skin}),
    }


@pytest.mark.parametrize("suffix", [".usda", ".usdz"])
def test_usd_samples_are_within_the_stated_error(
    over_mesh: Path, tmp_path: Path, suffix: str
) -> None:
    done = deliver(over_mesh, tmp_path / f"out{suffix}", error=ERROR)
    (cloud,) = done.splats
    radius = done.bodies[0].radius
    far, shapes = 0.0, []
    for code in np.arange(1.0, FRAMES + 1):
        at, found = world_splats(done.path, "/Ball/Splats", code)
        wanted_at, wanted = world_splats(over_mesh, "/Ball/Splats", code)
        far = max(far, np.linalg.norm(at - wanted_at, axis=1).max() / radius)
        gap = np.linalg.norm(found - wanted, axis=(1, 2))
        shapes.append(gap / np.linalg.norm(wanted, axis=(1, 2)))
    assert far == pytest.approx(cloud.position, abs=1e-5)
    assert 0.0 < far <= ERROR
    assert cloud.covariance[2] == pytest.approx(np.max(shapes), rel=1e-3)
    assert cloud.covariance[2] < 2e-3  # halves: 2^-11, squared
    stage = Usd.Stage.Open(str(done.path))
    prim = stage.GetPrimAtPath("/Ball/Splats")
    for name in ("positions", "orientations", "scales"):
        assert not prim.GetAttribute(name).HasValue()
        assert prim.GetAttribute(f"{name}h").GetNumTimeSamples() == FRAMES


def test_usd_positions_stay_single_where_halves_are_too_coarse(
    over_mesh: Path, tmp_path: Path
) -> None:
    # 2^-11 of two units is 0.1 % of a unit, 0.2 % of the radius
    done = deliver(over_mesh, tmp_path / "out.usda", error=0.001)
    stage = Usd.Stage.Open(str(done.path))
    prim = stage.GetPrimAtPath("/Ball/Splats")
    assert prim.GetAttribute("positions").GetNumTimeSamples() == FRAMES
    assert not prim.GetAttribute("positionsh").HasValue()
    assert done.splats[0].position < 1e-6


def test_usd_without_them_shows_the_first_frame(over_mesh: Path, tmp_path: Path) -> None:
    done = deliver(over_mesh, tmp_path / "out.usda", error=ERROR, splats="none")
    assert done.splats == ()
    first, last = (world_splats(done.path, "/Ball/Splats", code)[0] for code in (1.0, 5.0))
    np.testing.assert_array_equal(first, last)
    np.testing.assert_allclose(first, world_splats(over_mesh, "/Ball/Splats", 1.0)[0], atol=1e-9)


@pytest.mark.slow
def test_usd_holds_every_variant_of_a_bake(tmp_path: Path) -> None:
    """A real bake of a capture: its root layer has no mesh, and a variant for each material."""
    source = write_ply(tmp_path / "ball.ply", ball(300))
    result = gf_usd.bake(
        source, material="rubber,jelly", output=tmp_path / "ball.soft.usda", particles=200,
        frames=8, drop=0.1,
    )  # fmt: skip
    done = deliver(result.root, tmp_path / "out.usda", error=ERROR)
    assert done.bodies == ()
    assert [(one.variant, one.path) for one in done.splats] == [
        ("rubber", "/ball/Splats"), ("jelly", "/ball/Splats"),
    ]  # fmt: skip
    ends = {}
    for name in ("rubber", "jelly", "none"):
        ours, theirs = (Usd.Stage.Open(str(path)) for path in (result.root, done.path))
        rows = []
        for stage in (ours, theirs):
            prim = stage.GetPrimAtPath("/ball")
            prim.GetVariantSet("gaussianFlesh").SetVariantSelection(name)
            splats = stage.GetPrimAtPath("/ball/Splats")
            found = splats.GetAttribute("positions").Get(8.0)
            if found is None:
                found = splats.GetAttribute("positionsh").Get(8.0)
            rows.append(np.array(found, float))
        # a ball of half a meter
        assert np.linalg.norm(rows[0] - rows[1], axis=1).max() <= ERROR * 0.5
        ends[name] = rows[1]
    assert np.abs(ends["rubber"] - ends["jelly"]).max() > 1e-4
    np.testing.assert_allclose(ends["none"], ball(300).positions, atol=1e-6)


@pytest.mark.slow
def test_a_capture_that_stays_at_rest_is_a_body_of_its_own(tmp_path: Path) -> None:
    path = moving_splats(tmp_path / "ball.usdc", still=True)
    done = deliver(path, tmp_path / "out.glb", error=ERROR)
    assert [(body.meshes, body.splats) for body in done.bodies] == [
        (("/Ball/Skin",), ()), ((), ("/Ball/Splats",)),
    ]  # fmt: skip
    file = Glb.read(done.path)
    ((node, primitive),) = file.splats()
    wanted, _ = upright(*world_splats(path, "/Ball/Splats", 1.0))
    for frame in range(FRAMES):
        np.testing.assert_allclose(file.posed(node, primitive, frame)[0], wanted, atol=SINGLE)
    done = deliver(path, tmp_path / "out.usda", error=ERROR)
    stage = Usd.Stage.Open(str(done.path))
    prim = stage.GetPrimAtPath("/Ball/Splats")
    assert prim.GetAttribute("positions").GetNumTimeSamples() == 0
    assert prim.GetAttribute("positions").HasValue()


def test_usdskel_skins_no_particle_field(over_mesh: Path, tmp_path: Path) -> None:
    """Why samples are written: the reference implementation leaves a bound field where it is."""
    done = deliver(over_mesh, tmp_path / "out.usda", error=ERROR, kind="joints", splats="none")
    stage = Usd.Stage.Open(str(done.path))
    prim = stage.GetPrimAtPath("/Ball/Splats")
    count = len(prim.GetAttribute("positions").Get())
    api = UsdSkel.BindingAPI.Apply(prim)
    api.CreateSkeletonRel().SetTargets(["/Ball/Skeleton"])
    api.CreateJointIndicesPrimvar(False, 1).Set([0] * count)
    api.CreateJointWeightsPrimvar(False, 1).Set([1.0] * count)
    flat = Usd.Stage.Open(stage.Flatten())
    UsdSkel.BakeSkinning(flat.Traverse())
    assert flat.GetPrimAtPath("/Ball/Skin").GetAttribute("points").GetNumTimeSamples() == FRAMES
    assert flat.GetPrimAtPath("/Ball/Splats").GetAttribute("positions").GetNumTimeSamples() == 0


@pytest.mark.slow
def test_the_same_bytes_each_time(alone: Path, to_gltf: ToGltf, tmp_path: Path) -> None:
    again = deliver(alone, tmp_path / "out.glb", error=ERROR)
    assert again.path.read_bytes() == to_gltf(alone, "auto").path.read_bytes()


def test_what_makes_no_sense_is_refused(over_mesh: Path, alone: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="--splats is 'some'"):
        deliver(over_mesh, tmp_path / "out.glb", splats="some")
    with pytest.raises(UsageError, match=r"--splats all is only for \.glb"):
        deliver(over_mesh, tmp_path / "out.usdz", splats="all")
    with pytest.raises(UsageError, match="--bind-splats is 'glue'"):
        deliver(over_mesh, tmp_path / "out.glb", bind_splats="glue")
    for name, kind in (("out.glb", "shapes"), ("out.usdz", "auto")):
        with pytest.raises(UsageError, match=r"--bind-splats nodes is only for joints in \.glb"):
            deliver(over_mesh, tmp_path / name, kind=kind, bind_splats="nodes")
    with pytest.raises(InputError, match="neither a mesh nor captured Gaussians of the bake"):
        deliver(alone, tmp_path / "out.glb", splats="none")
    assert list(tmp_path.iterdir()) == []
