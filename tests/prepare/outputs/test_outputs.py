"""Where results go, and what may not be written to."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from gf_usd.core.errors import UsageError
from gf_usd.prepare.outputs.outputs import (
    Outputs,
    create_output_folder,
    outputs,
    report_of_failure,
    require_free,
    require_free_sequences,
    require_source_free,
    sequences,
    stamps,
)
from gf_usd.system.atomic_files import partial_path

DUCK = Path("models/duck.usda")


def refusal(call, *arguments) -> tuple[str, str]:
    """Message and hint of a UsageError."""
    with pytest.raises(UsageError) as caught:
        call(*arguments)
    return caught.value.message, caught.value.hint


def in_folder(folder: Path) -> Outputs:
    """The results of a rubber duck in a folder."""
    return outputs(DUCK, ["rubber"], f"{folder}/")


def test_a_bake_without_a_checkpoint_is_not_resumed_over_its_result(tmp_path: Path) -> None:
    files = in_folder(tmp_path)
    files.root.write_text("done")
    with pytest.raises(UsageError) as caught:
        require_free(files, overwrite=False, resume=True)
    assert caught.value.message == (
        f"{files.root} exists already, and there is no checkpoint from which to resume"
    )


@pytest.fixture
def sealed(tmp_path: Path) -> Iterator[Path]:
    """A folder that nobody may write to; for root, who may write anywhere, one of the kernel's."""
    folder = tmp_path / "sealed"
    folder.mkdir()
    folder.chmod(0o555)
    kernel = Path("/proc/self")
    if not os.access(folder, os.W_OK):
        yield folder
    elif kernel.is_dir():
        yield kernel
    else:
        pytest.skip("every folder of this system can be written to")
    folder.chmod(0o755)


def test_one_material_in_this_folder() -> None:
    files = outputs(DUCK, ["rubber"], None)
    assert files.root == Path("duck.rubber.usda")
    assert files.caches == (Path("duck.rubber.cache.usdc"),)
    assert files.report == Path("duck.rubber.report.json")
    assert files.all == (files.root, *files.caches, files.report)


def test_several_materials_have_a_cache_each() -> None:
    files = outputs(DUCK, ["rubber", "soft-silicone"], None)
    assert files.root == Path("duck.rubber-soft-silicone.usda")
    assert files.caches == (
        Path("duck.rubber-soft-silicone.rubber.cache.usdc"),
        Path("duck.rubber-soft-silicone.soft-silicone.cache.usdc"),
    )


def test_a_folder_is_named_by_a_slash_or_by_being_there(tmp_path: Path) -> None:
    assert outputs(DUCK, ["rubber"], "new/folder/").root == Path("new/folder/duck.rubber.usda")
    assert outputs(DUCK, ["rubber"], str(tmp_path)).root == tmp_path / "duck.rubber.usda"


@pytest.mark.parametrize("suffix", [".usda", ".usd", ".usdc"])
def test_a_root_layer_is_named_by_its_suffix(suffix: str) -> None:
    files = outputs(DUCK, ["rubber"], f"out/shot.v2{suffix}")
    assert files.root == Path(f"out/shot.v2{suffix}")
    assert files.caches == (Path("out/shot.v2.cache.usdc"),)
    assert files.report == Path("out/shot.v2.report.json")


@pytest.mark.parametrize(
    ("output", "name"), [("shot", "shot"), ("a/shot.usdx", "shot.usdx"), ("x.txt", "x.txt")]
)
def test_other_suffixes_are_refused(output: str, name: str) -> None:
    assert refusal(outputs, DUCK, ["rubber"], output) == (
        f"-o {output}: a root layer ends in .usda, .usd or .usdc, a package in .usdz",
        f"name it {name}.usda, or end a folder's name in /",
    )


