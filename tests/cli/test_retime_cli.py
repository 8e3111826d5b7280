"""gf-usd retime and gf_usd.retime: what they print and refuse."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from small_sources import PLAIN
from small_stages import bake

import gf_usd as package


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return bake(PLAIN.asset(tmp_path), tmp_path, frames=4)[0].path


def test_it_names_what_it_wrote(gf_usd, here: Path, root: Path) -> None:
    done = gf_usd("retime", root, "--speed", "0.5", "-o", "slow.usda")
    assert done.status == 0, done.err
    assert "slow.usda  " in done.out
    assert "slow.cache.usdc  " in done.out
    assert done.out.splitlines()[-1] == "7 frames, time codes 10 to 16"
    assert gf_usd("check", "slow.usda").status == 0


def test_quiet(gf_usd, here: Path, root: Path) -> None:
    done = gf_usd("retime", root, "--speed", "0.5", "-o", "slow.usda", "-q")
    assert (done.status, done.out, done.err) == (0, "", "")
    assert Path("slow.usda").exists()


def test_json(gf_usd, here: Path, root: Path) -> None:
    done = gf_usd("retime", root, "--keys", "1:10,3:13", "-o", "fast.usdc", "--json")
    assert json.loads(done.out) == {
        "path": "fast.usdc",
        "caches": ["fast.cache.usdc"],
        "frames": 3,
        "start": 1.0,
        "end": 3.0,
        "notes": [],
    }


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "either --speed or --keys is needed, but not both"),
        (("--speed", "0"), "--speed is 0"),
        (("--keys", "1:10;2:11"), "is not a pair of time codes"),
        (("--keys", "1:10"), "two pairs NEW:OLD"),
        (("--keys", "1:10,2:99"), "is outside the time codes 10 to 13"),
    ],
)
def test_misuse_ends_in_words(gf_usd, here: Path, root: Path, arguments, message: str) -> None:
    done = gf_usd("retime", root, *arguments, "-o", "slow.usda")
    assert done.status == 2
    assert message in done.err
    assert "hint: " in done.err
    assert not list(here.iterdir())


@pytest.mark.parametrize("damaged", [False, True])
def test_a_cache_that_cannot_be_read_is_named(gf_usd, here: Path, root: Path, damaged) -> None:
    cache = root.with_name("duck.rubber.cache.usdc")
    content = cache.read_bytes()
    cache.unlink()
    if damaged:
        cache.write_bytes(content[: len(content) // 2])
    for command in (("retime", "--speed", "0.5", "-o", "slow.usda"), ("report",),
                    ("deliver", "-o", "duck.glb")):  # fmt: skip
        done = gf_usd(command[0], root, *command[1:])
        assert (done.status, done.out) == (3, "")
        assert str(cache) in done.err
        assert "Traceback" not in done.err
        assert "bake the asset" not in done.err
    assert not list(here.iterdir())


def test_an_asset_that_is_not_there_is_named(gf_usd, here: Path, root: Path) -> None:
    asset = root.with_name("duck.usda")
    asset.rename(asset.with_suffix(".moved"))
    for command in (("preview", "-o", "duck.png"), ("deliver", "-o", "duck.glb")):
        done = gf_usd(command[0], root, *command[1:])
        assert (done.status, done.out) == (3, "")
        assert str(asset) in done.err
        assert "choose with --show" not in done.err
        assert "bake again" not in done.err
    assert not list(here.iterdir())


def test_from_python(root: Path, tmp_path: Path) -> None:
    done = package.retime(root, tmp_path / "slow.usda", speed=0.5)
    assert (done.frames, done.path) == (7, tmp_path / "slow.usda")
    for wrong in ("fast", True, [1]):
        with pytest.raises(package.UsageError, match=r"^speed is "):
            package.retime(root, tmp_path / "x.usda", speed=wrong)  # type: ignore[arg-type]
    for wrong in ([1, 2], [(1, 2, 3)], [("a", 1)], 5):
        with pytest.raises(package.UsageError, match=r"^keys is "):
            package.retime(root, tmp_path / "x.usda", keys=wrong)  # type: ignore[arg-type]
    with pytest.raises(package.UsageError, match="either speed or keys"):
        package.retime(root, tmp_path / "x.usda")
