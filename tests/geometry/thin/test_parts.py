"""Parts that the particles do not reach, on bodies made to have them, and none on those without."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from solids import cube, fill, solid, sphere, surface

from gf_usd.geometry.solid import OPEN_FRACTION, hole_fraction
from gf_usd.geometry.thin.parts import FEW, poor_parts, suggestion
from gf_usd.readers import read_asset


def parts_of(*surfaces, particles):
    body = solid(*surfaces)
    return poor_parts(body, *fill(body, particles))


def shells_of(*surfaces, path="/Body"):
    first = np.cumsum([0, *(len(s.points) for s in surfaces)])
    triangles = [s.triangles + o for s, o in zip(surfaces, first)]
    return surface(np.concatenate([s.points for s in surfaces]), np.concatenate(triangles), path)


def hat():
    """A bowl with a brim 0.12 thick, in one shell."""
    profile = [[0, -1], [0.9, -0.5], [1, -0.06], [2.5, -0.06], [2.5, 0.06], [1, 0.06], [0.9, 0.5],
               [0, 1]]  # fmt: skip
    mesh = trimesh.creation.revolve(np.array(profile, float), sections=48)
    mesh.fix_normals()
    return surface(mesh.vertices, mesh.faces, "/Hat")


@pytest.mark.parametrize("particles", [300, 2000, 8000])
@pytest.mark.parametrize("body", [sphere(), cube()], ids=["ball", "box"])
def test_a_body_without_thin_parts_has_none(body, particles):
    assert parts_of(body, particles=particles) == ()


@pytest.mark.parametrize("particles", [2000, 5200, 8000])
def test_the_edges_of_a_divided_box_are_not_thin(tmp_path, particles):
    # Samples are its points, also those on its edges: inward of them is in another face.
    file = tmp_path / "cube.usda"
    file.write_text('#usda 1.0\n(metersPerUnit = 1)\ndef Cube "Cube" {}')
    (box,) = read_asset(file).surfaces
    assert parts_of(box, particles=particles) == ()


def test_a_patch_of_the_skin_that_is_a_shell_of_its_own_is_no_part():
    """A tenth of a ball's surface has its own vertices, 1e-4 off those of the rest."""
    ball = sphere()
    middle = ball.points[ball.triangles].mean(1)
    cap = middle @ np.array([0.6, 0.0, 0.8]) > 0.92 * np.linalg.norm(middle, axis=1).min()
    assert 0.01 < cap.mean() < 0.1
    patch = surface(ball.points * (1.0 + 1e-4), ball.triangles[cap])
    body = shells_of(surface(ball.points, ball.triangles[~cap]), patch)
    assert parts_of(body, particles=2000) == ()


@pytest.mark.slow
def test_shells_thinner_than_a_spacing_are_named():
    plate = cube(low=(3.0, 0.0, 0.04), edge=(0.5, 0.5, 0.001))
    crumb = cube(low=(0.0, 3.0, 0.0), edge=0.08)
    found = parts_of(sphere(path="/Ball"), shells_of(plate, crumb, path="/Bits"), particles=8000)
    assert [(p.path, p.shell) for p in found] == [("/Bits", 0), ("/Bits", 1)]
    assert [p.kind for p in found] == ["thin", "thin"]
    flat, small = found
    assert flat.suggested is None  # a layer in it takes 4e9 particles
    assert flat.particles % FEW == 0  # so many in each cell
    assert flat.thickness == pytest.approx(0.001, rel=0.01)
    np.testing.assert_allclose(flat.center, [3.25, 0.25, 0.0405])
    assert small.particles >= FEW
    # Thickness 2 V / A = edge / 3 of a box bounds the spacing here.
    assert small.suggested == pytest.approx(solid(sphere()).volume / (0.08 / 3.0) ** 3, rel=0.1)
    assert small.speck
    assert not flat.speck
    assert suggestion(found) is None, "specks do not count, and no number fills the plate"


