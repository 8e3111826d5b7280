"""`gf_usd.read`: what the file holds, in SI, against what the solver gave."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

import gf_usd
from gf_usd.layers.tracks.health import FLOW, FRAME

SPHERE = Path(__file__).parents[2] / "samples" / "sphere.usda"
FRAMES = 4


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> gf_usd.BakeResult:
    # metersPerUnit given: meters in the file are another number
    return gf_usd.bake(
        SPHERE, material=["rubber", "clay"], particles=200, frames=FRAMES, drop=0.5,
        meters_per_unit=0.1, deformation_gradients=True, stress=True, internal=True,
        output=tmp_path_factory.mktemp("read"),
    )  # fmt: skip


@pytest.fixture
def bake(result: gf_usd.BakeResult) -> gf_usd.Bake:
    return gf_usd.read(result.root)


def test_it_is_a_sequence_of_frames(result: gf_usd.BakeResult, bake: gf_usd.Bake) -> None:
    assert (len(bake), bake.particles, bake.variant) == (FRAMES, result.particles, "rubber")
    assert bake.variants == ("clay", "rubber")
    assert [frame.index for frame in bake] == list(range(FRAMES))
    assert repr(bake[0]) == f"BakeFrame(index=0, time_code={bake.time_codes[0]:g})"
    assert [frame.time_code for frame in bake[1:]] == list(bake.time_codes[1:])
    assert bake[-1].index == FRAMES - 1
    assert bake[1].time == pytest.approx(1.0 / result.settings.fps)
    with pytest.raises(IndexError, match="has 4 frames but no frame 4"):
        bake[FRAMES]


def test_the_first_frame_is_the_rest_pose_lifted(
    result: gf_usd.BakeResult, bake: gf_usd.Bake
) -> None:
    lift = np.array(result.settings.lift)
    # single precision of positions of about a meter in the file
    moved = bake[0].positions - bake.rest["positions"]
    assert np.allclose(moved, lift, atol=1e-6)
    first = bake[0].F
    assert first is not None
    assert np.allclose(first, np.eye(3), atol=1e-6)


def test_velocities_are_the_rate_of_positions(bake: gf_usd.Bake) -> None:
    """In free fall from rest x(t) = x0 + v t / 2 exactly: the mean of both ends' velocities."""
    one, two = bake[1], bake[2]
    mean = 0.5 * (one.velocities + two.velocities)
    moved = two.positions - one.positions
    assert np.allclose(moved, mean * (two.time - one.time), atol=1e-6)


def test_totals_are_those_of_the_bake(result: gf_usd.BakeResult, bake: gf_usd.Bake) -> None:
    rows = result.bakes[0].per_frame
    rest = bake.rest
    assert rest["masses"].sum() == pytest.approx(rows[0]["mass"], rel=1e-5)
    assert set(bake.health) >= {field for _, field, _ in FRAME.values()}
    for name, values in bake.health.items():
        expected = np.array([row[name] for row in rows])
        assert np.allclose(values, expected, rtol=1e-5, atol=1e-12), name
    center = rest["masses"] @ bake[2].positions / rest["masses"].sum()
    assert np.allclose(center, bake.health["center"][2], atol=1e-5)


def test_the_health_has_the_names_of_its_fields() -> None:
    known = {field.name for field in fields(gf_usd.Health)}
    assert {field for _, field, _ in (FRAME | FLOW).values()} <= known


def test_gaussians_stress_and_memory(result: gf_usd.BakeResult) -> None:
    bake = gf_usd.read(result.root, variant="clay")
    last = bake[-1]
    sigma, stress = last.covariances, last.stress
    assert sigma is not None
    assert stress is not None
    assert np.allclose(sigma, sigma.transpose(0, 2, 1))
    assert (np.linalg.eigvalsh(sigma) > 0.0).all()
    assert stress.shape == last.internal["plastic_strain"].shape == (bake.particles,)
    assert "plastic_dissipation" in bake.health


def test_meshes_are_in_meters(result: gf_usd.BakeResult, bake: gf_usd.Bake) -> None:
    ((path, points),) = bake[0].meshes.items()
    counts, indices = bake.faces(path)
    assert counts.sum() == len(indices)
    assert indices.max() == len(points) - 1
    # the particles fill the mesh, from within
    inside = bake[0].positions
    assert (inside.min(0) > points.min(0) - 1e-6).all()
    assert (inside.max(0) < points.max(0) + 1e-6).all()


def test_faces_of_no_mesh_are_refused(bake: gf_usd.Bake) -> None:
    with pytest.raises(gf_usd.UsageError, match="no mesh '/x' is baked") as caught:
        bake.faces("/x")
    assert next(iter(bake[0].meshes)) in caught.value.hint


def test_what_cannot_be_read_is_said(result: gf_usd.BakeResult, tmp_path: Path) -> None:
    with pytest.raises(gf_usd.InputError, match="the file contains no bake by gf-usd"):
        gf_usd.read(SPHERE)
    with pytest.raises(gf_usd.InputError, match="does not exist"):
        gf_usd.read(tmp_path / "nope.usda")
    with pytest.raises(gf_usd.UsageError, match="has no variant 'jelly'"):
        gf_usd.read(result.root, variant="jelly")
    with pytest.raises(gf_usd.UsageError, match="the asset is 3"):
        gf_usd.read(3)  # pyright: ignore[reportArgumentType]
