"""The ramp of colors and what it paints."""

from __future__ import annotations

import numpy as np
import pytest

from gf_usd.core.errors import UsageError
from gf_usd.core.scene import Quantity, RenderEllipsoids, RenderMesh, RenderSplats, Scene
from gf_usd.view.colormap import color_by_value, color_map, colors, fraction
from gf_usd.view.legend import MIN_PICTURE_SIZE, Legend, caption, label
from gf_usd.view.ticks import format_number, round_up, si_prefix, ticks

# CIE XYZ of linear Rec. 709 (IEC 61966-2-1)
XYZ_OF_RGB = np.array(
    [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
)
WHITE = XYZ_OF_RGB.sum(axis=1)


def lab(linear: np.ndarray) -> np.ndarray:
    """CIELAB of linear Rec. 709, after CIE 15."""
    t = linear @ XYZ_OF_RGB.T / WHITE
    f = np.where(t > 216 / 24389, np.cbrt(t), (24389 / 27 * t + 16) / 116)
    return np.stack(
        [116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], axis=1
    )


def test_the_ramp_grows_lighter_in_even_steps():
    seen = lab(color_map())
    assert (np.diff(seen[:, 0]) > 0.0).all()
    steps = np.linalg.norm(np.diff(seen, axis=0), axis=1)
    # straight lines in sRGB between the stops, whose codes are rounded
    assert np.percentile(steps, 5) > 0.8 * np.median(steps)
    assert steps.max() < 1.2 * np.median(steps)
    assert color_map().min() >= 0.0
    assert color_map().max() <= 1.0


def test_values_beyond_the_range_have_its_ends_and_what_is_no_number_the_low_one():
    assert fraction(np.array([-1.0, 2.0, 3.0, 9.0, np.nan]), 2.0, 4.0) == pytest.approx(
        [0.0, 0.0, 0.5, 1.0, 0.0]
    )
    shown = colors(np.array([0.0, 0.5, 1.0]), 0.0, 1.0)
    assert np.allclose(shown[[0, 2]], color_map()[[0, -1]])
    assert fraction(np.array([3.0]), 3.0, 3.0) == [0.0]


def scene() -> Scene:
    mesh = RenderMesh(
        name="/mesh",
        points=np.eye(3),
        triangles=np.array([(0, 1, 2)]),
        colors=np.ones(3),
        roughness=np.array(0.1),
        metallic=np.array(1.0),
        values=np.array([0.0, 0.5, 2.0]),
    )
    bare = RenderMesh(
        name="/prop",
        points=np.eye(3),
        triangles=np.array([(0, 1, 2)]),
        colors=np.ones(3),
        roughness=np.array(0.1),
        metallic=np.array(1.0),
    )
    common = {
        "name": "/cloud",
        "positions": np.zeros((2, 3)),
        "axes": np.tile(np.eye(3), (2, 1, 1)),
    }
    white = np.ones((2, 3))
    values = np.array([0.0, 1.0])
    return Scene(
        up=(0, 1, 0),
        meshes=(mesh, bare),
        splats=(
            RenderSplats(**common, colors=white, opacities=np.ones(2), lit=True, values=values),
        ),
        ellipsoids=(RenderEllipsoids(**common, colors=white, values=values),),
    )


def test_what_has_values_is_painted_and_the_rest_is_not():
    painted = color_by_value(scene(), 0.0, 1.0)
    mesh, prop = painted.meshes
    assert prop is not None
    assert prop.textures == ()
    assert np.array_equal(prop.colors, np.ones(3))
    (texture,) = mesh.textures
    texel = np.floor(mesh.uvs[0, :, 0] * texture.pixels.shape[1]).astype(int)
    assert texel.tolist() == [0, 128, 255]
    assert float(mesh.metallic) == 0.0
    for cloud in (painted.splats[0], painted.ellipsoids[0]):
        assert np.allclose(cloud.colors, color_map()[[0, -1]])


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (0.0, 1.0, [0.0, 0.25, 0.5, 0.75, 1.0]),
        (0.0, 0.46, [0.0, 0.1, 0.2, 0.3, 0.4]),
        (-2.0, 2.0, [-2.0, -1.0, 0.0, 1.0, 2.0]),
        (3.0, 3.0, [3.0]),
    ],
)
def test_ticks_are_round(low, high, expected):
    assert ticks(low, high) == pytest.approx(expected)


def test_numbers_are_written_short():
    assert [format_number(v) for v in (0.0, 0.123456, 12.0, 2500.0, -0.5)] == [
        "0", "0.123", "12", "2500", "-0.5",
    ]  # fmt: skip
    assert si_prefix(12_300.0, "Pa") == (1e3, "kPa")
    assert si_prefix(0.3, "") == (1.0, "")
    assert [round_up(v) for v in (0.4567, 12.0, 123_400.0, 0.0)] == pytest.approx(
        [0.46, 12.0, 130_000.0, 0.0]
    )


def test_the_legend_shows_the_ramp_with_the_high_end_at_the_top():
    size = (640, 480)
    blank = np.full((480, 640, 3), 128, dtype=np.uint8)
    quantity = Quantity(title="stress", measure="von Mises", unit="Pa", high=4e4, largest=5e4)
    legend = Legend(quantity, size)
    shown = legend.overlay(blank)
    assert shown.shape == blank.shape
    # nothing beyond what it reserves, and that is less than a quarter of the picture
    assert np.array_equal(shown[:, legend.reserved :], blank[:, legend.reserved :])
    assert legend.reserved < 160
    left = shown[:, : legend.reserved].astype(int)
    yellow = np.argwhere((left[..., 0] > 200) & (left[..., 2] < 120))
    blue = np.argwhere((left[..., 2] > 100) & (left[..., 0] < 80))
    assert len(yellow) > 50
    assert len(blue) > 50
    assert yellow[:, 0].max() < blue[:, 0].min()
    # there is writing: ink that is neither panel, ramp nor ground
    assert (left.max(axis=2) < 70).sum() > 200


def test_other_numbers_give_another_legend():
    blank = np.full((480, 640, 3), 128, dtype=np.uint8)
    one, two = (
        Legend(Quantity(title="strain", high=high), (640, 480)).overlay(blank)
        for high in (0.5, 0.7)
    )
    assert not np.array_equal(one, two)


def test_a_picture_too_small_for_words_is_refused():
    with pytest.raises(UsageError, match="100x80 pixels is too small for a legend"):
        Legend(Quantity(title="strain"), (100, 80))
    assert Legend(Quantity(title="strain"), MIN_PICTURE_SIZE).reserved < MIN_PICTURE_SIZE[0] // 2


def test_a_label_stays_in_its_corner():
    blank = np.full((240, 320, 3), 128, dtype=np.uint8)
    marked = label(blank, "time code 12")
    assert (marked[:60, :160] != 128).any()
    assert np.array_equal(marked[60:], blank[60:])
    assert np.array_equal(marked[:, 160:], blank[:, 160:])


def test_a_caption_covers_nothing_of_its_picture():
    """A label in the corner covered bodies at the top of their pictures."""
    blank = np.full((90, 120, 3), 128, dtype=np.uint8)
    one, other = (caption(blank, text) for text in ("time code 1", "time code 2"))
    band = len(one) - len(blank)
    assert 11 < band < 25
    assert np.array_equal(one[band:], blank)
    assert not np.array_equal(one[:band], other[:band])
    # where there is no place for all, the number is what remains
    narrow = blank[:, :60]
    one, other = (caption(narrow, f"time code {code}") for code in (1000001, 1000002))
    assert one.shape == (len(blank) + band, 60, 3)
    assert not np.array_equal(one, other)
