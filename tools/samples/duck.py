"""The rubber duck: blended implicit shapes in centimeters, Y up, facing +Z, and its quads."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tools.samples.implicit import ellipsoid, join, lozenge, meet, one_side, round_cone, tilt
from tools.samples.quads import Box, Quads, box_surface, warp
from tools.samples.relax import MIRROR, Relaxation, Seam, edges_between
from tools.samples.uv import Atlas, chart, gather, pack

Floats = NDArray[np.float64]

X, Y, Z = np.eye(3)

HEAD_CENTER = np.array([0.0, 7.05, 1.55])
HEAD_RADIUS = 2.5
EYE_DIRECTION = np.array([0.62, 0.20, 0.76])
EYE_CENTER = HEAD_CENTER + (HEAD_RADIUS - 0.37) * EYE_DIRECTION
EYE_RADIUS = 0.60


def trunk(p: Floats) -> Floats:
    """Body, wings and head."""
    body = ellipsoid(p, (0.0, 2.45, -0.55), (3.45, 3.05, 4.15))
    chest = ellipsoid(p, (0.0, 3.2, 0.9), (3.0, 3.05, 2.9))
    lifted = tilt(one_side(p), (3.1, 3.7, -0.9), -14.0)
    wing = ellipsoid(lifted, (2.95, 3.6, -0.8), (0.7, 1.3, 2.3))
    head = np.linalg.norm((p - HEAD_CENTER) / [1.0, 0.97, 1.0], axis=-1) - HEAD_RADIUS
    return join(join(join(body, chest, 1.6), wing, 0.8), head, 1.3)


def tail(p: Floats) -> Floats:
    """A flat round cone that points up and back."""
    flat = p * np.array([0.65, 1.0, 1.0])
    return round_cone(flat, (0.0, 3.9, -3.0), (0.0, 5.75, -4.65), 1.15, 0.4)


def plumage(p: Floats) -> Floats:
    """Everything yellow, with a flat base at y = 0."""
    return meet(join(trunk(p), tail(p), 1.3), -p[..., 1], 0.4)


def upper_bill(p: Floats) -> Floats:
    """Broad, its tip lifted by a parabola."""
    rise = 0.16 * np.maximum(p[..., 2] - 3.6, 0.0) ** 2
    bent = p - rise[..., None] * np.array([0.0, 1.0, 0.0])
    return lozenge(bent, (0.0, 6.5, 3.2), (1.5, 0.47, 1.9))


def lower_bill(p: Floats) -> Floats:
    """Shorter and narrower than the upper bill."""
    return lozenge(p, (0.0, 5.97, 3.0), (1.15, 0.45, 1.65))


def bill(p: Floats) -> Floats:
    """Both halves, slightly melted together."""
    return join(upper_bill(p), lower_bill(p), 0.3)


def eyes(p: Floats) -> Floats:
    """Two domes, partly inside the head."""
    return np.linalg.norm(one_side(p) - EYE_CENTER, axis=-1) - EYE_RADIUS


def duck(p: Floats) -> Floats:
    """The whole duck."""
    return join(join(plumage(p), bill(p), 0.3), eyes(p), 0.12)


BOXES = (
    Box(part="body", lo=(-10, 0, 0), hi=(10, 14, 26)),
    Box(part="tail", lo=(-4, 10, -5), hi=(4, 14, 0)),
    Box(part="body", lo=(-6, 14, 11), hi=(6, 28, 26)),
    Box(part="upper", lo=(-5, 18, 26), hi=(5, 20, 34)),
    Box(part="lower", lo=(-4, 16, 26), hi=(4, 18, 32)),
    Box(part="eyes", lo=(4, 21, 24), hi=(7, 27, 27)),
    Box(part="eyes", lo=(-7, 21, 24), hi=(-4, 27, 27)),
)
PLANES = (
    {-10: -3.0, -6: -1.75, 6: 1.75, 10: 3.0},
    {0: 0.3, 10: 3.6, 14: 5.2, 16: 5.7, 18: 6.2, 20: 6.9, 28: 9.0},
    {-4: -4.8, 0: -3.8, 11: 0.0, 26: 3.3, 34: 5.0},
)
MATERIAL_OF = {"body": "body", "tail": "body", "upper": "beak", "lower": "beak", "eyes": "eyes"}
YELLOW, BEAK = {"body", "tail"}, {"upper", "lower"}
SEAMS = (
    # 0.4 up the tail from where it leaves the body: clear of the wings
    Seam(between=({"tail"}, {"body"}), field=lambda p: tail(p) - trunk(p) + 0.4),
    Seam(between=(BEAK, YELLOW), field=lambda p: bill(p) - plumage(p)),
    Seam(between=({"upper"}, {"lower"}), field=lambda p: upper_bill(p) - lower_bill(p)),
    Seam(between=({"eyes"}, YELLOW), field=lambda p: eyes(p) - plumage(p)),
)


def steer_eyes(points: Floats, blocks: Quads, relax: Relaxation) -> Floats:
    """Drift the quads of the eyes, and the face with them, until they surround the domes."""
    ring = np.unique(edges_between(blocks, {"eyes"}, YELLOW))
    ring = ring[blocks.points[ring, 0] > 0]
    for _ in range(10):
        middle = points[ring].mean(axis=0)
        shift = 0.3 * (EYE_CENTER - middle)
        for flip in (np.ones(3), MIRROR):
            distance = np.linalg.norm(points - flip * middle, axis=1)
            points = points + np.exp(-(distance**2) / 1.5)[:, None] * flip * shift
        points = relax.even(points, passes=2, limit=0.15)
    return points


def duck_quads() -> Quads:
    """The duck as one closed quad mesh; its parts are those of ``BOXES``."""
    blocks = box_surface(BOXES)
    points = warp(blocks.points, PLANES)
    points[:, 1] += 0.4 * np.maximum(-blocks.points[:, 2], 0.0)
    loose = Relaxation(blocks, duck)
    points = loose.even(points, passes=20, limit=0.15)
    points = steer_eyes(points, blocks, loose)
    tight = Relaxation(blocks, duck, SEAMS)
    points = tight.even(points, passes=200, limit=0.1)
    for _ in range(6):
        points = tight.settle(points, limit=0.1)
    return Quads(points=points, faces=blocks.faces, parts=blocks.parts)


def duck_atlas(mesh: Quads) -> Atlas:
    """Four charts: the two sides of the duck, mirror images, and the two halves of its bill."""
    left = mesh.points[mesh.faces].mean(axis=1)[:, 0] > 0.0
    skin = ~np.isin(mesh.parts, sorted(BEAK))
    charts = []
    for chosen, right, up in (
        (skin & left, -Z, Y),
        (skin & ~left, Z, Y),
        (mesh.parts == "upper", X, -Z),
        (mesh.parts == "lower", X, Z),
    ):
        numbers = np.flatnonzero(chosen)
        flat, quads = chart(mesh.points, mesh.faces[numbers], right, up, passes=100)
        charts.append((flat, numbers, quads))
    flats = [flat for flat, _, _ in charts]
    placed = pack([flats[:2], flats[2:]], margin=0.2)
    pairs = zip([*placed[0], *placed[1]], charts)
    return gather([(flat, numbers, quads) for flat, (_, numbers, quads) in pairs], len(mesh.faces))