def test_materials_of_one_name_are_refused() -> None:
    # Their caches would be one file, and their variants one variant.
    assert refusal(outputs, DUCK, ["rubber", "jelly", "rubber"], None) == (
        "--material has 2 materials named 'rubber'",
        "name each once; a material of a file is called after its prim",
    )
    assert refusal(outputs, DUCK, ["none"], None) == (
        "a material is named 'none', which is the variant that shows the source",
        "give its prim another name",
    )


@pytest.mark.parametrize(
    ("source", "output"),
    [("duck.usda", "duck.usda"), ("duck.usda", "x/../duck.usda"), ("a.cache.usdc", "a.usda")],
)
def test_the_asset_is_never_a_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, source: str, output: str
) -> None:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / source
    path.write_text("asset")
    written = "a.cache.usdc" if output == "a.usda" else output
    assert refusal(outputs, path, ["rubber"], output) == (
        f"{written} is the asset itself, which is never modified",
        "choose another -o",
    )


@pytest.mark.parametrize("number", [0, 1, 2])
def test_results_that_are_there_are_kept(tmp_path: Path, number: int) -> None:
    files = in_folder(tmp_path)
    files.all[number].write_text("earlier")
    assert refusal(require_free, files, False) == (
        f"{files.all[number]} exists already",
        "add --overwrite to replace it, or choose another -o",
    )
    require_free(files, True)
    assert files.all[number].read_text() == "earlier"


def test_a_free_folder_is_left_as_it_was(tmp_path: Path) -> None:
    require_free(in_folder(tmp_path), False)
    require_free(in_folder(tmp_path / "new" / "folder"), False)
    assert list(tmp_path.iterdir()) == []


def test_a_file_is_no_folder(tmp_path: Path) -> None:
    file = tmp_path / "notes.txt"
    file.write_text("")
    for folder in (file, file / "below"):
        assert refusal(require_free, in_folder(folder), False) == (
            f"{file} is not a folder",
            "choose a folder to write to with -o",
        )


@pytest.mark.parametrize("name", ["loop/duck.usda", "loop.usda"])
def test_a_link_to_itself_is_no_place_for_results(tmp_path: Path, name: str) -> None:
    link = tmp_path / name.partition("/")[0]
    link.symlink_to(link.name)
    files = outputs(Path("duck.usda"), ["rubber"], str(tmp_path / name))
    message, hint = refusal(stamps, files)
    assert message.startswith(f"{tmp_path / name}: Too many levels of symbolic links")
    assert hint == "choose another -o"


def test_no_file_is_below_a_file(tmp_path: Path) -> None:
    file = tmp_path / "notes.txt"
    file.write_text("")
    assert {stamp for _, stamp in stamps(in_folder(file))} == {None}


def test_a_folder_that_cannot_be_written_to(sealed: Path) -> None:
    message, hint = refusal(require_free, in_folder(sealed / "new"), False)
    # The system's own words differ: a sealed folder denies permission, the kernel's has no files.
    assert message in (
        f"{sealed} cannot be written to: Permission denied",
        f"{sealed} cannot be written to: No such file or directory",
    )
    assert hint == "choose another folder with -o, or change its permissions"


