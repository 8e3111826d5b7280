"""The creature: a plump biped of blended implicit shapes, in centimeters, Y up, facing +Z.

It stands in its bind pose with arms and ears spread, so that the plane z = 0 cuts every limb but
the tail: the texture is one chart of its front and two of its back.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tools.samples.implicit import ellipsoid, join, meet, one_side, round_cone
from tools.samples.quads import Quads
from tools.samples.relax import Relaxation, Seam
from tools.samples.surface_nets import surface_nets
from tools.samples.uv import Atlas, chart, gather, pack

Floats = NDArray[np.float64]

X, Y, Z = np.eye(3)
STEP = 1.65  # [cm] of the lattice that the quads are made on
HALF, LO, HI = 18, (-2, -20), (47, 11)  # [steps]

EYE = np.array([5.0, 47.0, 10.3])
EYE_RADIUS = 1.75
NOSE = np.array([0.0, 44.6, 14.3])
TAIL = ((0.0, 14.0, -8.5), (0.0, 14.5, -18.0), (0.0, 21.5, -26.0))


def trunk(p: Floats) -> Floats:
    """A pear: hips, belly and chest."""
    hips = ellipsoid(p, (0.0, 19.0, -0.5), (12.6, 12.5, 11.0))
    belly = ellipsoid(p, (0.0, 19.5, 4.0), (10.6, 10.8, 10.4))
    chest = ellipsoid(p, (0.0, 31.0, 0.0), (8.6, 9.0, 7.6))
    return join(join(hips, belly, 3.0), chest, 5.0)


def head(p: Floats) -> Floats:
    """A wide head with cheeks, a muzzle and a nose."""
    q = one_side(p)
    skull = ellipsoid(p, (0.0, 46.5, 0.5), (11.2, 9.8, 9.8))
    cheek = np.linalg.norm((q - [7.2, 42.4, 4.2]) / [1.0, 0.92, 1.0], axis=-1) - 5.3
    muzzle = ellipsoid(p, (0.0, 42.6, 9.2), (4.6, 3.5, 4.6))
    nose = ellipsoid(p, (0.0, 44.6, 12.9), (1.9, 1.35, 1.4))
    return join(join(join(skull, cheek, 4.5), muzzle, 2.5), nose, 0.8)


def ears(p: Floats) -> Floats:
    """Long and flat, half raised."""
    q = one_side(p) * np.array([1.0, 1.0, 1.45])
    low = round_cone(q, (5.6, 52.0, -0.6), (11.0, 62.0, -0.9), 3.2, 4.4)
    return join(low, round_cone(q, (11.0, 62.0, -0.9), (19.0, 69.0, -0.9), 4.4, 2.4), 5.0)


def arms(p: Floats) -> Floats:
    """Short, spread and hanging by half a right angle."""
    q = one_side(p)
    arm = round_cone(q, (7.5, 33.0, 0.0), (20.0, 29.5, 0.5), 3.7, 3.3)
    hand = np.linalg.norm(q - [21.6, 29.0, 0.8], axis=-1) - 4.0
    return join(arm, hand, 2.0)


def legs(p: Floats) -> Floats:
    """Stout, on long feet with flat soles at y = 0."""
    q = one_side(p)
    leg = round_cone(q, (7.2, 13.5, 0.0), (8.2, 4.5, 0.0), 5.8, 4.4)
    foot = ellipsoid(q, (8.6, 3.0, 3.4), (4.8, 4.2, 8.2))
    return meet(join(leg, foot, 2.2), -p[..., 1], 1.2)


def tail(p: Floats) -> Floats:
    """Thick, raised at its end."""
    low = round_cone(p, TAIL[0], TAIL[1], 5.4, 4.3)
    return join(low, round_cone(p, TAIL[1], TAIL[2], 4.3, 4.0), 5.0)


def creature(p: Floats) -> Floats:
    """The whole creature."""
    body = join(trunk(p), head(p), 5.5)
    body = join(join(body, legs(p), 2.2), arms(p), 4.0)
    return join(join(body, tail(p), 5.0), ears(p), 2.5)


def creature_quads() -> Quads:
    """One closed quad mesh, symmetric in x; its parts are `front` and `back` of z = 0."""
    raw = surface_nets(creature, HALF, LO, HI, STEP)
    middle = raw.points[raw.faces].mean(axis=1)
    parts = np.where(middle[:, 2] > 0.0, "front", "back")
    mesh = Quads(points=raw.points, faces=raw.faces, parts=parts)
    seam = Seam(between=({"front"}, {"back"}), field=lambda p: p[..., 2])
    relax = Relaxation(mesh, creature, (seam,))
    points = relax.even(mesh.points, passes=60, limit=0.3)
    for _ in range(6):
        points = relax.settle(points, limit=0.2)
    return Quads(points=points, faces=mesh.faces, parts=parts)


def creature_atlas(mesh: Quads) -> Atlas:
    """Three charts: the front, and the two sides of the back, mirror images."""
    left = mesh.points[mesh.faces].mean(axis=1)[:, 0] > 0.0
    front = mesh.parts == "front"
    charts = []
    for chosen, right in ((front, X), (~front & left, -X), (~front & ~left, -X)):
        numbers = np.flatnonzero(chosen)
        flat, quads = chart(mesh.points, mesh.faces[numbers], right, Y, passes=150)
        charts.append((flat, numbers, quads))
    [placed] = pack([[flat for flat, _, _ in charts]], margin=1.0)
    pairs = zip(placed, charts)
    return gather([(flat, numbers, quads) for flat, (_, numbers, quads) in pairs], len(mesh.faces))
