"""Values per particle: materials blended at their boundaries, and painted values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.frames.particles import Particles
from gf_usd.core.materials.laws import law_parameters
from gf_usd.core.materials.material import Material, lame
from gf_usd.core.materials.per_particle import columns, of_materials, summary, with_derived
from gf_usd.core.stage import StageSpec
from gf_usd.prepare.bodies.plan import BodyPlan
from gf_usd.prepare.materials.parts import MaterialPart, part_of_triangles

if TYPE_CHECKING:
    from gf_usd.geometry.solid import Solid


def with_own_values(
    particles: Particles,
    materials: Sequence[Material],
    slot: Ints,
    parts: Sequence[MaterialPart],
    solid: Solid,
    bodies: BodyPlan,
    spec: StageSpec,
    width: float,
) -> tuple[Particles, tuple[str, ...]]:
    """The particles with values per particle, where they have any, and notes.

    materials : of `table.table`; slot : (N,) of `part_of_particles`; width : [m] over which
        materials of a body are blended, 0: not blended.
    """
    values, notes = None, []
    if width > 0.0:
        values = blended(particles, materials, slot, parts, solid, bodies, width)
        if values is None:
            notes.append("--blend-width changes nothing: no body has two materials")
    if spec.painted:
        values = painted(particles, values or of_materials(particles, materials), solid, spec)
    if values is None:
        return particles, tuple(notes)
    particles = replace(particles, own=_with_blended_masses(values, particles, solid, spec))
    seen = summary(particles, materials)
    low, high = seen["youngs_modulus"]
    least, most = seen["density"]
    notes.append(
        f"{seen['particles']} of {len(particles)} particles have painted or blended material"
        f" values:"
        f" Young's modulus {low:.4g} to {high:.4g} Pa, density {least:.4g} to {most:.4g} kg/m^3"
    )
    return particles, tuple(notes)


def blended(
    particles: Particles,
    materials: Sequence[Material],
    slot: Ints,
    parts: Sequence[MaterialPart],
    solid: Solid,
    bodies: BodyPlan,
    width: float,
) -> dict[str, Floats] | None:
    """(N,) of each of `columns`: the mean over the materials of a body, weighted by `part_weights`.

    None where no body has two materials.
    """
    from gf_usd.geometry.connected.bodies import part_weights

    material = np.asarray(particles.material)
    of_slot = {int(k): int(material[np.flatnonzero(slot == k)[0]]) for k in np.unique(slot)}
    material_parts = part_of_triangles(solid, parts)
    body = particles.body_of
    table = columns(materials)
    values = of_materials(particles, materials)
    several = False
    for b in range(bodies.count):
        mine = np.flatnonzero(body == b)
        kinds = np.unique(material[mine])
        if len(kinds) < 2:
            continue
        several = True
        members = np.flatnonzero(np.asarray(bodies.of_surface) == b)
        center = particles.X[mine].mean(0)
        meshes = [
            _faces_of(int(kind), members, of_slot, material_parts, solid, center) for kind in kinds
        ]
        weights = part_weights(particles.X[mine] - center, meshes, width)
        for name, column in table.items():
            values[name][mine] = weights @ column[kinds]
    return values if several else None


def _faces_of(
    kind: int,
    members: Ints,
    of_slot: dict[int, int],
    material_parts: Sequence[Ints],
    solid: Solid,
    center: Floats,
) -> tuple[Floats, Ints]:
    """Points about a center and triangles of the faces of one material, of the surfaces given."""
    points, faces, first = [], [], 0
    kinds = {s for s, owner in of_slot.items() if owner == kind}
    for k in members:
        has = np.isin(material_parts[k][solid.sources[k]], list(kinds))
        points.append(solid.surfaces[k].points - center)
        faces.append(solid.triangles[k][has] + first)
        first += len(points[-1])
    return np.concatenate(points), np.concatenate(faces)


def painted(
    particles: Particles, values: dict[str, Floats], solid: Solid, spec: StageSpec
) -> dict[str, Floats]:
    """The values, replaced by those painted on the particle's mesh, at its nearest point.

    Painted moduli do not change the density, and the reverse.  If only one of Young's modulus and
    Poisson's ratio is painted, the other is kept.
    """
    from gf_usd.geometry.surface import nearest

    full = with_derived(values)
    young, nu, density = (
        full[name].copy() for name in ("youngs_modulus", "poissons_ratio", "density")
    )
    own = {p.name: values[p.name].copy() for p in law_parameters() if p.name in values}
    touched = np.zeros(len(particles), bool)
    for k, surface in enumerate(solid.surfaces):
        paints = spec.painted.get(surface.path, {})
        mine = np.flatnonzero(np.asarray(particles.surface) == k)
        if not paints or not len(mine):
            continue
        at = nearest(solid.part(np.array([k])), particles.X[mine])
        corners = surface.triangle_corners[at.triangle]
        for name, column in (("youngs_modulus", young), ("poissons_ratio", nu)):
            if name in paints:
                column[mine] = (paints[name][corners] * at.barycentric).sum(1)
                touched[mine] = True
        for name, column in {"density": density, **own}.items():
            if name in paints:
                column[mine] = (paints[name][corners] * at.barycentric).sum(1)
    mu, lam = lame(young, nu)
    return {
        **values,
        **own,
        "density": density,
        # untouched particles keep their digits
        "mu": np.where(touched, mu, values["mu"]),
        "lam": np.where(touched, lam, values["lam"]),
    }


def _with_blended_masses(
    values: dict[str, Floats], particles: Particles, solid: Solid, spec: StageSpec
) -> dict[str, Floats]:
    """Densities such that each part with a stated mass has this mass."""
    density = values["density"].copy()
    owner = np.full(len(solid.surfaces), "", object)
    mass: dict[str, float] = {}
    for k, surface in enumerate(solid.surfaces):
        body = spec.bodies.get(surface.path)
        if body is not None and body.mass is not None:
            owner[k] = body.mass_of or surface.path
            mass[owner[k]] = body.mass
    for name, kilograms in mass.items():
        mine = owner[np.asarray(particles.surface)] == name
        now = float(density[mine] @ particles.V0[mine])
        if now > 0.0:
            density[mine] *= kilograms / now
    return {**values, "density": density}
