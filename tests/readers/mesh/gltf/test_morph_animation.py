"""Animated weights of morph targets: blend shapes that stand where glTF 2.0 has them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import arm
import gltf_arm
import numpy as np
import pytest
from gltf_arm import FPS, FRAMES
from mesh_makers import CORNERS, TRIANGLES, GltfMaker
from numpy.typing import NDArray

from gf_usd.core.errors import InputError
from gf_usd.core.frames.frame import Pose
from gf_usd.geometry.flesh.shapes import with_shapes
from gf_usd.readers import convert, read_asset
from gf_usd.readers.mesh.gltf.scene import read_rigged_gltf
from gf_usd.readers.usd.skeleton.blend_shapes import read_blend_shapes

CLOSE = 1e-5  # of an arm of 2 m: UsdSkel has float32, and scales in half precision
LAST = (FRAMES - 1) / FPS  # [s]
KEYS = np.array([0.0, 4.0, 10.0, 12.0]) / FPS  # [s] on frames
WEIGHTS = np.array([[0.25, 0.5], [1.5, 0.5], [-0.5, 0.5], [1.0, 0.5]])  # the second stays
SLOPES = np.array([[3.0, 0.0], [-2.0, 0.0], [5.0, 0.0], [1.0, 0.0]])  # [1/s]

X = arm.points()
FATTER = np.zeros_like(X)
FATTER[12:20] = 0.3 * X[12:20] * [0, 1, 1]
HIGHER = np.tile([0.0, 0.25, 0.0], (len(X), 1))


def weights(mode: str, t: float) -> NDArray[np.float64]:
    """(2,) at a time [s], by the equations of the standard, one key interval at a time."""
    k = min(int(np.searchsorted(KEYS, t + 1e-9, side="right")) - 1, len(KEYS) - 2)
    if mode == "STEP":
        return WEIGHTS[-1] if t >= KEYS[-1] - 1e-9 else WEIGHTS[k]
    d = KEYS[k + 1] - KEYS[k]
    s = (t - KEYS[k]) / d
    if mode == "LINEAR":
        return (1 - s) * WEIGHTS[k] + s * WEIGHTS[k + 1]
    value = (2 * s**3 - 3 * s**2 + 1) * WEIGHTS[k] + d * (s**3 - 2 * s**2 + s) * SLOPES[k]
    return value + (3 * s**2 - 2 * s**3) * WEIGHTS[k + 1] + d * (s**3 - s**2) * SLOPES[k + 1]


def sparse(made: GltfMaker, values: NDArray[np.float64]) -> int:
    """The number of a sparse accessor, without a buffer view, of the rows that are not 0."""
    rows = np.flatnonzero(values.any(1))
    made.tree["accessors"].append(
        {
            "componentType": 5126, "count": len(values), "type": "VEC3",
            "sparse": {
                "count": len(rows),
                "indices": {
                    "bufferView": made.view(rows.astype(np.uint16).tobytes()),
                    "componentType": 5123,
                },
                "values": {"bufferView": made.view(values[rows].astype(np.float32).tobytes())},
            },
        }
    )  # fmt: skip
    return len(made.tree["accessors"]) - 1


def add_weights(made: GltfMaker, mode: str = "LINEAR", *, node: int = 0, **output: Any) -> None:
    """Add a channel for the weights of a node to the animation, or make one."""
    if mode == "CUBICSPLINE":  # for each key the in-tangents, the values, the out-tangents
        values = np.stack([SLOPES, WEIGHTS, SLOPES], 1)
    else:
        values = WEIGHTS
    values = output.get("values", values)
    if "animations" not in made.tree:
        made.tree["animations"] = [{"samplers": [], "channels": []}]
    (animation,) = made.tree["animations"]
    sampler = {
        "input": made.accessor(KEYS.astype(np.float32)),
        "output": made.accessor(values.astype(np.float32).reshape(-1)),
        "interpolation": mode,
    }
    animation["samplers"].append(sampler)
    animation["channels"].append(
        {"sampler": len(animation["samplers"]) - 1, "target": {"node": node, "path": "weights"}}
    )


def morphing_arm(mode: str = "LINEAR", *, animated: bool = True) -> GltfMaker:
    """The arm with the targets "fat", sparse, and "high"; animated : its joints as well."""
    made = gltf_arm.maker(animated=animated)
    (mesh,) = made.tree["meshes"]
    mesh["primitives"][0]["targets"] = [
        {"POSITION": sparse(made, FATTER)},
        {"POSITION": made.accessor(HIGHER.astype(np.float32))},
    ]
    mesh["extras"] = {"targetNames": ["fat", "high"]}
    mesh["weights"] = [0.0, 9.0]  # an animation overrides them
    add_weights(made, mode)
    return made


def usd(path: Path) -> Path:
    """The USD form of a file, with its skeletons."""
    source = convert(path, rigged=True)
    assert source is not None
    return source.write(path.with_suffix(".source.usdc"))


@pytest.mark.parametrize("mode", ["LINEAR", "STEP", "CUBICSPLINE"])
def test_the_skin_stands_where_gltf_has_it(tmp_path: Path, mode: str) -> None:
    layer = usd(gltf_arm.write(tmp_path, morphing_arm(mode)))
    for frame in range(FRAMES):
        w = weights(mode, frame / FPS)
        (surface,) = read_asset(layer, time_code=1.0 + frame).surfaces
        wanted = gltf_arm.posed(frame, offsets=w[0] * FATTER + w[1] * HIGHER)
        np.testing.assert_allclose(surface.points, wanted, atol=CLOSE)


def test_flesh_has_the_offsets_and_velocities_of_the_shapes(tmp_path: Path) -> None:
    """The rest shape has the weights of the first frame, and what they add since is on top."""
    layer = usd(gltf_arm.write(tmp_path, morphing_arm()))
    asset = read_asset(layer, bind_pose=True)
    (surface,) = asset.surfaces
    times = [1.0 + frame for frame in range(FRAMES)]
    found = read_blend_shapes(layer, [surface.path], asset.facts, first=1.0, times=times)
    shapes = found[surface.path]
    assert shapes.names == ("fat",)
    n = len(surface.points)
    still = Pose(x=np.zeros((n, 3)), v=np.zeros((n, 3)), F=np.tile(np.eye(3), (n, 1, 1)))
    lengths = np.linalg.norm(FATTER, axis=1)
    for frame in range(FRAMES):
        out = with_shapes(still, shapes, frame, 1.0 / FPS)
        added = weights("LINEAR", frame / FPS)[0] - WEIGHTS[0, 0]
        np.testing.assert_allclose(np.linalg.norm(out.x, axis=1), abs(added) * lengths, atol=CLOSE)
    # the last two frames are in one key interval, of a constant rate
    rate = (WEIGHTS[3, 0] - WEIGHTS[2, 0]) / (KEYS[3] - KEYS[2])
    np.testing.assert_allclose(np.linalg.norm(out.v, axis=1), abs(rate) * lengths, atol=CLOSE * FPS)


def test_weights_are_animated_without_moving_joints(tmp_path: Path) -> None:
    made = morphing_arm(animated=False)
    layer = usd(gltf_arm.write(tmp_path, made))
    start = read_asset(layer, time_code=1.0).surfaces[0].points
    for frame in range(FRAMES):
        moved = read_asset(layer, time_code=1.0 + frame).surfaces[0].points - start
        added = weights("LINEAR", frame / FPS)[0] - WEIGHTS[0, 0]
        np.testing.assert_allclose(
            np.linalg.norm(moved, axis=1), abs(added) * np.linalg.norm(FATTER, axis=1), atol=CLOSE
        )


def test_two_meshes_of_a_skeleton_have_weights_of_their_own(tmp_path: Path) -> None:
    """Blend shapes of equal names of a skeleton have one weight in UsdSkel."""
    made = morphing_arm()
    made.tree["nodes"].append({**made.tree["nodes"][0], "name": "Twin"})
    twin = len(made.tree["nodes"]) - 1
    made.tree["scenes"][0]["nodes"].append(twin)
    add_weights(made, node=twin, values=2.0 * WEIGHTS)
    layer = usd(gltf_arm.write(tmp_path, made))
    one, two = read_asset(layer, time_code=5.0).surfaces
    for surface, factor in ((one, 1.0), (two, 2.0)):
        w = factor * weights("LINEAR", 4.0 / FPS)
        wanted = gltf_arm.posed(4.0, offsets=w[0] * FATTER + w[1] * HIGHER)
        np.testing.assert_allclose(surface.points, wanted, atol=CLOSE)


def test_a_mesh_that_hangs_from_a_joint_changes_its_shape(tmp_path: Path) -> None:
    made = gltf_arm.maker()
    primitive = made.primitive(CORNERS, TRIANGLES)
    grown = CORNERS.astype(np.float32)
    primitive["targets"] = [{"POSITION": made.accessor(grown)}] * 2
    boot = made.mesh(primitive, name="Boot")
    made.tree["nodes"][4]["children"] = [boot]
    add_weights(made, node=boot)
    layer = usd(gltf_arm.write(tmp_path, made))
    for frame in (0, 4, 7):
        size = 1.0 + weights("LINEAR", frame / FPS).sum()
        (box,) = [s for s in read_asset(layer, time_code=1.0 + frame).surfaces if "Boot" in s.path]
        away = np.linalg.norm(box.points[:, None] - box.points[None], axis=2).max()
        wanted = gltf_arm.SMALL * size * np.linalg.norm(np.ptp(CORNERS, axis=0))
        np.testing.assert_allclose(away, wanted, atol=CLOSE)


def test_notes_name_the_targets_that_do_not_change_and_weights_that_are_ignored(
    tmp_path: Path,
) -> None:
    made = morphing_arm()
    primitive = made.primitive(CORNERS, TRIANGLES)
    primitive["targets"] = [{"POSITION": made.accessor(CORNERS.astype(np.float32))}] * 2
    prop = made.mesh(primitive, name="Prop")
    made.tree["scenes"][0]["nodes"].append(prop)
    add_weights(made, node=prop)
    add_weights(made, node=1)
    notes = read_rigged_gltf(gltf_arm.write(tmp_path, made)).notes
    assert "Prop: no skeleton poses it: its animated weights are ignored" in notes
    assert "Figure: it has no morph targets: its animated weights are ignored" in notes
    (still,) = [note for note in notes if note.startswith("Skin ") and "morph" in note]
    assert still.endswith("the morph targets whose weights do not change: high with 0.5")


def test_weights_that_do_not_fit_the_targets_are_refused(tmp_path: Path) -> None:
    made = morphing_arm()
    made.tree["meshes"][0]["primitives"][0]["targets"].pop()
    with pytest.raises(InputError, match=r"weights has 8 rows of 1 values for 4 keys \(LINEAR\)"):
        read_rigged_gltf(gltf_arm.write(tmp_path, made))


@pytest.mark.parametrize(
    ("key", "named"), [("POSITION", "offsets"), ("NORMAL", "normal offsets")], ids=str
)
def test_offsets_that_are_not_finite_are_refused(tmp_path: Path, key: str, named: str) -> None:
    """Those of normals reached the layer."""
    made = morphing_arm()
    broken = FATTER.copy()
    broken[12] = np.nan
    (primitive,) = made.tree["meshes"][0]["primitives"]
    primitive["attributes"]["NORMAL"] = made.accessor(
        np.tile([0.0, 0.0, 1.0], (len(X), 1)).astype(np.float32)
    )
    primitive["targets"][0][key] = sparse(made, broken)
    message = f"1 of 36 {named} of its blend shape 'fat' are not finite"
    with pytest.raises(InputError, match=message):
        read_rigged_gltf(gltf_arm.write(tmp_path, made))


def add_second_arm(made: GltfMaker) -> None:
    """Add a skeleton of its own with a mesh without morph targets."""
    nodes = made.tree["nodes"]
    first = len(nodes)
    points = made.tree["meshes"][0]["primitives"][0]
    primitive = {key: row for key, row in points.items() if key != "targets"}
    made.tree["meshes"].append({"primitives": [primitive]})
    made.tree["skins"].append({**made.tree["skins"][0], "joints": [first + 1, first + 2]})
    nodes += [
        {"name": "Still", "mesh": len(made.tree["meshes"]) - 1, "skin": 1},
        {"name": "C", "children": [first + 2], "scale": [gltf_arm.SMALL] * 3},
        {"name": "D", "translation": [1.0 / gltf_arm.SMALL, 0, 0]},
    ]
    made.tree["scenes"][0]["nodes"] += [first, first + 1]


def test_only_the_skeletons_of_meshes_whose_weights_are_animated_move(tmp_path: Path) -> None:
    """All skeletons of a file had an animation where one of its meshes had weights."""
    made = morphing_arm(animated=False)
    add_second_arm(made)
    file = read_rigged_gltf(gltf_arm.write(tmp_path, made))
    assert [one.translations is not None for one in file.skeletons] == [True, False]


def test_a_skeleton_moves_for_the_weights_of_a_mesh_that_hangs_from_its_joint(
    tmp_path: Path,
) -> None:
    made = gltf_arm.maker(animated=False)
    primitive = made.primitive(CORNERS, TRIANGLES)
    primitive["targets"] = [{"POSITION": made.accessor(CORNERS.astype(np.float32))}] * 2
    boot = made.mesh(primitive, name="Boot")
    made.tree["nodes"][4]["children"] = [boot]
    add_weights(made, node=boot)
    add_second_arm(made)
    file = read_rigged_gltf(gltf_arm.write(tmp_path, made))
    assert [one.translations is not None for one in file.skeletons] == [True, False]
