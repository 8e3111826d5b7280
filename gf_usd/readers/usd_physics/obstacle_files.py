"""Meshes of other files that a bake has as static obstacles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.asset import ASSUMED, Surface
from gf_usd.core.errors import InputError
from gf_usd.readers.isolated import Reading
from gf_usd.system.sandbox import Limits

# From Y up to Z up and back, for column vectors.
TURNED: Mapping[str, Floats] = {
    "Y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "Z": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
}


@dataclass(frozen=True, kw_only=True)
class ObstacleFile:
    """The meshes of a file, posed at its first frame."""

    surfaces: tuple[Surface, ...]  # their points are not rotated: see `points`
    turn: Floats  # (3, 3) rotates the up axis of the file to that of the asset
    turned_from: str  # the up axis of the file; "": that of the asset
    animated: bool  # the file has time samples
    assumed: tuple[str, ...]  # which unit and up axis, where the file states none

    def points(self, surface: Surface) -> Floats:
        """(V, 3) [m] points of a surface, in the world frame of the asset."""
        return np.asarray(surface.points) @ self.turn.T


def read_obstacle_file(path: Path, up_axis: str, limits: Limits | None = None) -> ObstacleFile:
    """The meshes of a file for an asset with an up axis.

    Raises InputError as `read_asset`, and for a file of captured Gaussians only.
    """
    with Reading(path, limits, elastic=False) as reading:
        read = reading.result().asset
    if not read.surfaces:
        raise InputError(f"{path}: no mesh in it can be an obstacle", "give a file with meshes")
    facts, theirs = read.facts, read.facts.up_axis
    assumed = (
        f"{facts.units.length:g} m per unit" if facts.unit_from == ASSUMED else "",
        f"{theirs} up" if facts.axis_from == ASSUMED else "",
    )
    return ObstacleFile(
        surfaces=read.surfaces,
        turn=np.eye(3) if theirs == up_axis else TURNED[theirs],
        turned_from="" if theirs == up_axis else theirs,
        animated=facts.animated,
        assumed=tuple(filter(None, assumed)),
    )
