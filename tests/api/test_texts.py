"""Functions take the texts of the command line, and answer bad ones with its messages and hints."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from moving_splats import moving_splats

import gf_usd
from gf_usd.api.call import keywords
from gf_usd.api.deliver import read_keys, read_share
from gf_usd.api.drawing.options import parse_limits, parse_size, parse_span

SPHERE = Path(__file__).parents[2] / "samples" / "sphere.usda"


@pytest.fixture(scope="module")
def ball(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return moving_splats(tmp_path_factory.mktemp("ball") / "ball.usdc")


@pytest.mark.slow
def test_an_error_in_percent_is_a_share(ball: Path, tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("percent.glb", "text.glb", "number.glb")]
    for file, error in zip(files, ("2%", "0.02", 0.02), strict=True):
        assert gf_usd.deliver(ball, file, error=error, splats="none").error <= 0.02
    assert files[0].read_bytes() == files[1].read_bytes() == files[2].read_bytes()


@pytest.mark.slow
def test_pictures_have_the_sizes_and_times_of_texts(ball: Path, tmp_path: Path) -> None:
    assert gf_usd.preview(ball, size="64x48").size == (64, 48)
    film = gf_usd.preview(ball, tmp_path / "a.gif", size="64x48", time_codes="2:4")
    assert (film.size, film.frames) == ((64, 48), 3)
    plain = gf_usd.preview(ball, size=(64, 48), color="none").pixels
    assert plain is not None
    assert (plain == gf_usd.preview(ball, size="64x48").pixels).all()
    gf_usd.compare(ball, ball, tmp_path / "b.png", size="240x180", tolerance="2%")
    assert (tmp_path / "b.png").is_file()


# a call that must be refused, and what reads the same text on the command line
BAD: list[tuple[Callable[..., Any], dict[str, Any], Callable[[str], Any], str]] = [
    (gf_usd.deliver, {"error": "two percent"}, read_share, "two percent"),
    (gf_usd.deliver, {"error": "%"}, read_share, "%"),
    (gf_usd.retime, {"keys": "1:1,48"}, read_keys, "1:1,48"),
    (gf_usd.preview, {"size": "640"}, parse_size, "640"),
    (gf_usd.compare, {"size": "640 by 480"}, parse_size, "640 by 480"),
    (gf_usd.preview, {"time_codes": "24:1", "sheet": 4}, parse_span, "24:1"),
    (gf_usd.preview, {"color_range": "0", "color": "strain"}, parse_limits, "0"),
]


@pytest.mark.parametrize(("function", "options", "read", "text"), BAD)
def test_a_bad_text_is_answered_as_on_the_command_line(
    function: Callable[..., Any], options: dict[str, Any], read: Callable[[str], Any], text: str,
    ball: Path, tmp_path: Path,
) -> None:  # fmt: skip
    with pytest.raises(gf_usd.UsageError) as told, keywords(*options):
        read(text)
    target = {
        gf_usd.deliver: "a.glb", gf_usd.retime: "a.usda", gf_usd.preview: "a.png",
        gf_usd.compare: "a.png",
    }[function]  # fmt: skip
    files = (ball, ball) if function is gf_usd.compare else (ball,)
    with pytest.raises(gf_usd.UsageError) as caught:
        function(*files, tmp_path / target, **options)
    assert (caught.value.message, caught.value.hint) == (told.value.message, told.value.hint)
    assert next(iter(options)) in caught.value.message
    assert list(tmp_path.iterdir()) == []


def test_keys_as_a_text_are_those_of_pairs(ball: Path, tmp_path: Path) -> None:
    with pytest.raises(gf_usd.InputError) as pairs:
        gf_usd.retime(ball, tmp_path / "a.usda", keys=[(1, 1), (9, 5)])
    with pytest.raises(gf_usd.InputError) as text:  # no bake with caches; the text itself is taken
        gf_usd.retime(ball, tmp_path / "a.usda", keys="1:1,9:5")
    assert text.value.message == pairs.value.message


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "message", "hint"),
    [
        ({"unknowns": "E,stiffness"}, "stiffness cannot be fitted", "choose one of"),
        ({"bounds": "E=1e4"}, "bounds 'E=1e4' is not a pair of bounds", "NAME=LOW:HIGH"),
        ({"bounds": ["E=1e4:many"]}, "bounds E=1e4:many: 'many' is not a number", "NAME=LOW:HIGH"),
        ({"bounds": {"E": 3}}, "bounds is {'E': 3}, of type dict", "{'E': (1e4, 1e6)}"),
    ],
)
def test_a_fit_takes_names_and_bounds_as_texts(
    options: dict[str, Any], message: str, hint: str
) -> None:
    with pytest.raises(gf_usd.UsageError) as caught:
        gf_usd.fit(SPHERE, {"least_height": "1.4+-1%"}, particles=100, **options)
    assert message in caught.value.message
    assert hint in caught.value.hint


def test_the_types_of_deliver_list_what_the_command_accepts() -> None:
    from gf_usd.api import deliver as api
    from gf_usd.delivery import deliver as delivery
    from gf_usd.delivery.splats import clouds

    assert api.KINDS == delivery.KINDS
    assert api.SPLATS == clouds.CHOICES
    assert api.BINDINGS == delivery.BINDINGS
