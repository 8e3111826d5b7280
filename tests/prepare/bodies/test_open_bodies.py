"""Open meshes that hold closed ones are no grounds: what they hold does not silently come off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from physics_stages import head, prim
from solids import asset, cube, sphere, surface

from gf_usd import inspect
from gf_usd.core.asset import Asset, Surface
from gf_usd.geometry.solid import build_solid
from gf_usd.pipeline.prepared import prepare
from gf_usd.prepare.bodies.open_bodies import OpenBody, comes_off_notes, open_bodies

SHELL, LEFT, RIGHT = "/Shell", "/Left", "/Right"
UP = np.array([0.0, 1.0, 0.0])


def dome(low: float = -0.3, squash: float = 1.0) -> Surface:
    """A sphere of radius 1 above a height, squashed, that faces outward."""
    whole = sphere(1.0, subdivisions=3)
    kept = whole.points[whole.triangles].mean(1)[:, 1] > low
    return surface(whole.points * [1.0, squash, 1.0], whole.triangles[kept], SHELL)


def button(x: float, y: float, path: str) -> Surface:
    return sphere(0.08, (x, y, 0.0), 1, path=path)


def on_dome(squash: float = 1.0) -> tuple[Surface, Surface]:
    return tuple(
        button(x, squash * np.sqrt(1.0 - x * x) + 0.03, path)
        for x, path in ((0.3, LEFT), (-0.3, RIGHT))
    )  # fmt: skip


def room(removed: Sequence[Any], *, inward: bool) -> Surface:
    """Walls of a room of 5 x 3 x 5 m without the sides that face some directions."""
    box = cube((-2.5, 0.0, -2.5), (5.0, 3.0, 5.0))
    a, b, c = np.moveaxis(box.points[box.triangles], 1, 0)
    normal = np.cross(b - a, c - a)
    kept = ~(normal @ np.array(removed).T > 0.0).any(1)
    faces = box.triangles[kept]
    return surface(box.points, faces[:, ::-1] if inward else faces, SHELL)


def found(*surfaces: Surface) -> tuple[OpenBody, ...]:
    whole = asset(*surfaces)
    return open_bodies(whole, build_solid(whole))


def test_a_shell_holds_the_buttons_on_it() -> None:
    shell, (left, right) = dome(), on_dome()
    assert build_solid(asset(shell, left)).embedded[0][0] == SHELL  # too open to be filled
    assert found(shell, left, right) == (OpenBody(path=SHELL, held=(LEFT, RIGHT), largest=True),)


def test_it_does_not_hold_what_is_next_to_it() -> None:
    assert found(dome(), button(0.0, 1.2, LEFT)) == ()


def test_a_low_hill_is_a_ground() -> None:
    assert found(dome(0.0, squash=0.2), *on_dome(squash=0.2)) == ()


def test_a_bowl_is_no_body_of_what_is_in_it() -> None:
    bowl = surface(dome(0.0).points * [1.0, -1.0, 1.0], dome(0.0).triangles[:, ::-1], SHELL)
    assert bowl.signed_volume > 0.0
    assert found(bowl, sphere(0.3, (0.0, -0.69, 0.0), 2, path=LEFT)) == ()


SIDES = {
    "floor": [UP, (1, 0, 0), (-1, 0, 0), (0, 0, 1), (0, 0, -1)],
    "backdrop": [UP, (1, 0, 0), (-1, 0, 0), (0, 0, 1)],
    "corner": [UP, (1, 0, 0), (0, 0, 1)],
    "stage": [UP, (0, 0, 1)],
    "tunnel": [(0, 0, 1), (0, 0, -1)],
}


@pytest.mark.parametrize("inward", [True, False], ids=["inward", "outward"])
@pytest.mark.parametrize("removed", SIDES.values(), ids=SIDES.keys())
def test_a_room_is_no_body_of_its_furniture(removed: Sequence[Any], inward: bool) -> None:
    table = cube((0.0, 0.0, -1.0), (1.0, 0.8, 0.7), path=LEFT)
    assert found(room(removed, inward=inward), table) == ()


def test_what_also_touches_a_large_body_is_not_held() -> None:
    """A head with teeth, on a torso."""
    torso = sphere(2.0, (0.0, -2.1, 0.0), path="/Torso")
    tooth, low = button(0.0, 1.03, LEFT), button(0.97, -0.28, RIGHT)
    made = found(dome(), torso, tooth, low)
    assert made == (OpenBody(path=SHELL, held=(LEFT,), largest=False),)
    assert comes_off_notes(made) == (
        "</Left> comes off </Shell>, which is open and not filled, and touches nothing else as"
        " large; --repair fills it",
    )
    both = (replace(made[0], held=(LEFT, RIGHT)),)
    assert comes_off_notes(both)[0].startswith("</Left>, </Right> come off </Shell>, which is open")


def test_nothing_is_measured_of_closed_meshes() -> None:
    assert found(cube(), cube((2.0, 0.0, 0.0), path=LEFT)) == ()


def write(path: Path, whole: Asset) -> Path:
    """An asset as a file."""
    prims = [
        prim(
            "Mesh",
            one.path[1:],
            f"int[] faceVertexCounts = {one.face_counts.tolist()}",
            f"int[] faceVertexIndices = {one.face_indices.tolist()}",
            f"point3f[] points = [{', '.join(str(tuple(p)) for p in one.points.tolist())}]",
        )
        for one in whole.surfaces
    ]
    path.write_text(head() + "".join(prims), encoding="utf-8")
    return path


def test_a_shell_with_buttons_is_baked_as_one_body(tmp_path: Path) -> None:
    """The shell was taken for a ground, and two buttons of a controller fell onto the floor."""
    path = write(tmp_path / "a.usda", asset(dome(), *on_dome()))
    plan = prepare(path, particles=400, output=tmp_path / "b.usda").plan
    assert plan.notes[0] == (
        "</Shell> is open, but it alone holds </Left>, </Right>: the asset is baked with --repair;"
        " --prim bakes some of its meshes without"
    )
    assert plan.command.split()[:4] == ["gf-usd", "bake", "a.usda", "--repair"]
    assert plan.bodies is not None
    assert plan.bodies.surfaces == ((SHELL, LEFT, RIGHT),)
    assert np.ptp(plan.particles.X, axis=0)[0] > 1.9  # the shell is filled


@pytest.mark.slow
def test_an_inspection_says_the_same(tmp_path: Path) -> None:
    path = write(tmp_path / "a.usda", asset(dome(), *on_dome()))
    seen = inspect(path, particles=400)
    assert seen.notes[0].endswith("the asset is baked with repair=True; prims bakes some of its"
                                  " meshes without")  # fmt: skip
    assert [mesh["fill"] for mesh in seen.as_json()["meshes"]] == ["filled"] * 3


@pytest.mark.slow
def test_its_coarser_runs_are_repaired_too(tmp_path: Path) -> None:
    path = write(tmp_path / "a.usda", asset(dome(), *on_dome()))
    prepared = prepare(path, particles=4096, certify=True, output=tmp_path / "b.usda")
    assert prepared.refill is not None
    coarse = prepared.refill(2.0 * prepared.plan.particles.spacing)
    assert coarse.bodies is not None
    assert coarse.bodies.surfaces == ((SHELL, LEFT, RIGHT),)
