"""Blender plays delivered files: every vertex of every frame within the error that was stated."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from client_assets import Baked, time_codes, world_points
from client_runs import PROBES, needs, programs, run

from gf_usd.core.neighbors import kd_tree
from gf_usd.delivery.deliver import deliver

pytestmark = [pytest.mark.clients, needs("blender")]

ERROR = 0.02
NEAR = 1e-5  # of the size of the scene: Blender's matrices are single precision
FIRST = {".usdz": None, ".glb": 0}  # Blender begins a glTF animation at frame 0


@pytest.mark.parametrize("suffix", FIRST)
@pytest.mark.parametrize("kind", ["joints", "shapes"])
@pytest.mark.parametrize("asset", ["duck", "blocks"])
def test_every_vertex_is_within_the_error(
    asset: str, kind: str, suffix: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    baked: Baked = request.getfixturevalue(asset)
    done = deliver(baked.root, tmp_path / f"out{suffix}", error=ERROR, kind=kind)
    codes = time_codes(baked.root)
    ours = np.concatenate(list(world_points(baked.root).values()), axis=1)
    begin = codes[0] if FIRST[suffix] is None else FIRST[suffix]
    rate = 24 if asset == "duck" else 30
    target = tmp_path / "blender.npz"
    python = programs("blender") / "python"
    probe = PROBES / "blender_deliver.py"
    run([python, probe, done.path, target, int(begin), int(begin) + len(codes) - 1, rate])
    with np.load(target) as arrays:
        theirs = np.concatenate([arrays[k] for k in arrays if ":" not in k], axis=1)
    # glTF splits vertices: each is the point that it coincides with at first
    gap, at = kd_tree(ours[0]).query(theirs[0])
    size = float(np.abs(ours).max())
    radius = max(body.radius for body in done.bodies)
    assert set(at.tolist()) == set(range(ours.shape[1]))
    assert gap.max() <= done.error * radius + NEAR * size
    off = np.linalg.norm(theirs - ours[:, at], axis=2).max()
    assert off <= done.error * radius + NEAR * size
    assert np.ptp(theirs, axis=0).max() > 10 * done.error * radius  # it does move
