"""What the page's data.js would unpack is what was packed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from recordings import FRAMES, FallingBox, unpack
from scipy.spatial.transform import Rotation

from gf_usd.view.report.motion import Motion, collect
from gf_usd.view.report.pack import Packer, color_reach, encode_stretch, pack


@pytest.fixture(scope="module")
def motion() -> Motion:
    source = FallingBox()
    recording = source.recording()
    return collect(recording, source.frames(recording.time_codes), 100, 30)


@pytest.mark.parametrize("dtype", ["uint8", "int8", "uint16", "uint32"])
@pytest.mark.parametrize("moving", [False, True])
def test_every_type_comes_back(dtype, moving):
    info = np.iinfo(dtype)
    values = np.random.default_rng(0).integers(info.min, info.max, (5, 7, 3), dtype, True)
    packer = Packer()
    packer.add("before", np.arange(3, dtype=np.uint8))
    packer.add("values", values, moving=moving)
    assert np.array_equal(unpack(packer.table, packer.blob(), "values"), values)


def test_positions_are_kept_to_a_step(motion):
    table, blob = pack(motion)
    for name, truth in (("points", motion.points), ("positions", motion.positions)):
        code = unpack(table, blob, name)
        assert code.shape == truth.shape
        back = table[name]["low"] + code * np.array(table[name]["step"])
        # half a step of rounding, and single precision
        step = np.array(table[name]["step"])
        assert (np.abs(back - truth) <= 0.5 * step + 1e-7).all()
        assert step.max() <= 1.0 / 65535.0


def test_gaussians_keep_their_shape(motion):
    table, blob = pack(motion)
    rotations = Rotation.from_quat(unpack(table, blob, "turns").reshape(-1, 4).astype(float))
    scale = table["scales"]
    sizes = np.exp(scale["low"] + scale["step"] * unpack(table, blob, "scales").reshape(-1, 3))
    R = rotations.as_matrix()
    sigma = (R * sizes[:, None, :] ** 2) @ R.transpose(0, 2, 1)
    squeezed = (1.0, 1.0, 0.8, 0.5, 0.9, 1.1, 1.0)
    truth = np.array([np.diag([1, s * s, 1]) for s in squeezed]) * 1e-4
    # scales in 255 steps of their logarithm, turns in 1/127
    count = len(motion.gaussian_indices)
    assert sigma.reshape(FRAMES, count, 3, 3) == pytest.approx(
        np.repeat(truth[:, None], count, axis=1), abs=0.02 * 1e-4
    )


def test_stretch_is_coded_by_its_logarithm(motion):
    assert encode_stretch(np.array([0.01, 0.25, 1.0, 4.0, 100.0])).tolist() == [1, 1, 128, 255, 255]
    table, blob = pack(motion)
    back = 2.0 ** ((unpack(table, blob, "ratio") - 128.0) / 127.0 * 2.0)
    # one code is 2^(2/127): 1.1 %
    assert back[:, 0] == pytest.approx([1.0, 1.0, 0.8, 0.5, 0.9, 1.1, 1.0], rel=0.006)


def test_curves_are_of_the_whole_body(motion):
    curves = motion.curves
    assert curves["lowest"] == pytest.approx([0.5, 0.3, 0.0, 0.0, 0.0, 0.1, 0.0], abs=1e-12)
    assert curves["highest"][3] == pytest.approx(0.1)
    assert curves["ratio_min"] == pytest.approx([1.0, 1.0, 0.8, 0.5, 0.9, 1.1, 1.0])
    assert curves["surface_min"][3] == pytest.approx(0.5)
    assert curves["surface_max"][5] == pytest.approx(1.1)
    whole = FallingBox()
    mean = np.mean([f.positions[:, 1].mean() for f in whole.frames([1.0])])
    # the center is that of all 40 Gaussians, of which the page keeps 30
    assert len(motion.gaussian_indices) == 30
    assert curves["center"][0] == pytest.approx(mean)


def test_a_small_body_is_not_left_out_of_the_stretches():
    """A thousandth of the area of each mesh is left out, not of all together."""
    source = FallingBox()
    recording, box = source.recording(), source.recording().meshes[0]
    assert len(recording.meshes) == 1
    small = replace(box, name="/Small", points=1e-3 * box.points)
    two = replace(recording, meshes=(box, small), baked=(True, True))
    torn = np.array([5.0, 1.0, 1.0])
    frames = [
        replace(frame, meshes=[frame.meshes[0], small.points * torn])
        for frame in source.frames(recording.time_codes)
    ]
    assert collect(two, frames, 100, 30).curves["surface_max"] == pytest.approx([5.0] * FRAMES)


@pytest.mark.parametrize("beside", ["nothing", "fine part", "ground"])
def test_the_colors_reach_what_the_area_of_the_bodies_is_stretched_by(beside):
    """Vertices were counted: a finely divided part of a thousandth of the area made the range."""
    source = FallingBox(gaussians=0)
    recording, box = source.recording(), source.recording().meshes[0]
    grid = np.array([(x, 0.0, z) for x in range(20) for z in range(20)], float)
    corner = np.array([20 * i + j for i in range(19) for j in range(19)])
    faces = np.concatenate([corner[:, None] + [0, 1, 21], corner[:, None] + [0, 21, 20]])
    meshes, baked = [box], [True]
    if beside != "nothing":
        points = grid * (1e-4 if beside == "fine part" else 10.0)
        colors = np.full((len(faces), 3, 3), 0.5)
        meshes.append(replace(box, name="/Two", points=points, triangles=faces, colors=colors))
        baked.append(beside == "fine part")
    frames = [
        replace(frame, meshes=[box.points * (1.9, 1.0, 1.0), *(m.points for m in meshes[1:])])
        for frame in source.frames(recording.time_codes)
    ]
    seen = replace(recording, meshes=tuple(meshes), baked=tuple(baked))
    table, _ = pack(collect(seen, frames, 1000, 30))
    assert table["stretch"]["reach"] == 1.0  # octaves: 1.9 is 0.93 of one


def test_the_colors_reach_most_of_the_gaussians(motion):
    """Their volumes are 0.5 to 1.1 of those at rest, at the worst in one frame of seven."""
    assert pack(motion)[0]["ratio"]["reach"] == 1.0
    assert color_reach(encode_stretch(np.array([[1.0] * 99 + [4.0]])), np.ones(100)) == 0.125
    assert color_reach(encode_stretch(np.array([[1.0] * 97 + [4.0] * 3])), np.ones(100)) == 2.0


def test_slivers_have_no_colors_beyond_the_curves():
    """They made the range of colors, in which vertices were counted: slivers have as many."""
    source = FallingBox()
    recording, box = source.recording(), source.recording().meshes[0]
    sliver = np.array([(0.5, 0.0, 0.0), (0.5, 1e-4, 0.0), (0.5, 0.0, 0.1)])
    one = replace(
        box,
        points=np.concatenate([box.points, sliver]),
        triangles=np.concatenate([box.triangles, [(8, 9, 10)]]),
        colors=np.full((13, 3, 3), 0.5),
    )
    frames = [
        replace(frame, meshes=[np.concatenate([frame.meshes[0], sliver * (1.0, 50.0, 1.0)])])
        for frame in source.frames(recording.time_codes)
    ]
    motion = collect(replace(recording, meshes=(one,)), frames, 100, 30)
    assert motion.points.shape[1] == 11
    assert motion.stretch.max(axis=1) == pytest.approx(motion.curves["surface_max"])
    assert max(motion.curves["surface_max"]) < 1.2
    # what is not a sliver keeps its stretch
    plain = collect(recording, source.frames(recording.time_codes), 100, 30)
    assert np.array_equal(motion.stretch[:, :8], plain.stretch)


def test_a_motion_without_gaussians_or_without_meshes_packs():
    bare = FallingBox(gaussians=0)
    recording = bare.recording()
    motion = collect(recording, bare.frames(recording.time_codes), 100, 100)
    table, _ = pack(motion)
    assert "positions" not in table
    assert motion.curves["center"][0] == pytest.approx(0.6)
    assert "ratio_min" not in motion.curves


def test_what_a_bake_measured_of_its_gaussians_is_kept_in_255_steps():
    source = FallingBox()
    recording = source.recording()
    rng = np.random.default_rng(3)
    given = {name: rng.uniform(0.0, 0.4, (FRAMES, 40)) for name in ("plastic", "stress")}
    frames = [
        replace(frame, measured={name: values[i] for name, values in given.items()})
        for i, frame in enumerate(source.frames(recording.time_codes))
    ]
    motion = collect(recording, frames, 100, 30)
    table, blob = pack(motion)
    assert "elastic" not in table
    for name, values in given.items():
        top = table[name]["top"]
        kept = values[:, motion.gaussian_indices]
        assert top == pytest.approx(np.percentile(kept, 99.5), rel=1e-6)
        back = unpack(table, blob, name) / 255.0 * top
        np.testing.assert_allclose(back, np.minimum(kept, top), rtol=0.0, atol=0.51 * top / 255.0)
