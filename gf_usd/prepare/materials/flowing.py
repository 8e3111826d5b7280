"""Which bodies flow without limit: from the laws of their materials, before particles are made."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gf_usd.core.arrays import Ints
from gf_usd.core.errors import InputError, UsageError
from gf_usd.core.frames.particles import Particles
from gf_usd.core.materials.laws import LAWS
from gf_usd.core.materials.material import Material
from gf_usd.core.materials.per_particle import unbounded
from gf_usd.core.materials.presets import find_preset
from gf_usd.core.stage import Pin, Skin, StageSpec
from gf_usd.prepare.materials.parts import material_parts
from gf_usd.prepare.materials.regions import MaterialBox, Region, inside_some
from gf_usd.prepare.materials.table import Authored, authored

if TYPE_CHECKING:
    from gf_usd.geometry.solid import Solid
    from gf_usd.prepare.materials.conversion import ConversionRule


@dataclass(frozen=True, kw_only=True)
class Dispatch:
    """Which surfaces flow, at least in part."""

    flows: Ints  # (S,) of each filled surface, in the order of `Solid.surfaces`
    first: Ints  # (S,) which of them do so from the start; the others can be converted
    paths: tuple[str, ...]  # of those that flow from the start
    names: tuple[str, ...]  # of their materials

    @property
    def all(self) -> bool:
        """Whether everything flows from the start."""
        return bool(self.first.all())

    @property
    def later(self) -> bool:
        """Whether some surfaces can be converted."""
        return bool((self.flows & ~self.first).any())

    @property
    def some(self) -> bool:
        """Whether some surfaces flow from the start and others do not."""
        return bool(self.first.any()) and not self.all


def dispatch(
    solid: Solid,
    spec: StageSpec,
    presets: Sequence[Any],
    law: str | None,
    regions: Sequence[Region],
    rules: Sequence[ConversionRule],
    unit: float,
) -> Dispatch:
    """The surfaces that flow without limit in part, from the start or after conversion.

    presets : as in `table`, one variant each; law : of the options, instead of all others.
    regions : of which boxes count; rules : of conversions; unit : [m] of the stage.

    Raises UsageError where variants differ.
    """
    found = [_flowing_materials(solid, spec, preset, law, regions, unit) for preset in presets]
    flows = np.array([[bool(names) for names in one] for one in found])
    if (flows != flows[0]).any():
        names = ", ".join(preset.name for preset in presets)
        raise UsageError(
            f"{names}: some of these materials flow without limit, and need a different solver"
            f" from the others",
            "bake them separately",
        )
    names = [name for one in found for each in one for name in each]
    later = np.zeros(len(solid.surfaces), bool)
    parts = {group[0]: group for group in solid.joined}
    for rule in rules:
        later |= np.array(
            [rule.may_hold(s, spec, unit, parts.get(s.path, ())) for s in solid.surfaces]
        )
    return Dispatch(
        flows=flows[0] | later,
        first=flows[0],
        paths=tuple(solid.surfaces[k].path for k in np.flatnonzero(flows[0])),
        names=tuple(dict.fromkeys(names)),
    )


def _flowing_materials(
    solid: Solid,
    spec: StageSpec,
    preset: Any,
    law: str | None,
    regions: Sequence[Region],
    unit: float,
) -> list[list[str]]:
    """For each surface, the names of its materials that flow; laws do not depend on a body's
    size.
    """

    def finish(one: Any, radius: float) -> Material:
        return one.material(radius, law)

    parts = material_parts(solid, spec)
    boxes = [region for region in regions if isinstance(region, MaterialBox)]
    out = []
    for k, surface in enumerate(solid.surfaces):
        mine = [part for part in parts if part.surface == k]
        subsets = [part for part in mine if part.subset is not None]
        faces = sum(len(part.subset.faces) for part in subsets if part.subset is not None)
        if subsets and faces >= len(surface.face_counts):
            mine = subsets
        made = [
            authored(surface.path, part, 1.0, spec, finish)
            if isinstance(preset, Authored)
            else finish(preset, 1.0)
            for part in mine
        ]
        for box in boxes:
            if not inside_some(box, surface, unit):
                continue
            held = finish(find_preset(box.material), 1.0)
            made = [held] if box.holds(surface.points, unit).all() else [*made, held]
        out.append([one.name for one in made if LAWS[law or one.law].unbounded])
    return out


def require_dispatched(
    path: Path,
    particles: Particles,
    tables: Sequence[Sequence[Material]],
    solid: Solid,
    flows: Ints,
) -> None:
    """Raise InputError for particles that flow without limit in a body that was taken as solid,
    as those of labels.

    path : of the asset, for messages; tables : the materials of each variant; flows : (B,) of
    bodies.
    """
    body = particles.body_of
    for table in tables:
        stray = np.flatnonzero(unbounded(particles, table) & ~flows[body])
        if len(stray):
            surface = solid.surfaces[int(particles.surface[stray[0]])]
            names = [m.name for m in table if LAWS[m.law].unbounded]
            count = int((body == body[stray[0]]).sum())
            raise InputError(
                f"{path}: <{surface.path}>: {len(stray)} of its {count} particles are"
                f" {' or '.join(names)}, which flows without limit, and the others are not",
                "split it into two meshes, one for each material",
            )


MOST_INSIDE = 0.02  # of the particles: fewer are a touch, which contact resolves


def require_outside(path: Path, particles: Particles, flows: Ints, skins: Sequence[Skin]) -> None:
    """Raise InputError where much of the flowing material starts inside a solid body.

    flows : (B,) which bodies flow; skins : of each body.
    """
    from gf_usd.geometry.winding import winding_inside

    body = particles.body_of
    X = np.asarray(particles.X)[flows[body]]
    for k in map(int, np.flatnonzero(~flows)):
        points, triangles = skins[k].points, skins[k].triangles
        near = ((points.min(0) <= X) & (points.max(0) >= X)).all(1)
        inside = int(winding_inside(points, triangles, X[near]).sum()) if near.any() else 0
        if inside > MOST_INSIDE * len(X):
            raise InputError(
                f"{path}: {inside} of the {len(X)} flowing particles start inside a solid body",
                "cut the solid out of the flowing mesh, or move one of the two",
            )


def require_solid_pins(
    path: Path,
    pins: Sequence[Pin],
    particles: Particles,
    flows: Ints,
    *,
    converts: bool,
    springs: Collection[str] = (),
) -> None:
    """Raise for pins and attachments that the bodies that flow, or those next to them, do not
    support.

    path : of the asset, for messages; flows : (B,) which bodies flow; converts : some can be
    converted; springs : prim paths of attachments with springs.

    Raises
    ------
    InputError : next to solid bodies, a pin contains only flowing ones; a pin moves, or an
        attachment has springs.
    UsageError : a pin, and all bodies flow or some can be converted.
    """
    if pins and converts:
        raise UsageError(
            "a bake with --conversion does not support pins", "leave out one of the two"
        )
    for pin in pins if flows.any() else ():
        held = pin.bodies if pin.body is None else {pin.body}
        held = held or np.unique(particles.body_of[pin.holds(particles.X, None)])
        if len(held) and all(flows[k] for k in held):
            fault = UsageError if flows.all() else InputError
            raise fault(
                f"{path}: the pin {pin.name} is part of a body that flows, which cannot be pinned",
                "leave it out, or give that body a solid --material",
            )
    if flows.all() or not flows.any():
        return
    faults = [f"the pin {pin.name} moves" for pin in pins if len(pin.path) > 1]
    faults += [f"the attachment <{name}> pulls with springs" for name in springs]
    if faults:
        raise InputError(
            f"{path}: {faults[0]}, which a bake with both flowing and solid bodies does not"
            " support",
            "leave it out, or bake the bodies separately with --prim",
        )
