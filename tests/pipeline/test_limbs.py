"""What contact of bodies with themselves is estimated to cost, from their shapes."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from solids import asset, ball, cube, fill, preset_material, settings, solid

from gf_usd.core.materials.material import Material
from gf_usd.core.stage import ContactSetup, Pin, Skin
from gf_usd.pipeline.cost import budget
from gf_usd.pipeline.cost.limbs import COMPACT, Limbs, hull_fill, limb_share, limbs_of
from gf_usd.pipeline.prepared import limbs
from gf_usd.prepare.bodies.convexity import SupportPoints
from gf_usd.prepare.outputs.outputs import outputs
from gf_usd.prepare.plan import Plan


@cache
def rubber() -> Material:
    return preset_material("rubber", ball(50)[0])


TOP = cube((0.0, 0.4, 0.0), (0.6, 0.1, 0.6))
LEGS = [cube((x, 0.0, z), (0.1, 0.4, 0.1)) for x in (0.0, 0.5) for z in (0.0, 0.5)]


def test_a_stool_fills_little_of_its_hull_and_a_box_all_of_it() -> None:
    stool, samples = fill(solid(TOP, *LEGS), 800)
    # of a box 0.6 x 0.5 x 0.6
    assert hull_fill(samples.X, stool.volume) == pytest.approx(stool.volume / 0.18, rel=0.05)
    assert limbs_of(samples, stool, [0]) == Limbs(share=1.0, samples=float(len(samples.X)))
    assert limbs_of(samples, stool, []) == Limbs(), "it has no contact with itself"
    box, samples = fill(solid(TOP), 300)
    assert hull_fill(samples.X, box.volume) == 1.0
    assert limbs_of(samples, box, [0]) == Limbs()


def test_a_ball_fills_its_hull() -> None:
    body, samples = ball(1000)
    # the points of the bound leave out up to 4 % of it
    assert hull_fill(samples.X, 4.0 / 3.0 * np.pi) == pytest.approx(1.0, abs=0.02)
    assert limb_share(hull_fill(samples.X, body.volume)) == 0.0


def test_the_hull_is_right_where_the_center_of_the_box_is_outside_it() -> None:
    """Three rods along the axes from a corner: the hull is about a sixth of a box."""
    dice = np.random.default_rng(0)
    ends = np.repeat(np.where(np.eye(3) > 0.0, 1.0, 0.03), 400, axis=0)
    X = dice.uniform(0.0, ends)
    volume = 3 * 0.03**2
    assert SupportPoints(X).hull_lower_bound() == 0.0
    assert hull_fill(X, volume) == pytest.approx(volume / ConvexHull(X).volume, rel=0.05)
    assert limb_share(hull_fill(X, volume)) == 1.0


def test_a_flat_body_has_no_limbs() -> None:
    X = np.random.default_rng(0).normal(size=(50, 3)) * (1.0, 0.0, 1.0)
    assert hull_fill(X, 1e-3) == 1.0


def test_each_body_counts_by_its_own_shape() -> None:
    body, samples = fill(solid(TOP, *LEGS), 800)
    box, more = fill(solid(cube((3.0, 0.0, 0.0), 0.4)), 300)
    n, k = len(body), len(samples.X)
    both = replace(
        body,
        X=np.vstack([body.X, box.X]),
        V0=np.append(body.V0, box.V0),
        body=np.repeat([0, 1], [n, len(box)]),
    )
    joined = replace(
        samples,
        X=np.vstack([samples.X, more.X]),
        area=np.append(samples.area, more.area),
        normal=None,
        body=np.repeat([0, 1], [k, len(more.X)]),
    )
    assert limbs_of(joined, both, [0, 1]) == Limbs(share=1.0, samples=float(k))
    assert limbs_of(joined, both, [1]) == Limbs()


def test_the_share_grows_as_less_of_the_hull_is_filled() -> None:
    shares = [limb_share(fill) for fill in (1.0, COMPACT, 0.75, 0.65, 0.5, 0.1)]
    assert shares[:2] == [0.0, 0.0]
    assert shares == sorted(shares)
    assert shares[-2:] == [1.0, 1.0]


# Name, particles, samples, share of the hull that is filled, substeps estimated without limbs and
# done, CPU seconds estimated without limbs and taken, on the machine of the constants of `budget`:
# docs/performance.md, Contact of bodies with themselves.
MEASURED = [
    ("duck", 2944, 1539, 0.87, 5325, 5287, 4.45, 3.70),
    ("creature", 3156, 2195, 0.41, 2779, 4162, 4.13, 6.71),
    ("spot", 2992, 1892, 0.55, 1487, 1776, 3.29, 3.90),
    ("penguin", 3080, 1971, 0.65, 1068, 2274, 3.80, 4.59),
    ("figure", 3748, 2860, 0.36, 2485, 5453, 3.63, 9.89),
    ("stool, legs 11 long", 6112, 3809, 0.10, 3110, 3367, 4.76, 5.55),
    ("stool, legs 20 long", 7280, 4336, 0.06, 3235, 5956, 5.30, 8.48),
    ("chair, legs 11 long", 7172, 4376, 0.11, 2792, 5952, 5.14, 9.19),
    ("chair, legs 15 long", 7624, 4807, 0.09, 2944, 5622, 5.41, 11.13),
    ("chair of six boxes", 6240, 3980, 0.13, 2751, 5911, 4.56, 8.75),
]


@pytest.mark.parametrize("row", MEASURED, ids=[row[0] for row in MEASURED])
def test_bakes_with_limbs_are_estimated_within_a_factor_of_two(row: tuple[Any, ...]) -> None:
    """A chair took 9,100 substeps where 4,400 were estimated."""
    _, particles, samples, filled, before, done, whole, took = row
    share = limb_share(filled)

    def estimated(limbs: Limbs) -> tuple[float, float]:
        found = budget.estimate(
            settings(frames=before + 1, threads=1), [rubber()], [1],
            particles=particles, vertices=0, paired=samples, frame_bytes=0.0, first_contact=None,
            crowd=False, limbs=limbs,
        )  # fmt: skip
        return found["per_material"][0]["substeps"], found["estimated_seconds"]

    (rest, without), (substeps, seconds) = (
        estimated(one) for one in (Limbs(), Limbs(share=share, samples=share * samples))
    )
    assert rest == before
    assert 0.5 < done / substeps < 2.0
    assert 0.5 < took / (whole + seconds - without) < 2.0


def plan_of_stool(**more: Any) -> Plan:
    body, samples = fill(solid(TOP, *LEGS), 400)
    return Plan(
        asset=asset(TOP, *LEGS), particles=body, samples=samples, settings=settings(),
        materials=(preset_material("rubber", body),), source=asset().facts.path, embedded=(),
        outputs=outputs(asset().facts.path, ["rubber"], None), drop=1.0, notes=(),
        contact_setup=ContactSetup(
            skins=(Skin(points=TOP.points, triangles=TOP.triangles),), self_contact=frozenset([0])
        ),
        **more,
    )  # fmt: skip


def test_limbs_of_held_bodies_stay_apart() -> None:
    assert limbs(plan_of_stool()).share == 1.0
    pin = Pin(
        name="seat", inside=lambda X: X[:, 1] > 0.4, nearest=lambda X: X, anchors=TOP.points,
        path=TOP.points[None],
    )  # fmt: skip
    assert limbs(plan_of_stool(pins=(pin,))) == Limbs()


def test_threads_share_the_kernels_of_limbs_but_not_detections() -> None:
    def each(threads: int, device: str, samples: float) -> float:
        """[s] that samples of limbs add to a substep."""
        one, none = (
            budget.estimate(
                settings(frames=2, threads=threads, device=device), [rubber()], [1000],
                particles=8000, vertices=0, paired=5000, frame_bytes=0.0, first_contact=None,
                crowd=False, limbs=Limbs(samples=many),
            )["estimated_seconds"]
            for many in (samples, 0.0)
        )  # fmt: skip
        return float(one - none) / 1000.0

    kernels, detection = budget.LIMB_SECONDS
    assert each(1, "cpu", 5000.0) == pytest.approx(5000.0 * (kernels + detection))
    assert each(2, "cpu", 5000.0) == pytest.approx(5000.0 * (kernels / 2.0 + detection))
    assert each(2, "cuda", 5000.0) == pytest.approx(5000.0 * detection)