@pytest.mark.parametrize("meshes", [1, 2])
@pytest.mark.parametrize("gap", [0.0, -0.001, 0.01], ids=["touching", "sunk", "above"])
def test_a_plate_on_a_body_is_as_thick_as_without_it(gap, meshes):
    """Rays through it continued through the body."""
    plate = cube(low=(0.2, 0.2, 1.0 + gap), edge=(0.6, 0.6, 0.003), path="/Plate")
    body = (shells_of(cube(), plate),) if meshes == 1 else (cube(), plate)
    (part,) = parts_of(*body, particles=2000)
    assert (part.path, part.shell) == (("/Body", 1) if meshes == 1 else ("/Plate", 0))
    assert part.thickness == pytest.approx(0.003, rel=1e-3)


def test_a_hollow_shell_is_as_thick_as_its_wall():
    """Not as its outer surface is wide."""
    inner = sphere(0.0999)
    hollow = surface(inner.points, inner.triangles[:, ::-1])
    found = parts_of(shells_of(cube(low=(3.0, 0.0, 0.0)), sphere(0.1), hollow), particles=2000)
    assert [part.shell for part in found] == [1]
    assert found[0].thickness == pytest.approx(1e-4, rel=0.05)


@pytest.mark.slow
def test_loose_faces_have_no_thickness():
    """Only the rounding error of their volume."""
    corners = np.array([[0.0, 0.0, 0.0], [0.7, 0.1, 0.2], [0.6, 0.8, 0.3], [-0.1, 0.7, 0.1]])
    flat = surface(corners + [3.1, 0.3, 0.7], np.array([[0, 1, 2], [0, 2, 3], [0, 2, 1]]))
    (loose,) = parts_of(shells_of(sphere(), flat), particles=500)
    assert loose.shell == 1
    assert loose.loose
    sheet = cube(low=(3.0, 0.0, 0.0), edge=(0.5, 0.5, 1e-5))
    (plate,) = parts_of(shells_of(sphere(), sheet), particles=500)
    assert not plate.loose


@pytest.mark.slow  # 66,000 particles
def test_the_suggested_number_fills_the_part():
    crumb = cube(low=(0.0, 3.0, 0.0), edge=0.12, path="/Crumb")
    (found,) = parts_of(sphere(), crumb, particles=8000)
    assert parts_of(sphere(), crumb, particles=found.suggested) == ()


@pytest.mark.slow
def test_a_thin_region_of_a_filled_shell_is_found():
    (brim,) = parts_of(hat(), particles=500)
    assert (brim.path, brim.shell, brim.kind) == ("/Hat", 0, "thin region")
    # By some thousand random points (3 %), and where it ends at the bowl is a spacing's choice.
    assert brim.thickness == pytest.approx(0.12, rel=0.1)
    # The brim runs around from 1 to 2.5; samples lie within two spacings, 0.4, of its rim.
    np.testing.assert_allclose(np.sort(brim.high - brim.low), [0.12, 5.0, 5.0], atol=0.4)
    assert parts_of(hat(), particles=brim.suggested) == ()


def open_can(flange, height=2.0):
    """A can of radius 1 m without a lid, with a flange of a single sheet; lengths in m."""
    profile = [[x, 0.0] for x in np.linspace(0.0, 1.0, 11)]
    profile += [[1.0, y] for y in np.linspace(0.1, height, 20)]
    profile += [[1.0 + flange, height]]
    mesh = trimesh.creation.revolve(np.array(profile), sections=48)
    return surface(mesh.vertices, mesh.faces)


def test_a_region_beside_a_hole_is_not_thin():
    """The fill ends there although there is no other side, and 4600 particles were to fill it."""
    can = open_can(0.2)
    assert 0.2 < hole_fraction(can.points, can.welded.triangles) < OPEN_FRACTION
    assert parts_of(can, particles=2000) == ()


def test_a_wide_sheet_of_an_open_mesh_is_a_part_that_no_number_fills():
    (sheet,) = parts_of(open_can(0.8, 4.0), particles=1000)
    assert (sheet.kind, sheet.suggested, sheet.loose) == ("bare region", None, True)
    assert sheet.size > 2.0


