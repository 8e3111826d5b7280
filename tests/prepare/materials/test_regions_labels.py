"""Presets for captured Gaussians of a label."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import captures
import numpy as np
import pytest
from physics_stages import mesh
from planned import noted, plan_fixture, table  # noqa: F401
from pxr import Sdf, Usd, UsdGeom, Vt

from gf_usd.core.asset import Splats
from gf_usd.core.errors import InputError, UsageError
from gf_usd.pipeline.inspect import inspect
from gf_usd.pipeline.prepared import prepare
from gf_usd.prepare.options.request import Request

FEW = {"particles": 300, "frames": 2, "material": "jelly"}


def halves() -> Splats:
    """A ball whose Gaussians say 3 where x > 0, 7 elsewhere."""
    ball = captures.ball()
    return replace(ball, labels={"label": np.where(ball.positions[:, 0] > 0.0, 3, 7)})


def labeled_ply(path: Path, kind: str = "int") -> Path:
    """`halves` as a 3DGS PLY file with a column more."""
    ball = halves()
    captures.write_ply(path, ball)
    head, body = path.read_bytes().split(b"end_header\n", 1)
    rows = np.frombuffer(body, "<f4").reshape(len(ball), -1)
    column = ball.labels["label"].astype({"int": "<i4", "float": "<f4", "uchar": "u1"}[kind])
    data = b"".join(a.tobytes() + b.tobytes() for a, b in zip(rows, column))
    path.write_bytes(head + f"property {kind} label\nend_header\n".encode() + data)
    return path


def labeled_stage(path: Path) -> Path:
    """`halves` as a ParticleField with an indexed primvar."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    ball = halves()
    prim = captures.define(stage, "/Ball", ball)
    made = UsdGeom.PrimvarsAPI(prim).CreatePrimvar(
        "label", Sdf.ValueTypeNames.IntArray, UsdGeom.Tokens.vertex
    )
    made.Set(Vt.IntArray([3, 7]))
    made.SetIndices(Vt.IntArray((ball.labels["label"] == 7).astype(int).tolist()))
    stage.SetDefaultPrim(prim)
    stage.Save()
    return path


def names(plan) -> np.ndarray:
    return np.array([m.name for m in table(plan)])[plan.particles.material]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["int", "float", "uchar", "usd"])
def test_particles_have_the_preset_of_the_nearest_gaussian(tmp_path: Path, kind: str) -> None:
    ball = halves()
    if kind == "usd":
        path = labeled_stage(tmp_path / "ball.usda")
    else:
        path = labeled_ply(tmp_path / "ball.ply", kind)
    request = {"output": tmp_path / "out.usda", "material_labels": ("label=3:metal",), **FEW}
    plan = prepare(path, **request).plan
    X = plan.particles.X
    apart = np.linalg.norm(X[:, None] - ball.positions[None], axis=2)
    metal = ball.labels["label"][apart.argmin(axis=1)] == 3
    assert np.array_equal(names(plan), np.where(metal, "metal", "jelly"))
    assert 0.4 < metal.mean() < 0.6  # the ball is halved; the particles are random
    assert noted(
        plan, f"{metal.sum()} of {len(X)} particles are metal, by --material-label label=3:metal"
    )
    assert "--material-label label=3:metal" in plan.command


@pytest.mark.slow
def test_boxes_hold_before_labels(tmp_path: Path) -> None:
    path = labeled_ply(tmp_path / "ball.ply")
    plan = prepare(
        path, output=tmp_path / "out.usda", material_boxes=("foam:-1,0,-1,1,1,1",),
        material_labels=("label=3:metal", "label=7:rubber"), **FEW,
    ).plan  # fmt: skip
    above = plan.particles.X[:, 1] >= 0.0
    assert set(names(plan)[above]) == {"foam"}
    assert set(names(plan)[~above]) == {"metal", "rubber"}


@pytest.mark.slow
def test_labels_are_written_as_primvars_of_the_source_layer(tmp_path: Path) -> None:
    from gf_usd.readers import convert

    made = convert(labeled_ply(tmp_path / "ball.ply"))
    assert made is not None
    stage = Usd.Stage.Open(str(made.layer))
    splats = next(p for p in stage.Traverse() if p.GetTypeName().startswith("ParticleField"))
    primvar = UsdGeom.PrimvarsAPI(splats).GetPrimvar("label")
    assert primvar.GetInterpolation() == "vertex"
    assert np.array_equal(primvar.Get(), halves().labels["label"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("label", "message"),
    [
        ("semantic=3:metal", r"no Gaussian has a property semantic .*; they have label"),
        ("label=4:metal", r"none of the 800 Gaussians has label 4; they have [37] \(400\), "),
    ],
)
def test_what_is_not_there_is_refused(tmp_path: Path, label: str, message: str) -> None:
    path = labeled_ply(tmp_path / "ball.ply")
    with pytest.raises(InputError, match=message):
        prepare(path, output=tmp_path / "out.usda", material_labels=(label,), **FEW)
    seen = inspect(path, material_labels=(label,), **FEW)
    assert seen.refusal is not None
    assert "--material-label" in seen.refusal.message


@pytest.mark.slow
def test_splats_without_labels_are_said_to_have_none(tmp_path: Path) -> None:
    captures.write_ply(tmp_path / "bare.ply", halves())
    with pytest.raises(InputError, match="property label of whole numbers; they have none\n"):
        prepare(
            tmp_path / "bare.ply", output=tmp_path / "out.usda",
            material_labels=("label=3:metal",), **FEW,
        )  # fmt: skip


@pytest.mark.slow
def test_a_label_without_particles_is_refused(tmp_path: Path) -> None:
    path = labeled_ply(tmp_path / "ball.ply")
    with pytest.raises(InputError, match="boxes override it for all of its particles"):
        prepare(
            path, output=tmp_path / "out.usda", material_labels=("label=3:metal",),
            material_boxes=("foam:-0.2,-1,-1,1,1,1",), **FEW,
        )  # fmt: skip


def test_meshes_have_no_labels(plan) -> None:
    with pytest.raises(InputError, match="no captured Gaussians"):
        plan(mesh("One"), material_labels=("label=3:metal",))


@pytest.mark.slow
def test_gaussians_that_are_left_out_take_their_labels_along() -> None:
    kept = halves().take(np.array([5, 2]))
    assert np.array_equal(kept.labels["label"], halves().labels["label"][[5, 2]])


@pytest.mark.parametrize(
    ("labels", "message"),
    [
        (("label=3",), "is not a property, a whole number and a preset"),
        (("3:metal",), "is not a property, a whole number and a preset"),
        (("label=x:metal",), "is not a property, a whole number and a preset"),
        (("label=3:butter",), "butter"),
        (("label=3:metal", "label=3:foam"), "name the same value twice"),
    ],
)
def test_what_is_no_label_is_refused_before_anything_is_read(labels, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        Request(material_labels=labels).check()


def test_labels_and_blending_are_refused_together() -> None:
    with pytest.raises(UsageError, match=r"--blend-width 0\.1 and --material-label"):
        Request(material_labels=("label=3:metal",), blend_width=0.1).check()
