"""Files appear whole under their final name."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from full_disk import full_disk  # noqa: F401

from gf_usd.core.errors import BakeError
from gf_usd.system.atomic_files import (
    absolute_note,
    asset_path,
    drop_working,
    is_astray,
    partial_path,
    publish,
    publish_text,
    same_place,
)


def test_the_partial_name_keeps_folder_and_suffix() -> None:
    path = Path("out") / "duck.rubber.cache.usdc"
    assert partial_path(path) == Path("out") / "duck.rubber.cache.partial.usdc"


def test_publishing_replaces_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "report.json"
    path.write_text("old")
    partial_path(path).write_text("new")
    assert publish(path) == path
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


def test_nothing_to_publish_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "report.json"
    path.write_text("old")
    with pytest.raises(BakeError) as caught:
        publish(path)
    assert caught.value.message == (
        f"{partial_path(path)} could not be published as report.json: No such file or directory"
    )
    assert path.read_text() == "old"


def test_text_is_written_in_one_step(tmp_path: Path) -> None:
    path = publish_text(tmp_path / "report.json", "{}\nμ")
    assert path.read_text(encoding="utf-8") == "{}\nμ"
    with pytest.raises(BakeError, match="could not be written"):
        publish_text(tmp_path / "no" / "report.json", "{}")


@pytest.mark.usefixtures("full_disk")
def test_a_full_disk_leaves_no_part_of_a_file_and_the_old_one(tmp_path: Path) -> None:
    path = publish_text(tmp_path / "duck.job.json", "old")
    with pytest.raises(BakeError, match=r"duck\.job\.partial\.json could not be written: "):
        publish_text(path, "x" * 1000)
    assert [p.name for p in tmp_path.iterdir()] == ["duck.job.json"]
    assert path.read_text() == "old"


def test_bytes_of_a_name_that_are_no_text_are_spelled_out(tmp_path: Path) -> None:
    path = publish_text(tmp_path / "page.html", os.fsdecode(b"d\xfcck.usda, \xc3\xa4"))
    assert path.read_text("utf-8") == "d\\udcfcck.usda, \u00e4"


def test_what_a_kill_within_usd_leaves_is_dropped_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "duck.rubber.cache.usdc"
    left = ["duck.rubber.cache.partial.LRS4IR", "duck.rubber.cache.partial.nm_fTH"]
    mine = ["duck.rubber.cache.partial.notes.txt", "duck.rubber.cache.partial.usdc",
            "duck.jelly.cache.partial.LRS4IR", "LRS4IR"]  # fmt: skip
    for name in (*left, *mine):
        (tmp_path / name).write_text("x")
    drop_working(path)
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(mine)


@pytest.mark.parametrize(
    ("other", "same"),
    [
        ("file", True),
        ("folder/../file", True),
        ("symbolic", True),
        ("hard", True),
        ("copy", False),
        ("missing", False),
        ("circle", False),
    ],
)
def test_paths_to_the_same_file_are_the_same_place(tmp_path: Path, other: str, same: bool) -> None:
    (tmp_path / "folder").mkdir()
    for name in ("file", "copy"):
        (tmp_path / name).write_text("text", encoding="utf-8")
    (tmp_path / "symbolic").symlink_to(tmp_path / "file")
    (tmp_path / "hard").hardlink_to(tmp_path / "file")
    (tmp_path / "circle").symlink_to(tmp_path / "circle")
    assert same_place(tmp_path / "file", tmp_path / other) is same
    assert same_place(tmp_path / other, tmp_path / "file") is same


def test_two_paths_to_a_file_that_is_not_there_are_the_same_place(tmp_path: Path) -> None:
    assert same_place(tmp_path / "none", tmp_path / "folder" / ".." / "none")
    assert not same_place(tmp_path / "none", tmp_path / "other")


@pytest.mark.skipif(os.name == "nt", reason="symbolic links need a permission there")
@pytest.mark.parametrize(
    ("folder", "path"),
    [
        ("out", "../assets/duck.usda"),
        ("assets", "./duck.usda"),
        ("same", "../assets/duck.usda"),  # a link that is as deep as what it leads to
        ("deep/er/out", "../../../assets/duck.usda"),
        ("short", None),  # a link to deep/er/out, above which other folders are
    ],
)
def test_a_reference_holds_by_any_path_to_its_layer(
    folder: str, path: str | None, tmp_path: Path
) -> None:
    for name in ("assets", "out", "deep/er/out"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "same").symlink_to("out")
    (tmp_path / "short").symlink_to("deep/er/out")
    target = tmp_path / "assets/duck.usda"
    target.write_text("")
    made = asset_path(target, tmp_path / folder)
    assert made == (target.as_posix() if path is None else path)
    assert is_astray(target, tmp_path / folder) == (path is None)
    for there in (tmp_path / folder, (tmp_path / folder).resolve()):
        assert Path(os.path.normpath(there / made)).samefile(target)
    note = (
        f"{tmp_path / folder} is reached through a symbolic link: it.usda refers to duck.usda by"
        " its absolute path, which is the same by any path to it"
    )
    layer = tmp_path / folder / "it.usda"
    assert absolute_note(layer, [target, target]) == ((note,) if path is None else ())
    other = target.with_name("other.png")
    several = note.replace("duck.usda by its absolute path, which is", "duck.usda and 1 other file"
                           " by absolute paths, which are")  # fmt: skip
    assert absolute_note(layer, [target, other]) == ((several,) if path is None else ())
