"""`gf_usd.Scene` and `gf_usd.simulate` against closed forms and conservation laws."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

import gf_usd

Array = NDArray[np.float64]
G = 9.81
FPS = 24.0
FACES = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]


def block(low: Any, high: Any) -> Array:
    """Corners of a box, for FACES."""
    ends = np.array([low, high], float)
    return np.array([[ends[i, 0], ends[j, 1], ends[k, 2]] for i, j, k in np.ndindex(2, 2, 2)])


UNIT = block((0, 1, 0), (1, 2, 1))
# single precision of nodes a few meters from the origin, summed over some hundred steps
ROUNDING = 2e-5


def alone(**options: Any) -> gf_usd.Scene:
    scene = gf_usd.Scene(**options)
    scene.add_body(UNIT, FACES, material="jelly", name="block")
    return scene


def of_size(size: float) -> gf_usd.Scene:
    scene = gf_usd.Scene()
    scene.add_body(UNIT * size, FACES, material="metal")
    return scene


def test_a_throw_is_a_parabola() -> None:
    scene = gf_usd.Scene()
    scene.add_body(UNIT, FACES, velocity=(1.0, 2.0, 0.0))
    frames = list(gf_usd.simulate(scene, frames=5, particles=100))
    start = frames[0].positions
    for frame in frames:
        t = frame.index / FPS
        way = np.array([1.0, 2.0, 0.0]) * t + np.array([0.0, -0.5 * G * t * t, 0.0])
        assert frame.time == pytest.approx(t)
        assert np.allclose(frame.positions - start, way, atol=ROUNDING)
        assert np.allclose(frame.meshes["body0"], UNIT + way, atol=ROUNDING)


@pytest.mark.slow
def test_gravity_and_floor_stand_on_any_axis() -> None:
    points = UNIT[:, [2, 0, 1]]  # its height along z
    scene = gf_usd.Scene(up="Z", floor=1.0, gravity=G)
    scene.add_body(points, FACES, material="jelly")
    frames = list(gf_usd.simulate(scene, frames=4, particles=100))
    # it begins on the floor, sinks in by its own weight, and does not move sideways
    assert frames[-1].health.penetration < 0.1
    assert frames[-1].positions[:, 2].mean() > 1.3
    assert abs(frames[-1].health.momentum[0]) < 1e-3 * frames[-1].health.mass


def test_a_negative_number_of_gravity_points_up_with_a_note() -> None:
    simulation = gf_usd.simulate(alone(gravity=-G), frames=2, particles=100)
    assert simulation.settings.gravity == (0.0, G, 0.0)
    assert simulation.notes[0].startswith("gravity of -9.81 m/s^2 points up")


@pytest.mark.parametrize("apart", [0.0, 0.5, 2.0])
def test_bodies_that_overlap_at_the_start_have_a_note(apart: float) -> None:
    """Also a copy at the same place; and notes name no option that a scene does not have."""
    scene = alone()
    scene.add_body(UNIT + (apart, 0.0, 0.0), FACES, name="other")
    notes = gf_usd.simulate(scene, frames=1, particles=100).notes
    message = "</block> and </other> are different physics bodies that overlap"
    assert any(note.startswith(message) for note in notes) == (apart < 1.0)
    assert not [note for note in notes if "--" in note or "asset" in note]


def test_forces_on_particles_give_their_momentum() -> None:
    simulation = gf_usd.simulate(alone(gravity=0.0), frames=5, particles=100)
    first = next(simulation)
    forces = np.random.default_rng(1).normal(size=first.positions.shape)  # [N]
    simulation.push(forces)
    pushed = [next(simulation) for _ in range(2)]
    for frame in pushed:
        wanted = forces.sum(0) * frame.index / FPS
        assert np.allclose(frame.health.momentum, wanted, atol=ROUNDING * np.abs(forces).sum())
    simulation.push(np.zeros_like(forces))
    after = next(simulation)
    assert np.allclose(after.health.momentum, pushed[-1].health.momentum, atol=1e-3)


def test_an_acceleration_can_carry_the_weight() -> None:
    with gf_usd.simulate(alone(), frames=4, particles=100) as simulation:
        first = next(simulation)
        simulation.accelerate((0.0, G, 0.0))
        for frame in simulation:
            assert frame.health.substeps > 0  # no closed form under a force
            assert np.allclose(frame.positions, first.positions, atol=ROUNDING)


def test_velocities_can_be_set_between_frames() -> None:
    simulation = gf_usd.simulate(alone(gravity=0.0), frames=4, particles=100)
    first = next(simulation)
    middle = first.positions.mean(0)
    spin = np.array([0.0, 0.5, 0.0])  # [rad/s]
    simulation.set_velocities(lambda x: np.cross(spin, x - middle))
    frame = next(simulation)
    # a cube: I = m a^2 / 6 about every axis, of which the particles have what they stand for
    arms = first.positions - middle
    masses = simulation.masses
    wanted = (masses[:, None] * np.cross(arms, np.cross(spin, arms))).sum(0)
    L = np.array(frame.health.angular_momentum)
    assert np.allclose(L, wanted, atol=0.02 * np.linalg.norm(wanted))
    assert np.allclose(frame.health.momentum, 0.0, atol=1e-3 * frame.health.mass)


@pytest.mark.slow
@pytest.mark.parametrize(
    "materials",
    [("dry-sand",), pytest.param(("jelly", "dry-sand"), marks=pytest.mark.slow)],
    ids=["flows", "solid and flows"],
)
def test_what_flows_takes_velocities_and_refuses_forces(materials: tuple[str, ...]) -> None:
    scene = gf_usd.Scene(gravity=0.0)
    for k, material in enumerate(materials):
        scene.add_body(UNIT + [0.0, 2.0 * k, 0.0], FACES, material=material)
    simulation = gf_usd.simulate(scene, frames=4, particles=200)
    first = next(simulation)
    assert set(first.meshes) == {f"body{k}" for k, m in enumerate(materials) if m == "jelly"}
    simulation.set_velocities((1.0, 0.0, -0.5))
    for frame in simulation:
        way = np.array([1.0, 0.0, -0.5]) * frame.index / FPS
        assert np.allclose(frame.positions, first.positions + way, atol=2.0 * ROUNDING)
    for call in (
        lambda: simulation.push(np.zeros((len(simulation.particles), 3))),
        lambda: simulation.accelerate((0.0, 1.0, 0.0)),
    ):
        with pytest.raises(gf_usd.UsageError, match="in which a body flows") as raised:
            call()
        assert "gravity" in str(raised.value.hint)


def test_a_saved_state_continues_bit_identically() -> None:
    scene = gf_usd.Scene(floor=0.9)
    scene.add_body(UNIT, FACES, material="jelly", velocity=(0.0, -1.0, 0.0))
    simulation = gf_usd.simulate(scene, frames=8, particles=100)
    for _ in range(5):
        next(simulation)
    saved = simulation.save()
    once = next(simulation)
    next(simulation)
    simulation.load(saved)
    again = next(simulation)
    assert again.index == once.index
    assert np.array_equal(again.positions, once.positions)
    assert np.array_equal(again.F, once.F)


@pytest.mark.slow
def test_a_state_of_contact_is_loaded_where_there_is_none_yet() -> None:
    """How many samples may touch is no property of the scene."""

    def started() -> gf_usd.Simulation:
        scene = gf_usd.Scene()
        scene.add_body(UNIT, FACES, material="jelly")
        scene.add_body(UNIT + [0.1, 1.2, 0.0], FACES, material="jelly", velocity=(0.0, -4.0, 0.0))
        return gf_usd.simulate(scene, frames=8, particles=200)

    one, other = started(), started()
    next(other)
    frames = [next(one) for _ in range(5)]
    saved = one.save()
    expected = next(one)
    assert saved["contact_is_watched"].any()
    other.load(saved)
    again = next(other)
    assert again.index == expected.index == frames[-1].index + 1
    assert np.array_equal(again.positions, expected.positions)


@pytest.mark.slow
def test_states_from_before_and_after_a_conversion_are_loaded() -> None:
    """The solver, and with it the arrays of the state, change where bodies begin to flow."""
    scene = gf_usd.Scene()
    scene.add_body(UNIT, FACES, material="rubber", name="one")
    more = {"frames": 5, "particles": 100, "conversions": "/one=dry-sand@time:2"}
    simulation = gf_usd.simulate(scene, **more)
    next(simulation)
    start = simulation.save()
    frames = list(simulation)
    end = simulation.save()
    simulation.load(start)
    for once, again in zip(frames, simulation):
        assert np.array_equal(once.positions, again.positions)
    other = gf_usd.simulate(scene, **more)
    other.load(end)
    assert int(other.save()["index"]) == int(end["index"])


def test_a_scene_is_run_again_from_its_first_state() -> None:
    simulation = gf_usd.simulate(alone(gravity=0.0), frames=3, particles=100)
    next(simulation)
    start = simulation.save()
    ends: list[float] = []
    for speed in (1.0, -2.0, 1.0):
        simulation.load(start)
        simulation.set_velocities((speed, 0.0, 0.0))
        ends.append([frame.health.center[0] for frame in simulation][-1])
    assert ends[0] == ends[2]
    assert np.allclose(ends[:2], [0.5 + 2.0 / FPS, 0.5 - 4.0 / FPS], atol=ROUNDING)


def test_a_force_of_0_ends_the_forces() -> None:
    simulation = gf_usd.simulate(alone(gravity=0.0), frames=4, particles=100)
    next(simulation)
    simulation.push(np.outer(simulation.masses, (24.0, 0.0, 0.0)))  # [N] for 24 m/s^2
    fast = next(simulation).health.momentum[0]
    simulation.push(0)
    rest = [frame.health.momentum[0] for frame in simulation]
    assert fast > 0.9 * simulation.masses.sum()
    assert np.allclose(rest, fast, rtol=ROUNDING)


def test_forces_and_an_acceleration_add_up_and_end_one_by_one() -> None:
    simulation = gf_usd.simulate(alone(gravity=0.0), frames=4, particles=100)
    next(simulation)
    masses = simulation.masses
    simulation.push(np.outer(masses, (24.0, 0.0, 0.0)))  # [N] for 24 m/s^2
    simulation.accelerate((0.0, 24.0, 0.0))
    momenta = [np.array(next(simulation).health.momentum) / masses.sum()]
    simulation.accelerate(0)
    momenta.append(np.array(next(simulation).health.momentum) / masses.sum())
    simulation.push(0)
    momenta.append(np.array(next(simulation).health.momentum) / masses.sum())
    assert np.allclose(momenta, [(1, 1, 0), (2, 1, 0), (2, 1, 0)], atol=1e-3)


def test_a_saved_state_has_its_forces_and_velocities() -> None:
    """What was changed since the last frame, too, and without a fault that is none."""
    simulation = gf_usd.simulate(alone(), frames=6, particles=100)
    next(simulation)
    start = simulation.save()
    simulation.push(np.outer(simulation.masses, (24.0, 0.0, 0.0)))
    next(simulation)
    simulation.set_velocities((1.0, 0.0, 0.0))
    saved = simulation.save()
    once = next(simulation)
    simulation.accelerate((0.0, 5.0, 0.0))
    simulation.push(0)
    next(simulation)
    simulation.load(saved)
    assert np.array_equal(next(simulation).positions, once.positions)
    other = gf_usd.simulate(alone(), frames=6, particles=100)
    other.load(saved)
    assert np.array_equal(next(other).positions, once.positions)
    simulation.load(start)  # nothing pushes there
    assert next(simulation).health.momentum[0] == 0.0


@pytest.mark.parametrize(
    ("moved", "material", "particles"),
    [(0.0, "jelly", 200), (0.1, "jelly", 100), (0.0, "clay", 100)],
    ids=["particles", "places", "kinds"],
)
def test_the_state_of_another_scene_is_refused(moved: float, material: str, particles: int) -> None:
    simulation = gf_usd.simulate(alone(), frames=3, particles=100)
    next(simulation)
    other = gf_usd.Scene()
    other.add_body(UNIT + moved, FACES, material=material, name="block")
    with pytest.raises(gf_usd.UsageError, match="another scene") as caught:
        gf_usd.simulate(other, frames=3, particles=particles).load(simulation.save())
    assert "same options" in caught.value.hint


def test_a_failure_has_a_hint_that_fits_a_scene() -> None:
    simulation = gf_usd.simulate(alone(floor=0.99), frames=6, particles=100)
    next(simulation)
    simulation.set_velocities(lambda x: 1e8 * (x - 0.5))
    with pytest.raises(gf_usd.SolverError, match="frame") as caught:
        list(simulation)
    assert caught.value.frame > 0
    assert "cache" not in caught.value.hint
    assert "drop" not in caught.value.hint


def test_a_frame_that_blows_up_is_redone() -> None:
    """There the strain requires a step of length 0, which was divided by."""
    simulation = gf_usd.simulate(alone(floor=0.99), frames=6, particles=100)
    next(simulation)
    simulation.set_velocities(lambda x: 4000.0 * (x - 0.5))  # [1/s] for 167 lengths a frame
    frames = list(simulation)
    assert max(frame.health.rollbacks for frame in frames) > 0
    assert all(np.isfinite(frame.positions).all() for frame in frames)


def test_a_frame_is_shown_in_a_line() -> None:
    (frame,) = gf_usd.simulate(alone(), frames=1, particles=100)
    assert repr(frame) == "SimulationFrame(index=0, time=0, particles=112)"


def test_what_is_pinned_follows_its_motion() -> None:
    scene = gf_usd.Scene(gravity=0.0)
    scene.add_body(block((0, 0, 0), (3, 1, 1)), FACES, material="metal", name="bar")
    up = np.eye(4)[None].repeat(4, axis=0)
    up[:, 1, 3] = 0.01 * np.arange(4)  # [m] a frame
    scene.pin((-0.1, -0.1, -0.1), (0.5, 1.1, 1.1), motion=up)
    frames = list(gf_usd.simulate(scene, frames=4, particles=200))
    held = frames[0].positions[:, 0] < 0.5
    rise = frames[-1].positions - frames[0].positions
    assert held.any()
    assert np.allclose(rise[held], (0.0, 0.03, 0.0), atol=ROUNDING)
    assert frames[-1].health.work > 0.0


@pytest.mark.slow
def test_a_moving_obstacle_pushes_a_body() -> None:
    scene = alone(gravity=0.0)

    def motion(time: float) -> Array:
        matrix = np.eye(4)
        matrix[0, 3] = 2.0 * time  # [m]
        return matrix

    scene.add_obstacle(block((-1.05, 0.5, -0.5), (-0.05, 2.5, 1.5)), FACES, motion=motion)
    frames = list(gf_usd.simulate(scene, frames=8, particles=100))
    assert frames[-1].health.momentum[0] > 0.1 * frames[-1].health.mass
    assert frames[-1].meshes["block"][:, 0].min() > 2.0 * frames[-1].time - 0.05 - 0.1


def test_bodies_have_their_own_materials_and_particles() -> None:
    stiff = gf_usd.Material(
        name="stiff", law="neoHookean", density=500.0, youngs_modulus=1e5, poissons_ratio=0.3
    )
    scene = gf_usd.Scene()
    scene.add_body(UNIT, FACES, material=stiff, name="one")
    scene.add_body(trimesh.creation.icosphere(2, radius=0.5), material="jelly", name="two")
    simulation = gf_usd.simulate(scene, frames=1, particles=200, stress=True)
    (frame,) = simulation
    of = simulation.body_of_particles
    assert [simulation.bodies[k] for k in np.unique(of)] == ["one", "two"]
    # jelly has 1000 kg/m^3; the polyhedron's volume is the mesh's own
    two = trimesh.creation.icosphere(2, radius=0.5).volume * 1000.0
    masses = simulation.masses
    assert masses[of == 0].sum() == pytest.approx(500.0, rel=1e-3)
    assert masses[of == 1].sum() == pytest.approx(two, rel=1e-3)
    assert frame.stress is not None
    assert set(frame.meshes) == {"one", "two"}


def test_leaving_early_and_closing() -> None:
    with gf_usd.simulate(alone(), frames=10, particles=100) as simulation:
        for frame in simulation:
            if frame.index == 1:
                break
    assert list(simulation) == []
    with pytest.raises(gf_usd.UsageError, match="the simulation is closed"):
        simulation.push(np.zeros((100, 3)))


def test_a_simulation_that_was_closed_before_its_first_frame_has_no_state() -> None:
    simulation = gf_usd.simulate(alone(), frames=2, particles=100)
    with pytest.raises(gf_usd.UsageError, match="the simulation has not started"):
        simulation.save()
    simulation.close()
    with pytest.raises(gf_usd.UsageError, match="the simulation is closed"):
        simulation.save()


@pytest.mark.slow
def test_a_simulation_whose_taichi_was_restarted_is_a_usage_error() -> None:
    one = gf_usd.simulate(alone(), frames=3, particles=100, threads=1)
    next(one)
    other = gf_usd.simulate(alone(), frames=3, particles=100, threads=2)
    with pytest.raises(gf_usd.UsageError, match="Taichi was restarted"):
        next(one)
    assert next(other).index == 0


def push_one_by_nan(simulation: gf_usd.Simulation) -> None:
    forces = np.zeros((len(simulation.masses), 3))
    forces[7, 1] = np.nan
    simulation.push(forces)


WRONG = gf_usd.Material(
    name="wrong", law="corotated", density=1e3, youngs_modulus=-1.0, poissons_ratio=0.3
)
MISUSES: list[tuple[Any, str]] = [
    (lambda s: gf_usd.Scene(up="X"), "up is 'X'"),
    (lambda s: gf_usd.Scene(floor=np.nan), "floor is nan"),
    (lambda s: gf_usd.Scene(gravity=(0, 1)), "gravity is (0, 1), of type tuple"),
    (lambda s: gf_usd.Scene(floor="0"), "floor is '0', of type str"),
    (lambda s: s.add_body(UNIT), "has points but no faces"),
    (lambda s: s.add_body("mug.glb"), "body body0: points is 'mug.glb', of type str"),
    (lambda s: s.add_body(trimesh.creation.box().scene()), "points is a Scene of trimesh"),
    (lambda s: s.add_body(UNIT[:, :2], FACES), "points is an array of shape (8, 2)"),
    (lambda s: s.add_body(UNIT * np.nan, FACES), "8 of 8 points are not finite"),
    (lambda s: s.add_body(UNIT, [[0, 1, 8]]), "a face refers to point 8, but there are 8"),
    (lambda s: s.add_body(UNIT, [[0, 1]]), "the smallest with 2 corners"),
    (lambda s: s.add_body(UNIT, [[0.0, 1.0, 2.0]]), "a face is [0.0, 1.0, 2.0]"),
    (lambda s: s.add_body(UNIT, FACES, material="ruber"), "there is no material 'ruber'"),
    (lambda s: s.add_body(UNIT, FACES, material=WRONG), "youngs_modulus is -1"),
    (lambda s: s.add_body(UNIT, FACES, name="block"), "already has a block"),
    (lambda s: s.add_body(UNIT, FACES, name="a b"), "name is 'a b'"),
    (lambda s: s.add_body(UNIT, FACES, velocity=3.0), "velocity is 3.0, of type float"),
    (lambda s: s.add_obstacle(UNIT, FACES, friction=-1.0), "friction is -1"),
    (lambda s: s.pin((0, 0, 0), (0, 1, 1)), "has no volume"),
    (lambda s: s.pin((0, 0, 0), (1, 1, 1), axes=(False, False, False)), "axes is"),
    (lambda s: s.pin((0, 0, 0), (1, 1, 1), axes=True), "axes is True, of type bool"),
    (lambda s: s.pin((0, 0, 0), (1, 1, 1), axes="xyz"), "axes is 'xyz', of type str"),
    (lambda s: s.pin((0, 0, 0), (1, 1, 1), axes=("x", "y", "z")), "axes is ('x', 'y', 'z')"),
    (lambda s: s.pin((0, 0, 0), (1, 1, 1), axes=np.ones((3, 2), bool)), "axes is"),
    (lambda s: gf_usd.Scene(up=["Y"]), "up is ['Y']"),
    (lambda s: s.add_body(UNIT, FACES, material=["clay"]), "material is ['clay'], of type list"),
    (lambda s: s.add_body(UNIT * 1j, FACES), "body body0: points is array"),
    (lambda s: gf_usd.simulate(s, self_contact="yes"), "self_contact is 'yes', of type str"),
    (lambda s: gf_usd.simulate(s, filter_rate="x"), "filter_rate is 'x', of type str"),
    (lambda s: gf_usd.simulate(s, device=None), "device is None"),
    (
        lambda s: (s.add_body(UNIT * 1e6, FACES), gf_usd.simulate(s, particles=100)),
        "</block> is 1 m wide, too small to fill with cells of",
    ),
    (lambda s: gf_usd.simulate(of_size(1e18), particles=100), "the bodies would weigh"),
    (lambda s: gf_usd.simulate(of_size(1e-14), particles=100), "a particle would weigh"),
    (
        lambda s: (s.add_body(UNIT * 1e12, FACES), gf_usd.simulate(s, particles=100)),
        "</block> is 1 m wide, too small to fill with",
    ),
    (lambda s: gf_usd.simulate("duck.usda"), "scene is 'duck.usda', of type str"),
    (lambda s: gf_usd.simulate(gf_usd.Scene()), "the scene has no body"),
    (lambda s: gf_usd.simulate(s, frames=0), "frames is 0"),
    (lambda s: gf_usd.simulate(s, particle=3), "simulate() has no option 'particle'"),
    (lambda s: gf_usd.simulate(s, particles=100).accelerate("x"), "acceleration is 'x', of type"),
    (lambda s: gf_usd.simulate(s, particles=100).accelerate(1.0), "acceleration has the shape ()"),
    (
        lambda s: gf_usd.simulate(s, particles=100).set_velocities(1.0),
        "velocities has the shape ()",
    ),
    (lambda s: gf_usd.simulate(s, particles=100).push("x"), "forces is 'x', of type str"),
    (lambda s: gf_usd.simulate(s, particles=100).push(1.0), "forces has the shape ()"),
    (
        lambda s: push_one_by_nan(gf_usd.simulate(s, particles=100)),
        "forces has 1 row that is not finite",
    ),
    (
        lambda s: gf_usd.simulate(s, particles=100).set_velocities((0.0, np.inf, 0.0)),
        "velocities is not finite",
    ),
    (lambda s: gf_usd.simulate(s, particles=100).load(None), "was not made by save()"),
    (lambda s: gf_usd.simulate(s, particles=100, spacing=0.1), "particles=100 and spacing=0.1"),
    (lambda s: gf_usd.simulate(s, device="tpu"), "there is no device 'tpu'"),
    (lambda s: (s.pin((5, 5, 5), (6, 6, 6)), gf_usd.simulate(s)), "pin0 touches no body"),
]


@pytest.mark.parametrize(("call", "message"), MISUSES, ids=[message for _, message in MISUSES])
def test_a_scene_that_makes_no_sense_is_refused(call: Any, message: str) -> None:
    with pytest.raises(gf_usd.GfUsdError) as caught:
        call(alone())
    assert message in caught.value.message
    assert caught.value.hint


@pytest.mark.parametrize(
    ("motion", "message"),
    [
        (np.eye(4), "its motion is an array of shape (4, 4)"),
        (np.eye(4)[None], "its motion has 1 frame, but 3 are simulated"),
        (lambda time: np.eye(3), "its motion is an array of shape (3, 3, 3)"),
        (np.full((3, 4, 4), np.nan), "its motion is not finite"),
        (
            np.array([np.eye(4), np.eye(4), np.eye(4) + np.eye(4, k=-3)]),
            "the last row of its matrix 2 is (1, 0, 0, 1)",
        ),
    ],
)
def test_a_motion_that_is_none_is_refused(motion: Any, message: str) -> None:
    scene = alone()
    scene.add_obstacle(UNIT, FACES, motion=motion)
    with pytest.raises(gf_usd.UsageError) as caught:
        gf_usd.simulate(scene, frames=3)
    assert message in caught.value.message


def test_a_scene_and_a_simulation_are_shown_with_what_they_hold() -> None:
    scene = alone(floor=0.0)
    assert repr(scene) == "Scene(bodies=('block',), obstacles=(), pins=())"
    scene.add_obstacle(UNIT - [0.0, 5.0, 0.0], FACES, name="step")
    scene.pin((0, 0, 0), (1, 1, 1))
    assert repr(scene) == "Scene(bodies=('block',), obstacles=('step',), pins=('pin0',))"
    with gf_usd.simulate(alone(), frames=3, particles=100) as simulation:
        count = len(simulation.masses)
        assert repr(simulation) == f"Simulation(next frame 0 of 3, particles={count})"
        next(simulation)
        assert repr(simulation) == f"Simulation(next frame 1 of 3, particles={count})"
    assert repr(simulation) == "Simulation(closed)"


def test_a_body_that_begins_below_the_floor_is_refused() -> None:
    with pytest.raises(gf_usd.UsageError, match=r"a body starts 50 cm below the floor"):
        gf_usd.simulate(alone(floor=1.5), particles=100)


@pytest.mark.slow
def test_a_body_is_converted_and_another_is_not() -> None:
    scene = gf_usd.Scene()
    for name, x in (("one", 0.0), ("other", 3.0)):
        scene.add_body(UNIT + [x, 0.0, 0.0], FACES, material="rubber", name=name)
    becomes = "/one=dry-sand@time:3"
    frames = list(gf_usd.simulate(scene, frames=6, particles=200, conversions=becomes))
    assert [sorted(f.meshes) for f in frames] == [["one", "other"]] * 4 + [["other"]] * 2
    assert [int(f.converted.sum()) for f in frames] == [
        0,
        0,
        0,
        0,
        *[len(frames[0].positions) // 2] * 2,
    ]
    for k, frame in enumerate(frames):
        fallen = 0.5 * G * (k / FPS) ** 2
        assert frame.health.center[1] == pytest.approx(1.5 - fallen, abs=ROUNDING)
    with pytest.raises(gf_usd.UsageError, match="does not flow without limit"):
        gf_usd.simulate(scene, conversions="rubber@time:3")
