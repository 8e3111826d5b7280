"""Names with bytes that are no UTF-8, which USD cannot open: refused with the reason."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from small_bakes import BLOCK, Done

Call = Callable[..., Done]
LATIN = os.fsdecode(b"d\xfcck.usda")


@pytest.fixture
def asset(here: Path) -> Path:
    path = here / LATIN
    try:
        path.write_text(BLOCK, encoding="utf-8")
    except OSError:
        pytest.skip("this file system has UTF-8 names only")
    return path


@pytest.mark.parametrize(
    "arguments",
    [
        ("bake", LATIN), ("bake", LATIN, "--limits", "none", "-o", "a.usda"), ("inspect", LATIN),
        ("inputs", LATIN), ("check", LATIN), ("preview", LATIN), ("report", LATIN),
        ("retime", LATIN, "--speed", "2", "-o", "a.usda"), ("compare", LATIN, LATIN),
        ("deliver", LATIN, "-o", "a.glb"),
    ],
)  # fmt: skip
def test_an_asset_with_such_a_name_is_refused(
    gf_usd: Call, asset: Path, arguments: tuple[str, ...]
) -> None:
    done = gf_usd(*arguments)
    assert done.status == 3
    assert r"d\udcfcck.usda: its path has bytes that are not UTF-8" in done.err
    assert "rename the file" in done.err


def test_a_result_cannot_have_such_a_name(gf_usd: Call, block: Path, here: Path) -> None:
    done = gf_usd("bake", block, "-o", LATIN)
    assert done.status == 2
    assert r"-o d\udcfcck.usda: its path has bytes that are not UTF-8" in done.err


@pytest.mark.slow
def test_a_batch_with_such_a_name_has_its_page(gf_usd: Call, here: Path, asset: Path) -> None:
    done = gf_usd("batch", LATIN, "-o", "out", "--no-warm", "-q")
    assert done.status == 1
    assert "are not UTF-8" in done.err
    assert r"d\udcfcck.usda: its path" in (here / "out" / "out.batch.html").read_text("utf-8")
    assert (here / "out" / "out.batch.json").is_file()
