"""What the prim path of an option selects, where the mesh is a part of a joined one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from physics_stages import bound, head, prim
from solids import CUBE_POINTS, CUBE_TRIANGLES, sphere

import gf_usd
from gf_usd.core.errors import InputError
from gf_usd.core.mesh.topology import weld
from gf_usd.core.stage import BodyPhysics, StagePhysics, StageSpec
from gf_usd.pipeline.prepared import prepare, solver_of
from gf_usd.prepare.fill import neighbors
from gf_usd.prepare.fill.parts import Parts
from gf_usd.prepare.plan import Plan
from gf_usd.readers import read_asset
from gf_usd.readers.usd import asset

SMALL: dict[str, Any] = {"particles": 400, "drop": 0, "frames": 3}


def part(name: str, points: np.ndarray, triangles: np.ndarray, *lines: str) -> str:
    """A Mesh prim as text."""
    used, renumbered = np.unique(triangles, return_inverse=True)
    return prim(
        "Mesh",
        name,
        f"int[] faceVertexCounts = {[3] * len(triangles)}",
        f"int[] faceVertexIndices = {renumbered.ravel().tolist()}",
        f"point3f[] points = [{', '.join(str(tuple(p)) for p in points[used].tolist())}]",
        *lines,
        apis=("PhysicsMassAPI", "GaussianFleshBakeAPI", "MaterialBindingAPI") if lines else (),
    )


def parts_of_ball(
    borders: tuple[float, float] = (0.75, 1.25),
    turned: float = 0.0,
    low: tuple[str, ...] = (),
    rest: tuple[str, ...] = (),
) -> list[str]:
    """A ball of radius 0.5 m about y = 1 m in three meshes above each other.

    borders : heights [m] between them; turned : share of the faces whose winding is reversed;
    low : lines of the lowest; rest : of the others.
    """
    ball = sphere(0.5, (0.0, 1.0, 0.0), subdivisions=3)
    welded = weld(ball.points)[0][ball.triangles]
    middle = ball.points[welded].mean(1)[:, 1]
    chosen = np.random.default_rng(0).random(len(welded)) < turned
    welded = np.where(chosen[:, None], welded[:, ::-1], welded)
    rows = np.searchsorted(borders, middle)
    names = {"Low": low, "Middle": rest, "High": rest}
    return [
        part(name, ball.points, welded[rows == k], *lines)
        for k, (name, lines) in enumerate(names.items())
    ]


def split_ball(folder: Path, *more: str, apis: tuple[str, ...] = (), **parts: Any) -> Path:
    """A stage of the ball of `parts_of_ball`, with more lines in the prim above its meshes."""
    path = folder / "ball.usda"
    root = prim("Xform", "Ball", *more, *parts_of_ball(**parts), apis=apis)
    path.write_text(head(extra='defaultPrim = "Ball"') + root, encoding="utf-8")
    return path


def whole_and_notes(file: Path, **options: Any) -> tuple[bool, str]:
    """Whether the ball is filled as a whole, and the notes."""
    seen = gf_usd.inspect(file, **SMALL, **options)
    assert seen.plan is not None
    whole = abs(seen.plan.particles.volume / BALL - 1.0) < 0.03
    return whole, "\n".join(seen.notes)


def converted(plan: Plan | None) -> np.ndarray:
    """(n, 3) [m] the particles that may be converted."""
    assert plan is not None
    (one,) = plan.particles.conversions
    return np.asarray(plan.particles.X)[one.particles]


def test_a_part_of_a_joined_mesh_selects_what_is_next_to_it(tmp_path: Path) -> None:
    """The largest part selected all, and each other one nothing."""
    ball = split_ball(tmp_path)

    def heights(name: str) -> np.ndarray:
        seen = gf_usd.inspect(ball, conversions=f"/Ball{name}=honey@time:3", **SMALL)
        return converted(seen.plan)[:, 1]

    whole, low, middle, high = (heights(name) for name in ("", "/Low", "/Middle", "/High"))
    assert low.max() < 1.0 < high.min()
    assert len(low) + len(middle) + len(high) == len(whole)
    assert abs(np.median(middle) - 1.0) < 0.1


def test_a_mesh_without_particles_is_refused_with_its_reason(tmp_path: Path) -> None:
    sheet = part("Cape", CUBE_POINTS + (0.4, 0.0, 0.0), np.array([[0, 2, 3], [0, 3, 1]]))
    ball = split_ball(tmp_path, sheet)
    with pytest.raises(InputError, match=r"none of the .*: </Ball/Cape> is not filled: the"):
        gf_usd.bake(
            ball, conversions="/Ball/Cape=honey@time:3", output=tmp_path / "out.usda", **SMALL
        )


@pytest.mark.parametrize("option", ["pins", "rigid"])
def test_a_face_of_a_box_that_is_a_mesh_is_a_patch(tmp_path: Path, option: str) -> None:
    """It encloses nothing, and was refused as smaller than a cell."""
    faces = [part(f"F{k}", CUBE_POINTS, CUBE_TRIANGLES[2 * k : 2 * k + 2]) for k in range(6)]
    path = tmp_path / "box.usda"
    path.write_text(head() + prim("Xform", "Box", *faces), encoding="utf-8")
    plan = gf_usd.inspect(path, **{option: ("/Box/F1",)}, **SMALL).plan
    assert plan is not None
    (pin,) = plan.pins
    top = plan.particles.X[:, 2] == plan.particles.X[:, 2].max()
    assert pin.anchors[:, 2].tolist() == 4 * [1.0]
    beyond, below = np.array([[0.5, 0.5, 1.2]]), np.array([[0.5, 0.5, -0.2]])
    assert pin.inside(beyond).all()
    assert not pin.inside(below).any()
    assert pin.inside(plan.particles.X[top]).any() == (option == "rigid")


@pytest.mark.parametrize("angle", [15.0, 30.0, 75.0])
def test_a_tilted_face_of_a_box_is_a_patch_too(tmp_path: Path, angle: float) -> None:
    """Points of the box around it lie in it exactly, where the winding number is half a turn."""
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    points = CUBE_POINTS @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    faces = [part(f"F{k}", points, CUBE_TRIANGLES[2 * k : 2 * k + 2]) for k in range(6)]
    path = tmp_path / "box.usda"
    path.write_text(head() + prim("Xform", "Box", *faces), encoding="utf-8")
    for k in range(6):
        plan = gf_usd.inspect(path, pins=(f"/Box/F{k}",), **SMALL).plan
        assert plan is not None
        assert len(plan.pins[0].anchors) == 4


BALL = 4.0 / 3.0 * np.pi * 0.5**3  # [m^3]


def test_the_parts_of_a_ball_are_one_body_with_repair_too(tmp_path: Path) -> None:
    """Each was made a hollow shell, as thick as the particles are apart."""
    seen = gf_usd.inspect(split_ball(tmp_path), repair=True, **SMALL)
    assert seen.plan is not None
    assert seen.plan.particles.volume == pytest.approx(BALL, rel=0.03)
    assert {s.path for s in seen.plan.asset.surfaces} == {
        "/Ball/Low", "/Ball/Middle", "/Ball/High",
    }  # fmt: skip
    assert [one.path for one in seen.repairs] == ["/Ball/Middle"]
    assert any("enclose a volume only together" in note for note in seen.notes)


def test_a_repair_of_parts_of_mixed_winding_counts_what_it_turns(tmp_path: Path) -> None:
    seen = gf_usd.inspect(split_ball(tmp_path, turned=0.2), repair=True, **SMALL)
    assert seen.plan is not None
    assert seen.plan.particles.volume == pytest.approx(BALL, rel=0.03)
    (one,) = seen.repairs
    assert 100 < one.turned < 400


BODY = ("PhysicsRigidBodyAPI", "PhysicsMassAPI")


def test_the_parts_of_a_physics_body_are_one_body(tmp_path: Path) -> None:
    """They were not joined, and only those of them were filled that are closed enough."""
    lines = ("float physics:mass = 3", "vector3f physics:velocity = (0, 1, 0)")
    plan = gf_usd.inspect(split_ball(tmp_path, *lines, apis=BODY), **SMALL).plan
    assert plan is not None
    assert plan.particles.volume == pytest.approx(BALL, rel=0.03)
    (density,) = {m.density for m in plan.tables[0]}
    assert density * plan.particles.volume == pytest.approx(3.0)
    assert np.allclose(plan.velocity[0](plan.particles.X), (0.0, 1.0, 0.0))
    assert plan.bodies is not None
    assert plan.bodies.count == 1


def test_a_joined_body_spins_about_its_center(tmp_path: Path) -> None:
    """It spun about that of its largest part, so that its center moved sideways."""
    spin = "vector3f physics:angularVelocity = (0, 0, 180)"
    ball = split_ball(tmp_path, spin, apis=BODY, borders=(0.6, 0.9))
    plan = gf_usd.inspect(ball, **SMALL).plan
    assert plan is not None
    assert plan.particles.volume == pytest.approx(BALL, rel=0.03)
    v = np.asarray(plan.velocity[0](plan.particles.X))
    assert np.abs(v).max() > 1.0
    assert np.average(v, axis=0, weights=plan.particles.V0) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("repair", [False, True])
def test_a_count_of_a_part_is_that_of_the_joined_body(tmp_path: Path, repair: bool) -> None:
    """Only that of the largest part held; each other one was ignored."""
    low = ("int gaussianFlesh:particles = 300",)
    ball = split_ball(tmp_path, apis=BODY, low=low)
    plan = gf_usd.inspect(ball, repair=repair, drop=0, frames=3).plan
    assert plan is not None
    assert plan.particles.volume == pytest.approx(BALL, rel=0.03)
    assert plan.particles.spacing == pytest.approx(np.cbrt(BALL / 300), rel=0.02)


def test_a_part_of_another_mass_is_not_joined(tmp_path: Path) -> None:
    ball = split_ball(tmp_path, apis=BODY, low=("float physics:density = 9",))
    plan = gf_usd.inspect(ball, **SMALL).plan
    assert plan is not None
    assert plan.particles.volume < 0.9 * BALL


@pytest.mark.parametrize("option", ["pins", "rigid"])
def test_a_part_of_a_ball_is_what_it_encloses(tmp_path: Path, option: str) -> None:
    plan = gf_usd.inspect(split_ball(tmp_path), **{option: ("/Ball/Low",)}, **SMALL).plan
    assert plan is not None
    X = np.asarray(plan.particles.X)
    held = plan.pins[0].inside(X)
    assert X[held][:, 1].max() == pytest.approx(X[~held][:, 1].min(), abs=plan.particles.spacing)


def two_bodies(
    folder: Path,
    low: tuple[float, float, float],
    parts: list[str],
    lines: tuple[str, ...] = (),
    apis: tuple[str, ...] = BODY,
) -> Path:
    """A body of UsdPhysics in parts, and a cube of edge 0.8 m with a corner at `low` [m].

    lines : of the cube; apis : of each, none: they are one body where they touch.
    """
    path = folder / "two.usda"
    cube = part("Cube", 0.8 * CUBE_POINTS + low, CUBE_TRIANGLES, *lines)
    bodies = [prim("Xform", name, *one, apis=apis) for name, one in (("A", parts), ("B", [cube]))]
    root = prim("Xform", "World", *bodies)
    path.write_text(head(extra='defaultPrim = "World"') + root, encoding="utf-8")
    return path


def held_of(plan: Plan | None) -> np.ndarray:
    """(2,) particles of each body that the first pin holds."""
    assert plan is not None
    body = plan.particles.body_of
    return np.bincount(body[plan.pins[0].holds(plan.particles.X, body)], minlength=2)


def test_a_conversion_of_a_part_leaves_an_overlapping_body_alone(tmp_path: Path) -> None:
    """88 particles of the cube became honey: the part was the surface nearest to them."""
    both = two_bodies(tmp_path, (-0.4, 1.3, -0.4), parts_of_ball())
    plan = gf_usd.inspect(both, conversions="/World/A/High=honey@time:3", **SMALL).plan
    assert plan is not None
    (one,) = plan.particles.conversions
    assert set(plan.particles.body_of[one.particles]) == {0}


def test_a_rigid_part_leaves_other_bodies_alone(tmp_path: Path) -> None:
    """All of the cube was rigid, 1 m away, and what of it overlapped a part of the ball."""
    faces = [part(f"F{k}", CUBE_POINTS, CUBE_TRIANGLES[2 * k : 2 * k + 2]) for k in range(6)]
    above = two_bodies(tmp_path, (0.1, 0.1, 2.0), faces)
    mine, others = held_of(gf_usd.inspect(above, rigid=("/World/A/F1",), **SMALL).plan)
    assert mine > 0
    assert others == 0
    both = ("/World/A/F1", "box:0,0,0,0.3,0.3,0.3")
    assert held_of(gf_usd.inspect(above, rigid=both, **SMALL).plan).tolist() == [mine, 0]
    overlapping = two_bodies(tmp_path, (-0.4, 1.3, -0.4), parts_of_ball())
    mine, others = held_of(gf_usd.inspect(overlapping, rigid=("/World/A/High",), **SMALL).plan)
    assert mine > 0
    assert others == 0


@pytest.mark.parametrize("option", ["pins", "rigid"])
def test_a_part_holds_its_own_body_only(tmp_path: Path, option: str) -> None:
    """A pinned face of a box also held the nodes of a cube that stood on it."""
    faces = [part(f"F{k}", CUBE_POINTS, CUBE_TRIANGLES[2 * k : 2 * k + 2]) for k in range(6)]
    on_top = two_bodies(tmp_path, (0.1, 0.1, 1.0), faces)
    for region, body in (("/World/A/F1", 0), ("/World/B", None), ("box:0,0,0.8,1,1,2", None)):
        plan = gf_usd.inspect(on_top, **{option: (region,)}, **SMALL).plan
        assert plan is not None
        assert plan.pins[0].body == body


@pytest.mark.parametrize("region", ["/World/B/Cube", "/World/B"])
def test_a_mesh_of_a_flowing_body_is_not_pinned(tmp_path: Path, region: str) -> None:
    """It held what of a solid body was in it, without a word: a part of it was refused."""
    solid, water = (
        (f'uniform token gaussianFlesh:material = "{name}"',) for name in ("rubber", "water")
    )
    faces = [
        part(f"F{k}", CUBE_POINTS, CUBE_TRIANGLES[2 * k : 2 * k + 2], *solid) for k in range(6)
    ]
    both = two_bodies(tmp_path, (0.1, 0.1, 1.05), faces, water)
    with pytest.raises(InputError, match=f"{region} is part of a body that flows, which cannot"):
        prepare(both, particles=400, drop="0", frames=3, pins=(region,))
    everything = prepare(both, particles=400, drop="0", frames=3, pins=("/World",)).plan
    assert everything.pins[0].bodies == {0, 1}
    with pytest.raises(InputError, match="the pins /World contain all"):
        solver_of(everything, everything.variants[0])


def test_a_rigid_part_leaves_a_touching_mesh_of_its_body_alone(tmp_path: Path) -> None:
    """All of the cube was rigid that stood on a box whose upper side was rigid."""
    faces = [part(f"F{k}", CUBE_POINTS, CUBE_TRIANGLES[2 * k : 2 * k + 2]) for k in range(6)]
    path = two_bodies(tmp_path, (0.1, 0.1, 1.0), faces, apis=())
    plan = gf_usd.inspect(path, rigid=("/World/A/F1",), **SMALL).plan
    assert plan is not None
    assert plan.bodies is not None
    assert plan.bodies.count == 1
    X = plan.particles.X
    under = (X[:, 2] < 1.0) & (X[:, 2] > np.abs(X[:, :2] - 0.5).max(1) + 0.55)
    held = plan.pins[0].holds(X, plan.particles.body)
    assert X[held][:, 2].max() < 1.0
    assert held[under].all()
    assert under.sum() > 3


def test_what_a_part_of_another_body_holds_leaves_a_body_unpinned(tmp_path: Path) -> None:
    """The note on its animation was missing: a particle of its own was the nearest to the pin."""
    faces = [part(f"F{k}", CUBE_POINTS, CUBE_TRIANGLES[2 * k : 2 * k + 2]) for k in range(6)]
    path = two_bodies(tmp_path, (0.1, 0.1, 0.8), faces, SLIDING)
    notes = "\n".join(gf_usd.inspect(path, pins=("/World/A/F1",), **SMALL).notes)
    assert "its transform is animated" in notes
    assert "</World/B/Cube>" in notes


SLIDING = (
    "float3 xformOp:translate.timeSamples = { 1: (0, 0, 0), 3: (1, 0, 0) }",
    'uniform token[] xformOpOrder = ["xformOp:translate"]',
)
MATERIALS = [
    prim("Material", name, f"float physics:density = {value}", apis=("PhysicsMaterialAPI",))
    for name, value in (("Wood", 500), ("Pine", 500), ("Iron", 8000))
]
HARD = prim(
    "Material", "Hard", "float physics:youngsModulus = 1e5", "float physics:poissonsRatio = 0.3",
    apis=("PhysicsMaterialAPI", "PhysicsDeformableMaterialAPI"),
)  # fmt: skip


@pytest.mark.parametrize(
    "lines",
    [
        ("float physics:density = 500",),
        (bound("/Ball/Wood"),),
        (bound("/Ball/Hard"),),
        ('uniform token gaussianFlesh:material = "jelly"',),
    ],
)
def test_parts_of_one_material_are_one_body(tmp_path: Path, lines: tuple[str, ...]) -> None:
    """Outside a body of UsdPhysics they were refused as open."""
    ball = split_ball(tmp_path, *MATERIALS, HARD, low=lines, rest=lines)
    whole, notes = whole_and_notes(ball)
    assert whole
    assert "not filled" not in notes


def test_materials_of_the_same_values_are_one(tmp_path: Path) -> None:
    low, rest = (bound("/Ball/Pine"),), (bound("/Ball/Wood"),)
    assert whole_and_notes(split_ball(tmp_path, *MATERIALS, low=low, rest=rest))[0]


@pytest.mark.parametrize(
    ("low", "rest", "why"),
    [
        (bound("/Ball/Iron"), bound("/Ball/Wood"), "the physics material of </Ball/Middle> is"),
        ("float physics:density = 500", "float physics:density = 7", "the mass or density of </"),
        (
            'uniform token gaussianFlesh:material = "jelly"',
            'uniform token gaussianFlesh:material = "rubber"',
            "the gaussianFlesh:material of </Ball/Middle> is rubber, and that of </Ball/Low> is je",
        ),
        (
            f"float[] primvars:gaussianFlesh:youngsModulus = {185 * [1e5]}"
            ' (interpolation = "vertex")',
            "",
            "</Ball/Low> has painted values",
        ),
    ],
)
def test_parts_of_different_materials_are_named(
    tmp_path: Path, low: str, rest: str, why: str
) -> None:
    """Of two materials without elasticity the ball had that of the largest part, without a word."""
    ball = split_ball(tmp_path, *MATERIALS, low=(low,), rest=(rest,) if rest else ())
    whole, notes = whole_and_notes(ball)
    assert not whole
    assert "not filled as one body" in notes
    assert why in notes


def test_the_refusal_of_parts_of_different_mass_says_why(tmp_path: Path) -> None:
    mass = ("float physics:mass = 1",)
    seen = gf_usd.inspect(split_ball(tmp_path, low=mass, rest=mass), **SMALL)
    assert seen.refusal is not None
    assert "is 1 kg (of </Ball/Middle>), and that of </Ball/Low> is 1" in seen.refusal.message
    assert "state the same physics" in seen.refusal.hint


PAINTED = 'float[] primvars:gaussianFlesh:youngsModulus = [1e5] (interpolation = "constant")'
WOODEN = prim(
    "GeomSubset", "Some", 'uniform token elementType = "face"', "int[] indices = [0]",
    'uniform token familyName = "materialBind"', bound("/Ball/Wood"), apis=("MaterialBindingAPI",),
)  # fmt: skip


@pytest.mark.parametrize(
    ("lines", "remedy"),
    [
        ((PAINTED,), "remove the painted values of </Ball/Middle>, </Ball/Low>, </Ball/High>, or"),
        ((WOODEN,), "bind one physics material to all faces of </Ball/Middle>, </Ball/Low>, </"),
    ],
)
def test_the_refusal_of_parts_has_a_remedy_for_its_reason(
    tmp_path: Path, lines: tuple[str, ...], remedy: str
) -> None:
    """It was to state the same physics, which they had."""
    seen = gf_usd.inspect(split_ball(tmp_path, *MATERIALS, low=lines, rest=lines), **SMALL)
    assert seen.refusal is not None
    assert seen.refusal.hint.startswith(remedy)
    assert seen.refusal.hint.endswith("or merge them into one mesh whose common points are welded")


def test_an_animation_that_ends_at_the_start_is_what_to_remove() -> None:
    bodies = tuple(
        BodyPhysics(path=path, owner="/Ball", moving=np.zeros((1, 3)))
        for path in ("/Ball/A", "/Ball/B")
    )
    parts = Parts(StageSpec(physics=StagePhysics(bodies=bodies)))
    both = ("/Ball/A", "/Ball/B")
    assert parts.why_not(both) == "</Ball/A> has an animation that ends at the start"
    assert parts.remedy(both) == "remove the animation before the start of </Ball/A>, </Ball/B>"


def test_flesh_says_that_it_joins_no_meshes(tmp_path: Path) -> None:
    """It listed their holes only."""
    seen = gf_usd.inspect(split_ball(tmp_path, *SLIDING), flesh=True, particles=400)
    assert seen.refusal is not None
    assert "meshes are not joined with flesh" in seen.refusal.message
    assert seen.refusal.hint.startswith("merge them")


def test_flesh_says_which_sheets_a_repair_made_thick(tmp_path: Path) -> None:
    """It said "has 185 points, but 555 points of its surface have to follow them"."""
    seen = gf_usd.inspect(split_ball(tmp_path, *SLIDING), flesh=True, repair=True, particles=400)
    assert seen.refusal is not None
    said = seen.refusal.message
    assert "ball.usda: </Ball/Low>, </Ball/Middle>, </Ball/High>" in said
    assert "are open or thin, and repair=True made them one spacing thick" in said
    assert seen.refusal.hint.startswith("merge meshes that close each other into one")


def test_the_hint_at_sheets_with_flesh_works(tmp_path: Path) -> None:
    ball = sphere(0.5, (0.0, 1.0, 0.0), subdivisions=3)
    path = tmp_path / "ball.usda"
    whole = part("Whole", ball.points, weld(ball.points)[0][ball.triangles])
    path.write_text(head() + prim("Xform", "Ball", *SLIDING, whole), encoding="utf-8")
    assert gf_usd.inspect(path, flesh=True, repair=True, particles=400).refusal is None


def test_a_repair_of_parts_that_are_not_joined_says_so(tmp_path: Path) -> None:
    mass = ("float physics:mass = 1",)
    whole, notes = whole_and_notes(split_ball(tmp_path, low=mass, rest=mass), repair=True)
    assert not whole
    assert "not filled as one body" in notes


def test_a_named_part_is_refused_with_the_parts_that_close_it(tmp_path: Path) -> None:
    """Only its hole was named."""
    ball = split_ball(tmp_path)
    seen = gf_usd.inspect(ball, prims=["/Ball/Low"], **SMALL)
    with pytest.raises(InputError) as raised:
        gf_usd.bake(ball, prims=["/Ball/Low"], output=tmp_path / "out.usda", **SMALL)
    for refusal in (seen.refusal, raised.value):
        assert refusal is not None
        assert refusal.message.endswith(
            "\n</Ball/Low> encloses a volume together with </Ball/Middle>, </Ball/High>"
        )
        assert refusal.hint.startswith("name those meshes as well (prims)")


def test_named_parts_that_are_filled_have_a_note_on_the_part_that_closes_them(
    tmp_path: Path,
) -> None:
    """The note on their hole named no mesh."""
    ball = split_ball(tmp_path)
    two = ["/Ball/Low", "/Ball/Middle"]
    text = (
        "</Ball/Middle>, </Ball/Low> enclose a volume together with </Ball/High>: name those"
        " meshes as well ({}), or a prim above all of them"
    )
    seen = gf_usd.inspect(ball, prims=two, **SMALL)
    assert seen.plan is not None
    assert "is filled despite 1 hole" in "\n".join(seen.plan.notes)
    assert text.format("prims") in seen.plan.notes
    assert text.format("--prim") in prepare(ball, prims=two, particles=400).plan.notes
    for closed in (["/Ball"], [*two, "/Ball/High"]):
        plan = gf_usd.inspect(ball, prims=closed, **SMALL).plan
        assert plan is not None
        assert "together with" not in "\n".join(plan.notes)


def test_only_a_part_with_a_large_hole_has_its_stage_read_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read = []
    monkeypatch.setattr(neighbors, "_neighbors", lambda *_: read.append(1) or iter(()))
    ball = split_ball(tmp_path, borders=(0.52, 1.25))  # a hole of 2 % of the ball
    gf_usd.inspect(ball, prims=["/Ball/Middle", "/Ball/High"], **SMALL)
    assert read == []
    gf_usd.inspect(split_ball(tmp_path), prims=["/Ball/Middle", "/Ball/High"], **SMALL)
    assert read == [1]


TRIANGLE = (
    "int[] faceVertexCounts = [3]",
    "point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]",
)


@pytest.mark.parametrize(
    "other",
    [
        prim("Mesh", "Bad", "int[] faceVertexIndices = [0, 1, 7]", *TRIANGLE),
        prim(
            "Mesh", "Bad", "int[] faceVertexIndices = [0, 1, 2]", *TRIANGLE,
            'uniform token gaussianFlesh:material = "nope"', apis=("GaussianFleshBakeAPI",),
        ),
        prim(
            "Mesh", "Bad", "int[] faceVertexIndices = [0, 1, 2]", *TRIANGLE,
            "float physics:density = -5", apis=("PhysicsMassAPI",),
        ),
        prim(
            "Mesh", "Huge", "int[] faceVertexCounts = [3]", "int[] faceVertexIndices = [0, 1, 2]",
            "point3f[] points = [(0, 0, 0), (1e30, 0, 0), (0, 1e30, 0)]",
        ),
    ],
    ids=["index", "material", "density", "huge"],
)  # fmt: skip
@pytest.mark.parametrize("named", [["/Ball/Low"], ["/Ball/Low", "/Ball/Middle"]])
def test_an_odd_prim_elsewhere_hides_no_part_that_closes_the_named(
    tmp_path: Path, other: str, named: list[str]
) -> None:
    """The meshes were no longer named, without a word."""
    ball = split_ball(tmp_path)
    ball.write_text(ball.read_text(encoding="utf-8") + other, encoding="utf-8")
    seen = gf_usd.inspect(ball, prims=named, **SMALL)
    said = [seen.refusal.message] if seen.refusal else seen.notes
    assert "a volume together with" in "\n".join(said)


def test_an_invalid_density_of_the_part_that_closes_the_named_hides_it_not(tmp_path: Path) -> None:
    ball = split_ball(tmp_path, low=("float physics:density = -5",))
    seen = gf_usd.inspect(ball, prims=["/Ball/Middle", "/Ball/High"], **SMALL)
    assert "enclose a volume together with </Ball/Low>" in "\n".join(seen.notes)


def test_only_meshes_at_the_borders_of_the_named_are_triangulated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The whole stage was read and joined: 2000 other balls took 25 s."""
    far = sphere(0.5, (3.0, 1.0, 0.0), subdivisions=1)
    others = [
        prim("Xform", f"Far{k}", part("Mesh", far.points + (k, 0, 0), far.triangles))
        for k in range(3)
    ]
    ball = split_ball(tmp_path)
    ball.write_text(ball.read_text(encoding="utf-8") + "".join(others), encoding="utf-8")
    read: list[str] = []
    one = asset.read_faces
    monkeypatch.setattr(
        asset, "read_faces", lambda p, *a: (read.append(str(p.GetPath())), one(p, *a))[1]
    )
    seen = gf_usd.inspect(ball, prims=["/Ball/Low"], **SMALL)
    assert seen.refusal is not None
    assert "together with </Ball/Middle>, </Ball/High>" in seen.refusal.message
    assert sorted(read) == ["/Ball/High", "/Ball/Low", "/Ball/Middle"]


