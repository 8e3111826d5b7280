"""A note on variants whose meshes the baked points do not fit, such as other levels of detail."""

from __future__ import annotations

from pathlib import Path

import pytest
from physics_stages import BOX, head

from gf_usd.readers import read_asset

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
    return f'def Mesh "{name}" {{\n{lines}\n}}'


@pytest.mark.parametrize(
    ("others", "named"),
    [
        ((geo(FINE),), "v1, with other meshes or faces: for it,"),
        ((geo(BOX, "Low"),), "v1, with"),
        ((geo(BOX + RED), geo(FINE), geo(FINE)), "v2, v3, with other meshes or faces: for each,"),
        ((geo(BOX + RED),), ""),
        (("",), ""),
    ],
    ids=["other faces", "another mesh", "some of them", "another color", "no mesh"],
)
def test_levels_of_detail_are_noted(tmp_path: Path, others: tuple[str, ...], named: str) -> None:
    """The other level had the points of the baked one, and faces of its own."""
    notes = read_asset(stage(tmp_path, geo(BOX), *others)).facts.notes
    found = [note for note in notes if note.startswith("</Toy>: of its variant set LOD")]
    assert len(found) == bool(named)
    if named:
        assert f"v0 is baked, and the motion does not fit {named}" in found[0]
