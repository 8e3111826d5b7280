"""The samples of what flows: closed meshes of the shapes they are drawn from, and sound stages."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from pxr import Usd, UsdGeom, UsdPhysics, UsdValidation

import gf_usd
from tools.samples import flowing
from tools.samples.implicit import Field
from tools.samples.quads import Quads

SAMPLES = Path(__file__).resolve().parents[2] / "samples"


def solid(quads: Quads) -> trimesh.Trimesh:
    a, b = quads.faces[:, [0, 1, 2]], quads.faces[:, [0, 2, 3]]
    return trimesh.Trimesh(quads.points, np.concatenate([a, b]), process=False)


@pytest.mark.parametrize(
    ("quads", "field", "step"),
    [
        (flowing.castle_mesh, flowing.castle, flowing.STEP),
        (flowing.paste_mesh, flowing.paste, flowing.PASTE_STEP),
    ],
    ids=["castle", "paste"],
)
def test_a_mesh_is_closed_and_encloses_what_it_is_drawn_from(quads, field: Field, step) -> None:
    made = solid(quads())
    assert made.is_watertight
    assert made.body_count == 1
    low, high = made.bounds
    axes = [np.arange(a, b, 0.5 * step) + 0.25 * step for a, b in zip(low, high)]
    inside = field(np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)) < 0.0
    # A surface net may be off by half a cell where the shape has an edge.
    assert abs(made.volume - inside.sum() * (0.5 * step) ** 3) < 0.5 * step * made.area


def test_tufts_are_closed_blocks() -> None:
    points, counts, indices, normals = flowing.tufts()
    assert set(counts) == {4}
    quads = Quads(points=points, faces=indices.reshape(-1, 4), parts=np.array([]))
    made, count = solid(quads), len(points) // 8
    assert made.is_watertight
    assert made.volume == pytest.approx(count * flowing.TUFT**2 * (flowing.BRUSH - 0.6))
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1.0)


@pytest.mark.parametrize("name", ["sandcastle", "snowball", "toothpaste"])
def test_a_stage_is_sound_and_as_the_tool_writes_it(tmp_path: Path, name: str) -> None:
    kept, path = SAMPLES / f"{name}.usda", tmp_path / f"{name}.usda"
    write = getattr(flowing, f"write_{name}")
    write(path, "./duck.usda") if name == "sandcastle" else write(path)
    assert path.read_bytes() == kept.read_bytes()
    stage = Usd.Stage.Open(str(kept))
    colliders = [p for p in stage.Traverse() if p.HasAPI(UsdPhysics.CollisionAPI)]
    assert any(p.IsA(UsdGeom.Plane) for p in colliders)
    materials = [p.GetAttribute("gaussianFlesh:material").Get() for p in stage.Traverse()]
    assert [one for one in materials if one] == {
        "sandcastle": ["wet-sand", "rubber"],
        "snowball": ["powder-snow"],
        "toothpaste": ["toothpaste"],
    }[name]
    found = UsdValidation.ValidationContext(
        UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    )
    errors = [
        e for e in found.Validate(stage) if e.GetType() == UsdValidation.ValidationErrorType.Error
    ]
    assert [e.GetMessage() for e in errors] == []


@pytest.mark.slow
def test_the_castle_flows_and_the_duck_holds_together() -> None:
    plan = gf_usd.inspect(SAMPLES / "sandcastle.usda", particles=800).plan
    assert plan is not None
    assert plan.settings.solver == "mixed"
    assert plan.choices.flowing == ("/SandCastle/Castle",)
    assert list(plan.points) == ["/SandCastle/Duck/Geom/Body"]


@pytest.mark.parametrize(
    ("name", "faced"), [("snowball", {"Bowl"}), ("toothpaste", {"Bristles", "Head", "Handle"})]
)
def test_what_flows_meets_the_obstacles(name: str, faced: set[str]) -> None:
    plan = gf_usd.inspect(SAMPLES / f"{name}.usda", particles=300).plan
    assert plan is not None
    assert plan.settings.solver == "ul"
    assert plan.contact_setup is not None
    assert {Path(c.path).name for c in plan.contact_setup.colliders} == faced | {"Ground"}