@pytest.mark.skipif(os.name == "nt", reason="symbolic links need a permission there")
def test_a_folder_that_is_a_link_to_nowhere(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to("nowhere")
    message, hint = refusal(require_free, in_folder(tmp_path / "link"), False)
    assert message == f"{tmp_path / 'link'} is a symbolic link to nowhere, which does not exist"
    assert hint == "make that folder, or choose another with -o"


def test_a_mesh_file_becomes_a_layer_next_to_the_root() -> None:
    files = outputs(Path("models/toy.OBJ"), ["rubber"], "out/")
    assert files.source == Path("out/toy.source.usdc")
    assert files.own == (files.root, *files.caches, files.report)
    assert files.all == (*files.own, files.source)
    assert outputs(Path("toy.USDZ"), ["rubber"], None).source is None


def test_results_have_different_names() -> None:
    assert refusal(outputs, Path("toy.obj"), ["rubber"], "toy.source.usdc") == (
        "two results would be named toy.source.usdc",
        "choose another -o",
    )


def test_the_layer_of_a_mesh_file_is_shared_by_its_bakes(tmp_path: Path) -> None:
    files = outputs(Path("toy.obj"), ["rubber"], f"{tmp_path}/")
    files = replace(files, textures=(tmp_path / "toy.textures" / "skin.png",))
    require_source_free(files, False, False)
    layer, texture = tmp_path / "toy.source.usdc", files.textures[0]
    texture.parent.mkdir()
    for there in (texture, layer):
        there.write_text("earlier")
        # What another bake may lie over is no reason to refuse a free name,
        require_free(files, False)
        # nor is a layer that was made of the same file in the same way.
        require_source_free(files, True, False)
        require_source_free(files, False, True)
        assert refusal(require_source_free, files, False, False) == (
            f"{there} exists already, and was made from another file or with other options",
            "add --overwrite to replace it (other bakes may be layered over it), or choose another"
            " folder with -o",
        )
        message, hint = refusal(
            partial(require_source_free, other_version=True), files, False, False
        )
        assert message == f"{there} exists already, and was made by another version of gf-usd"
        assert "--overwrite" in hint
        require_source_free(files, False, True, other_version=True)
    require_source_free(outputs(DUCK, ["rubber"], f"{tmp_path}/"), False, False)


def test_folders_are_made_when_the_bake_begins(tmp_path: Path) -> None:
    files = in_folder(tmp_path / "new" / "folder")
    create_output_folder(files)
    create_output_folder(files)
    assert files.root.parent.is_dir()
    assert list(files.root.parent.iterdir()) == []


def test_the_report_of_a_failure_is_in_nobodys_way(tmp_path: Path) -> None:
    files = outputs(Path("duck.usda"), ["rubber"], f"{tmp_path}/")
    assert report_of_failure(files) == files.report
    files.report.write_text('{"failed": {"frame": 3}}', encoding="utf-8")
    partial_path(files.root).write_text("#usda 1.0\n", encoding="utf-8")
    partial_path(files.caches[0]).write_bytes(b"half")
    assert report_of_failure(files) == files.report
    require_free(files, overwrite=False)
    create_output_folder(files)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("text", ["{}", "[]", "no json", '["failed"]'])
def test_any_other_report_is_kept(tmp_path: Path, text: str) -> None:
    files = outputs(Path("duck.usda"), ["rubber"], f"{tmp_path}/")
    files.report.write_text(text, encoding="utf-8")
    with pytest.raises(UsageError, match="exists already"):
        require_free(files, overwrite=False)
    assert report_of_failure(files) == partial_path(files.report)
    create_output_folder(files)
    assert files.report.read_text(encoding="utf-8") == text


def test_what_cannot_be_cleared_away_is_reported(tmp_path: Path) -> None:
    files = outputs(Path("duck.usda"), ["rubber"], f"{tmp_path}/")
    partial_path(files.root).mkdir()
    with pytest.raises(UsageError, match=r"duck\.rubber\.partial\.usda of an earlier bake cannot"):
        create_output_folder(files)


@pytest.mark.parametrize("stem", ["duck", "duck[1]", "duck*", "a b"])
def test_frames_of_splats_are_not_overwritten_unasked(tmp_path: Path, stem: str) -> None:
    """Those of an asset called duck[1] were: its brackets were taken as a pattern."""
    requested = sequences(stem, ["rubber"], ply=str(tmp_path), spz=None)
    require_free_sequences(requested, overwrite=False)
    frame = requested[0][0].path(0)
    frame.write_text("a frame")
    assert requested[0][0].existing_frames() == [frame]
    with pytest.raises(UsageError):
        require_free_sequences(requested, overwrite=False)
