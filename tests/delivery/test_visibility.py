"""Delivered bodies that the source shows and hides over time, and those that a bake hides."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from delivered import gltf_vertices, world_points
from mixed_stages import body, scene
from pxr import Usd, UsdGeom
from small_stages import open_with

import gf_usd
from gf_usd.core.errors import InputError
from gf_usd.delivery.deliver import deliver
from gf_usd.readers.pictures.recording import BakedMotion

TOLERANCE = 0.02
FRAMES = 4
SHOWN = {"Gone": (True, True, False, False), "Ghost": (False, True, True, True)}
"""Of each body, in which frames it is visible."""

BODY = """
    def Mesh "{name}"
    {{
        int[] faceVertexCounts = {counts}
        int[] faceVertexIndices = {faces}
        point3f[] points.timeSamples = {{ {points} }}
        token visibility.timeSamples = {{ {shown} }}
    }}
"""


def written(path: Path, *names: str) -> Path:
    """Balls that stand in each other, and are stretched, bent and moved in each frame."""
    ball = trimesh.creation.icosphere(subdivisions=1)
    counts, faces = [3] * len(ball.faces), ball.faces.reshape(-1).tolist()
    bodies = []
    for name in names:
        points, shown = [], []
        for k in range(FRAMES):
            bent = ball.vertices + 0.03 * k * np.sin(3.0 * ball.vertices[:, [1, 2, 0]])
            moved = bent * (1.0 + 0.1 * k, 1.0, 1.0) + (0.0, 0.5 * k, 0.0)
            points.append(f"{k + 1}: {[tuple(row) for row in moved.tolist()]}")
            word = "inherited" if SHOWN[name][k] else "invisible"
            shown.append(f'{k + 1}: "{word}"')
        bodies.append(
            BODY.format(
                name=name, counts=counts, faces=faces, points=", ".join(points),
                shown=", ".join(shown),
            )
        )  # fmt: skip
    head = f'upAxis = "Y"\n metersPerUnit = 1\n startTimeCode = 1\n endTimeCode = {FRAMES}'
    text = f'#usda 1.0\n(\n {head}\n defaultPrim = "World"\n)\ndef Xform "World"\n{{'
    path.write_text(text + "".join(bodies) + "}\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("kind", ["joints", "shapes"])
@pytest.mark.parametrize("name", list(SHOWN))
def test_gltf_scales_to_nothing_what_is_hidden(tmp_path: Path, name: str, kind: str) -> None:
    source = written(tmp_path / "in.usda", name)
    done = deliver(source, tmp_path / "out.glb", error=TOLERANCE, kind=kind)
    assert [body.meshes for body in done.bodies] == [(f"/World/{name}",)]
    assert done.notes == (
        f"/World/{name}: a scale of 0 hides it in the frames in which it is invisible",
    )
    theirs = gltf_vertices(done.path)
    ours = world_points_of(source, name)
    for frame, shown in enumerate(SHOWN[name]):
        if not shown:
            # single precision of numbers of about two
            assert np.ptp(theirs[frame], axis=0).max() <= 1e-6
            continue
        gap = np.linalg.norm(theirs[frame][:, None] - ours[frame][None], axis=2).min(axis=1)
        assert gap.max() <= TOLERANCE * done.bodies[0].radius


def world_points_of(path: Path, name: str) -> np.ndarray:
    stage = Usd.Stage.Open(str(path))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(f"/World/{name}"))
    return np.array([mesh.GetPointsAttr().Get(1.0 + k) for k in range(FRAMES)], np.float64)


def test_a_program_holds_the_scale_between_frames(tmp_path: Path) -> None:
    done = deliver(written(tmp_path / "in.usda", "Gone"), tmp_path / "out.glb", error=TOLERANCE)
    data = done.path.read_bytes()
    tree = json.loads(data[20 : 20 + struct.unpack_from("<I", data, 12)[0]])
    (animation,) = tree["animations"]
    hows = {
        channel["target"]["path"]: animation["samplers"][channel["sampler"]].get("interpolation")
        for channel in animation["channels"]
    }
    assert hows.pop("scale") == "STEP"
    assert set(hows.values()) == {None}  # linear


def test_what_is_hidden_at_other_times_is_a_body_of_its_own(tmp_path: Path) -> None:
    source = written(tmp_path / "in.usda", "Gone", "Ghost")
    done = deliver(source, tmp_path / "out.glb", error=TOLERANCE)
    assert sorted(body.meshes for body in done.bodies) == [("/World/Ghost",), ("/World/Gone",)]


@pytest.mark.parametrize("kind", ["joints", "shapes"])
def test_usd_keeps_the_visibility_of_the_source(tmp_path: Path, kind: str) -> None:
    source = written(tmp_path / "in.usda", "Gone", "Ghost")
    done = deliver(source, tmp_path / "out.usda", error=TOLERANCE, kind=kind)
    assert done.notes == ()
    stage = Usd.Stage.Open(str(done.path))
    for name, shown in SHOWN.items():
        image = UsdGeom.Imageable(stage.GetPrimAtPath(f"/World/{name}"))
        found = [image.ComputeVisibility(1.0 + k) != "invisible" for k in range(FRAMES)]
        assert tuple(found) == shown
    # of Gone, which is visible at the default time: that reader takes what is
    off = world_points(done.path)["/World/Gone"] - world_points_of(source, "Gone")
    assert np.linalg.norm(off, axis=2).max() <= TOLERANCE * done.bodies[0].radius


@pytest.mark.slow
@pytest.mark.parametrize("flatten", [False, True], ids=["layers", "one file"])
def test_usd_hides_what_particles_stand_for(tmp_path: Path, flatten: bool) -> None:
    """It stood at rest for the whole motion: what the bake hides it with is in the cache."""
    blocks = scene(
        tmp_path,
        body("Block", "rubber", "0, 0.1, 0"),
        body("Other", "rubber", "1, 0.3, 0"),
    )
    bake = gf_usd.bake(
        blocks, frames=4, output=tmp_path / "bake.usda", particles=300, flatten=flatten,
        conversions="/World/Block=dry-sand@time:2",
    )  # fmt: skip
    assert BakedMotion(bake.root).recording().converted == ("/World/Block",)
    done = deliver(bake.root, tmp_path / "out.usda", error=TOLERANCE)
    assert [one.meshes for one in done.bodies] == [("/World/Other",)]
    assert "</World/Block>: left out because particles replace it" in done.notes
    stage = Usd.Stage.Open(str(done.path))
    for name, shown in (("Block", False), ("Other", True)):
        image = UsdGeom.Imageable(stage.GetPrimAtPath(f"/World/{name}"))
        for code in (1.0, 4.0):
            assert (image.ComputeVisibility(code) != "invisible") == shown


@pytest.mark.slow
def test_usd_hides_in_every_variant_what_particles_stand_for(tmp_path: Path) -> None:
    blocks = scene(
        tmp_path,
        body("Block", "rubber", "0, 0.1, 0"),
        body("Other", "rubber", "1, 0.3, 0"),
    )
    bake = gf_usd.bake(
        blocks, frames=3, output=tmp_path / "bake.usda", particles=100, material="rubber,jelly",
        conversions="/World/Block=dry-sand@time:2",
    )  # fmt: skip
    done = deliver(bake.root, tmp_path / "out.usda", error=TOLERANCE)
    for variant, block in (("rubber", False), ("jelly", False), ("none", True)):
        stage = open_with(done.path, variant)
        for name, shown in (("Block", block), ("Other", True)):
            image = UsdGeom.Imageable(stage.GetPrimAtPath(f"/World/{name}"))
            assert (image.ComputeVisibility(2.0) != "invisible") == shown


def sand(folder: Path, **options: Any) -> Path:
    block = scene(folder, body("Block", "dry-sand", "0, 0.1, 0"))
    return gf_usd.bake(
        block, frames=3, output=folder / "bake.usda", particles=300, **options
    ).root  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [pytest.param(".glb", marks=pytest.mark.slow), ".usda"])
def test_the_hint_about_what_flows_can_be_followed(tmp_path: Path, suffix: str) -> None:
    bake = sand(tmp_path)
    with pytest.raises(InputError, match="flows without limit: particles replace") as caught:
        deliver(bake, tmp_path / f"out{suffix}")
    assert caught.value.hint.endswith("deliver the particles as Gaussians to a .glb: --splats only")
    assert deliver(bake, tmp_path / "out.glb", splats="only").splats


def test_without_gaussians_the_hint_says_how_to_get_them(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="flows without limit") as caught:
        deliver(sand(tmp_path, only="points"), tmp_path / "out.glb")
    assert "bake again with gaussians among --only" in caught.value.hint


def test_a_mesh_that_tears_is_delivered_with_a_note(tmp_path: Path) -> None:
    done = deliver(sand(tmp_path, only="mesh"), tmp_path / "out.glb", error=TOLERANCE)
    assert [one.meshes for one in done.bodies] == [("/World/Block",)]
    assert [note for note in done.notes if "meshes tear where particles separate" in note]
