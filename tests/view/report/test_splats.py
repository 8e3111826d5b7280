"""The page of splats holds what was read, rounded as it says and no larger than it may be."""

from __future__ import annotations

import base64
import json
import re
import zlib
from dataclasses import replace

import numpy as np
import pytest
from played_splats import Splats, shell
from scipy.spatial.transform import Rotation

from gf_usd.core.errors import InputError
from gf_usd.view.report.splats import MAX_SCALE, Limits, build_splat_page


def arrays_of(page: str) -> tuple[dict, dict[str, np.ndarray]]:
    """The first variant of a page, and its arrays as data.js unpacks them."""
    variant = json.loads(re.search(r'id="page">(.*?)</script>', page)[1])["variants"][0]
    raw = zlib.decompress(base64.b64decode(re.search(r'id="motion-0">(.*?)</script>', page)[1]))
    found = {}
    for name, entry in variant["table"].items():
        dtype, count = np.dtype(entry["type"]), int(np.prod(entry["shape"]))
        planes = np.frombuffer(raw, np.uint8, count * dtype.itemsize, entry["offset"])
        values = planes.reshape(dtype.itemsize, count).T.copy().view(dtype)
        values = values.reshape(entry["shape"])
        found[name] = np.cumsum(values, axis=0, dtype=dtype) if entry["moving"] else values
    return variant, found


def test_it_holds_the_motion_within_the_rounding_that_it_states() -> None:
    source = shell(300)
    page = build_splat_page([source], Limits())
    variant, found = arrays_of(page)
    table = variant["table"]
    assert variant["seconds"] == pytest.approx(np.arange(5) / 24.0, rel=1e-5)
    stated = float(re.search(r"standard deviations by ([\d.e-]+) %", page)[1]) / 100.0
    for frame, (truth,) in enumerate(source.frames(source.time_codes)):
        low, step = table["positions"]["low"], table["positions"]["step"]
        at = low + step * found["positions"][frame].astype(float)
        # half a step of 1/65535, and single precision
        assert np.abs(at - truth.positions).max() <= 0.51 * max(step) + 1e-6
        scales = np.exp(table["scales"]["low"] + table["scales"]["step"] * found["scales"][frame])
        rotations = Rotation.from_quat(found["turns"][frame].astype(float)).as_matrix()
        A = rotations * scales[:, None, :]
        S = truth.axes @ truth.axes.transpose(0, 2, 1)
        assert np.abs(A @ A.transpose(0, 2, 1) - S).max() <= (2.0 * stated + 1e-3) * S.max()
    colors = found["colors"][:, :3] / 255.0
    np.testing.assert_allclose(colors, source.colors, atol=0.51 / 255)
    assert "all 300 Gaussians" in page
    assert "a &lt;b&gt;note&lt;/b&gt;" in page


def test_what_is_left_out_is_counted_and_the_rest_is_larger() -> None:
    page = build_splat_page([shell(4000)], Limits(splats=1000, frames=3))
    variant, found = arrays_of(page)
    assert found["positions"].shape == (3, 1000, 3)
    assert "1000 of 4000 Gaussians" in page
    assert "3 of 5 frames" in page
    assert variant["grow"] == 2.0 == MAX_SCALE  # on a surface: the square root of four


@pytest.mark.slow
@pytest.mark.parametrize("size", [90_000, 120_000])
def test_the_page_is_no_larger_than_the_limit(size: int) -> None:
    limits = Limits(size=size)
    page = build_splat_page([shell(3000)], limits)
    _, found = arrays_of(page)
    whole = build_splat_page([shell(3000)], Limits())
    assert len(page) <= size < len(whole)
    assert 1000 <= found["positions"].shape[1] < 3000
    short = build_splat_page([shell(3000, 40)], replace(limits, size=75_000))
    assert arrays_of(short)[1]["positions"].shape[:2] != (40, 3000)
    assert len(short) <= 75_000 or arrays_of(short)[1]["positions"].shape[:2] == (2, 1000)


def test_strays_do_not_set_the_view() -> None:
    at = np.concatenate([np.random.default_rng(1).uniform(-1, 1, (200, 3)), [[500.0, 0, 0]]])
    source = Splats(at, np.full((201, 3), 0.1), np.full((201, 3), 0.5))
    variant, _ = arrays_of(build_splat_page([source], Limits()))
    assert max(variant["high"]) < 3.0


def test_a_still_is_refused() -> None:
    with pytest.raises(InputError, match="contains no moving Gaussians"):
        build_splat_page([shell(10, frames=1)], Limits())
