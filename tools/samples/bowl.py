"""A round bowl as one closed quad mesh, and how it rocks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

AROUND = 64
RADIUS, DEPTH, WALL = 4.4, 1.7, 0.36  # [m] to the middle of the rim, of the hollow, of the wall
TILT, PERIOD, BOB, EASE = 9.0, 2.2, 0.3, 0.6  # [deg], [s], [m], [s]


def profile() -> Floats:
    """(K, 2) radius and height, from the middle of the hollow over the rim to the middle below."""
    curve = (RADIUS**2 + DEPTH**2) / (2.0 * DEPTH)  # radius of the sphere inside
    end = np.arcsin(RADIUS / curve)
    middle = np.array([0.0, curve])
    angle = np.linspace(0.0, end, 15)
    ray = np.stack([np.sin(angle), -np.cos(angle)], axis=1)
    rim = middle + curve * ray[-1]
    turn = np.linspace(0.0, np.pi, 7)[1:-1, None]
    lip = rim - 0.5 * WALL * (np.cos(turn) * ray[-1] - np.sin(turn) * [-ray[-1, 1], ray[-1, 0]])
    inside, outside = (middle + (curve + side * 0.5 * WALL) * ray for side in (-1.0, 1.0))
    return np.concatenate([inside, lip, outside[::-1]])


def bowl() -> tuple[Floats, Ints, Ints, Floats]:
    """points (V, 3) [m], Y up, the lowest at y = -WALL / 2; counts, indices, vertex normals."""
    points, counts, indices = revolved(profile(), AROUND)
    return points, counts, indices, vertex_normals(points, counts, indices)


def revolved(line: Floats, around: int) -> tuple[Floats, Ints, Ints]:
    """points (V, 3), counts, indices of a profile (K, 2) of radius and height, turned about Y.

    It begins and ends on the axis; quads lie between, in `around` sectors.
    """
    count = len(line)
    angle = 2.0 * np.pi * np.arange(around) / around
    circle = np.stack([np.cos(angle), np.zeros(around), np.sin(angle)], axis=1)
    rings = line[1:-1, 0, None, None] * circle + line[1:-1, 1, None, None] * [0.0, 1.0, 0.0]
    top, bottom = ([[0.0, line[end, 1], 0.0]] for end in (0, -1))
    points = np.concatenate([top, rings.reshape(-1, 3), bottom])
    j = np.arange(around)
    ring = 1 + np.arange(count - 2)[:, None] * around
    here, after = ring + j, ring + (j + 1) % around
    quads = np.stack([here[:-1], after[:-1], after[1:], here[1:]], axis=-1).reshape(-1, 4)
    first = np.stack([np.zeros_like(j), after[0], here[0]], axis=-1)
    last = np.stack([np.full_like(j, len(points) - 1), here[-1], after[-1]], axis=-1)
    indices = np.concatenate([first.ravel(), quads.ravel(), last.ravel()])
    counts = np.concatenate([np.full(around, 3), np.full(len(quads), 4), np.full(around, 3)])
    return points, counts, indices


def vertex_normals(points: Floats, counts: Ints, indices: Ints) -> Floats:
    """(V, 3) unit: the sum of the area vectors of the faces around each point."""
    total = np.zeros_like(points)
    starts = np.cumsum(counts) - counts
    for start, n in zip(starts, counts):
        corners = indices[start : start + n]
        ring = points[corners]
        total[corners] += np.cross(ring, np.roll(ring, -1, axis=0)).sum(axis=0)
    return total / np.linalg.norm(total, axis=1, keepdims=True)


def rocking(seconds: Floats) -> tuple[Floats, Floats]:
    """Lift [m] and turns about X and Z [deg] (n, 2): at rest at first, then the tilt goes round."""
    ease = np.clip(seconds / EASE, 0.0, 1.0)
    ease = ease * ease * (3.0 - 2.0 * ease)
    phase = 2.0 * np.pi * seconds / PERIOD
    turns = TILT * ease[:, None] * np.stack([np.sin(phase), np.sin(phase - 0.5 * np.pi)], axis=1)
    return BOB * ease * np.sin(0.5 * phase), turns
