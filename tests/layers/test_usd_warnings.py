"""What USD warns of is counted, quoted once and kept from the terminal."""

from __future__ import annotations

from pathlib import Path

import pytest
from pxr import Sdf, Usd
from small_stages import write

from gf_usd.layers.check.run import check_file
from gf_usd.layers.check.validators import run_validators
from gf_usd.layers.usd_warnings import gathered

PICTURE = """
def Material "Paint"
{
    token outputs:surface.connect = </Paint/Picture.outputs:surface>
    def Shader "Picture"
    {
        asset inputs:file = @./tex/tile.<UDIM>.png@
        uniform token info:id = "UsdUVTexture"
        token outputs:surface
    }
}
"""


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


def test_a_warning_of_two_stages_is_one_kind(tmp_path: Path) -> None:
    """It named the stage by its address in memory: a bake told the same twice."""
    write(
        tmp_path / "leaf.usda",
        'def Xform "Leaf" ( prepend apiSchemas = ["MaterialBindingAPI"] )\n'
        '{ rel material:binding = </Outside>\n}\ndef Material "Outside" {}\n',
    )
    path = write(tmp_path / "tree.usda", 'def "It" ( payload = @./leaf.usda@</Leaf> ) {}\n')
    with gathered() as warned:
        for stage in [Usd.Stage.Open(str(path)), Usd.Stage.Open(str(path))]:
            stage.GetPrimAtPath("/It").GetRelationship("material:binding").GetTargets()
    assert list(warned.counts.values()) == [2]
    (line,) = warned.lines()
    assert "outside the scope of the payload" in line
    assert "0x" not in line


@pytest.mark.parametrize(
    ("stated", "left"),
    [
        ((), True),
        (("does not compose: Could not open asset @{file}@ for reference",), False),
        (("texture ./gone0.usda does not exist",), True),
        (("texture ./gone1.usda does not exist",), True),
    ],
)
def test_missing_files_are_reported_once(
    tmp_path: Path, stated: tuple[str, ...], left: bool
) -> None:
    """Not again as prim paths, which they are not; nor where notes name them."""
    path = with_missing(tmp_path, 1)
    file = tmp_path / "gone0.usda"
    with gathered() as warned:
        stage = Usd.Stage.Open(str(path))
        for _ in run_validators(stage):
            pass
    assert any("Ill-formed SdfPath" in text for text in warned.counts)
    notes = warned.lines(stated=[text.format(file=file) for text in stated])
    assert not any("Ill-formed" in note for note in notes)
    assert bool(notes) == left


def test_other_ill_formed_paths_are_reported() -> None:
    with gathered() as warned:
        Sdf.Path("/World/My Prim")
    (line,) = warned.lines(stated=["/World/My Prim"])
    assert line.startswith("USD warned once: Ill-formed SdfPath </World/My Prim>")


def test_findings_of_the_check_are_not_repeated(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    checked = check_file(with_missing(tmp_path, 3))
    for k in range(3):
        assert any(f"gone{k}.usda" in finding.message for finding in checked.findings)
    assert checked.warned == ()
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("tiles", [0, 2])
@pytest.mark.parametrize("zipped", [False, True], ids=["folder", "package"])
def test_tiles_of_a_udim_texture_are_not_missing(zipped: bool, tiles: int, tmp_path: Path) -> None:
    path = write(tmp_path / "udim.usda", PICTURE)
    (tmp_path / "tex").mkdir()
    names = [f"tex/tile.{1001 + k}.png" for k in range(tiles)]
    for name in names:
        (tmp_path / name).write_bytes(b"not looked into")
    if zipped:
        source, path = path, tmp_path / "udim.usdz"
        writer = Sdf.ZipFileWriter.CreateNew(str(path))
        assert writer.AddFile(str(source), source.name)
        assert all(writer.AddFile(str(tmp_path / name), name) for name in names)
        assert writer.Save()
    with gathered() as warned:
        for _ in run_validators(Usd.Stage.Open(str(path))):
            pass
    assert any("<UDIM>" in text for text in warned.counts)
    assert bool(warned.lines()) == (tiles == 0)
    if not zipped:
        return
    # a layer in another folder than the package, and than the current one
    over = tmp_path / "baked" / "over.usda"
    over.parent.mkdir()
    write(over, PICTURE.replace("@./tex", "@../udim.usdz[tex").replace("png@", "png]@"))
    checked = check_file(over)
    assert checked.warned == ()
    lost = [f for f in checked.findings if f.rule.endswith("UnresolvableDependency")]
    assert len(lost) == (tiles == 0)