def test_a_thin_region_of_an_open_mesh_is_found():
    """A brim, as that of a hat without a hole."""
    whole = hat()
    middle = whole.points[whole.triangles].mean(1)
    worn = surface(whole.points, whole.triangles[middle[:, 2] > -0.6], "/Hat")
    assert len(worn.welded.boundary)
    (brim,) = parts_of(worn, particles=500)
    assert brim.kind == "thin region"
    assert brim.suggested is not None
    assert brim.size > 5.0


def test_the_end_of_a_spike_is_found():
    # A ball of which one vertex is drawn out to a spike.
    ball = sphere()
    points = ball.points.copy()
    top = int(np.argmax(points[:, 2]))
    points[top] = [0.0, 0.0, 3.0]
    found = parts_of(surface(points, ball.triangles), particles=2000)
    # Cells have particles as long as there is half a percent in them.
    assert found
    assert {spike.kind for spike in found} <= {"thin region", "bare region"}
    # The last sample lies within two spacings, 0.26, of the tip.
    assert 2.74 < max(spike.high[2] for spike in found) <= 3.0
    assert min(spike.low[2] for spike in found) > 1.0


@pytest.mark.slow
def test_a_cavity_is_no_empty_part():
    inner = sphere(radius=0.5)
    hollow = shells_of(sphere(), surface(inner.points, inner.triangles[:, ::-1]))
    assert parts_of(hollow, particles=4000) == ()


@pytest.mark.slow
def test_a_shell_inside_another_shares_its_particles():
    eye = sphere(radius=0.3, center=(0.5, 0.0, 0.0), path="/Eye")
    assert parts_of(sphere(path="/Head"), eye, particles=4000) == ()


@pytest.mark.slow
def test_turned_faces_do_not_look_thin():
    body = sphere()
    triangles = body.triangles.copy()
    triangles[:60] = triangles[:60, ::-1]
    assert parts_of(surface(body.points, triangles), particles=2000) == ()


def test_nothing_is_suggested_where_nothing_is_missing():
    assert suggestion(()) is None


@pytest.mark.parametrize(("radius", "kind"), [(0.02, "few"), (0.002, "few")])
def test_a_rod_is_as_thick_as_its_diameter(radius: float, kind: str) -> None:
    rod = trimesh.creation.cylinder(radius=radius, height=1.0, sections=32)
    rod.apply_translation((3.0, 0.0, 0.0))
    (found,) = parts_of(sphere(), surface(rod.vertices, rod.faces, "/Rod"), particles=500)
    # flat sides of 32 lie between the inner and the outer circle
    assert 2.0 * radius * np.cos(np.pi / 32) * (1.0 - 1e-6) <= found.thickness <= 2.0 * radius
    assert found.wall == pytest.approx(radius, rel=0.05)


def test_the_thickness_of_an_end_of_a_shell_is_its_diameter() -> None:
    # a ball with a spine, of one shell
    profile = [[0.0, -1.0], [1.0, 0.0], [0.03, 0.99], [0.03, 3.0], [0.0, 3.0]]
    mesh = trimesh.creation.revolve(np.array(profile), sections=32)
    mesh.fix_normals()
    found = parts_of(surface(mesh.vertices, mesh.faces, "/Body"), particles=300)
    spine = max(found, key=lambda part: part.high[2])
    assert spine.thickness == pytest.approx(0.06, rel=0.02)


SMALL_CUBE = cube(low=(2.0, 0.0, 0.0), edge=0.1)  # 0.02 % of the volume of the ball


@pytest.mark.parametrize("meshes", [1, 2])
def test_a_speck_apart_from_the_rest_does_not_set_the_number(meshes) -> None:
    """One speck of noise in a scan suggested 270,000 particles."""
    far = surface(SMALL_CUBE.points, SMALL_CUBE.triangles, "/Far")
    body = (shells_of(sphere(), SMALL_CUBE),) if meshes == 1 else (sphere(), far)
    found = parts_of(*body, particles=2000)
    assert [(p.shell, p.speck) for p in found] == [(1 if meshes == 1 else 0, True)]
    assert found[0].suggested is not None
    assert suggestion(found) is None


