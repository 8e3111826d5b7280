"""A body of two legs, its skin and its contact samples."""

from __future__ import annotations

import numpy as np
from contact_scenes import bricks
from solids import solid, surface

from gf_usd.core.asset import Surface
from gf_usd.core.frames.particles import SurfaceSamples
from gf_usd.core.stage import Skin
from gf_usd.geometry.sampling.contact_samples import sample_surface

SPACING = 0.1


def legs(gap: float) -> Surface:
    """A U whose two legs, 0.4 m wide and 1 m long, are a gap [m] apart."""
    filled = np.ones((9, 12, 4), bool)
    filled[4, 2:] = False
    made = bricks(filled, 0.1)
    points = made.points.copy()
    right = points[:, 0] > 0.45
    points[right, 0] += gap - 0.1
    return surface(points, made.triangles)


def sampled(one: Surface) -> tuple[Skin, SurfaceSamples]:
    """The skin of a surface, and its samples."""
    made = solid(one)
    points, triangles = made.outward(0)
    return Skin(points=points, triangles=triangles), sample_surface(made, SPACING)
