"""A note on variants whose meshes the baked points do not fit, such as other levels of detail."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from physics_stages import BOX, head
from pxr import Sdf, Usd

from gf_usd.readers import read_asset
from gf_usd.readers.usd import variants as reader
from gf_usd.readers.usd.stage import composition_errors

# a cube with its top divided in two triangles
FINE = BOX.replace("[4, 4, 4, 4, 4, 4]", "[4, 3, 3, 4, 4, 4, 4]").replace(
    "4,5,7,6,", "4,5,7, 4,7,6,"
)
RED = "color3f[] primvars:displayColor = [(1, 0, 0)]"


def stage(folder: Path, *variants: str) -> Path:
    """A stage whose variants each have these lines, of which the first is selected."""
    blocks = "".join(f'"v{k}" {{\n{lines}\n}}\n' for k, lines in enumerate(variants))
    path = folder / "toy.usda"
    path.write_text(
        head(extra='defaultPrim = "Toy"')
        + f"""def Xform "Toy" (
    variants = {{ string LOD = "v0" }}
    prepend variantSets = "LOD"
)
{{
    variantSet "LOD" = {{
        {blocks}
    }}
}}
""",
        encoding="utf-8",
    )
    return path


def geo(lines: str, name: str = "Geo") -> str:
    return f'def Mesh "{name}" {{\n{lines}\n}}\n'


@pytest.mark.parametrize(
    ("others", "named"),
    [
        ((geo(FINE),), "v1, with other meshes or faces: for it,"),
        ((geo(BOX, "Low"),), "v1, with"),
        ((geo(BOX + RED), geo(FINE), geo(FINE)), "v2, v3, with other meshes or faces: for each,"),
        ((geo(BOX + RED),), ""),
        (("",), ""),
        (('def "Geo" (references = @fine.usda@) {\n}',), "v1, with"),
        (('over "Geo" (payload = @fine.usda@) {\n}',), "v1, with"),
    ],
    ids=[
        "other faces",
        "another mesh",
        "some of them",
        "another color",
        "no mesh",
        "a reference",
        "a payload",
    ],
)
def test_levels_of_detail_are_noted(tmp_path: Path, others: tuple[str, ...], named: str) -> None:
    """The other level had the points of the baked one, and faces of its own."""
    layer(tmp_path, geo(FINE), "fine.usda", "Geo")
    notes = read_asset(stage(tmp_path, geo(BOX), *others)).facts.notes
    found = [note for note in notes if note.startswith("</Toy>: of its variant set LOD")]
    assert len(found) == bool(named)
    if named:
        assert f"v0 is baked, and the motion does not fit {named}" in found[0]


def found(path: Path, **options: Any) -> list[str]:
    """The notes on variant sets."""
    notes = read_asset(path, **options).facts.notes
    return [note for note in notes if ": of its variant set " in note]


def layer(folder: Path, prims: str, name: str = "toy.usda", default: str = "Toy") -> Path:
    path = folder / name
    path.write_text(head(extra=f'defaultPrim = "{default}"') + prims, encoding="utf-8")
    return path


def with_set(inside: str, variants: dict[str, str], meta: str = "") -> str:
    """A prim with a variant set `kind`, none of whose variants is selected."""
    blocks = "".join(f'"{name}" {{\n{lines}\n}}\n' for name, lines in variants.items())
    return (
        f'def Xform "Toy" (\nprepend variantSets = "kind"\n{meta}\n) {{\n{inside}\n'
        f'variantSet "kind" = {{\n{blocks}}}\n}}\n'
    )


def test_a_set_without_a_selection_says_so(tmp_path: Path) -> None:
    (note,) = found(layer(tmp_path, with_set(geo(BOX), {"hat": geo(BOX, "Hat")})))
    assert note.startswith("</Toy>: of its variant set kind, no variant is baked, and the motion")


def test_meshes_beside_the_baked_prim_do_not_count(tmp_path: Path) -> None:
    path = layer(tmp_path, with_set(geo(BOX), {"table": geo(BOX, "Table")}))
    assert len(found(path)) == 1
    assert found(path, prims=["/Toy/Geo"]) == []


def test_faces_count_where_the_set_is_above_the_baked_prim(tmp_path: Path) -> None:
    path = stage(tmp_path, geo(BOX), geo(FINE))
    assert len(found(path, prims=["/Toy/Geo"])) == 1


@pytest.mark.parametrize(
    "line",
    [
        'uniform token purpose = "guide"',
        'uniform token purpose = "proxy"',
        'token visibility = "invisible"',
    ],
)
def test_meshes_that_are_not_baked_do_not_count(tmp_path: Path, line: str) -> None:
    assert found(stage(tmp_path, geo(BOX), geo(BOX) + geo(BOX + line, "More"))) == []


def test_a_level_of_detail_that_is_hidden_counts(tmp_path: Path) -> None:
    """Shown by its variant, it would stand still."""
    shapes = geo(BOX) + geo(BOX, "Low")
    hidden, shown = (
        f'over "Low" {{\ntoken visibility = "{value}"\n}}' for value in ("invisible", "inherited")
    )
    path = stage(tmp_path, hidden, shown)
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace('variantSet "LOD"', shapes + 'variantSet "LOD"'), encoding="utf-8")
    assert len(found(path)) == 1


def test_errors_of_the_stage_are_found_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They were found again for each error of each variant."""
    missing = [f'def Mesh "Geo" (references = @no{k}.usda@) {{\n}}' for k in range(3)]
    path = stage(tmp_path, geo(BOX), *missing)
    asked = []

    def errors(of: Usd.Stage) -> list[str]:
        asked.append(of)
        return composition_errors(of)

    monkeypatch.setattr(reader, "composition_errors", errors)
    (note,) = found(path)
    assert note.count("does not compose") == 3
    assert len(asked) == 1 + 3


