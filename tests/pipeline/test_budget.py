"""What a bake is estimated to cost, and where that is too much."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from solids import asset, facts, fill, preset_material, settings, solid, sphere

from gf_usd.core.errors import InputError
from gf_usd.core.materials.material import Material
from gf_usd.core.materials.presets import find_preset
from gf_usd.geometry.skinning import KEPT_BYTES
from gf_usd.pipeline.cost import budget
from gf_usd.pipeline.cost.budget import (
    PAIR_SECONDS,
    duration,
    require_affordable,
    require_resources,
    rough_duration,
    typical_rest,
)
from gf_usd.pipeline.cost.solvers import Solvers
from gf_usd.pipeline.prepared import Prepared
from gf_usd.prepare.outputs.outputs import outputs
from gf_usd.prepare.plan import Plan, Variant


@pytest.fixture(scope="module")
def plan() -> Plan:
    """A rubber ball of half a meter that falls a meter."""
    shape = sphere(0.5, path="/Ball")
    particles, samples = fill(solid(shape), 300)
    return Plan(
        asset=replace(asset(shape), facts=facts(path=Path("ball.usda"))),
        particles=particles,
        samples=samples,
        materials=(preset_material("rubber", particles),),
        settings=settings(frames=31, gravity=(0.0, -9.81, 0.0), floor=-1.5),
        outputs=outputs(Path("ball.usda"), ["rubber"], None),
        source=Path("ball.usda"),
        embedded=(),
        drop=1.0,
        notes=(),
    )


def cost(plan: Plan) -> Mapping[str, Any]:
    """What a plan is estimated to cost, whatever its materials are called."""
    names = [material.name for material in plan.materials]
    return Prepared(plan=replace(plan, outputs=outputs(Path("ball.usda"), names, None))).cost


def require(plan: Plan, hours: float) -> None:
    """See `require_affordable`."""
    require_affordable(
        cost(plan), hours, path=plan.asset.facts.path, settings=plan.settings,
        materials=plan.materials, tables=plan.tables, particles=len(plan.particles), drop=plan.drop,
    )  # fmt: skip


def stiff(plan: Plan, factor: float) -> Material:
    rubber = plan.materials[0]
    return replace(
        rubber, name="stiff", youngs_modulus=factor * rubber.youngs_modulus, damping_time=0.0
    )


@pytest.mark.slow
def test_substeps_grow_with_the_root_of_stiffness(plan: Plan) -> None:
    made = [replace(plan, materials=(stiff(plan, f),)) for f in (1e4, 1e6, 1e8)]
    steps = [cost(p)["per_material"][0]["substeps_per_frame"] for p in made]
    # whole numbers of hundreds and more
    assert [b / a for a, b in pairwise(steps)] == pytest.approx([10.0, 10.0], rel=0.01)


def test_a_bake_that_ends_at_rest_has_a_usual_cost_besides_that_of_all_frames(plan: Plan) -> None:
    whole = cost(plan)
    assert not whole["ends_early"]
    assert whole["usual_seconds"] == whole["estimated_seconds"]
    endless = replace(plan.settings, frames=10**6)
    usual = typical_rest(endless, plan.materials[0], plan.particles.radius, 0)
    long = replace(endless, frames=4 * usual)
    until = replace(plan, settings=long, choices=replace(plan.choices, until_rest=True))
    both = cost(until)
    assert both["ends_early"]
    assert both["usual_frames"] < long.frames / 3
    # the usual cost is that of a bake of so many frames: both have what is spent once, and rounding
    short = cost(replace(plan, settings=replace(long, frames=both["usual_frames"])))
    assert both["usual_seconds"] == pytest.approx(short["estimated_seconds"], rel=1e-9)
    assert both["estimated_seconds"] > short["estimated_seconds"]


def test_what_more_work_costs(plan: Plan) -> None:
    def seconds(p: Plan) -> float:
        return cost(p)["estimated_seconds"]

    rubber, jelly = plan.materials[0], replace(plan.materials[0], name="jelly")
    both = replace(plan, materials=(rubber, jelly))
    one, two = seconds(plan), seconds(both)
    assert one < two < 2.0 * one, "imports and kernels are paid for once"
    assert seconds(replace(plan, settings=replace(plan.settings, frames=310))) > one
    assert seconds(replace(plan, settings=replace(plan.settings, solver="ul"))) > 0.0


def test_a_gpu_pays_for_each_substep_and_hardly_for_each_particle(plan: Plan) -> None:
    def moving(device: str, n: int) -> float:
        """[s] that 1,000 substeps of a frame add."""
        on = replace(plan.settings, device=device, threads=1)
        one, none = (
            budget.estimate(
                on, plan.materials, [many], particles=n, vertices=0, paired=0, frame_bytes=0.0,
                first_contact=None,
            )["estimated_seconds"]
            for many in (1000, 0)
        )  # fmt: skip
        return float(one - none)

    assert moving("cuda", 1_000_000) < 0.02 * moving("cpu", 1_000_000)
    assert 1.0 < moving("cuda", 100_000) / moving("cuda", 10_000) < 1.3
    assert moving("cpu", 100_000) / moving("cpu", 10_000) > 9.0


@pytest.mark.parametrize("ratio", [0.5, 3.0])
def test_seconds_are_those_of_the_machine(
    plan: Plan, monkeypatch: pytest.MonkeyPatch, ratio: float
) -> None:
    """A bake took 2.5 times as long as estimated on another CPU than that of the constants."""

    def known(value: float) -> Mapping[str, Any]:
        monkeypatch.setattr("gf_usd.pipeline.prepared.cpu_time_ratio", lambda: value)
        return cost(replace(plan, materials=(plan.materials[0], stiff(plan, 1e6))))

    one, here = known(1.0), known(ratio)
    for whole in ("estimated_seconds", "usual_seconds"):
        assert here[whole] == pytest.approx(ratio * one[whole])
    for before, after in zip(one["per_material"], here["per_material"], strict=True):
        times = {name for name in before if name.endswith("seconds")}
        assert len(times) == 7
        for name, value in before.items():
            factor = ratio if name in times else 1.0
            assert after[name] == (pytest.approx(factor * value) if name in times else value)
    assert here["cpu_ratio"] == ratio
    counts = ("substeps_per_frame", "estimated_bytes", "estimated_memory_bytes")
    assert [here[name] for name in counts] == [one[name] for name in counts]


def test_seconds_of_a_gpu_do_not_follow_the_cpu(plan: Plan) -> None:
    def seconds(device: str, substeps: int, ratio: float, paired: int = 0) -> float:
        found = budget.estimate(
            replace(plan.settings, device=device), plan.materials, [substeps], particles=10_000,
            vertices=0, paired=paired, frame_bytes=0.0, first_contact=None, cpu_ratio=ratio,
        )  # fmt: skip
        return float(found["estimated_seconds"])

    def of_substeps(device: str, ratio: float, paired: int = 0) -> float:
        return seconds(device, 1000, ratio, paired) - seconds(device, 0, ratio)

    assert of_substeps("cpu", 3.0) == pytest.approx(3.0 * of_substeps("cpu", 1.0))
    assert of_substeps("cuda", 3.0) == pytest.approx(of_substeps("cuda", 1.0))
    # the CPU detects contact, and starts the bake and makes its frames
    contact = [of_substeps("cuda", r, 50_000) - of_substeps("cuda", r) for r in (1.0, 3.0)]
    assert contact[1] > 2.9 * contact[0] > 0.0
    assert seconds("cuda", 0, 3.0) == pytest.approx(3.0 * seconds("cuda", 0, 1.0))


@pytest.mark.slow
def test_the_papers_skin_costs_every_vertex_with_every_particle(plan: Plan) -> None:
    def more(count: int) -> float:
        """[s] a frame that the skin adds on a sphere of so many vertices."""
        shape = plan.asset.surfaces[0]
        wide = replace(shape, points=np.resize(shape.points, (count, 3)))
        bare = replace(plan, asset=replace(plan.asset, surfaces=(wide,)))
        skinned = replace(bare, settings=replace(bare.settings, skin="paper"))
        spent = (cost(p)["estimated_seconds"] for p in (skinned, bare))
        return (next(spent) - next(spent)) / plan.settings.frames

    n = len(plan.particles)
    kept, anew = KEPT_BYTES // (8 * n), 10 * KEPT_BYTES // (8 * n)
    assert more(anew) == pytest.approx(
        10.0 * more(kept) * PAIR_SECONDS[0] / PAIR_SECONDS[1], rel=0.01
    )
    assert more(2 * anew) == pytest.approx(2.0 * more(anew), rel=0.01)


def test_the_requested_solver_is_used(plan: Plan) -> None:
    made = []

    def build(variant: Variant) -> Any:
        made.append(prepared.solvers.take(variant))
        return made[-1]

    prepared, (variant,) = Prepared(plan=plan), plan.variants
    solvers = Solvers(build, len(plan.particles))
    substeps = solvers.substeps(variant)
    first = solvers.take(variant)
    assert made == [first], "it is built once"
    assert first.substeps == substeps
    next(first.frames())
    resume_hint = solvers.take(variant)
    assert resume_hint is not first, "a solver that has moved starts no other bake"
    assert solvers.substeps(variant) == substeps
    changed = Prepared(plan=replace(plan, settings=replace(plan.settings, substeps=7)))
    (variant,) = changed.plan.variants
    assert changed.solvers.substeps(variant) == 7, "a plan with other settings uses its own solver"


def test_a_solver_that_is_too_large_to_wait_is_built_again(
    plan: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gf_usd.pipeline.cost.solvers.KEPT", len(plan.particles) - 1)
    made = []

    def build(variant: Variant) -> Any:
        made.append(Prepared(plan=plan).solvers.take(variant))
        return made[-1]

    (variant,), solvers = plan.variants, Solvers(build, len(plan.particles))
    assert solvers.substeps(variant) == solvers.substeps(variant)
    assert len(made) == 1, "its substeps are kept"
    assert solvers.take(variant) is made[1]


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.4, "0 s"),
        (119.0, "119 s"),
        (120.0, "2 minutes"),
        (7199.0, "120 minutes"),
        (9000.0, "2.5 hours"),
        (86400.0, "24 hours"),
        (1.2e6, "13.9 days"),
    ],
)
def test_times_for_reading(seconds: float, text: str) -> None:
    assert duration(seconds) == text


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (119.0, "119 s"),
        (120.0, "2 minutes"),
        (123.6, "2.1 minutes"),
        (598.0, "10 minutes"),
        (1092.0, "18 minutes"),
        (7199.0, "120 minutes"),
        (9000.0, "2.5 hours"),
        (1.2e6, "14 days"),
    ],
)
def test_estimates_have_no_meaningless_digits(seconds: float, text: str) -> None:
    assert rough_duration(seconds) == text


@pytest.mark.slow
def test_too_long_is_refused_with_the_numbers(plan: Plan) -> None:
    hard = replace(plan, materials=(*plan.materials, stiff(plan, 1e12)))
    hours = cost(hard)["estimated_seconds"] / 3600.0
    require(hard, hours * 1.01)
    with pytest.raises(InputError) as caught:
        require(hard, hours * 0.99)
    substeps = cost(hard)["substeps_per_frame"]["stiff"]
    message = caught.value.message
    assert message.startswith(f"ball.usda: the bake would take about {duration(hours * 3600)}: ")
    assert (
        f"particles of stiff (Young's modulus {hard.materials[1].youngs_modulus:.3g} Pa" in message
    )
    assert f"need {substeps} substeps of {1 / 24 / substeps:.2g} s in each of 31 frames" in message
    allowed = float(caught.value.hint.split("--max-hours ")[1].split()[0])
    require(hard, allowed)


def test_too_long_by_one_of_several_materials_names_the_stiffest(plan: Plan) -> None:
    """It named the values of the first: "Young's modulus 1e+03 Pa" of gelatin under aluminium."""
    main = replace(plan.materials[0], name="authored")
    metal = stiff(plan, 1e12)
    table = (replace(plan.materials[0], name="rubber"), metal)
    with pytest.raises(InputError) as caught:
        require_affordable(
            {**cost(replace(plan, materials=(metal,))), "per_material": [
                {"name": "authored", "seconds": 1e9, "substeps_per_frame": 10**6}
            ]},
            1.0, path=Path("ball.usda"), settings=plan.settings, materials=[main], tables=[table],
            particles=1000, drop=1.0,
        )  # fmt: skip
    young = f"{metal.youngs_modulus:.3g}"
    assert (
        f"1000 particles of authored (stiff, the stiffest of 2: Young's modulus {young} Pa, damping"
        " time 0 s), dropped 1 m" in caught.value.message
    )


def test_too_large_a_bake_gives_sizes_in_fitting_units(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A disk of some gigabytes was "5e+03 MB"."""
    monkeypatch.setattr(budget, "free_disk", lambda folder: 5.0e9)
    rows = {"per_material": [{"disk_bytes": 2.5e12}], "estimated_memory_bytes": 1.0}
    with pytest.raises(InputError, match=r"needs about 2500 GB in \., where 5 GB are free"):
        require_resources(
            rows, path=Path("ball.usda"), folder=Path(), frames=1, done=[0.0], copies=1
        )


