"""Divides the particles, samples and points of a bake into solid and flowing bodies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.errors import InputError
from gf_usd.core.frames.particles import CellCopies, Particles, SurfaceSamples
from gf_usd.core.materials.conversion import Conversion
from gf_usd.core.materials.material import Material
from gf_usd.core.materials.per_particle import convertible, unbounded
from gf_usd.core.stage import ContactSetup, Pin


@dataclass(frozen=True, kw_only=True)
class Part:
    """A subset of the bodies, with their data."""

    bodies: Ints  # (b,) numbers of the bodies among all, ascending
    at: Ints  # (n,) indices of the particles among all
    particles: Particles  # bodies are renumbered from 0
    samples: SurfaceSamples | None
    embedded: Mapping[str, Floats]
    embedded_body: Mapping[str, int]
    embedded_copy: Mapping[str, Ints]
    copies: Ints | None  # (K,) new numbers of the cell copies; -1: of other bodies

    def velocity(self, velocity: Any) -> Any:
        """The initial velocities of the part's bodies, as a solver takes them."""
        if not isinstance(velocity, list):
            return velocity
        mine = [velocity[k] for k in self.bodies]
        return mine if len(mine) > 1 else mine[0]

    def pins(self, pins: Sequence[Pin]) -> tuple[Pin, ...]:
        """Pins with the numbers of the part's bodies; raises InputError for one of others only."""
        number = {int(k): i for i, k in enumerate(self.bodies)}
        for pin in pins:
            of = pin.bodies if pin.body is None else {pin.body}
            if of and of.isdisjoint(number):
                raise InputError(
                    f"the pin {pin.name} is part of a body that flows, which cannot be pinned",
                    "leave it out, or give that body a solid --material",
                )
        return tuple(
            pin if pin.body is None else replace(pin, body=number[pin.body]) for pin in pins
        )


def flowing_bodies(particles: Particles, materials: Sequence[Material]) -> Ints:
    """(B,) which bodies are for the Updated Lagrangian solver: those that flow without limit in
    part, or can be converted.
    """
    flows = unbounded(particles, materials) | convertible(particles)
    return np.bincount(particles.body_of, flows) > 0.0


def part_of(
    which: Ints,
    particles: Particles,
    samples: SurfaceSamples | None,
    embedded: Mapping[str, Floats],
    embedded_body: Mapping[str, int],
    embedded_copy: Mapping[str, Ints],
    *,
    copied: bool,
) -> Part:
    """The part with the bodies (B,) `which`; copied : cells that limbs share stay copied."""
    body = particles.body_of
    at = np.flatnonzero(which[body])
    number = np.cumsum(which) - 1
    several = int(which.sum()) > 1
    copies, new = _copies(particles.copies, which, number, at) if copied else (None, None)
    names = [name for name in embedded if which[embedded_body.get(name, 0)]]

    def rows(values: Any) -> Any:
        return None if values is None else np.asarray(values)[at]

    def copy_of(values: Ints | None) -> Ints | None:
        return None if values is None or new is None else new[values]

    mine = None
    if samples is not None:
        of = np.zeros(len(samples.X), int) if samples.body is None else samples.body
        take = np.flatnonzero(which[of])
        mine = SurfaceSamples(
            X=samples.X[take],
            area=samples.area[take],
            normal=None if samples.normal is None else samples.normal[take],
            body=number[of[take]] if several else None,
            cell_copy=copy_of(None if samples.cell_copy is None else samples.cell_copy[take]),
        )
    V0 = rows(particles.V0)
    taken = replace(
        particles,
        **{name: rows(getattr(particles, name)) for name in PER_PARTICLE},
        volume=float(V0.sum()),
        corners=None if particles.corners is None else particles.corners[which],
        body=number[body[at]] if several else None,
        own=None if particles.own is None else {k: rows(v) for k, v in particles.own.items()},
        copies=copies,
        conversions=_conversions(particles.conversions, len(body), at),
    )
    if particles.corners is not None and not several:
        taken = replace(taken, corner=particles.corners[which][0], corners=None)
    return Part(
        bodies=np.flatnonzero(which),
        at=at,
        particles=taken,
        samples=mine,
        embedded={name: embedded[name] for name in names},
        embedded_body={name: int(number[embedded_body.get(name, 0)]) for name in names},
        embedded_copy={
            name: new[embedded_copy[name]] for name in names if new is not None
            and name in embedded_copy
        },
        copies=new,
    )  # fmt: skip


