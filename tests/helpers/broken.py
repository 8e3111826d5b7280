"""Sound solids, broken on purpose."""

from __future__ import annotations

import numpy as np
from solids import surface

from gf_usd.core.mesh import signed_volume, weld


def without(body, rows):
    """A surface that lacks some of its triangles."""
    kept = np.delete(body.triangles, rows, axis=0)
    return surface(body.points, kept)


def turned(body, rows):
    """A surface with some triangles turned over."""
    triangles = body.triangles.copy()
    triangles[rows] = triangles[rows, ::-1]
    return surface(body.points, triangles)


def joined(*bodies):
    """Several surfaces as the shells of one."""
    first = np.cumsum([0, *(len(b.points) for b in bodies)])
    triangles = [b.triangles + o for b, o in zip(bodies, first)]
    return surface(np.concatenate([b.points for b in bodies]), np.concatenate(triangles))


def volume(body) -> float:
    """Signed volume of the welded triangles."""
    return signed_volume(body.points, weld(body.points)[0][body.triangles])


def around(body, vertex: int) -> np.ndarray:
    """Rows of the triangles about a vertex."""
    return np.flatnonzero((body.triangles == vertex).any(1))