@pytest.mark.parametrize(
    "other",
    [
        cube(low=(0.98, -0.05, -0.05), edge=0.1),
        cube(low=(1.01, -0.05, -0.05), edge=0.1),
        cube(low=(2.0, 0.0, 0.0), edge=(0.6, 0.05, 0.05)),
        cube(low=(0.88, 0.0, 0.0), edge=(0.3, 0.01, 0.01)),
    ],
    ids=["overlaps", "touches", "long", "pierces"],
)
def test_what_is_near_or_long_is_no_speck(other) -> None:
    found = parts_of(shells_of(sphere(), other), particles=2000)
    assert [p.speck for p in found if p.shell == 1] in ([False], [])
    assert not any(p.speck for p in found)


def test_thin_parts_set_the_number_beside_specks() -> None:
    rod = cube(low=(0.5, -0.1, -0.1), edge=(1.5, 0.05, 0.05))
    alone = parts_of(shells_of(sphere(), rod), particles=2000)
    both = parts_of(shells_of(sphere(), rod, SMALL_CUBE), particles=2000)
    assert [p.shell for p in both if p.speck] == [2]
    assert suggestion(alone) is not None
    assert suggestion(both) == pytest.approx(suggestion(alone), rel=0.1)


def turned(body):
    return surface(body.points, body.triangles[:, ::-1], body.path)


HORN = cube(low=(0.5, -0.1, -0.1), edge=(1.5, 0.05, 0.05), path="/Horn")
EYES = [sphere(0.05, (0.5, y, 0.0), 1, path=f"/Eye{k}") for k, y in enumerate((-0.3, 0.0, 0.3))]


@pytest.mark.parametrize("meshes", [1, 4])
def test_what_is_wholly_inside_another_shell_is_no_part(meshes) -> None:
    """It adds nothing to the solid.  Eyes in a head suggested 68,000 particles for 600."""
    head = sphere(path="/Head")
    body = (shells_of(head, *EYES),) if meshes == 1 else (head, *EYES)
    assert parts_of(*body, particles=600) == ()


def test_loose_faces_inside_a_body_are_no_part() -> None:
    flat = surface(np.array([[0.0, 0, 0], [0.2, 0.1, 0], [0.1, 0.2, 0.1]]), [[0, 1, 2], [0, 2, 1]])
    assert parts_of(shells_of(sphere(), flat), particles=600) == ()


@pytest.mark.slow
def test_what_is_wholly_inside_does_not_set_the_number() -> None:
    alone = parts_of(sphere(path="/Head"), HORN, particles=600)
    both = parts_of(sphere(path="/Head"), HORN, *EYES, particles=600)
    assert [(p.path, p.speck) for p in alone] == [("/Horn", False)]
    assert [(p.path, p.speck) for p in both] == [("/Horn", False)]
    assert suggestion(alone) is not None
    assert suggestion(both) == pytest.approx(suggestion(alone), rel=0.02), "of two digits"


@pytest.mark.parametrize("meshes", [1, 2])
def test_a_hair_whose_tip_is_outside_is_a_part(meshes) -> None:
    hair = cube(low=(0.705, 0.0, 0.0), edge=(0.3, 0.01, 0.01), path="/Hair")
    body = (shells_of(sphere(), hair),) if meshes == 1 else (sphere(), hair)
    (found,) = parts_of(*body, particles=2000)
    assert (found.path, found.shell) == (("/Body", 1) if meshes == 1 else ("/Hair", 0))


@pytest.mark.slow
def test_what_is_in_a_cavity_is_a_part() -> None:
    crumb = sphere(0.05, subdivisions=1)
    (found,) = parts_of(shells_of(sphere(), turned(sphere(0.6)), crumb), particles=2000)
    assert (found.shell, found.speck) == (2, True)


def test_the_walls_of_a_hollow_eye_in_a_head_are_no_part() -> None:
    eye = shells_of(sphere(0.1), turned(sphere(0.0999)), path="/Eye")
    assert parts_of(sphere(path="/Head"), eye, particles=600) == ()


def test_of_two_shells_in_one_place_none_counts_as_inside_the_other() -> None:
    plates = [cube(low=(2.0, 0.0, 0.0), edge=(0.5, 0.5, 0.001), path=f"/P{k}") for k in range(2)]
    found = parts_of(sphere(), *plates, particles=600)
    assert [p.path for p in found] == ["/P0", "/P1"]
