"""Materials by label: `--material-label label=3:metal`, a preset for the Gaussians of a label."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gf_usd.errors import InputError, UsageError
from gf_usd.materials import find_preset
from gf_usd.model import Ints, Particles, Surface

OPTION = "--material-label"
SHOWN = 8  # names or values in a message


@dataclass(frozen=True, kw_only=True)
class MaterialLabel:
    """A preset for the particles whose nearest Gaussian has a value of a property."""

    text: str  # as asked for
    material: str  # name of a preset
    name: str  # of the PLY property or the primvar
    value: int
    option = OPTION


def parse_labels(texts: Sequence[str]) -> tuple[MaterialLabel, ...]:
    """The labels of "NAME=VALUE:PRESET".

    Raises UsageError for anything else, for an unknown preset and for a value that is asked twice.
    """
    found: dict[tuple[str, int], MaterialLabel] = {}
    for text in texts:
        label = _parse(text)
        first = found.setdefault((label.name, label.value), label)
        if first is not label:
            raise UsageError(
                f"{OPTION} {first.text} and {OPTION} {text} name one value twice", "leave one out"
            )
    return tuple(found.values())


def _parse(text: str) -> MaterialLabel:
    asked, _, preset = text.rpartition(":")
    name, _, value = asked.rpartition("=")
    try:
        number = int(value)
    except ValueError:
        name, number = "", 0
    if not name.strip() or not preset.strip():
        raise UsageError(
            f"{OPTION} {text} is no property, whole value and preset",
            f"name the property of the Gaussians, a value of it and a preset: {OPTION}"
            " label=3:metal",
        )
    name = name.strip().removeprefix("primvars:")
    material = find_preset(preset.strip()).name
    return MaterialLabel(text=text, material=material, name=name, value=number)


def labelled(
    labels: Sequence[MaterialLabel], surfaces: Sequence[Surface], particles: Particles
) -> Ints:
    """(N,) index of the label that the nearest Gaussian of each particle has, -1: none.

    A particle knows the Gaussians of the surface it came from.  Where a Gaussian has several of the
    labels, of several properties, the later one holds.  Raises InputError for a property that no
    Gaussian has, and for a value that none of them has.
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
    """Raise InputError where a label is not there."""
    sets = [s.splats for s in surfaces if s.splats is not None]
    if not sets:
        raise InputError(
            f"{OPTION} {labels[0].text}: there are no captured Gaussians in what is baked",
            "leave it out; --material-box works on any asset",
        )
    for label in labels:
        held = [s.labels[label.name] for s in sets if label.name in s.labels]
        if not held:
            names = sorted({name for s in sets for name in s.labels})
            there = "have " + _listed(names) if names else "have no whole numbers at all"
            raise InputError(
                f"{OPTION} {label.text}: no Gaussian has a property {label.name} of whole numbers;"
                f" they {there}",
                "name a property of whole numbers, one a Gaussian",
            )
        values, count = np.unique(np.concatenate(held), return_counts=True)
        if label.value not in values:
            often = [f"{values[i]} ({count[i]})" for i in np.argsort(-count, kind="stable")]
            raise InputError(
                f"{OPTION} {label.text}: none of the {count.sum()} Gaussians has {label.name}"
                f" {label.value}; they have {_listed(often)}",
                "name a value that is there",
            )


def _listed(words: Sequence[str]) -> str:
    more = len(words) - SHOWN
    return ", ".join(words[:SHOWN]) + (f" and {more} more" if more > 0 else "")