@pytest.mark.parametrize("suffix", ["usda", "glb"])
def test_meshes_that_close_the_named_are_found_where_edges_are_divided(
    tmp_path: Path, suffix: str
) -> None:
    file = split_ball(tmp_path, borders=(1.25, 2.0))
    if suffix == "glb":
        ball = sphere(0.5, (0.0, 1.0, 0.0), subdivisions=3)
        T = weld(ball.points)[0][ball.triangles]
        high = ball.points[T].mean(1)[:, 1] > 1.25
        scene = trimesh.Scene()
        for name, which in (("Low", ~high), ("High", high)):
            scene.add_geometry(trimesh.Trimesh(ball.points, T[which]), name, name)
        file = tmp_path / "ball.glb"
        scene.export(str(file))
    every = [s.path for s in read_asset(file).surfaces]
    (named,) = (path for path in every if "Low" in path)
    seen = gf_usd.inspect(file, prims=[named], max_edge_length="0.05", **SMALL)
    said = "\n".join(seen.notes)
    assert "no edge is longer" in said
    assert f"<{named}> encloses a volume together with" in said


def test_parts_that_are_not_joined_are_no_remedy(tmp_path: Path) -> None:
    """They were named, and refused as well; and the error was its own cause."""
    ball = split_ball(tmp_path, low=("float physics:density = 500",))
    with pytest.raises(InputError) as raised:
        gf_usd.bake(ball, prims=["/Ball/Low"], output=tmp_path / "out.usda", **SMALL)
    assert "together with" not in raised.value.message
    assert raised.value.__cause__ is None
