"""Hints for bakes that take long, and that they promise what the estimate then says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from mixed_stages import castle_of

from gf_usd.core.materials.material import Material
from gf_usd.core.materials.physical import PHYSICAL
from gf_usd.core.materials.presets import find_preset
from gf_usd.physics.frame_loop import Solver
from gf_usd.pipeline.cost import shortcuts as hints
from gf_usd.pipeline.cost.budget import rough_duration
from gf_usd.pipeline.cost.shortcuts import LONG, shortcuts
from gf_usd.pipeline.prepared import prepare, solver_of
from gf_usd.prepare.materials.mass_scaling import scaled_material
from gf_usd.prepare.plan import Plan, Variant

SPHERE = Path(__file__).parents[2] / "samples" / "sphere.usda"
FACTORS = {"mild-steel": 16.0, "lead": 26.0, "copper": 5.8, "aluminium": 4.9}


def row(name: str, seconds: float, **more: Any) -> dict[str, Any]:
    return {"name": name, "seconds": seconds, "damping_ratio": 0.0, **more}


def found(
    rows: Sequence[dict[str, Any]], *tables: Sequence[Material], scaling: float = 1.0
) -> tuple[str, ...]:
    """Hints where damping takes 90 % of the substeps, and waves all of the time."""
    total = sum(one["seconds"] for one in rows)
    return shortcuts(
        {"per_material": rows, "usual_seconds": total},
        tables,
        damped=lambda number, time: rows[number]["substeps_per_frame"] // 10,
        scaled=lambda factor: total / factor**0.5,
        scaling=scaling,
    )


@pytest.mark.parametrize("name", [*FACTORS, "silicone"])
def test_stiff_metals_are_offered_mass_scaling(name: str) -> None:
    made = PHYSICAL[name].material(1.0)
    lines = found([row(name, 3600.0)], [made])
    if name not in FACTORS:
        assert lines == ()
        return
    (line,) = lines
    factor = FACTORS[name]
    assert line.startswith(f"--mass-scaling {factor:g} would bake {name}")
    assert made.yield_strain is not None
    assert 0.018 <= factor * made.yield_strain <= 0.02
    assert f"about {rough_duration(3600.0 / factor**0.5)} and dent it alike" in line
    assert found([row(name, LONG - 1.0)], [made]) == ()


def test_the_mass_scaling_that_a_bake_has_is_replaced() -> None:
    """A factor of the scaled material was printed, which the option would have put in its place."""
    made = scaled_material(PHYSICAL["copper"].material(1.0), 1.2)
    (line,) = found([row("copper", 3600.0)], [made], scaling=1.2)
    assert line.startswith("--mass-scaling 5.8 would bake copper")
    assert f"about {rough_duration(3600.0 / (5.8 / 1.2) ** 0.5)} and dent" in line
    assert made.yield_strain is not None
    assert line.endswith(
        f"up to {100.0 * 5.8 / 1.2 * made.yield_strain:.2g} % instead of"
        f" {100.0 * made.yield_strain:.2g} %"
    )


def test_looks_and_soft_materials_have_nothing_to_gain() -> None:
    for name in ("dented", "clay", "wax", "dough"):
        assert found([row(name, 1e5)], [find_preset(name).material(1.0)]) == ()


def test_variants_have_one_mass_scaling() -> None:
    """Each had its own, which the option cannot give it."""
    steel, lead, sand = (find_preset(n).material(1.0) for n in ("mild-steel", "lead", "dry-sand"))
    rows = [row("mild-steel", 3600.0), row("lead", 10.0)]
    (line,) = found(rows, [steel], [lead])
    assert line.startswith(
        "--mass-scaling 16 would bake all 2 materials in about 15 minutes and dent mild-steel, lead"
        " alike: they spring back by up to 2 % instead of"
    )
    # sand flows too, without a strain at which it yields
    assert found([*rows, row("dry-sand", 10.0)], [steel], [lead], [sand]) == ()


def test_a_damping_that_shortens_the_step_is_reported_with_one_that_does_not() -> None:
    made = replace(PHYSICAL["foam"].material(0.04), damping_time=0.002)
    one = row("foam", 3600.0, damping_ratio=100.0, substeps_per_frame=200_000)
    (line,) = found([one], [made])
    assert line.startswith("--damping-time 2e-05 would bake foam in 20000 substeps a frame")
    assert line.endswith("its damping time of 0.002 s takes 200000")
    for calm in ({"damping_ratio": 2.0}, {"seconds": 10.0}):
        assert found([{**one, **calm}], [made]) == ()


def test_of_several_materials_the_damping_that_shortens_the_step_is_reported() -> None:
    """The first one, after which the variant is named, may have none."""
    first = replace(PHYSICAL["gelatin"].material(0.04), name="jelly", damping_time=0.0)
    foam = replace(PHYSICAL["foam"].material(0.04), damping_time=0.002)
    one = row(
        "jelly", 3600.0, damping_ratio=100.0, substeps_per_frame=200_000,
        critical_damping_time=3e-5,
    )  # fmt: skip
    for table in ([first, foam], [foam, first]):
        (line,) = found([one], table)
        assert line.startswith("--damping-time 3e-05 for all 2 materials would bake jelly in 20000")
        assert line.endswith("the damping time of foam, 0.002 s, takes 200000")
    assert found([{**one, "critical_damping_time": 0.003}], [first, foam]) == ()


def test_of_several_materials_the_stiff_metal_is_offered_mass_scaling() -> None:
    soft, steel, lead = (PHYSICAL[n].material(1.0) for n in ("gelatin", "mild-steel", "lead"))
    rows = [row("gelatin", 3600.0)]
    (line,) = found(rows, [soft, steel])
    assert line.startswith(
        f"--mass-scaling 16 would bake gelatin, in the mild-steel of which waves run at"
        f" {steel.wave_speed:.3g} m/s, in about 15 minutes"
    )
    # lead yields later than steel does: the factor is that of the later one, for both
    strains = [one.yield_strain or 0.0 for one in (steel, lead)]
    (line,) = found(rows, [soft, lead, steel])
    factor = float(line.split()[1])
    assert 0.018 <= factor * max(strains) <= 0.02
    assert line.endswith(f"instead of {100.0 * max(strains):.2g} %")
    # nothing is gained where an elastic material has the fastest waves
    stiff = replace(soft, name="glass", youngs_modulus=7e10, density=2500.0)
    assert found(rows, [soft, stiff, steel]) == ()


@pytest.mark.slow
def test_mass_scaling_takes_as_long_as_promised(monkeypatch: pytest.MonkeyPatch) -> None:
    """The costs of frames and of the start, and the contact of a softer body, were scaled too."""
    monkeypatch.setattr(hints, "LONG", 1.0)
    monkeypatch.setattr("gf_usd.pipeline.prepared.REST_WORK", 1)  # limited to a shot
    options: dict[str, Any] = {"material": "mild-steel,lead", "particles": 300}
    prepared = prepare(SPHERE, **options)
    assert prepared.until_rest is not None  # both lengths have one solver of each material
    built: list[str] = []

    def counted(plan: Plan, variant: Variant) -> Solver:
        built.append(variant.name)
        return solver_of(plan, variant)

    prepared.cost  # noqa: B018
    monkeypatch.setattr("gf_usd.pipeline.prepared.solver_of", counted)
    (line,) = prepared.shortcuts
    assert built == ["mild-steel", "lead"]
    factor = float(line.split()[1])
    again = prepare(SPHERE, mass_scaling=factor, **options)
    assert f"in about {rough_duration(again.cost['usual_seconds'])} and" in line


@pytest.mark.slow
def test_a_shorter_damping_takes_the_substeps_promised(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also of a bake with sand, whose steps have a limit of their own."""
    monkeypatch.setattr(hints, "DAMPED", 0.0)
    castle = castle_of(tmp_path)
    options: dict[str, Any] = {"particles": 600, "frames": 6}
    (line,) = prepare(castle, damping_time=0.05, **options).shortcuts
    again = prepare(castle, damping_time=float(line.split()[1]), **options)
    (count,) = again.cost["substeps_per_frame"].values()
    assert f" in {count} substeps a frame" in line
