"""What USD warns of is counted, quoted once and kept from the terminal."""

from __future__ import annotations

from pathlib import Path

import pytest
from pxr import Usd
from small_stages import write

from gf_usd.layers.check.run import check_file
from gf_usd.layers.usd_warnings import gathered


def with_missing(folder: Path, count: int) -> Path:
    """A stage with references to files that are not there."""
    return write(
        folder / "gaps.usda",
        "".join(f'def "P{k}" (references = @./gone{k}.usda@) {{}}\n' for k in range(count)),
    )


def test_warnings_are_counted_by_kind(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = with_missing(tmp_path, 3)
    with gathered() as warned:
        stages = [Usd.Stage.Open(str(path)), Usd.Stage.Open(str(path))]
    assert len(stages) == 2
    assert sorted(warned.counts.values()) == [2, 2, 2]
    (line,) = warned.lines()
    assert line.startswith("USD warned 6 times: In </P")
    assert line.endswith("; and 1 more")
    assert str(hex(id(stages))) not in line
    assert warned.lines(reported=set(warned.counts)) == ()
    assert capfd.readouterr().err == ""
    Usd.Stage.Open(str(path))
    assert "gone0.usda" in capfd.readouterr().err


def test_the_check_says_them_in_one_line(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    checked = check_file(with_missing(tmp_path, 3))
    (line,) = checked.warned
    assert "gone" in line
    assert capfd.readouterr().err == ""
