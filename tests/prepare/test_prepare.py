"""What an inspection says of sound, odd and broken assets, and that a bake says the same."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from solids import CUBE_POINTS, CUBE_TRIANGLES, sphere

from gf_usd.core.errors import InputError, UsageError
from gf_usd.geometry.solid import build_solid
from gf_usd.pipeline.inspect import inspect
from gf_usd.pipeline.prepared import prepare
from gf_usd.prepare.prepare import poor_parts_of

SAMPLES = Path(__file__).parents[2] / "samples"
DUCK = SAMPLES / "duck.usda"
FEW = {"particles": 400, "frames": 3}


def mesh(name: str, points, faces) -> str:
    """A Mesh prim as text."""
    counts = [len(face) for face in faces]
    corners = [int(i) for face in faces for i in face]
    values = ", ".join(f"({x:.9g}, {y:.9g}, {z:.9g})" for x, y, z in np.asarray(points, float))
    return f"""
    def Mesh "{name}"
    {{
        int[] faceVertexCounts = {counts}
        int[] faceVertexIndices = {corners}
        point3f[] points = [{values}]
        uniform token subdivisionScheme = "none"
    }}
"""


def ball(name="Ball", radius=1.0, center=(0.0, 0.0, 0.0), rows=slice(None)) -> str:
    body = sphere(radius, center, subdivisions=2)
    return mesh(name, body.points, body.triangles[rows])


@pytest.fixture
def stage(tmp_path):
    """Writes a stage of these prims and returns its path."""

    def write(*prims, unit: float | None = 1.0, axis: str | None = "Y") -> Path:
        metadata = [f"metersPerUnit = {unit}"] if unit else []
        metadata += [f'upAxis = "{axis}"'] if axis else []
        path = tmp_path / "asset.usda"
        path.write_text(
            "#usda 1.0\n(\n" + "\n".join(['defaultPrim = "Root"', *metadata])
            + '\n)\ndef Xform "Root"\n{' + "".join(prims) + "}\n",
            encoding="utf-8",
        )  # fmt: skip
        return path

    return write


CLOTH = mesh("Cloth", [[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]], [[0, 1, 2, 3]])


@pytest.mark.slow
def test_a_sample_is_bakeable_and_its_numbers_are_those_of_the_plan(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    seen = inspect(DUCK, **FEW)
    prepared = prepare(DUCK, **FEW)
    plan = prepared.plan
    assert seen.refusal is None
    assert seen.warnings == ()
    out = seen.as_json()
    assert out["bakeable"] is True
    assert out["units"]["meters_per_unit_from"] == "file"
    (body,) = out["meshes"]
    assert (body["fill"], body["watertight"], body["quads"]) == ("filled", True, 3488)
    assert out["body"]["particles"] == len(plan.particles)
    assert out["body"]["volume_m3"] == pytest.approx(body["volume_m3"])
    across = out["body"]["thickness_5_percent"] / out["body"]["spacing"]
    assert out["body"]["particles_across"] == pytest.approx(across)
    assert 0.0 < out["body"]["thickness_5_percent"] < out["body"]["thickness_median"]
    assert out["body"]["thickness_median"] < max(out["size"])
    assert out["materials"][0]["substeps_per_frame"] == prepared.solvers.substeps(plan.variants[0])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_the_json_is_json_and_has_every_documented_key():
    out = json.loads(json.dumps(inspect(DUCK, **FEW).as_json()))
    from gf_usd.pipeline import inspect as inspection

    documented = inspection.__doc__ or ""
    for key in out:
        assert key in documented
    for group in ("units", "time", "body"):
        for key in out[group]:
            assert key in documented
    for row in (*out["meshes"], *out["meshes"][0]["shells"], *out["materials"]):
        for key in row:
            assert key in documented


@pytest.mark.slow
def test_each_material_has_its_cost():
    # requested one by one: of two with one law the second finds its kernels loaded
    rubber, metal = (
        inspect(DUCK, material=name, **FEW).as_json()["materials"][0]
        for name in ("rubber", "metal")
    )
    assert (rubber["name"], metal["name"]) == ("rubber", "metal")
    assert metal["substeps_per_frame"] > rubber["substeps_per_frame"]
    assert metal["moving_seconds"] > rubber["moving_seconds"]
    assert metal["disk_bytes"] == rubber["disk_bytes"] > 0
    assert metal["memory_bytes"] == rubber["memory_bytes"] > 0


def test_cloth_is_refused_in_the_words_of_bake(stage, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = stage(CLOTH)
    seen = inspect(path)
    with pytest.raises(InputError) as refused:
        prepare(path)
    assert isinstance(seen.refusal, InputError)
    assert str(seen.refusal) == str(refused.value)
    assert "</Root/Cloth>: the surface is open" in str(seen.refusal)
    out = seen.as_json()
    assert (out["bakeable"], out["body"], out["materials"]) == (False, None, [])
    assert out["refusal"]["message"] == refused.value.message
    assert out["meshes"][0]["fill"] == "refused"
    assert seen.warnings == ("it can be baked with --repair",)
    mended = inspect(path, repair=True, **FEW).as_json()
    assert mended["bakeable"] is True
    repairs = mended["meshes"][0]["repairs"]
    assert (repairs["thickened"], repairs["thickness"]) == (
        1,
        pytest.approx(0.97 * mended["body"]["spacing"], rel=0.1),
    )


def test_cloth_on_a_body_is_embedded_and_a_note_says_why(stage):
    seen = inspect(stage(CLOTH, ball()), **FEW)
    fill = {m["path"]: (m["fill"], m["reason"]) for m in seen.as_json()["meshes"]}
    assert fill["/Root/Ball"] == ("filled", "")
    assert fill["/Root/Cloth"][0] == "rides along"
    assert "4 boundary edges" in fill["/Root/Cloth"][1]


def test_a_file_that_cannot_be_read_is_an_error(tmp_path, stage):
    with pytest.raises(InputError, match="does not exist"):
        inspect(tmp_path / "nothing.usda")
    with pytest.raises(InputError, match="no mesh was found"):
        inspect(stage())
    with pytest.raises(UsageError, match="no option 'particle'"):
        inspect(DUCK, particle=3)


@pytest.mark.slow
def test_what_the_fill_tolerates_is_said_and_what_repair_did(stage, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = stage(ball(rows=slice(3, None)))
    assert any("despite" in note and "--repair" in note for note in prepare(path, **FEW).plan.notes)
    plan = prepare(path, repair=True, **FEW).plan
    assert not any("despite" in note for note in plan.notes)
    assert any("</Root/Ball> repaired for the fill: closed" in note for note in plan.notes)
    seen = inspect(path, repair=True, **FEW)
    (row,) = seen.as_json()["meshes"]
    assert row["repairs"]["holes_closed"] >= 1
    # The page shows the mesh as it came; the repairs stand next to it.
    assert row["watertight"] is False


@pytest.mark.slow
def test_repair_leaves_the_skin_as_it_is(stage, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = stage(ball(rows=slice(3, None)))
    plain, mended = (prepare(path, repair=r, **FEW).plan.asset.surfaces[0] for r in (False, True))
    assert len(mended.triangles) > len(plain.triangles)
    np.testing.assert_array_equal(mended.points, plain.points)
    np.testing.assert_array_equal(mended.face_indices, plain.face_indices)


def test_a_refusal_that_repair_would_lift_says_so(stage):
    body = sphere(subdivisions=2)
    twice = np.concatenate([body.triangles, body.triangles[:, ::-1]])
    path = stage(mesh("Ball", body.points, twice))
    seen = inspect(path, **FEW)
    assert "flat" in str(seen.refusal)
    assert seen.warnings == ("it can be baked with --repair",)
    assert inspect(path, repair=True, **FEW).refusal is None


@pytest.mark.slow
def test_a_fill_that_faults_have_hollowed_out_is_warned_of(stage):
    """Two balls of one mesh that overlap, one inside out: where both are they cancel."""
    body = sphere(subdivisions=2)
    points = np.concatenate([body.points, 0.8 * body.points + [0.8, 0.0, 0.0]])
    faces = np.concatenate([body.triangles, body.triangles[:, ::-1] + len(body.points)])
    path = stage(mesh("Ball", points, faces))
    (warning,) = inspect(path, **FEW).warnings
    assert warning.startswith("only ")
    assert warning.endswith("try --repair")
    mended = inspect(path, repair=True, **FEW)
    assert mended.warnings == ()
    # A geodesic ball of 320 triangles holds 0.95 of the round one's volume; both share a lens.
    lens = np.pi * (0.64 + 1.6 * 1.8 - 3.0 * 0.04) / 9.6
    union = 4.0 / 3.0 * np.pi * (1.0 + 0.512) - lens
    assert mended.as_json()["body"]["volume_m3"] == pytest.approx(0.95 * union, rel=0.03)


@pytest.mark.slow
def test_meshes_inside_others_are_no_lost_volume(stage):
    """A faulty ball in a ball: the inner one is filled by the outer one already."""
    ball = sphere(subdivisions=2)
    inner = mesh("Core", 0.9 * ball.points, ball.triangles[:-1])  # lacks a face
    seen = inspect(stage(mesh("Ball", ball.points, ball.triangles) + inner), **FEW)
    assert seen.warnings == ()
    assert not any("try --repair" in note for note in seen.notes)
    assert any("filled despite 1 hole" in note for note in seen.notes)


@pytest.mark.parametrize(
    ("radius", "unit", "message"),
    [
        (56.0, 1.0, "with --meters-per-unit 0.01 it would be 1.12 m"),
        (1.0, 1.0, ""),
        (0.5, 0.01, ""),  # a small thing, and somebody wrote the unit down
        (0.5, None, "with --meters-per-unit 1 it would be 1 m"),  # nobody did
        (0.4, 0.001, "with --meters-per-unit 1 it would be 0.8 m"),
        (1e6, 1.0, "check its unit (--meters-per-unit)"),
    ],
)
def test_sizes_that_no_one_means(stage, radius, unit, message):
    warnings = inspect(stage(ball(radius=radius), unit=unit), **FEW).warnings
    assert len(warnings) == bool(message)
    assert not message or warnings[0].endswith(message)


@pytest.mark.parametrize("stray", [(0.0, -8.0, 0.0), (40.0, 1.0, 0.0)], ids=["below", "beside"])
def test_points_of_no_face_change_nothing(stage, tmp_path, monkeypatch, stray):
    """Points that exporters leave behind made a body fall from as high as they lie below it."""
    monkeypatch.chdir(tmp_path)
    body = sphere(1.0, (0.0, 1.0, 0.0), subdivisions=2)
    plain, odd = (
        prepare(stage(mesh("Ball", points, body.triangles)), **FEW, material="jelly").plan
        for points in (body.points, [*body.points, stray])
    )
    assert len(odd.asset.surfaces[0].points) == len(body.points) + 1  # it still moves with the body
    assert (odd.settings.lift, odd.odd, odd.notes) == (plain.settings.lift, "", plain.notes)
    assert np.allclose(odd.particles.X, plain.particles.X)


def test_what_many_prims_have_in_common_is_one_note(stage, tmp_path, monkeypatch):
    """A bush of forty leaves, with proxies, had eighty notes."""
    monkeypatch.chdir(tmp_path)

    def leaves(count):
        quad = [[0, 2, 0], [0.1, 2, 0], [0.1, 2, 0.1], [0, 2, 0.1]]
        return [mesh(f"Leaf{k}", quad, [[0, 1, 2, 3]]) for k in range(count)]

    def proxies(count):
        shown = 'uniform token purpose = "proxy"\n'
        return [ball(f"Proxy{k}").replace("{\n", "{\n" + shown, 1) for k in range(count)]

    def notes(count):
        return prepare(stage(ball(), *leaves(count), *proxies(count)), **FEW).plan.notes

    filled, baked = (note for note in notes(5) if " not " in note)
    assert filled.startswith("</Root/Leaf0> and 4 more are not filled: they move with")
    assert baked.startswith("</Root/Proxy0> and 4 more are not baked: purpose proxy; it keeps")
    assert "usdview" in baked
    (leaf, other, proxy, last) = (note for note in notes(2) if " not " in note)
    assert leaf.startswith("</Root/Leaf0> is not filled: it moves with")
    assert other.startswith("</Root/Leaf1> is not")
    assert proxy.startswith("</Root/Proxy0> is not baked: purpose proxy;")
    assert last.startswith("</Root/Proxy1> is not")


def test_the_suggested_unit_removes_the_warning(stage):
    path = stage(ball(radius=56.0))
    seen = inspect(path, meters_per_unit=0.01, **FEW)
    assert seen.warnings == ()
    out = seen.as_json()
    assert out["units"]["meters_per_unit_from"] == "option"
    assert out["size"] == pytest.approx([1.12] * 3, rel=0.02)


def test_assumed_units_and_axis_are_distinguished_from_authored_ones(stage):
    units = inspect(stage(ball(), unit=None, axis=None), **FEW).as_json()["units"]
    assert (units["meters_per_unit"], units["meters_per_unit_from"]) == (0.01, "assumed")
    assert (units["up_axis"], units["up_axis_from"]) == ("Y", "assumed")


def test_parts_without_particles_are_named(stage):
    plate = mesh("Plate", [4, 0, 0] + CUBE_POINTS * [1.0, 1.0, 0.001], CUBE_TRIANGLES)
    out = inspect(stage(ball(), plate), particles=1000, frames=3).as_json()
    (part,) = out["parts"]
    assert (part["path"], part["shell"]) == ("/Root/Plate", 0)
    # 1 mm of wall at 16 cm spacing: a twentieth of a full cell's particles, merged by lots.
    assert part["kind"] in ("few", "thin")
    assert part["thickness"] == pytest.approx(0.001, rel=0.01)
    assert out["suggested_particles"] is None
    assert part["suggested_particles"] is None


@pytest.mark.slow
@pytest.mark.parametrize("particles", [1000, pytest.param(100_000, marks=pytest.mark.acceptance)])
def test_memory_is_estimated_within_a_factor_of_two(tmp_path, particles):
    sizes = {"particles": particles, "frames": 2}
    expected = inspect(DUCK, **sizes).as_json()["materials"][0]["memory_bytes"]
    # VmHWM is of this program alone; ru_maxrss includes the process that was forked for it
    script = (
        "import pathlib, re, gf_usd\n"
        f"gf_usd.bake({str(DUCK)!r}, **{sizes})\n"
        "status = pathlib.Path('/proc/self/status').read_text()\n"
        "print(re.search(r'VmHWM:\\s*(\\d+)', status)[1])"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    measured = 1024 * int(done.stdout.split()[-1])
    assert 0.5 < expected / measured < 2.0


def rod(radius: float) -> str:
    body = trimesh.creation.cylinder(radius=radius, height=2.0, sections=12)
    return mesh("Rod", body.vertices + [0.0, 0.0, 1.5], body.faces)


def test_a_bake_names_thin_parts_as_an_inspection_does(stage):
    """It was silent about them."""
    path = stage(ball(), rod(0.05))
    needed = inspect(path, **FEW).as_json()["suggested_particles"]
    (note,) = [one for one in prepare(path, **FEW).plan.notes if "few particles or none" in one]
    assert note.startswith("1 part contains")
    assert f"; --particles {needed} would fill it and take up to " in note
    assert " times as long (shell 0 of </Root/Rod>, 2 m large" in note


def test_a_bake_names_no_thin_parts_where_there_are_none(stage):
    path = stage(ball(), rod(0.5))
    assert not any("few particles" in one for one in prepare(path, **FEW).plan.notes)


def test_nothing_is_too_stiff_where_all_flows(stage):
    path = stage(ball(), rod(0.05))
    notes = prepare(path, material="water", **FEW).plan.notes
    assert not any("few particles" in one for one in notes)
    assert inspect(path, material="water", **FEW).parts == (), "it listed what a bake does not"


def test_only_what_is_solid_is_too_stiff_next_to_what_flows(stage):
    thin = trimesh.creation.cylinder(radius=0.15, height=2.0, sections=12)
    thin.apply_translation([5.0, 0.0, 1.5])
    path = stage(ball(), rod(0.05), mesh("Wet", thin.vertices, thin.faces))
    held = FEW | {"material_boxes": ("honey:4,-1,0,6,1,3",)}
    assert {p.path for p in inspect(path, **FEW).parts} == {"/Root/Rod", "/Root/Wet"}
    assert {p.path for p in inspect(path, **held).parts} == {"/Root/Rod"}


@pytest.mark.parametrize("option", ["rigid", "pins"])
def test_what_does_not_deform_is_not_too_stiff(stage, option):
    path = stage(ball(), rod(0.05))
    held = FEW | {option: ("/Root/Rod",)}
    assert not any("few particles" in one for one in prepare(path, **held).plan.notes)
    assert inspect(path, **held).parts == ()


def test_what_a_pin_holds_in_part_or_along_some_axes_may_be_too_stiff(stage):
    path = stage(ball(), rod(0.05))
    upper = ("box:-1,-1,1,1,1,3",)
    assert len(inspect(path, pins=upper, **FEW).parts) == 1
    plan = prepare(path, pins=("/Root/Rod",), **FEW).plan
    solid = build_solid(plan.asset)
    assert poor_parts_of(plan, solid) == ()
    free = replace(plan, pins=(replace(plan.pins[0], axes=(True, False, True)),))
    assert len(poor_parts_of(free, solid)) == 1


def test_a_thin_part_beside_a_pinned_one_may_be_too_stiff(stage):
    other = trimesh.creation.cylinder(radius=0.05, height=2.0, sections=12)
    other.apply_translation([0.1, 0.0, 1.5])
    path = stage(ball(), rod(0.05), mesh("Free", other.vertices, other.faces))
    assert [p.path for p in inspect(path, rigid=("/Root/Rod",), **FEW).parts] == ["/Root/Free"]
