"""The particles of a bake divided among its solid and its flowing bodies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from solids import cube, solid

from gf_usd.core.errors import InputError
from gf_usd.core.frames.particles import CellCopies, SurfaceSamples
from gf_usd.core.materials.conversion import TIME, Conversion, Limit
from gf_usd.core.materials.presets import find_preset
from gf_usd.core.stage import ContactSetup, Pin
from gf_usd.geometry.sampling.particles import sample_solid
from gf_usd.physics.coupled.parts import flowing_bodies, part_of, passes, solid_setup
from gf_usd.prepare.bodies.contact import skins

OF = np.arange(4)
MADE = solid(*(cube((1.5 * k, 0.0, 0.0), path=f"/Body{k}") for k in OF))
TABLE = [find_preset(name).material(0.6, None) for name in ("rubber", "dry-sand")]
FLOWS = np.array([True, False, True, False])


def four():
    """Four cubes, the first and the third of which flow."""
    filled = sample_solid(MADE, particles=200, spacing=None, seed=0, bodies=OF)
    body = OF[filled.surface]
    copies = CellCopies(
        h=1.0, cell=np.zeros((4, 3), int), body=OF, links=np.array([[0, 0], [1, 3]]), of=body
    )
    return replace(filled, body=body, material=FLOWS[body].astype(int), copies=copies)


def parts():
    particles = four()
    samples = SurfaceSamples(X=particles.X, area=np.ones(len(particles)), body=particles.body)
    points = {f"/Body{k}": MADE.surfaces[k].points for k in OF}
    on = {f"/Body{k}": int(k) for k in OF}
    return particles, [
        part_of(which, particles, samples, points, on, {}, copied=copied)
        for which, copied in ((~FLOWS, True), (FLOWS, False))
    ]


def test_every_particle_is_in_one_part_and_bodies_are_numbered_anew() -> None:
    particles, (hold, flow) = parts()
    assert np.array_equal(np.sort(np.concatenate([hold.at, flow.at])), np.arange(len(particles)))
    for part, bodies in ((hold, [1, 3]), (flow, [0, 2])):
        assert part.bodies.tolist() == bodies
        assert np.array_equal(part.particles.X, particles.X[part.at])
        assert set(part.particles.body.tolist()) == {0, 1}
        assert part.particles.volume == pytest.approx(2.0)
        assert np.array_equal(part.samples.X, part.particles.X)
        assert list(part.embedded) == [f"/Body{k}" for k in bodies]
        assert list(part.embedded_body.values()) == [0, 1]
    assert hold.velocity([1, 2, 3, 4]) == [2, 4]
    assert flow.velocity((0.0, 1.0, 0.0)) == (0.0, 1.0, 0.0)


def test_copies_of_cells_go_with_their_bodies() -> None:
    _, (hold, flow) = parts()
    copies = hold.particles.copies
    assert copies is not None
    assert copies.body.tolist() == [0, 1]
    assert copies.links.tolist() == [[0, 1]]
    assert np.array_equal(copies.of, hold.particles.body)
    assert flow.particles.copies is None


def test_pins_of_a_body_have_its_new_number() -> None:
    """They had the number among all bodies, and held another one or none."""
    _, (hold, _) = parts()
    everywhere = Pin(
        name="box", inside=lambda X: X[:, 0] > -np.inf, nearest=lambda X: X,
        anchors=np.zeros((1, 3)), path=np.zeros((1, 1, 3)),
    )  # fmt: skip
    mine = hold.pins([replace(everywhere, body=3), everywhere])
    assert [pin.body for pin in mine] == [1, None]
    with pytest.raises(InputError, match="the pin box is part of a body that flows"):
        hold.pins([replace(everywhere, body=2)])


def test_a_body_flows_where_a_part_of_it_does_or_can_be_converted() -> None:
    particles = four()
    assert np.array_equal(flowing_bodies(particles, TABLE), FLOWS)
    mixed = np.array(particles.material)
    mixed[np.flatnonzero(particles.body == 1)[0]] = 1
    assert flowing_bodies(replace(particles, material=mixed), TABLE).tolist() == [1, 1, 1, 0]
    last = np.flatnonzero(particles.body == 3)[:2]
    becomes = Conversion(particles=last, material=1, limit=Limit(kind=TIME, value=3.0))
    ready = replace(particles, conversions=(becomes,))
    which = flowing_bodies(ready, TABLE)
    assert which.tolist() == [1, 0, 1, 1]
    samples = SurfaceSamples(X=ready.X, area=ready.V0, body=ready.body)
    flow = part_of(which, ready, samples, {}, {}, {}, copied=False)
    (mine,) = flow.particles.conversions
    assert np.array_equal(flow.at[mine.particles], last)
    hold = part_of(~which, ready, samples, {}, {}, {}, copied=False)
    assert hold.particles.conversions == ()


def test_pairs_without_contact_are_converted_to_the_parts() -> None:
    _, (hold, flow) = parts()
    setup = ContactSetup(
        skins=skins(MADE, OF), through=frozenset({(1, 3), (2, 3)}),
        self_contact=frozenset({0, 1}),
    )  # fmt: skip
    own = solid_setup(setup, hold)
    assert own.flows
    assert own.any
    assert own.through == {(0, 1)}
    assert own.self_contact == {0}
    through = passes(setup, hold, flow)
    assert list(through) == [1], "the second solid body, and there is no obstacle"
    assert np.array_equal(through[1], flow.samples.body == 1)
