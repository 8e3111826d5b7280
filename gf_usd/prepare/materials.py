"""The material of every part of every body: of the look that was asked for, or of the stage.

A look is made for a body's own size, so that bodies of several sizes have as many materials.

Values of particles of their own: materials blended where they meet, and painted values.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import Surface
from gf_usd.core.errors import InputError, UsageError
from gf_usd.core.frames import Particles, columns, of_materials, summary, with_derived
from gf_usd.core.materials.dimensionless import DimensionlessPreset
from gf_usd.core.materials.laws import LAWS, flowing_law, law_parameters
from gf_usd.core.materials.material import Material, lame
from gf_usd.core.materials.presets import Fixed, find_preset
from gf_usd.core.stage import BodyPhysics, PhysicsMaterialSpec, StageSpec, SubsetMaterial
from gf_usd.prepare.bodies import BodyPlan
from gf_usd.prepare.regions import Region

if TYPE_CHECKING:
    from gf_usd.geometry.solid import Solid


FLOW = frozenset(p.name for p in law_parameters() if p.required)  # asks for a law that flows
AUTHORED = "authored"  # the look of a stage whose prims do not all ask for the same
SAME = 1e-3  # relative: materials that differ by less are one


@dataclass(frozen=True, kw_only=True)
class MaterialPart:
    """A part of a body that has one material: a surface, some of its faces, or a region."""

    surface: int  # into Solid.surfaces
    subset: SubsetMaterial | None = None
    region: Region | None = None


@dataclass(frozen=True)
class Authored:
    """The look that the stage's own materials make, in the clothes of a preset."""

    name: str


def material_parts(
    solid: Solid, spec: StageSpec, regions: Sequence[Region] = ()
) -> list[MaterialPart]:
    """The parts, first the surfaces in their order, last those in regions."""
    found = [MaterialPart(surface=k) for k in range(len(solid.surfaces))]
    for k, surface in enumerate(solid.surfaces):
        body = spec.bodies.get(surface.path)
        found += [MaterialPart(surface=k, subset=one) for one in (body.subsets if body else ())]
    return found + [
        MaterialPart(surface=k, region=r) for r in regions for k in range(len(solid.surfaces))
    ]


def in_regions(slot: Ints, particles: Particles, parts: Sequence[MaterialPart], of: Ints) -> Ints:
    """(N,) part of each particle, with those in regions in parts of their own.

    slot : of `part_of_particles`; of : (N,) of `material_regions.owners`.
    """
    first = next((k for k, part in enumerate(parts) if part.region is not None), len(parts))
    surfaces = 1 + max(part.surface for part in parts)
    return np.where(of < 0, slot, first + of * surfaces + np.asarray(particles.surface))


def part_of_particles(solid: Solid, particles: Particles, parts: Sequence[MaterialPart]) -> Ints:
    """(N,) part of each particle: of the nearest surface, or of the nearest face's subset."""
    out = np.asarray(particles.surface).copy()
    divided = {slot.surface for slot in parts if slot.subset}
    if not divided:
        return out
    from gf_usd.geometry.surface import nearest

    at = nearest(solid, particles.X)
    of_triangle = part_of_triangles(solid, parts)
    for k in divided:
        mine = np.flatnonzero(at.surface == k)
        out[mine] = of_triangle[k][at.triangle[mine]]
    return out


def part_of_triangles(solid: Solid, parts: Sequence[MaterialPart]) -> list[Ints]:
    """For each surface (T,) the part of each row of `Surface.triangles`."""
    out = []
    for k, surface in enumerate(solid.surfaces):
        last = np.cumsum(surface.face_counts)
        face = np.searchsorted(last, surface.triangle_corners[:, 0], side="right")
        of = np.full(len(face), k)
        for number, slot in enumerate(parts):
            if slot.surface == k and slot.subset:
                of[np.isin(face, slot.subset.faces)] = number
        out.append(of)
    return out


def variant_name(spec: StageSpec, surfaces: Sequence[Surface]) -> str:
    """What the stage's own materials are called together."""
    names = set().union(*(_own_names(surface, spec) for surface in surfaces))
    return names.pop() if len(names) == 1 else AUTHORED


