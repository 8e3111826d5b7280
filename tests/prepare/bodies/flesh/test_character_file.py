"""What a file states about characters is read once: later requests need no file."""

from __future__ import annotations

from pathlib import Path

from arm import FIRST, LAST, arm, booted, write

from gf_usd.prepare.bodies.flesh.character_file import CharacterFile
from gf_usd.readers import read_asset


def test_the_file_is_read_once(tmp_path: Path) -> None:
    path = write(tmp_path, arm())
    asset = read_asset(path)
    source = CharacterFile(asset, path, None)
    posed, animation = source.posed(asset), source.animation(asset)
    assert posed == {"/Arm/Skin": ("/Arm/Skel", "/Arm")}
    assert (animation.first, animation.last) == (FIRST, LAST)
    path.unlink()
    assert source.posed(asset) == posed
    assert source.animation(asset) is animation


def test_surfaces_that_were_left_out_are_not_listed(tmp_path: Path) -> None:
    path = booted(tmp_path)
    asset = read_asset(path)
    source = CharacterFile(asset, path, None)
    kept = asset.without({"/Arm/Skin": "it is left out"})
    assert list(source.posed(kept)) == ["/Arm/Boot"]
    assert list(source.posed(asset)) == ["/Arm/Skin", "/Arm/Boot"]
