"""Contact where a body has less mass than a layer one spacing thick: blades, edges, bare faces."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from contact_scenes import contact_solver
from solids import (
    CUBE_POINTS,
    CUBE_TRIANGLES,
    cube,
    fill,
    preset_material,
    settings,
    solid,
    surface,
)

from gf_usd.core.asset import Surface
from gf_usd.core.frames.settings import Settings
from gf_usd.core.materials.dimensionless import FILTER_RATE, G0, time_scale
from gf_usd.physics.contact.detection.pair_values import pair_values
from gf_usd.physics.contact.floor import (
    LIGHT,
    STIFF,
    FloorContact,
    build_contact,
    damping_coefficient,
    largest_eigenvalue,
    layers_moved,
)
from gf_usd.physics.contact.planes.contact_planes import nothing
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.physics.updated_lagrangian.setup import floor_contact

# A prism with a knife edge along z at the bottom.
CORNERS = [(0, 0, 0), (0.02, 1, 0), (-0.02, 1, 0), (0, 0, 1), (0.02, 1, 1), (-0.02, 1, 1)]
FACES = [(0, 2, 1), (3, 4, 5), (0, 1, 4), (0, 4, 3), (0, 3, 5), (0, 5, 2), (1, 2, 5), (1, 5, 4)]


def blade(**more: str) -> Surface:
    return surface(np.array(CORNERS, float), np.array(FACES), **more)


def box_with_bare_face() -> Surface:
    """A cube, and a triangle on one of its edges that encloses nothing."""
    points = np.vstack([CUBE_POINTS, [[-1.0, 0.5, 0.5]]])
    return surface(points, np.vstack([CUBE_TRIANGLES, [[0, 4, 8]]]))


def on_floor(**changes: object) -> Settings:
    return settings(floor=-1.0, gravity=(0.0, -G0, 0.0), **changes)


@cache
def solver_of(shape: str, restitution: float = 0.85) -> TotalLagrangian:
    body, samples = fill(solid(SHAPES[shape]), 600)
    made = preset_material("rubber", body, restitution=restitution)
    return TotalLagrangian(body, [made], on_floor(), samples=samples)


def contact_of(shape: str) -> FloorContact:
    made = solver_of(shape).body.contact
    assert made is not None
    return made


SHAPES = {
    "cube": cube(),
    "blade": blade(),
    "sheet": cube(edge=(2.0, 0.01, 2.0)),
    "bare": box_with_bare_face(),
}
THIN = ["blade", "sheet", "bare"]


def test_samples_of_a_thick_body_stand_for_a_layer_one_spacing_thick() -> None:
    contact, mass = contact_of("cube"), solver_of("cube").body.mass
    assert np.array_equal(contact.mass, contact.layer)
    moved = layers_moved(contact.rows.W, contact.layer, mass)
    # On its faces that is the mass that they move; a corner moves a third of it.
    assert np.median(moved) == pytest.approx(1.0, abs=0.3)
    assert 3.0 < moved.max() < LIGHT


@pytest.mark.parametrize("shape", THIN)
def test_the_mass_of_light_samples_is_bounded_by_what_they_move(shape: str) -> None:
    contact, mass = contact_of(shape), solver_of(shape).body.mass
    moved = layers_moved(contact.rows.W, contact.layer, mass)
    assert moved.max() > 2.0 * LIGHT
    np.testing.assert_allclose(contact.mass / contact.layer, np.minimum(1.0, LIGHT / moved))
    share = np.minimum(1.0, STIFF / moved)
    for k in (contact.stiffness, contact.pair_stiffness, contact.tangential):
        per_mass = k / (contact.layer * share)
        np.testing.assert_allclose(per_mass, per_mass[0])
    expected = damping_coefficient(contact.stiffness, contact.mass, contact.restitution)
    np.testing.assert_allclose(contact.damping, expected)


@pytest.mark.parametrize("shape", ["blade", "bare"])
def test_that_bounds_the_fastest_vibration_of_contact(shape: str) -> None:
    contact, mass = contact_of(shape), solver_of(shape).body.mass
    rate = (contact.stiffness / contact.layer).max()
    # The iteration adds its residual of 1 %. With the layer it is more than twice the bound.
    fastest = largest_eigenvalue(contact.rows.W, contact.stiffness, mass.lumped)
    assert fastest <= 1.02 * STIFF * rate
    assert largest_eigenvalue(contact.rows.W, rate * contact.layer, mass.lumped) > 2.0 * fastest


@pytest.mark.parametrize("shape", ["blade", "bare"])
def test_damped_contact_of_light_parts_takes_few_more_substeps(shape: str) -> None:
    # Damping was that of the layer, and its ratio grew as the mass fell: 94 and 314 times the
    # substeps of the body alone, the cube 8 times.
    thick = solver_of("cube", 0.0).body.step.contact_factor
    assert solver_of(shape, 0.0).body.step.contact_factor < 6.0 * thick


def test_the_stiffness_of_the_paper_is_per_mass_of_the_layer() -> None:
    made = solver_of("blade").body
    assert made.contact is not None
    samples = made.contact.samples
    ones = np.ones(len(samples.X))
    contact = build_contact(
        samples, made.stencil, spacing=0.1, density=ones, modulus=ones, friction=ones,
        restitution=ones, impact_speed=ones, pressure=ones, rate=2000.0,
    )  # fmt: skip
    np.testing.assert_allclose(contact.stiffness, 200.0 * samples.area, rtol=1e-14)


def test_a_light_sample_may_have_to_stop_what_lies_behind_it() -> None:
    """The estimate of how deep it goes, and so of how far its spring hardens, has the layer."""
    contact = contact_of("blade")
    n = len(contact.mass)
    planes = replace(nothing(n), partner=np.arange(n)[::-1].copy())
    values = pair_values(planes, contact, ())
    for name, own in (("mass", contact.mass), ("layer", contact.layer)):
        reduced = own * own[::-1] / (own + own[::-1])
        np.testing.assert_allclose(values[name], reduced)
    assert (values["layer"] > 2.0 * values["mass"]).any()


@pytest.mark.parametrize("shape", THIN)
def test_the_updated_lagrangian_solver_bounds_them_by_its_own_rows(shape: str) -> None:
    made = solver_of(shape).body
    assert made.contact is not None
    arguments = made.particles, made.stencil, made.settings, dict(made.per)
    contact, _ = floor_contact(made.contact.samples, *arguments)
    assert contact is not None
    rate = contact.stiffness / contact.layer
    # The residual of the iteration, 1 %, is added.
    assert contact.omega2 <= 1.02 * STIFF * rate.max()
    assert (contact.mass < 0.5 * contact.layer).any()


@pytest.mark.slow
def test_a_blade_comes_to_rest_on_the_floor_a_tenth_of_a_spacing_deep_at_most() -> None:
    """A sheet a third of a spacing thick lies on it with its own weight."""
    shape = cube(edge=(2.0, 0.03, 2.0))
    body, samples = fill(solid(shape), 600)
    T = time_scale(body.radius)
    s = settings(
        frames=40, fps=5.0 / T, gravity=(0.0, -G0, 0.0), floor=0.0, filter_rate=FILTER_RATE / T,
        lift=(0.0, 0.2, 0.0), drag=3.0 / T,
    )  # fmt: skip
    solver = TotalLagrangian(body, [preset_material("jelly", body)], s, samples=samples)
    contact = solver.body.contact
    assert contact is not None
    assert (contact.mass < 0.7 * contact.layer).any()
    last = list(solver.frames())[-1]
    assert last.health.kinetic < 1e-4 * solver.body.m.sum() * G0 * body.radius
    assert 0.0 < last.health.penetration <= 0.1 * body.spacing


@pytest.mark.slow
def test_a_blade_that_hits_a_cube_conserves_momentum_and_energy() -> None:
    solver = contact_solver(
        blade(path="/Blade"), cube(low=(-0.5, -1.2, 0.0), path="/Cube"), particles=1000,
        frames=16, fps=96.0, velocity=[(0.0, -3.0, 0.0), (0.0, 3.0, 0.0)],
        changes={"damping_time": 0.0, "restitution": 1.0, "friction": 0.0}, filter_rate=0.0,
    )  # fmt: skip
    frames = list(solver.frames())
    first, last = frames[0].health, frames[-1].health
    assert max(frame.health.contact for frame in frames) > 0.0
    assert max(frame.health.overlap for frame in frames) < 0.5 * solver.body.particles.spacing
    mass, size = solver.body.m.sum(), solver.body.particles.radius
    p = np.subtract(last.momentum, first.momentum)
    L = np.subtract(last.angular_momentum, first.angular_momentum)
    assert np.abs(p).max() < 1e-5 * mass * 3.0
    assert np.abs(L).max() < 1e-5 * mass * 3.0 * size
    energy = [h.kinetic + h.elastic + h.contact for h in (first, last)]
    assert energy[1] == pytest.approx(energy[0], rel=0.02)
    assert energy[1] < 1.001 * energy[0]
