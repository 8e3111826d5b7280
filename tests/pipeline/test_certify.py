"""Certificates: of series that are made up, and of whole bakes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import gf_usd
from gf_usd.core.errors import InputError, SolverError, UsageError
from gf_usd.pipeline.measures.certify import FEWEST, certify, coarser_runs, interval_text
from gf_usd.pipeline.measures.convergence import Interval
from gf_usd.pipeline.measures.figures import Recorder
from gf_usd.pipeline.measures.observe import Observed

UP, G = np.array([0.0, 1.0, 0.0]), np.array([0.0, -9.81, 0.0])
FRAMES, DT = 30, 1.0 / 24.0
CUBE = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])


def write_box(folder: Path) -> Path:
    """A cube of 1 m whose lower face is in the plane y = 0."""
    file = folder / "box.obj"
    corners = "".join(f"v {x} {y + 0.5} {z}\n" for x, y, z in CUBE)
    faces = ((1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4))
    file.write_text(corners + "".join("f {} {} {} {}\n".format(*face) for face in faces))
    return file


@pytest.mark.parametrize(
    ("value", "half", "text"),
    [
        ([0.4321], 0.012, "43.2 +- 1.2 cm"),
        ([2.345e-4], 1.2e-6, "234.5 +- 1.2 µm"),
        ([0.0], 3.4e-3, "0.0 +- 3.4 mm"),
        ([12.0, -3.0, 0.0], 0.5, "12.00, -3.00, 0.00 +- 0.50 m"),
    ],
)
def test_lengths_have_the_unit_that_fits(value: list[float], half: float, text: str) -> None:
    """They were in meters: those of a body of a few millimeters had two digits or none."""
    one = Interval(fine=np.array(value), value=np.array(value), half=half)
    assert interval_text("rebound", one) == text
    unknown = Interval(fine=np.array([0.00213]), value=np.array([0.0]), half=0.0, reason="so")
    assert interval_text("rebound", unknown) == "2.13 mm, not certified: so"
    ratio = Interval(fine=np.array([0.002]), value=np.array([0.002]), half=0.001)
    assert interval_text("squash", ratio) == "0.0020 +- 0.0010"


def observed(h: float, *, astray: float = 0.0, inverted_from: int = FRAMES, count: int = 4096):
    """A cube that falls for 10 frames, stays squashed by 0.2 + h, and drifts astray after 20."""
    recorder = Recorder(UP, 0.0, G)
    fall = 10.5 * DT
    for i in range(FRAMES):
        t = i * DT
        falls = t < fall
        y = 0.5 * 9.81 * (fall**2 - t**2) if falls else 0.0
        flat = 1.0 if falls else 0.8 - h
        x = CUBE * [1.0, flat, 1.0] + (y + 0.5 * flat) * UP
        x = x + [astray * max(0, i - 20) * DT, 0.0, 0.0]
        v = np.tile(-9.81 * t * UP if falls else 0.0 * UP, (8, 1))
        inverted = 1 if i >= inverted_from else 0
        recorder.add(
            t, x, v, center=x.mean(0), velocity=v[0], touching=not falls, inverted=inverted,
            strain=0.2 + 2.0 * h if i == 25 else 0.0,
        )  # fmt: skip
    return Observed(particles=count, spacing=h, series=recorder.series(), at_rest=False)


def test_a_motion_that_converges_is_known() -> None:
    found = certify([observed(h) for h in (0.05, 0.1, 0.2)], held=False, single=True)
    assert found.figures["squash"].value == pytest.approx(0.2)
    assert found.figures["squash"].order == pytest.approx(1.0)
    assert found.figures["peak_strain"].value == pytest.approx(0.2)
    assert found.center is not None
    assert found.center.until == FRAMES
    assert found.contacts == (11,)
    assert any("peak squash 0.200 +- 0.050 (order 1.0)" in line for line in found.lines())
    assert json.loads(json.dumps(found.as_json()))["figures"]["squash"]["half_width"] > 0.0


def test_what_is_decided_after_the_runs_part_is_not_known() -> None:
    runs = [observed(h, astray=w) for h, w in ((0.05, 3.0), (0.1, -3.0), (0.2, 0.5))]
    found = certify(runs, held=False, single=True)
    assert found.center is not None
    assert 20 < found.center.until < 25
    assert found.figures["squash"].known
    strain = found.figures["peak_strain"]
    assert not strain.known
    assert "frame 25" in strain.reason
    assert f"from frame {found.center.until}" in strain.reason
    assert found.as_json()["figures"]["peak_strain"]["value"] is None


def test_particles_inside_out_are_no_material() -> None:
    runs = [observed(0.05, inverted_from=12), observed(0.1), observed(0.2)]
    found = certify(runs, held=False, single=True)
    assert found.figures["first_contact_time"].known
    assert "inverted from frame 12" in found.figures["peak_strain"].reason


def test_several_bodies_have_no_bounce() -> None:
    runs = [observed(h) for h in (0.05, 0.1, 0.2)]
    assert "squash" not in certify(runs, held=False, single=False).figures


@pytest.mark.parametrize(
    ("count", "volume", "error", "message"),
    [
        (FEWEST - 1, 1.0, None, f"63 particles, fewer than {FEWEST}; give --particles 4096"),
        (FEWEST, 1.1, None, "a different body"),
        (FEWEST, 1.0, InputError("too thin", ""), "half of the resolution failed: too thin"),
        (FEWEST, 1.0, SolverError("it burst", "", frame=3), "failed: it burst"),
    ],
)
def test_coarser_runs_of_no_use_say_why(count, volume, error, message) -> None:
    def run(spacing: float) -> tuple[Observed, float]:
        if error is not None:
            raise error
        return observed(spacing, count=count), volume

    runs, why = coarser_runs(0.05, 1.0, run)
    assert runs == ()
    assert message in why
    found = certify([observed(0.05)], held=False, single=True, reason=why)
    assert found.lines() == (f"nothing is certified: {why}",)
    assert not any(one.known for one in found.figures.values())


def test_coarser_runs_have_twice_and_four_times_the_spacing() -> None:
    runs, why = coarser_runs(0.05, 1.0, lambda spacing: (observed(spacing), 1.0))
    assert [one.spacing for one in runs] == [0.1, 0.2]
    assert why == ""


@pytest.mark.parametrize(
    "options",
    [
        {"preset": "paper"},
        {"skin": "idw"},
        {"only": "points"},
        {"samples_per_frame": 2},
        {"resume": True},
    ],
)
def test_what_cannot_be_certified_is_refused(tmp_path: Path, options) -> None:
    with pytest.raises(UsageError, match="certify"):
        gf_usd.bake(write_box(tmp_path), certify=True, output=f"{tmp_path}/", **options)


@pytest.mark.slow
def test_a_bake_says_how_certain_it_is(tmp_path: Path) -> None:
    options = {"drop": 1.0, "frames": 20, "particles": 5000, "only": "mesh", "overwrite": True}
    box = write_box(tmp_path)
    plain = gf_usd.bake(box, output=f"{tmp_path}/plain/", **options)
    result = gf_usd.bake(box, output=f"{tmp_path}/", certify=True, **options)
    found = result.bakes[0].certificate
    assert found is not None
    assert [edge / found.runs[0][1] for _, edge in found.runs] == pytest.approx([1.0, 2.0, 4.0])
    # free flight: t = sqrt(2 h / g)
    landed = found.figures["first_contact_time"]
    assert abs(landed.value[0] - np.sqrt(2.0 / 9.81)) <= landed.half + 1e-6
    assert found.figures["squash"].known
    report = json.loads(result.report.read_text("utf-8"))
    assert report["bakes"][0]["certificate"] == json.loads(json.dumps(found.as_json()))
    assert "--certify" in report["command"]
    # the frames are those of a bake without it
    assert plain.bakes[0].per_frame == result.bakes[0].per_frame
    assert {path.name for path in tmp_path.glob("*partial*")} == set()
    again = gf_usd.bake(box, output=f"{tmp_path}/", certify=True, **options)
    assert again.bakes[0].certificate.as_json() == found.as_json()
