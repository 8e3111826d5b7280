"""Blender plays a surface whose points and faces are others in every frame."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from client_assets import time_codes
from client_runs import PROBES, needs, programs, run
from pxr import Usd, UsdGeom

import gf_usd

pytestmark = [pytest.mark.clients, needs("blender")]

SPHERE = Path(__file__).resolve().parents[2] / "samples" / "sphere.usda"
SURFACE = "/Sphere/GaussianFlesh/Surface"


@pytest.mark.parametrize("clips", [0, 4])
def test_every_frame_has_its_points_faces_and_colors(tmp_path: Path, clips: int) -> None:
    done = gf_usd.bake(
        SPHERE, material="dry-sand", particles=300, frames=8, drop=0, surface=True,
        clip_frames=clips, output=tmp_path / "s.usda",
    )  # fmt: skip
    codes = time_codes(done.root)
    target = tmp_path / "seen.npz"
    probe = [programs("blender") / "python", PROBES / "blender_surface.py"]
    run([*probe, done.root, SURFACE, target, codes[0], codes[-1]])
    seen = np.load(target)
    stage = Usd.Stage.Open(str(done.root))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(SURFACE))
    turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # to Z up
    counts = set()
    for code in codes:
        ours = np.array(mesh.GetPointsAttr().Get(code), np.float64) @ turn
        assert seen[f"points:{code}"].shape == ours.shape
        # single precision, of a scene of 4 m
        assert np.abs(seen[f"points:{code}"] - ours).max() < 4e-5
        faces = np.array(mesh.GetFaceVertexIndicesAttr().Get(code))
        assert np.array_equal(seen[f"faces:{code}"], faces)
        color = np.array(mesh.GetDisplayColorAttr().Get(code))
        assert np.abs(seen[f"color:{code}"][:, :3] - color).max() < 1e-3
        speed = np.array(mesh.GetVelocitiesAttr().Get(code), np.float64)
        assert np.array_equal(seen[f"velocity:{code}"], speed)  # in the axes of the prim, a second
        counts.add(len(ours))
    assert len(counts) > 1, "its points do change"
    report = json.loads(target.with_suffix(".json").read_text())
    assert report["meshes"]["Surface"], "it is rendered"
    assert not report["meshes"].get("Body", False), "the mesh of the asset is not"