def test_a_variant_that_does_not_compose_is_named(tmp_path: Path) -> None:
    """Nothing said that it was not compared."""
    missing = 'def Mesh "Geo" (references = @missing.usda@) {\n}'
    path = stage(tmp_path, geo(BOX), missing, geo(FINE))
    (note,) = found(path)
    assert "does not fit v2, with" in note
    assert "; v1 does not compose and was not compared: " in note
    assert "missing.usda" in note
    assert "\n" not in note
    (tmp_path / "missing.usda").write_text("#usda 1.0\nnonsense", encoding="utf-8")
    (note,) = found(stage(tmp_path, geo(BOX), missing))
    assert "; v1 does not compose and was not compared: " in note
    assert "missing.usda" in note


def test_looks_are_not_compared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Many variants before a level of detail exhausted the limit."""
    looks = ["", 'over "Geo" {\n' + RED + "\n}", 'def Scope "Looks" {\ndef Material "Red" {\n}\n}']
    monkeypatch.setattr("gf_usd.readers.usd.variants.MOST_VARIANTS", 1)
    (note,) = found(stage(tmp_path, geo(BOX), *looks, geo(FINE)))
    assert "does not fit v4, with" in note
    assert "compared" not in note


@pytest.mark.parametrize(
    ("limit", "text"),
    [
        (1, "bake a layer that selects it; 1 other variant was not compared, and the motion may"),
        (0, "v0 is baked; 2 other variants were not compared, and the motion may not fit them"),
    ],
)
def test_variants_that_are_not_compared_are_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: int, text: str
) -> None:
    monkeypatch.setattr("gf_usd.readers.usd.variants.MOST_VARIANTS", limit)
    (note,) = found(stage(tmp_path, geo(BOX), geo(FINE), geo(FINE)))
    assert text in note


@pytest.mark.parametrize("inner", [False, True], ids=["on the instance", "below it"])
def test_meshes_of_an_instance_count(tmp_path: Path, inner: bool) -> None:
    path = stage(tmp_path, geo(BOX), geo(FINE))
    if inner:
        text = 'def Xform "Group" {\ndef "Toy" (references = @toy.usda@) {\n}\n}'
        path = layer(tmp_path, text, "group.usda", "Group")
    instances = "".join(
        f'def "{name}" (\ninstanceable = true\nreferences = @{path.name}@\n) {{}}\n'
        for name in ("One", "Two")
    )
    text = f'def Xform "Scene" {{\n{instances}\n}}'
    (note,) = found(layer(tmp_path, text, "scene.usda", "Scene"))
    below = "/Toy" if inner else ""
    assert note.startswith(f"each of </Scene/One{below}> and </Scene/Two{below}>: of its variant")
    assert "does not fit v1, with" in note


def test_opinions_of_the_session_hold(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The session takes away the mesh that the other variant adds."""
    path = stage(tmp_path, geo(BOX), geo(BOX) + geo(BOX, "Hat"))

    def opened(path: Path) -> Usd.Stage:
        made = Usd.Stage.Open(str(path), Usd.Stage.LoadAll)
        spec = Sdf.CreatePrimInLayer(made.GetSessionLayer(), "/Toy/Hat")
        spec.active = False
        return made

    assert len(found(path)) == 1
    monkeypatch.setattr("gf_usd.readers.usd.asset.open_stage", opened)
    assert found(path) == []