def _own_names(surface: Surface, spec: StageSpec) -> set[str]:
    bake, body = spec.bakes.get(surface.path), spec.bodies.get(surface.path)
    own = bake.material if bake is not None and bake.material else ""
    if not own and body is not None and body.material:
        own = body.material.name
    subsets = [one for one in (body.subsets if body else ()) if one.material is not None]
    names = {one.material.name for one in subsets if one.material is not None}
    if not subsets or len(np.unique(np.concatenate([s.faces for s in subsets]))) < len(
        surface.face_counts
    ):
        names.add(own or (AUTHORED if surface.path in spec.painted else "rubber"))
    return names


def table(
    look: Any,
    parts: Sequence[MaterialPart],
    slot: Ints,
    particles: Particles,
    solid: Solid,
    bodies: BodyPlan,
    spec: StageSpec,
    finish: Callable[[Any, float], Material],
) -> tuple[tuple[Material, ...], Ints]:
    """The materials of a look, and (N,) which of them each particle has.

    look : `Authored`, or a preset for every part that is in no region; slot : (N,) of
    `part_of_particles`; finish : the material of a preset on a body of radius [m], with what the
    command line says.
    """
    made: list[Material] = []
    for part in parts:
        surface = solid.surfaces[part.surface]
        radius = float(bodies.radius[bodies.of_surface[part.surface]])
        if part.region is not None:
            made.append(finish(find_preset(part.region.material), radius))
        elif isinstance(look, Authored):
            made.append(_authored(surface.path, part, radius, spec, finish))
        else:
            made.append(finish(look, radius))
    if isinstance(look, Authored):
        made = _with_masses(made, parts, slot, particles, solid, spec)
    kept: list[Material] = []
    index = np.zeros(len(made), np.int64)
    used = np.bincount(slot, minlength=len(made)) > 0
    for k, one in enumerate(made):
        if not used[k]:
            continue
        near = [j for j, other in enumerate(kept) if _alike(one, other)]
        index[k] = near[0] if near else len(kept)
        if not near:
            kept.append(one)
    return tuple(kept), index[slot]


def _authored(
    path: str,
    part: MaterialPart,
    radius: float,
    spec: StageSpec,
    finish: Callable[[Any, float], Material],
) -> Material:
    bake, body = spec.bakes.get(path), spec.bodies.get(path)
    if part.subset is None and bake is not None and bake.material:
        return finish(find_preset(bake.material), radius)
    advice = spec.advice.get(path)
    name = advice.material if advice is not None and advice.by != "stage" else "rubber"
    base: Any = find_preset(bake.material if bake is not None and bake.material else name)
    stated = part.subset.spec.density if part.subset else None
    if stated is None and body is not None:
        stated = body.spec.density if body.density is None else body.density
    if stated is not None and isinstance(base, DimensionlessPreset):
        base = replace(base, density=stated)  # a look's moduli go with its density
    made = finish(base, radius)
    if part.subset is not None and body is not None:
        made = part.subset.resolve(body.resolve(made), body.density)
    elif body is not None:
        made = body.resolve(made)
    own = _own_spec(part, body)
    if own is None or own.law is None:
        painted = spec.painted.get(path, {}).keys() & FLOW
        made = replace(made, law=flowing_law(painted, made.law))
    return made


def _own_spec(part: MaterialPart, body: BodyPhysics | None) -> PhysicsMaterialSpec | None:
    """What the stage's own material of a part says; None where it has none."""
    if part.region is not None or body is None:
        return None
    return part.subset.spec if part.subset else body.spec


def flow_notes(
    look: Any,
    law: str | None,
    parts: Sequence[MaterialPart],
    materials: Mapping[int, Material],
    solid: Solid,
    spec: StageSpec,
) -> tuple[str, ...]:
    """Where a yield stress is stated: which law was chosen for it, or that none uses it.

    look : as of `table`; law : that the command asks for; materials : of the parts that have
    particles, by their place in parts.
    """
    notes = list(look.notes) if isinstance(look, Fixed) else []
    for k, material in materials.items():
        part, path = parts[k], solid.surfaces[parts[k].surface].path
        painted = spec.painted.get(path, {}).keys() & FLOW
        own = _own_spec(part, spec.bodies.get(path)) if isinstance(look, Authored) else None
        stated = own.parameters.keys() & FLOW if own else set()
        if not LAWS[material.law].flows and (painted or material.parameters.keys() & FLOW):
            notes.append(
                f"<{path}>: a yield stress is stated and not used, because the law {material.law}"
                " does not flow: --law vonMises does"
            )
        elif law is None and stated and own and own.law is None:
            notes.append(f"<{own.path}>: a yield stress is stated and no law: {material.law}")
        elif law is None and painted and not stated and (own is None or own.law is None):
            notes.append(f"<{path}>: a yield stress is painted: the law is {material.law}")
    return tuple(dict.fromkeys(notes))


