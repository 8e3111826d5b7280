"""Newton reads the TetMesh of --tets, and its VBD solver lets it fall as bodies fall."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from client_assets import cube_grid
from client_runs import PROBES, needs, programs, run
from pxr import Usd

import gf_usd

pytestmark = [pytest.mark.clients, needs("newton")]

FRAMES = 10
SINGLE = 2.0**-22  # two roundings to single precision


def test_vbd_simulates_ten_frames_of_the_body(tmp_path: Path) -> None:
    asset = tmp_path / "block.obj"
    points, quads = cube_grid(4)
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in 0.1 * points]
    lines += ["f " + " ".join(str(v + 1) for v in quad) for quad in quads]
    asset.write_text("\n".join(lines) + "\n", encoding="utf-8")
    done = gf_usd.bake(
        asset, output=tmp_path / "block.usda", material="rubber", particles=300, frames=3, tets=True
    )
    assert not done.findings, done.findings
    stage = Usd.Stage.Open(str(done.root))
    path = next(str(p.GetPath()) for p in stage.Traverse() if p.GetTypeName() == "TetMesh")
    prim = stage.GetPrimAtPath(path)
    run([programs("newton") / "python", PROBES / "newton_tets.py", done.root, path, FRAMES])
    report = json.loads(done.root.with_suffix(".json").read_text())
    # All of the tetrahedra and points, masses and moduli of the bake arrive.
    assert report["tets"] == len(prim.GetAttribute("tetVertexIndices").Get())
    assert report["points"] == len(prim.GetAttribute("points").Get())
    np.testing.assert_allclose(
        report["masses"], prim.GetAttribute("physics:masses").Get(), rtol=1e-6
    )
    material = done.bakes[0].material
    much = SINGLE * (1 + 2 / (1 - 2 * material.poissons_ratio))
    np.testing.assert_allclose(
        report["lame"], np.tile((material.mu, material.lam), (report["tets"], 1)), rtol=much
    )
    start, end = np.array(report["start"]), np.array(report["end"])
    np.testing.assert_allclose(start, prim.GetAttribute("points").Get(), atol=1e-6)
    # Implicit Euler falls by g dt^2 n (n + 1) / 2; the body has no stress at rest, so that all of
    # it falls alike, up to what single precision leaves of positions over the steps.
    n = FRAMES * 10
    fallen = report["gravity"][1] * report["step"] ** 2 * n * (n + 1) / 2
    np.testing.assert_allclose((end - start).mean(axis=0), (0, fallen, 0), atol=1e-3 * abs(fallen))
    np.testing.assert_allclose(
        end - start, np.tile((0, fallen, 0), (len(end), 1)), atol=5e-3 * abs(fallen)
    )
