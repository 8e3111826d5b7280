"""Half precision: where it is used, how far it is off, and that this is what the notes say."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd
from small_sources import PLAIN
from small_stages import frames_of, info_of, particles_of

from gf_usd.core.asset import Asset
from gf_usd.core.errors import BakeError
from gf_usd.core.frames.choices import Choices
from gf_usd.core.frames.particles import Particles
from gf_usd.core.units import StageUnits
from gf_usd.layers.cache import CacheSummary, CacheWriter
from gf_usd.layers.check.run import check_file
from gf_usd.layers.tracks.gaussians import half_is_precise
from gf_usd.system.atomic_files import publish

# A half has 11 bits: rounding to the nearest is off by half of the last.
BITS = 2.0**-11
SPLATS = "/duck/GaussianFlesh/Gaussians"
HALF = Choices(half=True)


def written(
    path: Path, asset: Asset, particles: Particles, choices: Choices, stretch: float = 1.0
) -> tuple[CacheSummary, Usd.Stage]:
    info = info_of(asset)
    with CacheWriter(path, asset, particles, info, choices=choices) as writer:
        for frame in frames_of(asset, particles, info, choices):
            pose = replace(frame.gaussians, scales=frame.gaussians.scales * stretch)
            writer.write(replace(frame, gaussians=pose))
        summary = writer.close()
    publish(path)
    return summary, Usd.Stage.Open(str(path))


def test_what_is_half_is_close_and_the_rest_is_the_same(tmp_path: Path) -> None:
    asset = PLAIN.asset(tmp_path)
    particles = particles_of(asset)
    _, single = written(tmp_path / "whole.usdc", asset, particles, Choices())
    summary, rounded = written(tmp_path / "half.usdc", asset, particles, HALF)
    whole, half = (stage.GetPrimAtPath(SPLATS) for stage in (single, rounded))
    assert half.GetAttribute("positions").GetTypeName() == "point3f[]"
    names = {
        "orientations": ("quath[]", 1.0), "scales": ("half3[]", None), "opacities": ("half[]", 1.0),
        "radiance:sphericalHarmonicsCoefficients": ("half3[]", 2.0),
    }  # fmt: skip
    notes = " ".join(summary.notes)
    for name, (kind, most) in names.items():
        attribute, other = half.GetAttribute(f"{name}h"), whole.GetAttribute(name)
        assert attribute.GetTypeName() == kind
        assert not half.GetAttribute(name).HasAuthoredValue()
        worst = 0.0
        for time in attribute.GetTimeSamples() or [Usd.TimeCode.Default()]:
            a, b = (np.array(x.Get(time), np.float64) for x in (attribute, other))
            error = np.abs(a - b) / (np.abs(b) if most is None else most)
            assert 0.0 < error.max() <= BITS * (1 + 1e-3)
            worst = max(worst, error.max() * (most or 1.0))
        found = re.search(rf"{name} by ([\d.e-]+)", notes)
        stated = float(found[1]) / (100.0 if most is None else 1.0)
        # two digits are written; singles round, too
        assert stated == pytest.approx(worst, rel=0.06)
    for name in ("positions", "gaussianFlesh:velocities"):
        a, b = (prim.GetAttribute(name) for prim in (half, whole))
        assert [a.Get(t) for t in a.GetTimeSamples()] == [b.Get(t) for t in b.GetTimeSamples()]
    assert check_file(tmp_path / "half.usdc").errors == check_file(tmp_path / "whole.usdc").errors
    assert (tmp_path / "half.usdc").stat().st_size < (tmp_path / "whole.usdc").stat().st_size


def test_scales_that_are_too_small_stay_single(tmp_path: Path) -> None:
    asset = PLAIN.asset(tmp_path)
    particles = particles_of(asset)
    tiny = replace(particles, scale=particles.scale * 1e-4)
    summary, stage = written(tmp_path / "c.usdc", asset, tiny, HALF)
    prim = stage.GetPrimAtPath(SPLATS)
    assert prim.GetAttribute("scales").GetTypeName() == "float3[]"
    assert prim.GetAttribute("orientationsh").GetTypeName() == "quath[]"
    assert not prim.GetAttribute("scalesh").HasAuthoredValue()
    assert any("its scales stay in single precision" in note for note in summary.notes)
    # the same body in a stage of millimeters has scales that do
    facts = replace(asset.facts, units=StageUnits(meters_per_unit=1e-3))
    _, stage = written(tmp_path / "mm.usdc", replace(asset, facts=facts), tiny, HALF)
    scales = stage.GetAttributeAtPath(f"{SPLATS}.scalesh")
    assert scales.GetTypeName() == "half3[]"


def test_a_scale_beyond_halves_is_an_error_in_words(tmp_path: Path) -> None:
    asset = PLAIN.asset(tmp_path)
    with pytest.raises(BakeError, match=r"scales up to .* do not fit in half precision") as caught:
        written(tmp_path / "c.usdc", asset, particles_of(asset), HALF, stretch=1e6)
    assert caught.value.hint == "leave --half out"


def test_no_gaussians_no_halves(tmp_path: Path) -> None:
    asset = PLAIN.asset(tmp_path)
    choices = Choices(half=True, shapes=("mesh", "points"))
    summary, stage = written(tmp_path / "c.usdc", asset, particles_of(asset), choices)
    assert not stage.GetPrimAtPath(SPLATS)
    assert summary.notes == ()


def test_where_halves_do() -> None:
    assert half_is_precise(np.array([[1e-3, 1.0, 100.0]]))
    assert not half_is_precise(np.array([1e-4, 1.0]))
    assert not half_is_precise(np.array([1.0, 2e4]))
