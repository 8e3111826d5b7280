"""Regions of an asset with separate presets: boxes and labels.

Boxes: `--material-box metal:x0,y0,z0,x1,y1,z1`, a preset for the particles in a box.  Labels:
`--material-label label=3:metal`, a preset for the Gaussians with a label.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import Surface
from gf_usd.core.errors import InputError, UsageError, listed
from gf_usd.core.frames.particles import Particles
from gf_usd.core.materials.presets import find_preset

BOX_OPTION = "--material-box"


@dataclass(frozen=True, kw_only=True)
class MaterialBox:
    """A preset for the particles whose rest position is in a box, faces included."""

    text: str  # as given
    material: str  # name of a preset
    low: Floats  # (3,) [stage units]
    high: Floats  # (3,) [stage units]
    option = BOX_OPTION

    def holds(self, X: Floats, unit: float) -> Floats:
        """(n,) which points (n, 3) [m] lie in it; unit : [m] per stage length."""
        return np.all((self.low * unit <= X) & (self.high * unit >= X), axis=1)


LABEL_OPTION = "--material-label"


@dataclass(frozen=True, kw_only=True)
class MaterialLabel:
    """A preset for the particles whose nearest Gaussian has a given value of a property."""

    text: str  # as given
    material: str  # name of a preset
    name: str  # of the PLY property or the primvar
    value: int
    option = LABEL_OPTION


Region = MaterialBox | MaterialLabel


def parse_regions(boxes: Sequence[str], labels: Sequence[str]) -> tuple[Region, ...]:
    """The regions of the options, labels first, read by `parse_labels` and `parse_boxes`.

    Raises UsageError for an invalid one.
    """
    return (*parse_labels(labels), *parse_boxes(boxes))


def owners(
    regions: Sequence[Region], surfaces: Sequence[Surface], particles: Particles, unit: float
) -> tuple[Ints, tuple[str, ...]]:
    """(N,) index of the region of each particle, -1: none, and a note on each region.

    unit : [m] per stage length.
    Boxes have precedence over labels, and later boxes over earlier ones.
    Raises InputError for a region without particles.
    """
    labels = [r for r in regions if isinstance(r, MaterialLabel)]
    boxes = [r for r in regions if isinstance(r, MaterialBox)]
    by_label = labeled(labels, surfaces, particles)
    by_box = boxed(boxes, particles.X, unit)
    of = np.where(by_box >= 0, len(labels) + by_box, by_label)
    near = np.bincount(by_label[by_label >= 0], minlength=len(labels))
    held = np.bincount(of[of >= 0], minlength=len(regions))
    for k, region in enumerate(regions):
        if held[k]:
            continue
        if isinstance(region, MaterialBox):
            why, hint = "later boxes override it for all of its particles", "name it after them"
        elif near[k]:
            why, hint = "boxes override it for all of its particles", "make the boxes smaller"
        else:
            why = f"none of its Gaussians is nearest to any of the {len(particles)} particles"
            hint = "use more --particles"
        raise InputError(f"{region.option} {region.text}: {why}", f"leave it out, or {hint}")
    return of, tuple(
        f"{count} of {len(particles)} particles are {region.material}, by {region.option}"
        f" {region.text}"
        for region, count in zip(regions, held)
    )


def parse_boxes(texts: Sequence[str]) -> tuple[MaterialBox, ...]:
    """The boxes of "PRESET:x0,y0,z0,x1,y1,z1", two opposite corners in stage units, world axes.

    Raises UsageError for anything else, for an unknown preset and for a box without volume.
    """
    return tuple(_parse_box(text) for text in texts)


def _parse_box(text: str) -> MaterialBox:
    name, _, corners = text.partition(":")
    low, high = parse_corners(BOX_OPTION, text, corners)
    preset = find_preset(name.strip())
    return MaterialBox(text=text, material=preset.name, low=low, high=high)


def parse_corners(option: str, text: str, corners: str) -> tuple[Floats, Floats]:
    """The corners (3,) of least and of greatest coordinates of "x0,y0,z0,x1,y1,z1".

    Raises UsageError, as for the text of an option, for anything else and for no volume.
    """
    try:
        numbers = np.array([float(word) for word in corners.split(",")])
    except ValueError:
        numbers = np.full(6, np.nan)
    if len(numbers) != 6 or not np.isfinite(numbers).all():
        raise UsageError(
            f"{option} {text} is not a preset and a box",
            "give two opposite corners in stage units: "
            + (
                f"{BOX_OPTION} metal:-1,0,-1,1,0.2,1"
                if option == BOX_OPTION
                else f"{option} -1,0,-1,1,0.2,1=honey@time:48"
            ),
        )
    low, high = np.minimum(numbers[:3], numbers[3:]), np.maximum(numbers[:3], numbers[3:])
    if (high - low).min() <= 0.0:
        raise UsageError(
            f"{option} {text} has no volume: its sides are {(high - low).tolist()}",
            "give two opposite corners that differ along every axis",
        )
    return low, high


LATTICE = 9  # points along each edge of a box, that test whether a surface is in it


def inside_some(box: MaterialBox, surface: Surface, unit: float) -> bool:
    """Whether a box overlaps a closed surface or its inside; unit : [m]."""
    from gf_usd.geometry.winding import winding_inside

    low, high = box.low * unit, box.high * unit
    points = np.asarray(surface.points)
    if (points.max(0) <= low).any() or (points.min(0) >= high).any():
        return False
    rim = 1e-6 * (high - low)  # what only touches the box is not in it
    if ((points > low + rim) & (points < high - rim)).all(1).any():
        return True
    low, high = np.maximum(low, points.min(0)), np.minimum(high, points.max(0))
    steps = (np.arange(LATTICE) + 0.5) / LATTICE
    at = low + (high - low) * np.stack(np.meshgrid(steps, steps, steps), -1).reshape(-1, 3)
    return bool(winding_inside(points, surface.triangles, at).any())


def boxed(boxes: Sequence[MaterialBox], X: Floats, unit: float) -> Ints:
    """(N,) index of the box of each particle with rest position X (N, 3) [m], -1: none.

    Where boxes overlap, the later one has precedence.  Raises InputError for a box without
    particles.
    """
    out = np.full(len(X), -1)
    for k, box in enumerate(boxes):
        mine = box.holds(X, unit)
        if not mine.any():
            low, high = X.min(0) / unit, X.max(0) / unit
            raise InputError(
                f"{BOX_OPTION} {box.text} contains none of the {len(X)} particles, which are"
                f" between"
                f" {shown(low)} and {shown(high)}",
                "give corners in the asset's units and axes, or use more --particles",
            )
        out[mine] = k
    return out


def shown(values: Sequence[float] | Floats) -> str:
    """Coordinates as text."""
    return "(" + ", ".join(f"{v:.4g}" for v in values) + ")"


SHOWN = 8  # names or values in a message


def parse_labels(texts: Sequence[str]) -> tuple[MaterialLabel, ...]:
    """The labels of "NAME=VALUE:PRESET".

    Raises UsageError for anything else, for an unknown preset and for a value that is given twice.
    """
    found: dict[tuple[str, int], MaterialLabel] = {}
    for text in texts:
        label = _parse_label(text)
        first = found.setdefault((label.name, label.value), label)
        if first is not label:
            raise UsageError(
                f"{LABEL_OPTION} {first.text} and {LABEL_OPTION} {text} name the same value twice",
                "leave one out",
            )
    return tuple(found.values())


def _parse_label(text: str) -> MaterialLabel:
    selector, _, preset = text.rpartition(":")
    name, _, value = selector.rpartition("=")
    try:
        number = int(value)
    except ValueError:
        name, number = "", 0
    if not name.strip() or not preset.strip():
        raise UsageError(
            f"{LABEL_OPTION} {text} is not a property, a whole number and a preset",
            f"name the property of the Gaussians, a value of it and a preset: {LABEL_OPTION}"
            " label=3:metal",
        )
    name = name.strip().removeprefix("primvars:")
    material = find_preset(preset.strip()).name
    return MaterialLabel(text=text, material=material, name=name, value=number)


def labeled(
    labels: Sequence[MaterialLabel], surfaces: Sequence[Surface], particles: Particles
) -> Ints:
    """(N,) index of the label of the Gaussian nearest to each particle, -1: none.

    Only Gaussians of the particle's own surface count.  For a Gaussian with several labels of
    different properties, the later one has precedence.

    Raises InputError for a property that no Gaussian has, and for a value that none of them has.
    """
    out = np.full(len(particles), -1)
    if not labels:
        return out
    _require(labels, surfaces)
    from scipy.spatial import cKDTree

    for k, surface in enumerate(surfaces):
        if surface.splats is None or not surface.splats.labels:
            continue
        mine = np.flatnonzero(np.asarray(particles.surface) == k)
        _, near = cKDTree(surface.splats.points).query(particles.X[mine])
        for number, label in enumerate(labels):
            values = surface.splats.labels.get(label.name)
            if values is not None:
                out[mine[values[near] == label.value]] = number
    return out


def _require(labels: Sequence[MaterialLabel], surfaces: Sequence[Surface]) -> None:
    """Raise InputError for a label that no Gaussian has."""
    sets = [s.splats for s in surfaces if s.splats is not None]
    if not sets:
        raise InputError(
            f"{LABEL_OPTION} {labels[0].text}: the bake has no captured Gaussians",
            "omit it; --material-box works on any asset",
        )
    for label in labels:
        held = [s.labels[label.name] for s in sets if label.name in s.labels]
        if not held:
            names = sorted({name for s in sets for name in s.labels})
            there = "have " + listed(names, SHOWN) if names else "have none"
            raise InputError(
                f"{LABEL_OPTION} {label.text}: no Gaussian has a property {label.name} of whole"
                f" numbers; they {there}",
                "name a property of whole numbers, one a Gaussian",
            )
        values, count = np.unique(np.concatenate(held), return_counts=True)
        if label.value not in values:
            often = [f"{values[i]} ({count[i]})" for i in np.argsort(-count, kind="stable")]
            raise InputError(
                f"{LABEL_OPTION} {label.text}: none of the {count.sum()} Gaussians has {label.name}"
                f" {label.value}; they have {listed(often, SHOWN)}",
                "name an existing value",
            )