def _conversions(given: Sequence[Conversion], count: int, at: Ints) -> tuple[Conversion, ...]:
    """The conversions of particles `at` of `count`, with the new indices."""
    number = np.full(count, -1)
    number[at] = np.arange(len(at))
    found = [replace(one, particles=number[one.particles]) for one in given]
    found = [replace(one, particles=one.particles[one.particles >= 0]) for one in found]
    return tuple(one for one in found if len(one.particles))


def used_materials(
    particles: Particles, materials: Sequence[Material]
) -> tuple[Particles, tuple[Material, ...]]:
    """The particles with only those materials that they have or can be converted to, renumbered, so
    that kernels contain no unused law.
    """
    becomes = [one.material for one in particles.conversions]
    used = np.unique([*np.unique(particles.material), *becomes]).astype(np.int64)
    number = np.full(len(materials), -1)
    number[used] = np.arange(len(used))
    made = replace(
        particles,
        material=number[np.asarray(particles.material)],
        conversions=tuple(
            replace(one, material=int(number[one.material])) for one in particles.conversions
        ),
    )
    return made, tuple(materials[k] for k in used)


PER_PARTICLE = ("X", "V0", "material", "orientation", "scale", "color", "opacity", "surface")


def _copies(
    copies: CellCopies | None, which: Ints, number: Ints, at: Ints
) -> tuple[CellCopies | None, Ints | None]:
    """The cell copies of some bodies, and the new number of each; -1 for those of other bodies."""
    if copies is None:
        return None, None
    mine = which[copies.body]
    new = np.where(mine, np.cumsum(mine) - 1, -1)
    links = new[copies.links]
    return CellCopies(
        h=copies.h,
        cell=copies.cell[mine],
        body=number[copies.body[mine]],
        links=links[(links >= 0).all(1)],
        of=new[copies.of[at]],
    ), new


def solid_setup(setup: ContactSetup, solid: Part, copied: Ints | None = None) -> ContactSetup:
    """The possible contacts of the solid bodies; `copied` (K,) new numbers of the copies of
    cells.
    """
    number = {int(k): i for i, k in enumerate(solid.bodies)}
    skins = tuple(setup.skins[k] for k in solid.bodies)
    if copied is not None:
        skins = tuple(
            s if s.cell_copy is None else replace(s, cell_copy=copied[s.cell_copy]) for s in skins
        )
    return ContactSetup(
        skins=skins,
        colliders=setup.colliders,
        through=frozenset(
            (number[a], number[b]) for a, b in setup.through if a in number and b in number
        ),
        through_colliders=frozenset(
            (number[a], c) for a, c in setup.through_colliders if a in number
        ),
        self_contact=frozenset(number[k] for k in setup.self_contact if k in number),
        flows=True,
    )


def passing_obstacles(setup: ContactSetup, body: Ints) -> dict[int, Ints]:
    """By obstacle number, which samples pass through the obstacle; body : (n,) of each sample."""
    through = setup.through_colliders
    return {
        c: np.isin(body, [a for a, b in through if b == c]) for c in range(len(setup.colliders))
    }


def passes(setup: ContactSetup, solid: Part, flow: Part) -> dict[int, Ints]:
    """(n,) which samples of the flow pass through an obstacle, or a solid body (numbered after the
    obstacles), as the stage allows.
    """
    assert flow.samples is not None
    of = np.zeros(len(flow.samples.X), int) if flow.samples.body is None else flow.samples.body
    body, count = flow.bodies[of], len(setup.colliders)
    out = passing_obstacles(setup, body)
    for i, k in enumerate(solid.bodies):
        others = [a for a, b in setup.through if b == k] + [b for a, b in setup.through if a == k]
        out[count + i] = np.isin(body, others)
    return {number: rows for number, rows in out.items() if rows.any()}
