"""Meshes that a character's animation does not hold: the ground, props and sheets."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from arm import arm, write

from gf_usd.core.arrays import Floats
from gf_usd.geometry.solid import build_solid
from gf_usd.prepare.bodies.flesh.character_file import CharacterFile
from gf_usd.prepare.bodies.flesh.characters import GROUND, OWN, PROP, SHEET, without_props
from gf_usd.readers import read_asset

QUAD = np.array([(-1.0, 0.0, -1.0), (-1.0, 0.0, 1.0), (1.0, 0.0, 1.0), (1.0, 0.0, -1.0)])
SPACING = 0.1  # [m]


def listed(points: Floats) -> str:
    return "[" + ", ".join(str(tuple(p)) for p in points.tolist()) + "]"


def samples(points: Floats) -> str:
    """Points that rise by 0.1 m."""
    return f"point3f[] points.timeSamples = {{ 1: {listed(points)}, 9: {listed(points + 0.1)} }}"


def quad(
    name: str, scale: float, place: tuple[float, float, float], *, animated: bool = False
) -> str:
    points = QUAD * scale + place
    return f"""
    def Mesh "{name}"
    {{
        uniform token subdivisionScheme = "none"
        point3f[] points = {listed(points)}
        {samples(points) if animated else ""}
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
    }}
"""


def box(
    name: str,
    size: tuple[float, float, float],
    place: tuple[float, float, float],
    *,
    animated: bool = False,
) -> str:
    corners = np.array(size) * (np.array(list(np.ndindex(2, 2, 2))) - 0.5) + place
    faces = [0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4, 1, 5, 7, 3]

    return f"""
    def Mesh "{name}"
    {{
        uniform token subdivisionScheme = "none"
        point3f[] points = {listed(corners)}
        {samples(corners) if animated else ""}
        int[] faceVertexCounts = {[4] * 6}
        int[] faceVertexIndices = {faces}
    }}
"""


def with_arm(folder: Path, *meshes: str) -> Path:
    return write(folder, arm().rstrip().removesuffix("}") + "".join(meshes) + "}")


def cache(folder: Path, *meshes: str) -> Path:
    """A stage of meshes without a skeleton."""
    path = folder / "cache.usda"
    path.write_text(
        '#usda 1.0\n( metersPerUnit = 1\n upAxis = "Y"\n defaultPrim = "A" )\n'
        f'def Xform "A"\n{{{"".join(meshes)}}}\n',
        encoding="utf-8",
    )
    return path


def left_out(path: Path) -> dict[str, str]:
    """The reason for each mesh that is left out, by its name."""
    asset = read_asset(path, bind_pose=True)
    kept = without_props(asset, build_solid(asset), CharacterFile(asset, path, None), SPACING)
    new = kept.skipped[len(asset.skipped) :]
    assert {s.path for s in asset.surfaces} - {s.path for s in kept.surfaces} == {p for p, _ in new}
    return {path.rsplit("/", 1)[1]: reason for path, reason in new}


@pytest.mark.parametrize("height", [-0.5, -0.2], ids=["below", "at the skin"])
def test_the_ground_under_a_character_does_not_follow_it(tmp_path: Path, height: float) -> None:
    ground = quad("Ground", 5.0, (1.0, height, 0.0))
    found = left_out(with_arm(tmp_path, ground))
    assert found == {"Ground": f"no skeleton poses it, and {GROUND}"}


def test_a_sheet_follows_flesh_that_it_is_near_and_no_other(tmp_path: Path) -> None:
    """Nearer than 2 % of the arm's size, 4 cm, at any resolution."""
    near = quad("Cuff", 0.1, (1.5, 0.23, 0.0))
    far = quad("Kite", 0.1, (1.5, 0.26, 0.0))
    inside = quad("Card", 0.1, (1.5, 0.0, 0.0))
    found = left_out(with_arm(tmp_path, near, far, inside))
    assert found == {"Kite": f"no skeleton poses it, and {SHEET}"}


def test_two_props_on_a_slab_are_not_held_by_the_character_that_stands_on_it(
    tmp_path: Path,
) -> None:
    """The crate touches the slab, and the slab the character."""
    slab = box("Slab", (8.0, 0.1, 8.0), (1.0, -0.25, 0.0))
    crate = box("Crate", (0.4, 0.4, 0.4), (1.0, 0.0, 2.0))
    found = left_out(with_arm(tmp_path, slab, crate))
    assert found == {
        "Slab": f"no skeleton poses it, and {GROUND}",
        "Crate": f"no skeleton poses it, and {PROP}",
    }


def test_beside_animated_points_meshes_that_are_not_animated_stay(tmp_path: Path) -> None:
    path = cache(
        tmp_path,
        box("Body", (1.0, 1.0, 1.0), (0.0, 0.5, 0.0), animated=True),
        box("Hat", (0.4, 0.4, 0.4), (0.0, 1.2, 0.0)),
        box("Crate", (1.0, 1.0, 1.0), (3.0, 0.5, 0.0)),
        quad("Ground", 9.0, (0.0, 0.0, 0.0)),
    )
    assert left_out(path) == {
        "Crate": f"it is not animated, and {PROP}",
        "Ground": f"it is not animated, and {GROUND}",
    }


def test_an_animated_sheet_under_a_body_is_no_ground(tmp_path: Path) -> None:
    """As a wide dress is under a head."""
    path = cache(
        tmp_path,
        box("Head", (0.4, 0.4, 0.4), (0.0, 1.0, 0.0), animated=True),
        quad("Dress", 2.0, (0.0, 0.0, 0.0), animated=True),
    )
    assert left_out(path) == {}


def test_the_ground_does_not_follow_the_nearest_bones_either(tmp_path: Path) -> None:
    """Meshes without joint weights follow those of the only skeleton."""
    text = arm(skeleton="").replace("int[] primvars:skel:jointIndices", "int[] primvars:a")
    text = text.replace("float[] primvars:skel:jointWeights", "float[] primvars:b")
    text = text.rstrip().removesuffix("}") + quad("Ground", 5.0, (1.0, -0.5, 0.0)) + "}"
    assert left_out(write(tmp_path, text)) == {"Ground": f"no skeleton poses it, and {GROUND}"}


def under_transform(body: str, name: str, places: tuple[tuple[float, float, float], ...]) -> str:
    """A prim under a transform with time samples from 1 on."""
    samples = ", ".join(f"{k + 1}: {place}" for k, place in enumerate(places))
    return f"""
    def Xform "{name}"
    {{
        double3 xformOp:translate.timeSamples = {{ {samples} }}
        uniform token[] xformOpOrder = ["xformOp:translate"]
        {body}
    }}
"""


def test_a_mesh_with_an_animation_of_its_own_keeps_it_beside_a_skeleton(tmp_path: Path) -> None:
    """Eyes under an animated transform were attached where they are in the first frame, to a head
    in its bind pose.
    """
    moving = ((0.0, 0.0, 0.0), (0.0, 0.3, 0.0))
    eye = under_transform(box("Eye", (0.2, 0.2, 0.2), (1.8, 0.2, 0.0)), "Head", moving)
    still = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    watch = under_transform(box("Watch", (0.2, 0.2, 0.2), (0.5, 0.2, 0.0)), "Wrist", still)
    found = left_out(with_arm(tmp_path, eye, watch))
    assert found == {"Eye": f"no skeleton poses it, and {OWN}"}
