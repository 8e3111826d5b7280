"""``gf-usd deliver``: what it prints."""

from __future__ import annotations

import json
from pathlib import Path

from moving_splats import moving_splats


def test_it_says_how_far_off_gaussians_are(gf_usd, tmp_path: Path) -> None:
    source = moving_splats(tmp_path / "ball.usdc", mesh=False)
    done = gf_usd("deliver", source, "-o", tmp_path / "out.glb", "--error", "2%")
    assert done.status == 0, done.err
    assert "</Ball/Splats>: 200 Gaussians, position error at most" in done.out
    assert "covariance error" in done.out
    done = gf_usd("deliver", source, "-o", tmp_path / "out.glb", "--error", "2%", "--json")
    report = json.loads(done.out)["splats"][0]
    assert report["count"] == 200
    assert len(report["covariance"]) == 3
    done = gf_usd("deliver", source, "-o", tmp_path / "out.usdz", "--splats", "only")
    assert done.status == 2
    assert "--splats only is only for .glb" in done.err
