"""What has a preset of its own within an asset: boxes and labels, as one list of regions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gf_usd import material_boxes, material_labels
from gf_usd.errors import InputError
from gf_usd.material_boxes import MaterialBox
from gf_usd.material_labels import MaterialLabel
from gf_usd.model import Ints, Particles, Surface

Region = MaterialBox | MaterialLabel


def parse_regions(boxes: Sequence[str], labels: Sequence[str]) -> tuple[Region, ...]:
    """The regions that were asked for, labels first, as `parse_labels` and `parse_boxes` read them.

    Raises UsageError for what is neither.
    """
    return (*material_labels.parse_labels(labels), *material_boxes.parse_boxes(boxes))


def owners(
    regions: Sequence[Region], surfaces: Sequence[Surface], particles: Particles, unit: float
) -> tuple[Ints, tuple[str, ...]]:
    """(N,) index of the region that each particle is in, -1: none, and a note on each region.

    unit : [m] per stage length.  Boxes hold before labels, and later boxes before earlier ones.
    Raises InputError for a region that has no particle.
    """
    labels = [r for r in regions if isinstance(r, MaterialLabel)]
    boxes = [r for r in regions if isinstance(r, MaterialBox)]
    by_label = material_labels.labelled(labels, surfaces, particles)
    by_box = material_boxes.boxed(boxes, particles.X, unit)
    of = np.where(by_box >= 0, len(labels) + by_box, by_label)
    near = np.bincount(by_label[by_label >= 0], minlength=len(labels))
    held = np.bincount(of[of >= 0], minlength=len(regions))
    for k, region in enumerate(regions):
        if held[k]:
            continue
        if isinstance(region, MaterialBox):
            why, hint = "later boxes take all of its particles", "name it after them"
        elif near[k]:
            why, hint = "boxes take all of its particles", "make the boxes smaller"
        else:
            why = f"its Gaussians are the nearest of none of the {len(particles)} particles"
            hint = "use more --particles"
        raise InputError(f"{region.option} {region.text}: {why}", f"leave it out, or {hint}")
    return of, tuple(
        f"{count} of {len(particles)} particles are {region.material}, by {region.option}"
        f" {region.text}"
        for region, count in zip(regions, held)
    )
