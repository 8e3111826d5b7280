"""Checks that materials are consistent: yield stresses and laws, weight and stiffness."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gf_usd.core.arrays import Ints
from gf_usd.core.errors import InputError, listed_paths
from gf_usd.core.frames.particles import Particles, times_as_long
from gf_usd.core.materials.laws import LAWS, stated_flow
from gf_usd.core.materials.material import Material
from gf_usd.core.materials.physical import PHYSICAL, PhysicalPreset
from gf_usd.core.materials.presets import Fixed
from gf_usd.core.mesh.measures import areas, signed_volume
from gf_usd.core.neighbors import kd_tree
from gf_usd.core.stage import StageSpec
from gf_usd.core.units import length_text, rounded_text
from gf_usd.prepare.materials.parts import MaterialPart
from gf_usd.prepare.materials.table import FLOW, Authored, alike, authored, own_spec

if TYPE_CHECKING:
    from gf_usd.geometry.solid import Solid


def flow_notes(
    preset: Any,
    law: str | None,
    parts: Sequence[MaterialPart],
    materials: Mapping[int, Material],
    solid: Solid,
    spec: StageSpec,
) -> tuple[str, ...]:
    """Notes where a yield stress is stated: which law was chosen for it, or that no law uses it.

    preset : as in `table`; law : of the options; materials : of the parts that have particles, by
        index of parts.
    """
    notes = list(preset.notes) if isinstance(preset, Fixed) else []
    for k, material in materials.items():
        part, path = parts[k], solid.surfaces[parts[k].surface].path
        painted = spec.painted.get(path, {}).keys() & FLOW
        own = own_spec(part, spec.bodies.get(path)) if isinstance(preset, Authored) else None
        stated = own.parameters.keys() & FLOW if own else set()
        if not LAWS[material.law].flows and (painted or material.parameters.keys() & FLOW):
            notes.append(
                f"<{path}>: the yield stress is not used, because the law {material.law}"
                " has no plastic flow: use --law vonMises"
            )
        elif law is None and stated and own and own.law is None:
            what = stated_flow(material.law)
            notes.append(f"<{own.path}>: {what} is stated but no law: {material.law} is used")
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
    """Raise InputError where a parameter of a law is neither stated nor painted.

    path : of the asset, for messages; slot, materials : as in `table` and `flow_notes`.
    """
    for k, material in materials.items():
        for p in LAWS[material.law].parameters:
            if not p.required or p.name in material.parameters:
                continue
            bare = [p.name not in spec.painted.get(s.path, {}) for s in solid.surfaces]
            mine = np.flatnonzero(slot == k)
            found = mine[np.array(bare)[np.asarray(particles.surface)[mine]]]
            if len(found):
                surface = solid.surfaces[int(particles.surface[found[0]])]
                raise InputError(
                    f"{path}: <{surface.path}>: the law {material.law} needs a"
                    f" {p.label.lower()}, and {material.name} (Young's modulus"
                    f" {material.youngs_modulus:.3g} Pa) has none",
                    f"author gaussianFlesh:{p.attribute} on a material or paint it as a primvar,"
                    " or use a plastic material, such as clay or mild-steel",
                )


SINGLE = np.finfo(np.float32)


def unused_notes(
    parts: Sequence[MaterialPart],
    particles: Particles,
    solid: Solid,
    spec: StageSpec,
    finish: Callable[[Any, float], Material],
    unit: float,
) -> tuple[str, ...]:
    """A note on meshes inside others whose material differs from that around them and that have no
    particle, so that it is not used.

    Meshes that are not inside others are poorly filled parts, which have notes of their own.

    finish : as in `table`; unit : [m] of the stage.
    """
    empty = np.flatnonzero(np.bincount(particles.surface, minlength=len(solid.surfaces)) == 0)
    if not len(empty):
        return ()

    def material(surface: int) -> Material:  # whether two differ does not depend on the size
        return authored(solid.surfaces[surface].path, parts[surface], 1.0, spec, finish)

    center = np.array([solid.surfaces[k].face_points.mean(axis=0) for k in empty])
    around = np.asarray(particles.surface)[kd_tree(particles.X).query(center)[1]]
    enclosed = solid.enclosed()
    lost = [
        k
        for k, other in zip(empty.tolist(), around.tolist())
        if solid.surfaces[k].path in enclosed and not alike(material(k), material(other))
    ]
    return (_unused_note(lost, particles, solid, unit),) if lost else ()


def _unused_note(lost: Sequence[int], particles: Particles, solid: Solid, unit: float) -> str:
    from gf_usd.geometry.thin.parts import SENSIBLE, filling_spacing

    surfaces = [(solid.surfaces[k].points, solid.triangles[k]) for k in lost]
    needed = min(
        filling_spacing(abs(signed_volume(*one)), float(areas(*one).sum())) for one in surfaces
    )
    one = len(lost) == 1
    paths = listed_paths([solid.surfaces[k].path for k in lost])
    digits = 10.0 ** (np.floor(np.log10(needed / unit)) - 1.0)
    finer = np.floor(needed / unit / digits * (1.0 + 1e-9)) * digits
    count = solid.volume / (finer * unit) ** 3
    longer = times_as_long(count, len(particles))
    cost = f"{rounded_text(count)} particles" + f", {longer}" * bool(longer)
    way = f"--spacing {rounded_text(finer)} ({cost})"
    way = f"{way} fills {'it' if one else 'all of them'}"
    if count > SENSIBLE:
        way = f"make {'it' if one else 'them'} larger, since only {way}"
    return (
        f"{paths} {'has' if one else 'have'} no particle, so that the material of the mesh around"
        f" is used there: too small for the spacing of {length_text(particles.spacing)}; {way}"
    )


def require_weighable(
    path: Path, particles: Particles, slot: Ints, materials: Sequence[Material]
) -> None:
    """Raise InputError where masses are beyond the range of single precision, which solvers and
    caches use.

    slot : (N,) of each particle in materials.
    """
    mass = np.array([m.density for m in materials])[slot] * particles.V0
    whole, least = float(mass.sum()), float(mass.min())
    most, smallest = float(SINGLE.max), float(SINGLE.tiny)
    if whole >= most or least <= smallest:
        what = (
            f"the bodies would weigh {whole:.3g} kg"
            if whole >= most
            else f"a particle would weigh {least:.3g} kg"
        )
        raise InputError(
            f"{path}: {what}, and single precision holds from {smallest:.2g} to"
            f" {most:.2g}; particles are {length_text(particles.spacing)} apart",
            "check the unit (--meters-per-unit) and the transforms of the asset",
        )


SPREADS = 3.0  # times its Young's modulus: weight that presses a body flat

FLAT = 100.0  # times: there is no such body


def require_standing(
    path: Path,
    materials: Sequence[Material],
    height: float,
    gravity: float,
    *,
    carried: bool = False,
) -> tuple[str, ...]:
    """Notes on materials that are too soft for bodies of this height.

    The weight of a column, rho g H, over Young's modulus E is the strain at its foot, for small
    strains.  Jelly has 1.1 by design: it spreads on the floor and keeps a third of its height.

    height : H [m] of the tallest body along gravity [m/s^2]. carried : bones support it, or there
        is no floor: it does not spread.
    Raises InputError where the ratio is FLAT or more.
    """
    notes = []
    for material in dict.fromkeys(materials):
        weight = material.density * gravity * height
        ratio = weight / material.youngs_modulus
        if ratio < SPREADS:
            continue
        problem = (
            f"{material.name} cannot carry its own weight: {length_text(height)} of it weigh"
            f" {weight:.3g} Pa,"
            f" {ratio:.3g} times its Young's modulus of {material.youngs_modulus:.3g} Pa"
        )
        change = f"a Young's modulus of {weight:.2g} Pa"
        if ratio >= FLAT:
            raise InputError(
                f"{path}: {problem}",
                f"take {change} or more, a preset such as jelly, whose stiffness grows with the"
                " body, or check the unit (--meters-per-unit)",
            )
        if not carried:
            notes.append(f"{problem}, so it spreads on the floor; {change} would keep its shape")
    return tuple(notes)


STIFF = 0.15  # strain in a fall below which a material is taken as one that hardly bends
FOLDS = 2.0  # [rad] by which it folds a slender part: four of the samples bend by less than 1
ADVISED = ("hard-rubber", "mild-steel")  # in its place


MOST_BENT = float(np.pi)  # [rad] up to which an angle is stated: larger ones mean nothing


@dataclass(frozen=True, kw_only=True)
class FallingBody:
    """A body of stiff materials that falls onto the floor."""

    path: str  # prim path
    length: float  # L [m], the longest edge of its box
    thick: float  # t [m] of most of its surface
    materials: Sequence[Material]


def folding_notes(bodies: Sequence[FallingBody], fall: float, gravity: float) -> tuple[str, ...]:
    """Notes on stiff materials of which slender bodies fold in a fall, although compact ones hardly
    bend: one for each material, on the body that bends most.

    If the energy of the fall, rho g H, is stored by the strain e at the surface of a bent part,
    e^2 E / 2, its curvature 2 e / t makes an angle over its length L,

        angle = 2 e L / t,    e = sqrt(2 rho g H / E)

    which overestimates bending, since the middle of the part is strained less, and underestimates
    it where a part of the body is strained.  Presets without dimensions have the same e for any
    shape.  A table and a wheel with spokes, of 2.4 to 3.3 rad, fold; gears and a tire, of 1.1 to
    1.4, do not.

    fall : H [m]; gravity : [m/s^2].
    """
    worst: dict[str, tuple[float, FallingBody, Material]] = {}
    for body in bodies:
        for material in body.materials:
            angle = _angle(material, body, fall, gravity)
            if angle >= FOLDS and (material.name not in worst or angle > worst[material.name][0]):
                worst[material.name] = angle, body, material
    return tuple(_folding_note(*one, fall, gravity) for one in worst.values())


def _folding_note(
    angle: float, body: FallingBody, material: Material, fall: float, gravity: float
) -> str:
    bent = f"about {_degrees(angle)}" if angle <= MOST_BENT else f"more than {_degrees(MOST_BENT)}"
    others = ((other, _angle(PHYSICAL[other], body, fall, gravity)) for other in ADVISED)
    firmer = [f"--material {other} by {_degrees(a)}" for other, a in others if a < FOLDS]
    return (
        f"a fall of {length_text(fall)} folds <{body.path}> of {material.name}, which is"
        f" {length_text(body.length)} long and mostly {length_text(body.thick)} thick: its Young's"
        f" modulus of {material.youngs_modulus:.2g} Pa bends it by {bent} degrees"
        + (f"; {' and '.join(firmer)}" if firmer else "")
    )


def _angle(
    material: Material | PhysicalPreset, body: FallingBody, fall: float, gravity: float
) -> float:
    e = _strain(material.density, material.youngs_modulus, fall, gravity)
    return 2.0 * e * body.length / body.thick


def stiff_in_fall(material: Material, fall: float, gravity: float) -> bool:
    """Whether an elastic material is so stiff that a compact body hardly bends in a fall [m]."""
    strain = _strain(material.density, material.youngs_modulus, fall, gravity)
    return not LAWS[material.law].flows and strain <= STIFF


def _strain(density: float, E: float, fall: float, gravity: float) -> float:
    return float(np.sqrt(2.0 * density * gravity * fall / E))


def _degrees(angle: float) -> str:
    return rounded_text(float(np.degrees(angle)))