def test_first_contact_is_a_fall(plan: Plan) -> None:
    # sqrt(2 * 1 m / g) = 0.4515 s, 10.8 frames
    assert cost(plan)["first_contact_frame"] == 11
    assert cost(replace(plan, drop=20.0))["first_contact_frame"] is None, "after the bake"
    none = replace(plan, settings=replace(plan.settings, floor=None))
    assert cost(none)["first_contact_frame"] is None
    thrown = replace(plan, velocity=(lambda X: 0.0 * X + 1.0,))
    assert cost(thrown)["first_contact_frame"] is None
    # On a slope of 60 degrees, 1 m of height is half a meter along the normal, and so is g: the
    # time is the same.
    n = (math.sin(math.pi / 3.0), math.cos(math.pi / 3.0), 0.0)
    tilted = replace(plan, settings=replace(plan.settings, floor_normal=n))
    assert cost(tilted)["first_contact_frame"] == 11


def test_a_bake_that_ends_just_above_the_floor_has_substeps(plan: Plan) -> None:
    """Contact is prepared a frame before the floor, also where that is the last frame."""
    # The ball falls 1 m in 10.8 frames.
    flights = [
        cost(replace(plan, settings=replace(plan.settings, frames=frames, shortcuts=True)))[
            "per_material"
        ][0]
        for frames in (9, 11, 12)
    ]
    assert [row["flying_samples"] for row in flights] == [9, 9, 9]
    assert [row["substeps"] > 0 for row in flights] == [False, True, True]


