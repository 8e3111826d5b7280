"""Which bodies flow without end: by the laws of their materials, before there are particles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gf_usd.core.arrays import Ints
from gf_usd.core.errors import InputError, UsageError
from gf_usd.core.frames import Particles
from gf_usd.core.materials.laws import LAWS
from gf_usd.core.materials.material import Material
from gf_usd.core.materials.per_particle import unbounded
from gf_usd.core.materials.presets import find_preset
from gf_usd.core.stage import Skin, StageSpec
from gf_usd.prepare.materials.parts import material_parts
from gf_usd.prepare.materials.regions import MaterialBox, Region
from gf_usd.prepare.materials.table import Authored, authored

if TYPE_CHECKING:
    from gf_usd.geometry.solid import Solid


@dataclass(frozen=True, kw_only=True)
class Dispatch:
    """Which surfaces flow."""

    flows: Ints  # (S,) of each filled surface, in the order of `Solid.surfaces`
    paths: tuple[str, ...]  # of those that do
    names: tuple[str, ...]  # of their materials

    @property
    def all(self) -> bool:
        """Whether everything flows."""
        return bool(self.flows.all())

    @property
    def some(self) -> bool:
        """Whether some surfaces flow and others do not."""
        return bool(self.flows.any()) and not self.all


def dispatch(
    solid: Solid,
    spec: StageSpec,
    presets: Sequence[Any],
    law: str | None,
    regions: Sequence[Region],
    unit: float,
) -> Dispatch:
    """Which surfaces flow, by the material of each; of subsets of its faces the first part counts.

    presets : as of `table`, each makes a variant; law : of the options, instead of all others.
    regions : of which boxes count that hold a surface whole; unit : [m] of the stage's.

    Raises UsageError where that differs between variants.
    """
    found = [_materials(solid, spec, preset, law, regions, unit) for preset in presets]
    flows = np.array([[LAWS[m].unbounded for _, m in one] for one in found])
    if (flows != flows[0]).any():
        names = ", ".join(preset.name for preset in presets)
        raise UsageError(
            f"{names}: some of these materials flow without limit, and need a different solver"
            f" from the others",
            "bake them separately",
        )
    mine = np.flatnonzero(flows[0])
    return Dispatch(
        flows=flows[0],
        paths=tuple(solid.surfaces[k].path for k in mine),
        names=tuple(dict.fromkeys(one[k][0] for one in found for k in mine)),
    )


def _materials(
    solid: Solid,
    spec: StageSpec,
    preset: Any,
    law: str | None,
    regions: Sequence[Region],
    unit: float,
) -> list[tuple[str, str]]:
    """The name and the law of the material of each surface; no law depends on a body's size."""

    def finish(one: Any, radius: float) -> Material:
        return one.material(radius, law)

    parts = material_parts(solid, spec)
    out = []
    for k, surface in enumerate(solid.surfaces):
        mine = [part for part in parts if part.surface == k]
        subsets = [part for part in mine if part.subset is not None]
        faces = sum(len(part.subset.faces) for part in subsets if part.subset is not None)
        part = subsets[0] if subsets and faces >= len(surface.face_counts) else mine[0]
        made = (
            authored(surface.path, part, 1.0, spec, finish)
            if isinstance(preset, Authored)
            else finish(preset, 1.0)
        )
        for region in regions:
            if isinstance(region, MaterialBox) and region.holds(surface.points, unit).all():
                made = finish(find_preset(region.material), 1.0)
        out.append((made.name, law or made.law))
    return out


def require_whole(
    path: Path, particles: Particles, tables: Sequence[Sequence[Material]], solid: Solid
) -> None:
    """Raise InputError for a body of which only a part flows without end.

    path : of the asset, for messages; tables : the materials of each variant.
    """
    body = particles.body_of
    for table in tables:
        flows = unbounded(particles, table)
        for k in range(int(body.max()) + 1):
            mine = np.flatnonzero(body == k)
            count = int(flows[mine].sum())
            if 0 < count < len(mine):
                surface = solid.surfaces[int(particles.surface[mine[0]])]
                names = [m.name for m in table if LAWS[m.law].unbounded]
                raise InputError(
                    f"{path}: <{surface.path}>: {count} of its {len(mine)} particles are"
                    f" {' or '.join(names)}, which flows without limit, and the others are not:"
                    f" a body must flow as a whole or not at all",
                    "split it into two meshes, one for each material",
                )


MOST_INSIDE = 0.02  # of the particles: fewer are a touch, which contact resolves


def require_outside(path: Path, particles: Particles, flows: Ints, skins: Sequence[Skin]) -> None:
    """Raise InputError where much of what flows starts inside a solid body.

    flows : (B,) which bodies do; skins : of each body.
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