def require_parameters(
    path: Path,
    particles: Particles,
    slot: Ints,
    materials: Mapping[int, Material],
    solid: Solid,
    spec: StageSpec,
) -> None:
    """Raise InputError where a law asks for what neither its material nor paint states.

    path : of the asset, for messages; slot, materials : as of `table` and `flow_notes`.
    """
    for k, material in materials.items():
        for p in LAWS[material.law].parameters:
            if not p.required or p.name in material.parameters:
                continue
            bare = [p.name not in spec.painted.get(s.path, {}) for s in solid.surfaces]
            mine = np.flatnonzero(slot == k)
            found = mine[np.array(bare)[_nearest_surface(solid, particles)[mine]]]
            if len(found):
                surface = solid.surfaces[int(particles.surface[found[0]])]
                raise InputError(
                    f"{path}: <{surface.path}>: the law {material.law} asks for a"
                    f" {p.label.lower()}, and {material.name} (Young's modulus"
                    f" {material.youngs_modulus:.3g} Pa) states none",
                    f"author gaussianFlesh:{p.attribute} on a material or paint it as a primvar,"
                    " or take a material that flows, such as clay or mild-steel",
                )


SPREADS = 3.0  # times its Young's modulus: weight that presses a body flat
FLAT = 100.0  # times: there is no such body


def require_standing(
    path: Path,
    materials: Sequence[Material],
    height: float,
    gravity: float,
) -> tuple[str, ...]:
    """Notes on materials that cannot carry bodies of this height.

    The weight of a column, rho g H, over Young's modulus E is the strain at its foot, were it
    small.  Jelly has 1.1 by design: it spreads on the floor and keeps a third of its height.
    height : H [m] of the tallest body along gravity [m/s^2].

    Raises InputError where the ratio is FLAT and more.
    """
    notes = []
    for material in dict.fromkeys(materials):
        weight = material.density * gravity * height
        ratio = weight / material.youngs_modulus
        if ratio < SPREADS:
            continue
        said = (
            f"{material.name} cannot carry itself: {height:.3g} m of it weigh {weight:.3g} Pa,"
            f" {ratio:.3g} times its Young's modulus of {material.youngs_modulus:.3g} Pa"
        )
        change = f"a Young's modulus of {weight:.2g} Pa"
        if ratio >= FLAT:
            raise InputError(
                f"{path}: {said}",
                f"take {change} or more, a preset such as jelly, whose stiffness grows with the"
                " body, or check the unit (--meters-per-unit)",
            )
        notes.append(f"{said}, so that it spreads on the floor; {change} would hold its shape")
    return tuple(notes)


def mass_scaled(
    tables: Sequence[tuple[Material, ...]], particles: Particles, factor: float
) -> tuple[list[tuple[Material, ...]], Particles, tuple[str, ...]]:
    """Materials that flow with a `factor`-th of their elastic moduli, and notes on that.

    Density, weight, speeds, and with them the energy of an impact stay, and so does the stress at
    which it yields: the shape that is left is the same as long as elastic strains are small.  The
    same motion has a body of `factor` times the density and strength.  Inertia alone would not do:
    with the true weight the motion is the true one slowed down by the root of the factor, so that
    longer steps have as much longer to go.

    Raises UsageError where no material flows.
    """
    if factor == 1.0:
        return list(tables), particles, ()
    seen = {m.name: m for table in tables for m in table if LAWS[m.law].flows}
    if not seen:
        laws = {m.name: m.law for table in tables for m in table}
        raise UsageError(
            f"--mass-scaling {factor:g}: no material of the bake flows: "
            + ", ".join(f"{name} is {law}" for name, law in laws.items()),
            "leave it out: the shape of an elastic body is that of its stiffness",
        )
    own = particles.own
    if own is not None:
        flows = np.array([LAWS[m.law].flows for m in tables[0]])[np.asarray(particles.material)]
        share = np.where(flows, 1.0 / factor, 1.0)
        own = {**own, "mu": own["mu"] * share, "lam": own["lam"] * share}
    notes = [
        f"--mass-scaling {factor:g}: {m.name} has a Young's modulus of"
        f" {m.youngs_modulus / factor:.3g} Pa in place of {m.youngs_modulus:.3g} Pa"
        + (
            f", and yields at an elastic strain of {100.0 * factor * strain:.2g} % in place of"
            f" {100.0 * strain:.2g} %"
            if (strain := m.yield_strain) is not None else ""
        )
        + "; mass, weight and yield stress stay"
        for m in seen.values()
    ]  # fmt: skip
    scaled = [
        tuple(
            replace(m, youngs_modulus=m.youngs_modulus / factor) if LAWS[m.law].flows else m
            for m in table
        )
        for table in tables
    ]
    return scaled, replace(particles, own=own), tuple(notes)


