"""Films and sheets, written and read back."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from gf_usd.core.errors import BakeError, GfUsdError, UsageError
from gf_usd.view import film as movie
from gf_usd.view.contact_sheet import choose_frames, contact_sheet, sheet_columns
from gf_usd.view.film import write_gif, write_mp4

WIDTH, HEIGHT = 96, 64


def picture(i: int, count: int = 12) -> np.ndarray:
    """A gray ramp on which a red square moves to the right."""
    y = np.mgrid[0:HEIGHT, 0:WIDTH][0]
    pixels = np.repeat((150 + 60 * y / HEIGHT)[..., None], 3, axis=2).astype(np.uint8)
    at = 4 + i * (WIDTH - 28) // count
    pixels[20:40, at : at + 20] = (200, 40, 30)
    return pixels


def frames(count: int = 12) -> Iterator[np.ndarray]:
    return (picture(i, count) for i in range(count))


def read_mp4(path) -> tuple[dict, list[np.ndarray]]:
    reader = imageio_ffmpeg.read_frames(str(path))
    facts = next(reader)
    return facts, [np.frombuffer(f, np.uint8).reshape(HEIGHT, WIDTH, 3) for f in reader]


def test_an_mp4_holds_the_frames_the_rate_and_the_colors(tmp_path):
    path = tmp_path / "a.mp4"
    write_mp4(path, frames(), 24.0, (WIDTH, HEIGHT))
    facts, shown = read_mp4(path)
    assert facts["codec"] == "h264"
    assert facts["pix_fmt"].startswith("yuv420p")
    assert facts["fps"] == 24.0
    assert facts["size"] == (WIDTH, HEIGHT)
    assert len(shown) == 12
    for i in (0, 11):
        error = np.abs(shown[i].astype(int) - picture(i))
        # 4:2:0 halves the chroma along the square's edges; away from them the codec is near exact
        assert np.median(error) <= 2
        assert error.mean() < 4.0
    assert [path.name for path in tmp_path.iterdir()] == ["a.mp4"]


def test_fractional_rates_are_kept(tmp_path):
    write_mp4(tmp_path / "a.mp4", frames(4), 23.976, (WIDTH, HEIGHT))
    # as ffmpeg prints it
    assert read_mp4(tmp_path / "a.mp4")[0]["fps"] == pytest.approx(23.98, abs=0.01)


@pytest.mark.parametrize("write", [write_mp4, write_gif])
def test_a_film_that_is_broken_off_does_not_appear(tmp_path, write):
    def broken() -> Iterator[np.ndarray]:
        yield picture(0)
        raise SystemExit(130)

    path = tmp_path / ("a.mp4" if write is write_mp4 else "a.gif")
    path.write_bytes(b"old")
    last = [picture(0)] if write is write_gif else (WIDTH, HEIGHT)
    with pytest.raises(SystemExit):
        write(path, broken(), 24.0, last)
    assert path.read_bytes() == b"old"
    assert all(".partial." in other.name for other in tmp_path.iterdir() if other != path)


def test_what_cannot_be_written_is_said(tmp_path, monkeypatch):
    with pytest.raises(UsageError, match="97x64"):
        write_mp4(tmp_path / "a.mp4", frames(), 24.0, (97, 64))
    with pytest.raises(UsageError, match="is not a folder"):
        write_mp4(tmp_path / "none" / "a.mp4", frames(), 24.0, (WIDTH, HEIGHT))
    with pytest.raises(UsageError, match=r"none.a\.gif cannot be written"):
        write_gif(tmp_path / "none" / "a.gif", frames(), 24.0, [picture(0)])
    with pytest.raises(UsageError, match="60 frames per second"):
        write_gif(tmp_path / "a.gif", frames(), 60.0, [picture(0)])
    monkeypatch.setattr(movie, "MP4", ("-no-such-option", "1"))
    # also where all frames fit into the pipe before ffmpeg fails
    for count in (400, 2):
        with pytest.raises(BakeError, match="ffmpeg could not write"):
            write_mp4(tmp_path / "a.mp4", frames(count), 24.0, (WIDTH, HEIGHT))
        assert not (tmp_path / "a.mp4").exists()


def test_a_missing_ffmpeg_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(GfUsdError, match="not installed") as caught:
        write_mp4(tmp_path / "a.mp4", frames(), 24.0, (WIDTH, HEIGHT))
    assert "imageio[ffmpeg]" in caught.value.hint


def test_a_gif_repeats_without_limit_in_real_time(tmp_path):
    path = tmp_path / "a.gif"
    write_gif(path, frames(24), 24.0, [picture(0), picture(12)])
    with Image.open(path) as film:
        assert film.n_frames == 24
        assert film.size == (WIDTH, HEIGHT)
        assert film.info["loop"] == 0
        length = 0
        for i in range(24):
            film.seek(i)
            length += film.info["duration"]
            error = np.abs(np.asarray(film.convert("RGB")).astype(int) - picture(i, 24))
            # half the dither, the grouping of codes and a neighbor in the palette
            assert error.max() <= 12
    # 24 frames at 24 a second: one second, though a frame lasts 4 or 5 hundredths
    assert length == 1000


def test_what_does_not_change_costs_next_to_nothing(tmp_path):
    write_gif(tmp_path / "one.gif", [picture(0), picture(1)], 24.0, [picture(0)])
    still = [picture(0)] * 40 + [picture(1)]
    write_gif(tmp_path / "many.gif", still, 24.0, [picture(0)])
    sizes = [(tmp_path / name).stat().st_size for name in ("one.gif", "many.gif")]
    # the repeats are joined into one empty frame, of a palette (768 bytes) and little more
    assert sizes[1] - sizes[0] < 2 * 768


def test_a_small_bright_body_gets_its_share_of_the_palette(tmp_path):
    sample = picture(0)
    sample[30:34, 60:64] = (20, 60, 220)
    write_gif(tmp_path / "a.gif", [sample], 24.0, [sample])
    with Image.open(tmp_path / "a.gif") as film:
        found = np.asarray(film.convert("RGB")).astype(int)
    assert np.abs(found[30:34, 60:64] - (20, 60, 220)).sum(axis=2).max() <= 6
    assert np.abs(found[20:40, 4:24] - (200, 40, 30)).sum(axis=2).max() <= 6


def test_a_film_of_one_color(tmp_path):
    black = np.zeros((4, 4, 3), dtype=np.uint8)
    write_gif(tmp_path / "a.gif", [black, black], 24.0, [black])
    with Image.open(tmp_path / "a.gif") as film:
        assert not np.asarray(film.convert("RGB")).any()


def test_a_gif_has_the_same_bytes_each_time(tmp_path):
    for name in ("a.gif", "b.gif"):
        write_gif(tmp_path / name, frames(), 24.0, [picture(0), picture(11)])
    assert (tmp_path / "a.gif").read_bytes() == (tmp_path / "b.gif").read_bytes()


def test_frames_of_a_sheet_are_spread_evenly_or_by_what_moves() -> None:
    assert choose_frames(11, 3) == [0, 5, 10]
    assert choose_frames(3, 6) == [0, 1, 2]
    assert choose_frames(1, 4) == [0]
    speeds = np.zeros(101)
    speeds[:20] = 1.0
    chosen = choose_frames(101, 6, speeds)
    assert (chosen[0], chosen[-1]) == (0, 100)
    assert chosen == sorted(set(chosen))
    # 19.5 of way by the motion and 100 x 0.1 x 0.198 besides: all but the last are in the motion
    assert sum(i <= 20 for i in chosen) == 5
    jump = np.zeros(9)
    jump[4] = 1.0
    assert len(set(choose_frames(9, 8, jump))) == 8, "no frame twice"
    assert choose_frames(5, 3, np.zeros(5)) == [0, 2, 4]


def test_a_sheet_has_its_tiles_in_reading_order():
    tiles = [np.full((30, 40, 3), 10 * i, dtype=np.uint8) for i in range(5)]
    page = contact_sheet(tiles, 3)
    gap = 2
    assert page.shape == (2 * 32 + gap, 3 * 42 + gap, 3)
    for i in range(5):
        y, x = gap + (i // 3) * 32, gap + (i % 3) * 42
        assert (page[y : y + 30, x : x + 40] == 10 * i).all()
    assert (page[gap + 32 :, gap + 84 :] == page[0, 0]).all()
    assert contact_sheet(tiles[:2], 9).shape[1] == 2 * 42 + gap


@pytest.mark.parametrize(("count", "columns"), [(1, 1), (2, 2), (6, 3), (12, 4), (20, 5)])
def test_a_sheet_is_about_three_to_two(count, columns):
    assert sheet_columns(count, 4 / 3) == columns


def test_importing_the_films_loads_no_codec():
    code = "import sys, gf_usd.view.film; print('imageio_ffmpeg' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