def test_the_damping_ratio_is_that_of_the_step(plan: Plan) -> None:
    """z = tau w / 2 grows with the damping time, and foretells the substeps of two of them."""
    rubber = plan.materials[0]
    rows = [
        cost(replace(plan, materials=(replace(rubber, damping_time=tau),)))["per_material"][0]
        for tau in (0.05, 0.5)
    ]
    z, stronger = (row["damping_ratio"] for row in rows)
    assert z > 3.0
    assert stronger == pytest.approx(10.0 * z)
    step = [math.sqrt(1.0 + ratio * ratio) - ratio for ratio in (z, stronger)]
    counts = [row["substeps_per_frame"] for row in rows]
    assert counts[1] / counts[0] == pytest.approx(step[0] / step[1], rel=0.05)


def test_the_critical_damping_time_is_that_of_the_step(plan: Plan) -> None:
    """tau / z, also where the damping is that of a material that has slower waves."""
    rubber = replace(plan.materials[0], damping_time=0.05)
    (row,) = cost(replace(plan, materials=(rubber,)))["per_material"]
    critical = row["critical_damping_time"]
    # the number of substeps is rounded up
    assert critical == pytest.approx(0.05 / row["damping_ratio"], rel=0.02)
    halves = np.arange(len(plan.particles)) % 2
    soft = replace(rubber, name="soft", youngs_modulus=rubber.youngs_modulus / 1e3)
    both = replace(plan, particles=replace(plan.particles, material=halves))
    for tables in ((soft, rubber), (rubber, soft)):
        used = replace(both, materials=tables[:1], tables=(tables,))
        assert [[one.name for one in table] for table in used.used_tables] == [
            [one.name for one in tables]
        ]
        (row,) = cost(used)["per_material"]
        tau = row["critical_damping_time"]
        again = tuple(replace(one, damping_time=tau) for one in tables)
        (row,) = cost(replace(used, materials=again[:1], tables=(again,)))["per_material"]
        assert row["damping_ratio"] == pytest.approx(1.0, rel=0.1)


