"""Which meshes of characters are garments or closed sheets, on stages of one or two characters."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from arm import arm, bound_mesh, write

from gf_usd.geometry.solid import build_solid
from gf_usd.prepare.bodies.flesh.character_file import CharacterFile
from gf_usd.prepare.bodies.flesh.characters import WORN, worn_meshes
from gf_usd.readers import read_asset

SPACING = 0.05  # [m]


def tube(name: str, radius: float, low: float, high: float, hole: float = 0.0) -> str:
    """A closed tube along the arm, or one with a hole of a radius [m] in its upper end."""
    made = trimesh.creation.cylinder(radius, segment=((low, 0, 0), (high, 0, 0)), sections=24)
    made = made.subdivide_to_size(0.15)
    points, faces = np.array(made.vertices), np.array(made.faces)
    center = points[faces].mean(1)
    end = np.isclose(center[:, 0], high)
    return of_two_joints(name, points, faces[~(end & (np.hypot(*center.T[1:]) < hole))])


def wall(name: str, low: float, high: float, thickness: float = 0.01) -> str:
    """A closed wall around the arm, as thick as given [m]."""
    made = trimesh.creation.annulus(0.45 - thickness, 0.45, height=high - low)
    points = np.array(made.vertices)[:, [2, 0, 1]] + (0.5 * (low + high), 0.0, 0.0)
    return of_two_joints(name, points, np.array(made.faces))


def of_two_joints(name: str, points: Any, faces: Any) -> str:
    share = np.clip(points[:, 0] - 0.5, 0.0, 1.0)
    weights = np.stack([1.0 - share, share], 1).ravel().tolist()
    return bound_mesh(name, points, faces, [0, 1] * len(points), weights)


def stage(*characters: tuple[str, ...]) -> str:
    """A stage of characters with the skeleton of the arm and the meshes given."""
    text = arm()
    head, root = text.split('def SkelRoot "Arm"')
    bones = root[: root.index('    def Mesh "Skin"')]
    out = head.replace('"Arm"', '"World"') + 'def Xform "World"\n{\n'
    for k, meshes in enumerate(characters):
        one = f'def SkelRoot "C{k}"' + bones + "".join(meshes) + "}\n"
        out += one.replace("</Arm/", f"</World/C{k}/")
    return out + "}\n"


def worn(folder: Path, *characters: tuple[str, ...]) -> dict[str, str]:
    path = write(folder, stage(*characters))
    asset = read_asset(path)
    return worn_meshes(asset, build_solid(asset), CharacterFile(asset, path, None), SPACING)


BODY = tube("Body", 0.3, -1.0, 3.2)
TRUNK = tube("Trunk", 0.4, 0.0, 2.0, hole=0.12)


def test_meshes_of_another_character_do_not_make_a_garment(tmp_path: Path) -> None:
    """Where bind poses overlap, the flesh of one character became a sheet around the other."""
    assert worn(tmp_path, (TRUNK,), (BODY,)) == {}
    assert worn(tmp_path, (TRUNK, BODY)) == {"/World/C0/Trunk": WORN}
    # each character keeps its own
    found = worn(tmp_path, (TRUNK, BODY), (TRUNK, BODY))
    assert found == dict.fromkeys(["/World/C0/Trunk", "/World/C1/Trunk"], WORN)


def test_bones_of_another_character_do_not_make_a_sheet(tmp_path: Path) -> None:
    skirt = wall("Skirt", 0.2, 0.9)
    assert list(worn(tmp_path, (BODY, skirt))) == ["/World/C0/Skirt"]
    assert worn(tmp_path, (skirt, wall("Cape", 1.1, 1.8)), (BODY,)) == {}, "they hold no bone"


def test_something_of_each_character_is_filled(tmp_path: Path) -> None:
    """A body that its own thin clothes pass through is flesh, beside a body of another one too."""
    inner = wall("Sleeve", 0.2, 3.0)
    coat = tube("Body", 0.46, 0.0, 2.0, hole=0.45)
    assert list(worn(tmp_path, (coat, inner), (BODY,))) == ["/World/C0/Sleeve"]


def test_closed_sheets_of_different_thickness_share_a_reason(tmp_path: Path) -> None:
    """Each had a note of its own."""
    thick = [wall(f"S{k}", 0.6 + 0.2 * k, 0.7 + 0.2 * k, 0.01 + 0.002 * k) for k in range(4)]
    reasons = worn(tmp_path, (BODY, *thick))
    assert len(reasons) == 4
    (reason,) = set(reasons.values())
    assert reason.startswith("closed, but at most 1.3")
