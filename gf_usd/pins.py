"""Regions of the rest body, and pins: regions whose motion is given.  SI, world, as `model`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from gf_usd.model import Floats, Ints


@dataclass(frozen=True, kw_only=True)
class Region:
    """A part of space that is bounded by triangles, and where its points go over the frames."""

    name: str  # as asked for
    kind: str  # "volume": what the triangles enclose; "patch": a part of a body's surface
    points: Floats  # (V, 3) [m] at rest, world
    triangles: Ints  # (T, 3) into points
    path: Floats  # (F, V, 3) [m] at each frame; F = 1: they stay
    body: str = ""  # of a patch: prim path of the mesh it is a part of


@dataclass(frozen=True, kw_only=True)
class Pin:
    """A region whose motion is given: held where it is, or following the source's animation.

    The region's anchors are points whose place is known at every frame; between them it moves by
    an affine fit.
    """

    name: str  # as asked for, e.g. "/Duck/mesh:feet"
    inside: Callable[[Floats], Floats]  # X (n, 3) [m] at rest -> (n,) bool: held
    nearest: Callable[[Floats], Floats]  # X (n, 3) [m] -> (n, 3) on the boundary of the region
    anchors: Floats  # (k, 3) [m] at rest, world
    path: Floats  # (T, k, 3) [m] where the anchors are at each frame; T = 1: they stay
    axes: tuple[bool, bool, bool] = (True, True, True)  # world axes that are held