def test_bodies_in_flight_and_those_that_meet_only_themselves_are_cheap(plan: Plan) -> None:
    def seconds(**more: Any) -> float:
        known: dict[str, Any] = {
            "particles": 1000, "vertices": 100, "paired": 800, "frame_bytes": 1.0,
            "first_contact": None,
        }  # fmt: skip
        made = budget.estimate(plan.settings, plan.materials, [1000], **{**known, **more})
        return made["estimated_seconds"]

    assert seconds(flying=20) < seconds(flying=0)
    assert seconds(crowd=False) < seconds(crowd=True)


@pytest.mark.parametrize(
    ("young", "radius", "done"),
    [(1e3, 0.21, 4.3), (1e4, 0.21, 1.66), (2e4, 0.21, 1.35), (6e4, 0.21, 1.22)],
)
def test_a_heap_of_soft_bodies_takes_the_substeps_of_their_sag(
    plan: Plan, young: float, radius: float, done: float
) -> None:
    """Seven animals of a radius of 0.21 m together that fell from 0.25 to 2.6 m took `done` times
    the substeps at rest."""
    soft = replace(plan.materials[0], density=1000.0, youngs_modulus=young, poissons_ratio=0.42)

    def substeps(radius: float, **more: Any) -> int:
        found = budget.estimate(
            replace(plan.settings, **more), [soft], [1000], particles=1000, vertices=0, paired=800,
            frame_bytes=0.0, first_contact=None, radius=radius,
        )["per_material"]  # fmt: skip
        return int(found[0]["substeps"])

    factor = budget.CROWD * substeps(radius) / substeps(0.0)
    assert 1.0 / 1.4 < done / factor < 1.4  # the accuracy of the fit, except for what is flat
    assert substeps(100.0) == pytest.approx(budget.MOST * substeps(0.0))
    assert substeps(radius, gravity=(0.0, 0.0, 0.0)) == substeps(0.0)
    assert substeps(radius, substeps=7) == substeps(0.0, substeps=7)


