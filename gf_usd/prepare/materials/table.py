"""The material of every part: of a preset, or of the stage.

The material of a preset depends on a body's size, so bodies of several sizes have as many
materials.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from gf_usd.core.arrays import Ints
from gf_usd.core.asset import Surface
from gf_usd.core.frames.particles import Particles
from gf_usd.core.materials.dimensionless import DimensionlessPreset
from gf_usd.core.materials.laws import flowing_law, law_parameters
from gf_usd.core.materials.material import Material
from gf_usd.core.materials.presets import find_preset
from gf_usd.core.stage import BodyPhysics, PhysicsMaterialSpec, StageSpec
from gf_usd.prepare.bodies.plan import BodyPlan
from gf_usd.prepare.materials.parts import MaterialPart

if TYPE_CHECKING:
    from gf_usd.geometry.solid import Solid


FLOW = frozenset(p.name for p in law_parameters() if p.required)  # require a law that flows

AUTHORED = "authored"  # the variant of a stage whose prims have different materials

SAME = 1e-3  # relative: materials that differ by less are one


@dataclass(frozen=True)
class Authored:
    """The variant with the stage's own materials, with the interface of a preset."""

    name: str


def variant_name(spec: StageSpec, surfaces: Sequence[Surface]) -> str:
    """The name of the variant with the stage's own materials."""
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
    preset: Any,
    parts: Sequence[MaterialPart],
    slot: Ints,
    particles: Particles,
    solid: Solid,
    bodies: BodyPlan,
    spec: StageSpec,
    finish: Callable[[Any, float], Material],
) -> tuple[tuple[Material, ...], Ints]:
    """The materials of a variant, and (N,) the index of each particle's material.

    preset : `Authored`, or a preset for every part outside regions; slot : (N,) of
        `part_of_particles`; finish : the material of a preset for a body of radius [m], with the
        values of the options.
    """
    made: list[Material] = []
    for part in parts:
        surface = solid.surfaces[part.surface]
        radius = float(bodies.radius[bodies.of_surface[part.surface]])
        if part.region is not None:
            made.append(finish(find_preset(part.region.material), radius))
        elif isinstance(preset, Authored):
            made.append(authored(surface.path, part, radius, spec, finish))
        else:
            made.append(finish(preset, radius))
    if isinstance(preset, Authored):
        made = _with_masses(made, parts, slot, particles, solid, spec)
    kept: list[Material] = []
    index = np.zeros(len(made), np.int64)
    used = np.bincount(slot, minlength=len(made)) > 0
    for k, one in enumerate(made):
        if not used[k]:
            continue
        near = [j for j, other in enumerate(kept) if alike(one, other)]
        index[k] = near[0] if near else len(kept)
        if not near:
            kept.append(one)
    return tuple(kept), index[slot]


def authored(
    path: str,
    part: MaterialPart,
    radius: float,
    spec: StageSpec,
    finish: Callable[[Any, float], Material],
) -> Material:
    """The stage's material of a part of a surface, for a body of radius [m]."""
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
        base = replace(base, density=stated)  # the moduli of such a preset follow its density
    made = finish(base, radius)
    if part.subset is not None and body is not None:
        made = part.subset.resolve(body.resolve(made), body.density)
    elif body is not None:
        made = body.resolve(made)
    own = own_spec(part, body)
    if own is None or own.law is None:
        painted = spec.painted.get(path, {}).keys() & FLOW
        made = replace(made, law=flowing_law(painted, made.law))
    return made


def own_spec(part: MaterialPart, body: BodyPhysics | None) -> PhysicsMaterialSpec | None:
    """The stage's material specification of a part; None where it has none."""
    if part.region is not None or body is None:
        return None
    return part.subset.spec if part.subset else body.spec


def _with_masses(
    made: list[Material],
    parts: Sequence[MaterialPart],
    slot: Ints,
    particles: Particles,
    solid: Solid,
    spec: StageSpec,
) -> list[Material]:
    """Densities such that each part with a stated mass has this mass; moduli are unchanged."""
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


def alike(one: Material, other: Material) -> bool:
    """Whether two materials have one name, one law, and the same values up to SAME."""
    if (one.name, one.law) != (other.name, other.law):
        return False
    a, b = (
        np.array([v for v in m.values.values() if not isinstance(v, str)], float)
        for m in (one, other)
    )
    return bool(np.allclose(a, b, rtol=SAME, atol=0.0))
