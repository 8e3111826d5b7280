"""The rigged creature: sound as a mesh, valid as USD, and grounded in its motions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from pxr import Usd, UsdGeom, UsdSkel, UsdValidation

from tools.samples.creature_rig import AIR, FPS, FRAMES, GRAVITY, height

REPO = Path(__file__).resolve().parents[2]
ROUNDING = 2e-5  # [cm] of points, transforms and float32 skinning


@pytest.fixture(scope="module")
def stage() -> Usd.Stage:
    return Usd.Stage.Open(str(REPO / "samples" / "creature.usda"))


def body(stage: Usd.Stage) -> UsdGeom.Mesh:
    return UsdGeom.Mesh(stage.GetPrimAtPath("/Creature/Geom/Body"))


def posed(stage: Usd.Stage, motion: str) -> np.ndarray:
    """(FRAMES, V, 3) [cm] as UsdSkel skins the mesh."""
    variants = stage.GetDefaultPrim().GetVariantSets().GetVariantSet("motion")
    assert variants.SetVariantSelection(motion)
    root = UsdSkel.Root(stage.GetDefaultPrim())
    cache = UsdSkel.Cache()
    cache.Populate(root, Usd.TraverseInstanceProxies())
    skinning = cache.GetSkinningQuery(body(stage).GetPrim())
    skeleton = cache.GetSkelQuery(UsdSkel.Skeleton(stage.GetPrimAtPath("/Creature/Skeleton")))
    frames = []
    for code in range(1, FRAMES + 1):
        points = body(stage).GetPointsAttr().Get()
        transforms = skeleton.ComputeSkinningTransforms(code)
        assert skinning.ComputeSkinnedPoints(transforms, points, code)
        frames.append(np.array(points))
    variants.SetVariantSelection("walk")
    return np.stack(frames)


def test_the_mesh_is_one_closed_shell_and_exactly_symmetric(stage: Usd.Stage) -> None:
    points = np.array(body(stage).GetPointsAttr().Get(), dtype=float)
    faces = np.array(body(stage).GetFaceVertexIndicesAttr().Get()).reshape(-1, 4)
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    directed = {(int(a), int(b)) for a, b in edges}
    assert len(directed) == len(edges)
    assert {(b, a) for a, b in directed} == directed
    assert len(points) - len(edges) // 2 + len(faces) == 2
    mirrored = {tuple(p) for p in points * [-1.0, 1.0, 1.0] + 0.0}
    assert {tuple(p) for p in points + 0.0} == mirrored


@pytest.mark.slow
def test_texture_coordinates_are_not_flipped_and_the_texture_is_there(stage: Usd.Stage) -> None:
    st = UsdGeom.PrimvarsAPI(body(stage)).GetPrimvar("st")
    uv = np.array(st.ComputeFlattened(), dtype=float).reshape(-1, 4, 2)
    one, two = uv[:, 2] - uv[:, 0], uv[:, 3] - uv[:, 1]
    assert (one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]).min() > 0.0
    file = stage.GetPrimAtPath("/Creature/Materials/Coat/Texture").GetAttribute("inputs:file")
    with Image.open(file.Get().resolvedPath) as image:
        assert len(np.unique(np.array(image.convert("RGB")).reshape(-1, 3), axis=0)) > 20


def test_weights_sum_to_one(stage: Usd.Stage) -> None:
    binding = UsdSkel.BindingAPI(body(stage))
    weights = np.array(binding.GetJointWeightsPrimvar().Get(), dtype=float).reshape(-1, 4)
    joints = np.array(binding.GetJointIndicesPrimvar().Get())
    # each of the four is rounded to half a unit of the fifth decimal
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=2e-5)
    assert weights.min() >= 0.0
    assert set(joints) <= set(range(15))


def test_the_walk_touches_the_ground_and_closes(stage: Usd.Stage) -> None:
    frames = posed(stage, "walk")
    np.testing.assert_allclose(frames[..., 1].min(axis=1), 0.0, atol=10.0 * ROUNDING)
    steps = np.linalg.norm(np.roll(frames, -1, axis=0) - frames, axis=2).max(axis=1)
    # the step from the last frame to the first is one of the cycle's own
    assert steps[-1] <= 1.2 * steps[:-1].max()
    assert steps.max() < 5.0  # [cm] a frame: nothing jumps


def test_the_jump_is_a_free_flight(stage: Usd.Stage) -> None:
    low = posed(stage, "jump")[..., 1].min(axis=1)
    np.testing.assert_allclose(low, [height(k) for k in range(FRAMES)], atol=10.0 * ROUNDING)
    top = GRAVITY * ((AIR[1] - AIR[0]) / FPS) ** 2 / 8.0
    assert low.max() == pytest.approx(top, rel=0.01)  # the top is between two frames at most


def test_usd_validation_finds_nothing(stage: Usd.Stage) -> None:
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    errors = UsdValidation.ValidationContext(validators).Validate(stage)
    assert [f"{error.GetName()}: {error.GetMessage()}" for error in errors] == []
