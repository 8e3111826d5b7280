"""Health as attributes: of single frames in the cache, of the whole bake in its variant."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Sdf, Usd
from small_sources import PLAIN, ROOT_MESH, Source
from small_stages import frames_of, info_of, open_with, particles_of

from gf_usd.core.frames.frame import BakeInfo, Health
from gf_usd.core.units import StageUnits
from gf_usd.layers.cache import CacheWriter
from gf_usd.layers.check.run import review
from gf_usd.layers.root import write_root
from gf_usd.layers.tracks.health import (
    CERTIFIED,
    FLOW,
    FRAME,
    PREFIX,
    SETTLING,
    TOTAL,
    author_certificate,
    author_totals,
)
from gf_usd.layers.variants import BakedVariant
from gf_usd.pipeline.health.log import HealthLog
from gf_usd.system import usd_schema
from gf_usd.system.atomic_files import publish

HEALTH = Health(
    substeps=7, kinetic=2.0, elastic=3.0, potential=-4.0, contact=5.0, mass=6.0,
    center=(0.1, 0.2, 0.3), momentum=(1.0, 2.0, 3.0), angular_momentum=(4.0, 5.0, 6.0),
    min_J=0.5, max_J=1.5, min_stretch=0.4, max_stretch=1.6, inverted=2, penetration=0.01,
    friction_capped=3_000_000_000, rollbacks=1, work=0.25, clamped=8, stress_capped=9,
    injected=0.5,
)  # fmt: skip
UNITS = StageUnits(meters_per_unit=0.01, kilograms_per_unit=0.1)


def totals(info: BakeInfo, health: Health) -> dict:
    """The summary of two frames with this health."""
    log = HealthLog(info.settings, spacing=0.1, drop=1.0, radius=0.5, particles=40)
    log.add(health)
    log.add(health)
    return log.summary()


def bakes(folder: Path, source: Source = PLAIN, *, units: StageUnits | None = None) -> Path:
    """A root layer with two variants: rubber has HEALTH, jelly has half its depth and failed."""
    asset = source.asset(folder)
    if units is not None:
        asset = replace(asset, facts=replace(asset.facts, units=units))
    particles = particles_of(asset)
    looks = []
    for name, health, warnings, failure in (
        ("rubber", HEALTH, (), ""),
        ("jelly", replace(HEALTH, penetration=0.005), ("it sank", "it rose"), "it burst"),
    ):
        info = info_of(asset, look=name, frames=2)
        cache = folder / f"{name}.cache.usdc"
        with CacheWriter(cache, asset, particles, info) as writer:
            for frame in frames_of(asset, particles, info):
                writer.write(replace(frame, health=replace(health, substeps=7 + frame.index)))
        publish(cache)
        looks.append(
            BakedVariant(
                name=name, cache=cache, info=info, health=totals(info, health),
                warnings=warnings, failure=failure,
            )
        )  # fmt: skip
    return write_root(folder / "root.usda", asset, looks).path


def values(prim: Usd.Prim, time: float | None = None) -> dict[str, Any]:
    """What the prim says of its health, without the prefix; at a time, or what is uniform."""
    found: dict[str, Any] = {}
    for attribute in prim.GetAuthoredPropertiesInNamespace(PREFIX.rstrip(":")):
        value = attribute.Get() if time is None else attribute.Get(time)
        if value is not None and (attribute.GetNumTimeSamples() > 0) == (time is not None):
            found[attribute.GetName().removeprefix(PREFIX)] = value
    return found


def test_tables_and_schema_say_the_same() -> None:
    definitions = Sdf.Layer.FindOrOpen(str(usd_schema.schema_path() / usd_schema.DEFINITIONS))
    declared = {
        spec.name.removeprefix(PREFIX): (spec.typeName, spec.variability)
        for spec in definitions.GetPrimAtPath(f"/{usd_schema.HEALTH_API}").properties
    }
    frame = FRAME | FLOW | SETTLING
    ours = {name: (kind, Sdf.VariabilityVarying) for name, (kind, _, _) in frame.items()}
    for name, (kind, _, _) in TOTAL.items():
        ours[f"total:{name}"] = (kind, Sdf.VariabilityUniform)
    for name, kind in CERTIFIED.items():
        ours[f"certified:{name}"] = (kind, Sdf.VariabilityUniform)
    ours["warnings"] = (Sdf.ValueTypeNames.StringArray, Sdf.VariabilityUniform)
    ours["failure"] = (Sdf.ValueTypeNames.String, Sdf.VariabilityUniform)
    assert declared == ours


def test_tables_read_what_there_is(tmp_path: Path) -> None:
    flowed = replace(HEALTH, plastic_dissipation=1.0, settling_dissipation=1.0)
    known = totals(info_of(PLAIN.asset(tmp_path)), flowed)
    assert {key for _, key, _ in TOTAL.values()} <= set(known)
    assert "plastic_dissipation_J" not in totals(info_of(PLAIN.asset(tmp_path)), HEALTH)
    fields = {field for _, field, _ in (FRAME | FLOW | SETTLING).values()}
    assert fields <= set(Health.__dataclass_fields__)
    left = set(Health.__dataclass_fields__) - fields
    # The particles have their masses; what is inside is looked at in a few frames alone; what
    # contact planes gave is part of what was injected; bodies and particles that fall past every
    # obstacle, the volume and thickness of what flows, bodies that expand and particles outside a
    # coarse mesh are warnings of the totals; conversion is counted in them.
    apart = {"fallen", "fallen_kinetic", "lost", "flow_volume", "converted", "flow_per_cell"}
    apart |= {"conversion_dissipation", "outside_share", "outside_depth", "outside_mesh"}
    apart |= {"overlap_pair", "overlap_names"}
    apart |= {"pierced", "pierced_through", "pierced_pair"}  # in every sixth frame
    apart |= {"expanded", "expanded_body", "stretched", "stretched_body"}
    assert left == {"mass", "inside_share", "inside_depth", "planes", *apart}


def test_frames_are_time_samples_in_stage_units(tmp_path: Path) -> None:
    stage = open_with(bakes(tmp_path, units=UNITS), "rubber")
    prim = stage.GetDefaultPrim()
    assert usd_schema.HEALTH_API in prim.GetAppliedSchemas()
    codes = prim.GetAttribute(PREFIX + "kineticEnergy").GetTimeSamples()
    assert codes == [10.0, 11.0]
    first, second = (values(prim, code) for code in codes)
    assert set(first) == set(FRAME)
    assert (first["substeps"], second["substeps"]) == (7, 8)
    energy = 0.1 * 0.01**2  # [J] of a mass unit, distance unit squared and second
    for name, joules in (("kinetic", 2.0), ("elastic", 3.0), ("potential", -4.0), ("contact", 5.0)):
        assert first[f"{name}Energy"] == pytest.approx(joules / energy, rel=1e-12)
    assert first["injectedEnergy"] == pytest.approx(0.5 / energy, rel=1e-12)
    assert first["pinWork"] == pytest.approx(0.25 / energy, rel=1e-12)
    np.testing.assert_allclose(first["centerOfMass"], (10.0, 20.0, 30.0), rtol=1e-12)
    np.testing.assert_allclose(first["momentum"], np.array([1, 2, 3]) / 0.001, rtol=1e-12)
    np.testing.assert_allclose(first["angularMomentum"], np.array([4, 5, 6]) / energy, rtol=1e-12)
    assert first["penetration"] == pytest.approx(1.0, rel=1e-6)  # a float
    assert first["frictionCaps"] == 3_000_000_000, "more than 32 bits hold"
    counts = ("invertedParticles", "clampedParticles", "stressCappedParticles", "rollbacks")
    assert [first[name] for name in counts] == [2, 8, 9, 1]
    assert (first["minVolumeRatio"], first["maxStretch"]) == (0.5, pytest.approx(1.6, rel=1e-7))


def test_totals_follow_the_variant(tmp_path: Path) -> None:
    path = bakes(tmp_path)
    rubber, jelly = (
        values(stage.GetDefaultPrim())
        for stage in (open_with(path, "rubber"), open_with(path, "jelly"))
    )
    assert rubber["total:penetration"] == pytest.approx(0.01, rel=1e-6)
    assert jelly["total:penetration"] == pytest.approx(0.005, rel=1e-6)
    assert (rubber["total:frames"], rubber["total:substeps"]) == (2, 14)
    assert (rubber["total:rollbacks"], rubber["total:invertedParticles"]) == (2, 4)
    assert list(jelly["warnings"]) == ["it sank", "it rose"]
    assert jelly["failure"] == "it burst"
    assert not {"warnings", "failure", "total:restitution"} & set(rubber), "nothing to say"


def test_intervals_are_in_stage_units() -> None:
    layer = Sdf.Layer.CreateAnonymous(".usda")
    spec = Sdf.CreatePrimInLayer(layer, "/body")
    one = {"unit": "m", "value": [0.02], "half_width": 0.001, "reason": ""}
    place = {"unit": "m", "value": [0.01, 0.02, 0.03], "half_width": 0.002, "reason": ""}
    lost = {"unit": "", "value": None, "half_width": None, "reason": "it differs"}
    share = {"unit": "", "value": [0.2], "half_width": 0.01, "reason": ""}
    figures = {"rebound": one, "settled_center": place, "peak_strain": lost, "squash": share}
    certificate = {"figures": figures, "center": {"frames": 7}}
    author_certificate(spec, certificate, UNITS)
    written = {name: spec.attributes[f"{PREFIX}certified:{name}"].default for name in CERTIFIED}
    names = ["rebound", "settledCenterX", "settledCenterY", "settledCenterZ", "squash"]
    assert list(written["figures"]) == names
    np.testing.assert_allclose(written["values"], [2.0, 1.0, 2.0, 3.0, 0.2])
    np.testing.assert_allclose(written["halfWidths"], [0.1, 0.2, 0.2, 0.2, 0.01])
    assert list(written["unknown"]) == ["peakStrain: it differs"]
    assert written["frames"] == 7


def test_without_a_bake_nothing_is_said(tmp_path: Path) -> None:
    stage = open_with(bakes(tmp_path), "none")
    prim = stage.GetDefaultPrim()
    assert values(prim) == values(prim, 10.0) == {}
    assert usd_schema.HEALTH_API not in prim.GetAppliedSchemas()


def test_totals_need_no_payload(tmp_path: Path) -> None:
    stage = open_with(bakes(tmp_path), "rubber", Usd.Stage.LoadNone)
    prim = stage.GetDefaultPrim()
    assert usd_schema.HEALTH_API in prim.GetAppliedSchemas()
    assert values(prim)["total:frames"] == 2
    assert values(prim, 10.0) == {}


def test_metadata_repeats_the_words(tmp_path: Path) -> None:
    looks = Sdf.Layer.FindOrOpen(str(bakes(tmp_path))).customLayerData["gaussianFlesh"]["looks"]
    assert list(looks["jelly"]["warnings"]) == ["it sank", "it rose"]
    assert looks["jelly"]["failure"] == "it burst"
    assert not {"warnings", "failure"} & set(looks["rubber"])


@pytest.mark.parametrize("source", [PLAIN, ROOT_MESH])
def test_the_checker_has_nothing_against_it(tmp_path: Path, source: Source) -> None:
    path = bakes(tmp_path, source)
    assert review(path, source.asset(tmp_path).facts.path) == []


def test_a_root_prim_that_is_a_mesh_carries_it_itself(tmp_path: Path) -> None:
    stage = open_with(bakes(tmp_path, ROOT_MESH), "rubber")
    assert set(values(stage.GetPrimAtPath("/blob"), 1.0)) == set(FRAME)
    assert values(stage.GetPrimAtPath("/blob"))["total:frames"] == 2
    assert values(stage.GetPrimAtPath("/blob_GaussianFlesh"), 1.0) == {}


def test_an_unknown_total_has_no_value() -> None:
    layer = Sdf.Layer.CreateAnonymous(".usda")
    spec = Sdf.CreatePrimInLayer(layer, "/A")
    author_totals(spec, {"frames": 3, "restitution": None}, StageUnits())
    assert [p.name for p in spec.properties] == [PREFIX + "total:frames"]


def test_what_lies_inside_is_a_total_in_stage_units(tmp_path: Path) -> None:
    measured = replace(HEALTH, inside_share=0.125, inside_depth=0.02)
    layer = Sdf.Layer.CreateAnonymous(".usda")
    for name, health in (("measured", measured), ("not", HEALTH)):
        spec = Sdf.CreatePrimInLayer(layer, f"/{name}")
        author_totals(spec, totals(info_of(PLAIN.asset(tmp_path)), health), UNITS)
    stage = Usd.Stage.Open(layer)
    seen, none = (values(stage.GetPrimAtPath(path)) for path in ("/measured", "/not"))
    assert seen["total:insideShare"] == pytest.approx(0.125)
    assert seen["total:insideDepth"] == pytest.approx(2.0, rel=1e-6)  # a unit is a centimeter
    assert not {"total:insideShare", "total:insideDepth"} & set(none)