def test_the_height_of_a_fall_takes_no_more_substeps_than_its_contact_springs(plan: Plan) -> None:
    """A duck of jelly that fell 40 radii was estimated at 4.5 times the substeps that it took."""
    jelly = find_preset("jelly").material(plan.particles.radius)
    low, high = (cost(replace(plan, materials=(jelly,), drop=drop)) for drop in (0.1, 5.0))
    rows = [one["per_material"][0] for one in (low, high)]
    moving = [plan.settings.frames - 1 - row["flying_samples"] for row in rows]
    each = [
        row["substeps"] / row["substeps_per_frame"] / max(1, frames)
        for row, frames in zip(rows, moving, strict=True)
    ]
    assert each[0] == pytest.approx(each[1], rel=0.01)


def test_a_soft_body_next_to_a_stiff_one_costs_no_more_substeps(plan: Plan) -> None:
    """The waves of the stiff one determine them, whichever of the two names the variant."""
    jelly, metal = (find_preset(name).material(0.1) for name in ("jelly", "metal"))
    assert metal.wave_speed > 3.0 * jelly.wave_speed

    def substeps(main: Material, *table: Material) -> int:
        found = budget.estimate(
            plan.settings, [main], [1000], tables=[table], particles=1000, vertices=0, paired=0,
            frame_bytes=0.0, first_contact=None, radius=0.5,
        )["per_material"]  # fmt: skip
        return int(found[0]["substeps"])

    alone = substeps(metal, metal)
    assert substeps(jelly, jelly) > 2.0 * alone, "strained, it needs many times its own"
    both = substeps(jelly, jelly, metal)
    assert both == substeps(metal, metal, jelly)
    assert alone <= both < 1.7 * alone


# Peaks [MB] of `python -m tools.bench.scale --case particles N`, 26 November 2026.
@pytest.mark.parametrize(("n", "peak"), [(100_000, 508), (1_000_000, 2057), (10_000_000, 16_471)])
def test_memory_is_estimated_above_what_was_measured_but_not_far(
    plan: Plan, n: int, peak: float
) -> None:
    found = budget.estimate(
        plan.settings, plan.materials, [100], particles=n, vertices=10_000, paired=0,
        frame_bytes=0.0, first_contact=None,
    )["estimated_memory_bytes"]  # fmt: skip
    assert 1.0 <= found / (1e6 * peak) < 1.25
