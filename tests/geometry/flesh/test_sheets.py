"""Sheets next to flesh: which meshes are garments, and the motion of skinned sheets."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import solids
import trimesh
from scipy.sparse import csr_matrix

from gf_usd.core.asset import Surface
from gf_usd.core.frames.frame import Pose
from gf_usd.core.stage import Bone, Skeleton
from gf_usd.geometry.flesh import sheets
from gf_usd.geometry.flesh.sheets import REACH, garments, skinned_sheets, thin_sheets

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)


def column(
    path: str, radius: float, low: float, high: float, open_ends: int = 0, top: float | None = None
) -> Surface:
    """A column along y with a radius [m] from `low` to `high`, without the caps of some ends.

    top : [m] radius of its upper end.
    """
    mesh = trimesh.creation.cylinder(radius, segment=((0, low, 0), (0, high, 0)), sections=24)
    mesh = mesh.subdivide_to_size(0.2)
    points, faces = np.array(mesh.vertices), np.array(mesh.faces)
    across = points[faces][:, :, 1]
    ends = [low, high][:open_ends]
    kept = ~np.any([np.isclose(across, end).all(1) for end in ends], axis=0) if ends else ...
    if top is not None:
        share = 1.0 + (top / radius - 1.0) * (points[:, 1:2] - low) / (high - low)
        points[:, [0, 2]] *= share
    return solids.surface(points, faces[kept], path)


def found(*surfaces: Surface, posed: Any = None) -> tuple[str, ...]:
    return garments(solids.solid(*surfaces), posed or [s.path for s in surfaces])


def test_an_open_mesh_that_others_pass_through_is_a_garment() -> None:
    """A skirt was filled around the legs, as a slab, where its holes were less than 25 %."""
    body = column("/body", 0.3, 0.0, 2.0)
    skirt = column("/skirt", 0.4, 0.3, 1.6, open_ends=2)
    assert found(body, skirt) == ("/skirt",)
    assert found(body, skirt, posed={"/body"}) == (), "no skeleton poses it"
    assert found(body, column("/skirt", 0.4, 0.3, 1.6)) == (), "it is closed"


def test_bodies_with_holes_are_no_garments() -> None:
    # a torso that is open at the neck and the waist, a head in its hole, and a shirt around it
    torso = column("/torso", 0.3, -1.0, 1.5, open_ends=2)
    head = column("/head", 0.25, 1.4, 2.2, open_ends=1)
    shirt = column("/shirt", 0.35, 0.2, 1.45, open_ends=2)
    assert found(torso, head, shirt) == ("/shirt",)
    # eyes in a head that is open around them
    eye = column("/eye", 0.08, 1.5, 1.7)
    assert found(head, eye) == ()
    # of a shell around another one nothing but the outer one would be seen
    assert found(torso, column("/core", 0.2, -0.9, 1.4)) == ()


def test_few_points_of_a_body_in_a_band_around_it_are_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sheets, "TESTED", 8)  # about which one would be in the band
    body = column("/body", 0.3, 0.0, 12.0)
    assert found(body, column("/band", 0.4, 5.0, 6.3, open_ends=2)) == ("/band",)


def test_something_is_always_filled() -> None:
    """Two open shells that are in each other, each with most of its points outside the other."""
    across = column("/1", 0.4, -1.2, 1.2, open_ends=2)
    crossed = solids.surface(across.points[:, [1, 0, 2]], across.triangles[:, ::-1], "/0")
    each = [s.path for s in (across, crossed)]
    solid, points = solids.solid(across, crossed), [across.face_points, crossed.face_points]
    assert all(sheets._holds_others(solid.bounds, k, points) for k in (0, 1))
    assert garments(solid, each) == ()


def skeleton(**weights: int) -> Skeleton:
    """Two bones; the second moves by 1 m along x from frame 0 to frame 1, and turns a quarter."""
    still = np.stack([CORNERS, CORNERS])
    turn = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    moved = np.stack([CORNERS, CORNERS @ turn + (1.0, 0.0, 0.0)])
    bones = tuple(
        Bone(name=str(k), segments=np.zeros((0, 2, 3)), free=(), anchors=CORNERS, path=path)
        for k, path in enumerate((still, moved))
    )
    counts = {"body": len(BODY.points), "skirt": len(SKIRT.points)}
    rows = {f"/{name}": np.eye(2)[[bone] * counts[name]] for name, bone in weights.items()}
    return Skeleton(bones=bones, weights={path: csr_matrix(w) for path, w in rows.items()})


BODY = column("/body", 0.3, 0.0, 2.0)
SKIRT = column("/skirt", 0.3, 0.0, 2.0, open_ends=2, top=2.0)  # touches the body at its lower end


def test_a_sheet_follows_its_skinned_pose_and_the_flesh_near_it() -> None:
    solid = solids.solid(BODY)
    sheet = skinned_sheets([BODY, SKIRT], solid, skeleton(body=0, skirt=1))["/skirt"]
    X = SKIRT.points
    size = float(np.linalg.norm(solid.high - solid.low))
    far, touching = (np.linalg.norm(X - sheet.near, axis=1) >= REACH * size), X[:, 1] == 0.0
    assert far.any()
    assert touching.any()
    # the flesh is 0.1 m from its skinned pose, in z
    away = np.array([0.0, 0.0, 0.1])
    n = len(X)
    F = np.tile(1.1 * np.eye(3), (n, 1, 1))
    near = Pose(x=sheet.near + away, v=np.tile(2.0 * away, (n, 1)), F=F)
    pose = sheet.pose(near, 1, 0.5)
    skinned = np.stack([1.0 - X[:, 1], X[:, 0], X[:, 2]], 1)
    np.testing.assert_allclose(pose.x[far], skinned[far], atol=1e-12)
    np.testing.assert_allclose(pose.x[touching], (skinned + away)[touching], atol=1e-9)
    between = (pose.x - skinned)[~far]
    assert (np.abs(between[:, :2]) < 1e-9).all()
    assert (between[:, 2] <= 0.1 + 1e-9).all()
    rate = (skinned - X) / 0.5  # one-sided at the last frame
    np.testing.assert_allclose(pose.v[far], rate[far], atol=1e-9)
    np.testing.assert_allclose(pose.v[touching], (rate + 2.0 * away)[touching], atol=1e-9)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(pose.F[far], np.tile(turn, (far.sum(), 1, 1)), atol=1e-12)
    np.testing.assert_allclose(pose.F[touching][0], turn + 0.1 * np.eye(3), atol=1e-9)


def test_rates_of_skinned_points_are_exact_for_a_constant_velocity() -> None:
    """At the last frame the rate was half of it."""
    offset = np.arange(4.0)[:, None, None] * (0.0, 0.0, 0.3)
    X, linear = np.zeros((1, 3)), np.tile(np.eye(3), (4, 1, 1, 1))
    skin = sheets.Skinning(X=X, weights=csr_matrix([[1.0]]), linear=linear, offset=offset)
    rates = [skin.rate(frame, 0.1)[0] for frame in range(4)]
    np.testing.assert_allclose(rates, np.tile((0.0, 0.0, 3.0), (4, 1)))
    assert not skin.rate(5, 0.1).any(), "it stays after the last frame"


def test_a_sheet_next_to_flesh_without_weights_follows_its_skinned_pose() -> None:
    """It was thrown to the origin: without weights the skinned pose of the flesh was 0."""
    sheet = column("/skirt", 0.35, 0.4, 1.9, open_ends=2)
    solid, both = solids.solid(BODY), skeleton(body=0)
    partly = np.eye(2)[[0] * len(BODY.points)]
    partly[BODY.points[:, 1] > 1.0] = 0.0
    weights = {
        "/body": csr_matrix(partly),
        "/skirt": csr_matrix(np.eye(2)[[0] * len(sheet.points)]),
    }
    made = skinned_sheets([sheet], solid, Skeleton(bones=both.bones, weights=weights))["/skirt"]
    np.testing.assert_allclose(np.asarray(made.flesh.weights.sum(1)).max(), 1.0)
    n, away = len(sheet.points), np.array([0.0, 0.0, 0.1])
    F = np.tile(np.eye(3), (n, 1, 1))
    low, high = sheet.points[:, 1] < 0.7, sheet.points[:, 1] > 1.5
    for frame in (0, 1):
        pose = made.pose(Pose(x=made.near + away, v=np.zeros((n, 3)), F=F), frame, 0.5)
        moved = pose.x - sheet.points
        np.testing.assert_allclose(moved[high], 0.0, atol=1e-9)
        assert (moved[low, 2] > 0.05).all()
        # between points with weights and others it moves by a share
        assert np.abs(moved[:, :2]).max() < 1e-9
        assert (np.abs(moved[:, 2]) <= 0.1 + 1e-9).all()
        np.testing.assert_allclose(pose.F, F, atol=1e-9)


def test_only_meshes_that_are_skinned_and_free_are_sheets() -> None:
    solid = solids.solid(BODY)
    assert skinned_sheets([BODY, SKIRT], solid, skeleton(body=0)) == {}
    both = skeleton(body=0, skirt=1)
    assert skinned_sheets([BODY, SKIRT], solid, both, taken={"/skirt"}) == {}
    assert skinned_sheets([BODY, SKIRT], solid, skeleton(skirt=1)) == {}, "no flesh is posed"
    none = {**both.weights, "/skirt": csr_matrix(both.weights["/skirt"].shape)}
    unbound = Skeleton(bones=both.bones, weights=none)
    assert skinned_sheets([BODY, SKIRT], solid, unbound) == {}, "no point has a bone"


def test_a_point_without_a_bone_takes_the_weights_of_the_nearest_one() -> None:
    """For one such point the whole mesh moved with the nearest flesh."""
    both = skeleton(body=0, skirt=1)
    partly = both.weights["/skirt"].tolil()
    y = SKIRT.points[:, 1]
    partly[y < 1.0] = (1.0, 0.0)
    whole = csr_matrix(partly)
    rows = [int(y.argmin()), int(y.argmax())]
    partly[rows] = 0.0
    weights = {**both.weights, "/skirt": csr_matrix(partly)}
    loose = Skeleton(bones=both.bones, weights=weights)
    sheet = skinned_sheets([BODY, SKIRT], solids.solid(BODY), loose)["/skirt"]
    assert sheet.unbound == 2
    np.testing.assert_array_equal(sheet.skin.weights.toarray(), whole.toarray())


def test_points_inside_the_flesh_move_as_it_does_there() -> None:
    inner = column("/skirt", 0.1, 0.5, 1.5, open_ends=2)
    both = skeleton(body=1)
    weights = {**both.weights, "/skirt": csr_matrix(np.eye(2)[[1] * len(inner.points)])}
    made = skinned_sheets(
        [BODY, inner], solids.solid(BODY), Skeleton(bones=both.bones, weights=weights)
    )
    sheet = made["/skirt"]
    np.testing.assert_array_equal(sheet.near, inner.points)
    n = len(inner.points)
    wanted = Pose(x=inner.points + 3.0, v=np.ones((n, 3)), F=np.tile(np.eye(3), (n, 1, 1)))
    pose = sheet.pose(wanted, 1, 0.5)
    np.testing.assert_allclose(pose.x, wanted.x, atol=1e-9)
    assert pose.v[:, 2] == pytest.approx(1.0)


def wall(path: str, thickness: float) -> Surface:
    """A closed wall around the body, as thick as given [m]."""
    mesh = trimesh.creation.annulus(0.45 - thickness, 0.45, height=1.0)
    turned = np.array(mesh.vertices)[:, [0, 2, 1]] * (1.0, 1.0, -1.0) + (0.0, 1.0, 0.0)
    return solids.surface(turned, np.array(mesh.faces), path)


def test_a_bone_through_the_wall_of_a_jacket_is_not_in_it() -> None:
    """A sixth of the short bone from the chest to the arm was, and the thin jacket was filled."""
    skirt = wall("/skirt", 0.02)
    ways = np.array([[[0.0, 0.2, 0.0], [0.0, 1.8, 0.0]], [[0.38, 1.0, 0.0], [0.5, 1.0, 0.0]]])
    bone = Bone(name="0", segments=ways, free=(False, False), anchors=CORNERS, path=CORNERS[None])
    weights = {s.path: csr_matrix(np.tile([0.5, 0.5], (len(s.points), 1))) for s in (BODY, skirt)}
    skeleton = Skeleton(bones=(bone, bone), weights=weights)
    assert list(thin_sheets(solids.solid(BODY, skirt), skeleton, spacing=0.05)) == ["/skirt"]


@pytest.mark.parametrize(
    ("thickness", "joints", "bone", "thin"),
    [
        (0.02, 2, True, True),
        (0.2, 2, True, False),  # thicker than the particles are apart
        (0.02, 1, True, False),  # of one joint: rigid
        (0.02, 2, False, False),  # nothing else would hold it
    ],
)
def test_closed_sheets_thinner_than_the_particles_are_apart_are_sheets(
    thickness: float, joints: int, bone: bool, thin: bool
) -> None:
    """A solidified skirt hung from its rim as a slab of jelly."""
    skirt = wall("/skirt", thickness)
    way = np.array([[[0.0, 0.2, 0.0], [0.0, 1.8, 0.0]]]) if bone else np.zeros((0, 2, 3))
    given = {"segments": way, "free": (False,) * len(way), "anchors": CORNERS}
    bones = tuple(Bone(name=str(k), path=CORNERS[None], **given) for k in range(2))
    row = [0.5, 0.5] if joints == 2 else [1.0, 0.0]
    weights = {
        "/body": csr_matrix(np.tile([0.5, 0.5], (len(BODY.points), 1))),
        "/skirt": csr_matrix(np.tile(row, (len(skirt.points), 1))),
    }
    found = thin_sheets(
        solids.solid(BODY, skirt), Skeleton(bones=bones, weights=weights), spacing=0.05
    )
    assert list(found) == (["/skirt"] if thin else [])
    if thin:
        assert found["/skirt"] == pytest.approx(thickness, rel=0.05)


def test_mirrored_pads_are_as_thick_as_each_of_them() -> None:
    """The volumes of a left pad and its mirror image, which was inside out, canceled."""
    pad = solids.sphere(0.25, (1.0, 1.0, 0.0))
    mirrored = solids.surface(pad.points * (-1.0, 1.0, 1.0), pad.triangles)
    pads = solids.joined(pad, mirrored)
    half = {"segments": np.array([[[0.0, 0.2, 0.0], [0.0, 1.8, 0.0]]]), "free": (False,)}
    bones = tuple(Bone(name=str(k), anchors=CORNERS, path=CORNERS[None], **half) for k in range(2))
    weights = {
        path: csr_matrix(np.full((count, 2), 0.5))
        for path, count in (("/body", len(BODY.points)), ("/pads", len(pads.points)))
    }
    solid = solids.solid(BODY, replace(pads, path="/pads"))
    assert thin_sheets(solid, Skeleton(bones=bones, weights=weights), spacing=0.05) == {}