def _nearest_surface(solid: Solid, particles: Particles) -> Ints:
    """(N,) the surface that each particle is nearest to."""
    from gf_usd.geometry.surface import nearest

    return nearest(solid, particles.X).surface


def _with_masses(
    made: list[Material],
    parts: Sequence[MaterialPart],
    slot: Ints,
    particles: Particles,
    solid: Solid,
    spec: StageSpec,
) -> list[Material]:
    """Densities such that what states a mass has it; moduli stay."""
    volume = np.bincount(slot, particles.V0, minlength=len(made))
    groups: dict[str, list[int]] = {}
    mass: dict[str, float] = {}
    for k, part in enumerate(parts):
        body = spec.bodies.get(solid.surfaces[part.surface].path)
        if body is not None and body.mass is not None:
            groups.setdefault(body.mass_of, []).append(k)
            mass[body.mass_of] = body.mass
    for owner, members in groups.items():
        now = float(sum(made[k].density * volume[k] for k in members))
        for k in members if now > 0.0 else ():
            made[k] = replace(made[k], density=made[k].density * mass[owner] / now)
    return made


def _alike(one: Material, other: Material) -> bool:
    if (one.name, one.law) != (other.name, other.law):
        return False
    a, b = (
        np.array([v for v in m.values.values() if not isinstance(v, str)], float)
        for m in (one, other)
    )
    return bool(np.allclose(a, b, rtol=SAME, atol=0.0))


def stated_spacing(spec: StageSpec, volumes: Mapping[str, float]) -> tuple[float | None, str]:
    """Spacing [m] that the stage asks for, and a note where it asks for several: the finest.

    volumes : [m^3] of each surface, by prim path.
    """
    asked: dict[str, float] = {}
    groups: dict[str, tuple[int, float]] = {}
    for path, bake in spec.bakes.items():
        if bake.spacing is not None:
            asked[path] = bake.spacing
        elif bake.particles is not None:
            count, volume = groups.get(bake.particles_of, (bake.particles, 0.0))
            groups[bake.particles_of] = count, volume + volumes.get(path, 0.0)
    asked |= {p: float(np.cbrt(v / n)) for p, (n, v) in groups.items() if v > 0.0}
    if not asked:
        return None, ""
    path, finest = min(asked.items(), key=lambda item: item[1])
    several = max(asked.values()) > (1.0 + SAME) * finest
    note = (
        f"a bake has one spacing: the {finest:.4g} m of <{path}> holds for all" if several else ""
    )
    return finest, note


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
    """The particles with values of their own, where they have any, and notes on that.

    materials : of `body_materials.table`; slot : (N,) of `part_of_particles`; width : [m] over
    which materials of a body turn into each other, 0: at once.
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
        f"{seen['particles']} of {len(particles)} particles have material values of their own:"
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
    body = np.zeros(len(particles), np.int64) if particles.body is None else particles.body
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
    """The values with what is painted on the nearest point of the surface in their place.

    Painted moduli leave the density as it is and the other way round; of Young's modulus and
    Poisson's ratio the one that is not painted stays.
    """
    from gf_usd.geometry.surface import nearest

    at = nearest(solid, particles.X)
    full = with_derived(values)
    young, nu, density = (
        full[name].copy() for name in ("youngs_modulus", "poissons_ratio", "density")
    )
    own = {p.name: values[p.name].copy() for p in law_parameters() if p.name in values}
    touched = np.zeros(len(particles), bool)
    for k, surface in enumerate(solid.surfaces):
        mine = np.flatnonzero(at.surface == k)
        said = spec.painted.get(surface.path, {})
        corners = surface.triangle_corners[at.triangle[mine]]
        for name, column in (("youngs_modulus", young), ("poissons_ratio", nu)):
            if name in said:
                column[mine] = (said[name][corners] * at.barycentric[mine]).sum(1)
                touched[mine] = True
        for name, column in {"density": density, **own}.items():
            if name in said:
                column[mine] = (said[name][corners] * at.barycentric[mine]).sum(1)
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
    """Densities such that what states a mass has it all the same."""
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
