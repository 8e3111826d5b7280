"""Parts of bodies with a single material each: surfaces, subsets of their faces, regions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gf_usd.core.arrays import Ints
from gf_usd.core.frames.particles import Particles
from gf_usd.core.stage import StageSpec, SubsetMaterial
from gf_usd.prepare.materials.regions import Region

if TYPE_CHECKING:
    from gf_usd.geometry.solid import Solid


@dataclass(frozen=True, kw_only=True)
class MaterialPart:
    """A part of a body that has one material: a surface, some of its faces, or a region."""

    surface: int  # into Solid.surfaces
    subset: SubsetMaterial | None = None
    region: Region | None = None


def material_parts(
    solid: Solid, spec: StageSpec, regions: Sequence[Region] = ()
) -> list[MaterialPart]:
    """The parts: surfaces and subsets in order, then regions."""
    found = [MaterialPart(surface=k) for k in range(len(solid.surfaces))]
    for k, surface in enumerate(solid.surfaces):
        body = spec.bodies.get(surface.path)
        found += [MaterialPart(surface=k, subset=one) for one in (body.subsets if body else ())]
    return found + [
        MaterialPart(surface=k, region=r) for r in regions for k in range(len(solid.surfaces))
    ]


def in_regions(slot: Ints, particles: Particles, parts: Sequence[MaterialPart], of: Ints) -> Ints:
    """(N,) part of each particle, where those in regions belong to the part of the region.

    slot : of `part_of_particles`; of : (N,) of `regions.owners`.
    """
    first = next((k for k, part in enumerate(parts) if part.region is not None), len(parts))
    surfaces = 1 + max(part.surface for part in parts)
    return np.where(of < 0, slot, first + of * surfaces + np.asarray(particles.surface))


def part_of_particles(solid: Solid, particles: Particles, parts: Sequence[MaterialPart]) -> Ints:
    """(N,) part of each particle: of its surface, or of the subset of that surface's nearest face.

    Surfaces of other bodies that overlap its own may be nearer, but do not count.
    """
    surface = np.asarray(particles.surface)
    out = surface.copy()
    divided = {slot.surface for slot in parts if slot.subset}
    if not divided:
        return out
    from gf_usd.geometry.surface import nearest

    of_triangle = part_of_triangles(solid, parts)
    for k in divided:
        mine = np.flatnonzero(surface == k)
        if len(mine):
            at = nearest(solid.part(np.array([k])), particles.X[mine])
            out[mine] = of_triangle[k][at.triangle]
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
