"""Numbers of splat files that cannot be meant are mended, and counted."""

from __future__ import annotations

import struct
from dataclasses import replace

import numpy as np
import pytest
from captures import ball

from gf_usd.core.asset import BRIGHTEST
from gf_usd.readers import read_asset
from gf_usd.readers.splats.write import ply_bytes

NAMES = ("positions", "orientations", "scales", "opacities", "harmonics")


def test_broken_gaussians_are_left_out_and_reported(tmp_path):
    rest = ball(20)
    spoiled = {name: np.array(getattr(rest, name)) for name in NAMES}
    spoiled["positions"][3, 1] = np.nan
    spoiled["orientations"][4] = 0.0
    path = tmp_path / "ball.ply"
    path.write_bytes(ply_bytes(type(rest)(**spoiled)))
    asset = read_asset(path)
    assert len(asset.splats[0]) == 19
    assert "1 of 20 Gaussians are not finite: left out" in asset.facts.notes
    assert "1 Gaussian has a quaternion of length 0: no rotation is assumed" in asset.facts.notes
    np.testing.assert_array_equal(asset.splats[0].orientations[3], [1, 0, 0, 0])


@pytest.mark.parametrize("value", [1e5, -1e30])
def test_coefficients_that_half_precision_cannot_hold_are_clipped_and_reported(tmp_path, value):
    """The cache writes turned coefficients as halves, which end at 65504."""
    harmonics = np.array(ball(20, degree=1).harmonics)
    harmonics[4, 2, 1] = value
    path = tmp_path / "ball.ply"
    path.write_bytes(ply_bytes(replace(ball(20, degree=1), harmonics=harmonics)))
    asset = read_asset(path)
    held = asset.splats[0].harmonics
    assert held[4, 2, 1] == np.copysign(BRIGHTEST, value)
    # turned, they are no longer than their root of the sum of seven squares
    assert np.isfinite(np.float16(np.sqrt(7) * BRIGHTEST))
    note = "1 spherical harmonics coefficient beyond 10000: clipped"
    assert note in asset.facts.notes
    harmonics[4, 2, 1] = 0.0
    np.testing.assert_array_equal(np.where(np.abs(held) < BRIGHTEST, held, 0.0), harmonics)


@pytest.mark.parametrize(
    ("column", "value", "note"),
    [
        ("scale_1", 200.0, "1 of 20 Gaussians are not finite: left out"),
        ("scale_1", -200.0, "1 of 20 Gaussians have a scale of 0 or less: left out"),
        ("x", 3e38, "1 of 20 Gaussians are not finite: left out"),
    ],
)
@pytest.mark.filterwarnings("error")
def test_what_single_precision_cannot_hold_is_left_out_and_reported(tmp_path, column, value, note):
    """USD holds floats, and an extent of three standard deviations around them."""
    data = bytearray(ply_bytes(ball(20)))
    start = data.index(b"end_header\n") + 11
    names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1"]
    struct.pack_into("<f", data, start + 5 * 4 * 14 + 4 * names.index(column), value)
    path = tmp_path / "ball.ply"
    path.write_bytes(data)
    asset = read_asset(path)
    assert len(asset.splats[0]) == 19
    assert note in asset.facts.notes
