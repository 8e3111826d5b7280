"""Open meshes that hold closed ones are no grounds: what they hold does not silently come off."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import igl
import numpy as np
import pytest
from physics_stages import head, prim
from solids import asset, cube, sphere, surface

from gf_usd.core.asset import Asset, Surface
from gf_usd.geometry.solid import build_solid
from gf_usd.pipeline.prepared import prepare
from gf_usd.prepare.bodies import open_bodies as module
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


def on_dome(squash: float = 1.0, height: float = -0.1) -> tuple[Surface, Surface]:
    """Two buttons on the sides of a dome, at a height before it is squashed."""
    x = np.sqrt(1.0 - height**2) + 0.03
    return button(x, squash * height, LEFT), button(-x, squash * height, RIGHT)


def room(removed: Sequence[Any], *, inward: bool) -> Surface:
    """Walls of a room of 5 x 3 x 5 m without the sides that face some directions."""
    box = cube((-2.5, 0.0, -2.5), (5.0, 3.0, 5.0))
    a, b, c = np.moveaxis(box.points[box.triangles], 1, 0)
    normal = np.cross(b - a, c - a)
    kept = ~(normal @ np.array(removed).T > 0.0).any(1)
    faces = box.triangles[kept]
    return surface(box.points, faces[:, ::-1] if inward else faces, SHELL)


def found(*surfaces: Surface, own: Collection[str] = ()) -> tuple[OpenBody, ...]:
    whole = asset(*surfaces)
    return open_bodies(whole, build_solid(whole), own)


def test_a_shell_holds_the_buttons_on_it() -> None:
    shell, (left, right) = dome(), on_dome()
    assert build_solid(asset(shell, left)).embedded[0][0] == SHELL  # too open to be filled
    assert found(shell, left, right) == (OpenBody(path=SHELL, held=(LEFT, RIGHT)),)


def test_it_does_not_hold_what_is_next_to_it() -> None:
    assert found(dome(), button(1.2, 0.0, LEFT)) == ()


def test_what_has_physics_of_its_own_is_not_held() -> None:
    """A body of UsdPhysics comes off because the stage says so."""
    shell, buttons = dome(), on_dome()
    assert found(shell, *buttons, own={RIGHT}) == (OpenBody(path=SHELL, held=(LEFT,)),)
    assert found(shell, *buttons, own={LEFT, RIGHT}) == ()
    assert found(shell, *buttons, own={SHELL}) == ()


def test_a_component_of_its_own_is_not_held() -> None:
    """It stays a body of its own with --repair, too."""
    shell, (left, right) = dome(), on_dome()
    apart = replace(left, component="/Left")
    assert found(shell, apart, right) == (OpenBody(path=SHELL, held=(RIGHT,)),)


def test_what_stands_on_an_open_mesh_is_not_held() -> None:
    """A plinth and a slab have no bottom face."""
    slab = cube((-1.0, 0.0, -1.0), (2.0, 0.6, 2.0))
    bottom = (slab.points[slab.triangles][:, :, 1] == 0.0).all(1)
    plinth = surface(slab.points, slab.triangles[~bottom], SHELL)
    assert build_solid(asset(plinth, button(0.0, 0.7, LEFT))).embedded[0][0] == SHELL
    on_top = button(0.5, 0.67, LEFT), button(0.0, 0.67, RIGHT)
    assert found(plinth, *on_top) == ()
    handle = button(1.07, 0.2, "/Handle")
    assert found(plinth, *on_top, handle) == (
        OpenBody(path=SHELL, held=(LEFT, RIGHT, "/Handle")),
    )  # fmt: skip


def test_a_low_hill_is_a_ground() -> None:
    assert found(dome(0.0, squash=0.2), *on_dome(squash=0.2, height=0.3)) == ()


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
    tooth, low = button(-1.03, 0.1, LEFT), button(0.97, -0.28, RIGHT)
    made = found(dome(), torso, tooth, low)
    assert made == (OpenBody(path=SHELL, held=(LEFT,)),)
    assert comes_off_notes(made) == (
        "</Left> comes off </Shell>, which is open and not filled, and touches nothing else as"
        " large; with --repair </Shell> is a shell one spacing thick, and one body with what"
        " touches it",
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


def test_a_bake_names_what_comes_off(tmp_path: Path) -> None:
    """Two buttons of a controller fell onto the floor, and nothing said so."""
    path = write(tmp_path / "a.usda", asset(dome(), *on_dome()))
    plan = prepare(path, particles=400, frames=2, output=tmp_path / "b.usda").plan
    assert [note for note in plan.notes if " off " in note] == [
        "</Left>, </Right> come off </Shell>, which is open and not filled, and touch nothing else"
        " as large; with --repair </Shell> is a shell one spacing thick, and one body with"
        " what touches it"
    ]
    assert plan.bodies is not None
    assert plan.bodies.surfaces == ((LEFT,), (RIGHT,))


@pytest.mark.slow
def test_repair_makes_a_shell_and_what_it_holds_one_body(tmp_path: Path) -> None:
    """The note says so."""
    path = write(tmp_path / "a.usda", asset(dome(), *on_dome()))
    repaired = prepare(path, particles=400, frames=2, repair=True, output=tmp_path / "b.usda").plan
    assert not [note for note in repaired.notes if " off " in note]
    assert repaired.bodies is not None
    assert repaired.bodies.surfaces == ((SHELL, LEFT, RIGHT),)
    radii = np.linalg.norm(repaired.particles.X, axis=1)
    assert np.median(radii) == pytest.approx(1.0, abs=repaired.particles.spacing)
    assert radii.min() > 1.0 - 1.5 * repaired.particles.spacing  # hollow


def test_a_backdrop_holds_nothing(tmp_path: Path) -> None:
    """A panel, without half of its back and two of its edges, is flat and upright."""
    box = cube((-1.0, 0.0, -0.09), (2.0, 2.0, 0.09))
    flat = np.ptp(box.points[box.triangles], axis=1)
    back = np.flatnonzero((box.points[box.triangles][:, :, 2] == -0.09).all(1))[:1]
    edges = np.flatnonzero(flat[:, 0] == 0.0)
    panel = surface(box.points, np.delete(box.triangles, [*back, *edges], axis=0), SHELL)
    knob = button(0.0, 0.4, LEFT)
    knob = surface(knob.points + [0.0, 0.0, 0.07], knob.triangles, LEFT)
    assert found(panel, knob)  # it would be taken for a body
    path = write(tmp_path / "a.usda", asset(panel, knob))
    notes = prepare(path, particles=400, frames=2, output=tmp_path / "b.usda").plan.notes
    assert [note for note in notes if "as at a wall or a backdrop" in note]
    assert not [note for note in notes if " off " in note]


def test_the_physics_of_the_stage_goes_first(tmp_path: Path) -> None:
    path = write(tmp_path / "a.usda", asset(dome(), *on_dome()))
    text = path.read_text(encoding="utf-8")
    for name in (LEFT, RIGHT):
        named = f'def Mesh "{name[1:]}" (\n'
        text = text.replace(named, named + 'prepend apiSchemas = ["PhysicsRigidBodyAPI"]\n')
    path.write_text(text, encoding="utf-8")
    notes = prepare(path, particles=400, frames=2, output=tmp_path / "b.usda").plan.notes
    assert not [note for note in notes if " off " in note]


def test_one_query_finds_what_touches_a_shell(monkeypatch: pytest.MonkeyPatch) -> None:
    """A hierarchy of 222,080 triangles was built for each of 60 parts: 13 s."""
    whole = sphere(1.0, subdivisions=4)
    kept = whole.points[whole.triangles].mean(1)[:, 1] > -0.353
    angles = 2.0 * np.pi * np.arange(12) / 12
    parts = [
        sphere(0.1, (np.cos(a), -0.2, np.sin(a)), 2, path=f"/Part{k}") for k, a in enumerate(angles)
    ]
    scene = asset(surface(whole.points, whole.triangles[kept], SHELL), *parts)
    solid = build_solid(scene)
    query, asked = igl.point_mesh_squared_distance, []

    def counted(X: np.ndarray, points: np.ndarray, triangles: np.ndarray) -> Any:
        asked.append(len(triangles))
        return query(X, points, triangles)

    monkeypatch.setattr(module.igl, "point_mesh_squared_distance", counted)
    assert len(open_bodies(scene, solid)[0].held) == 12
    assert sum(count > 100 for count in asked) == 1
