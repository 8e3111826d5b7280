"""Surface extraction and validation of the tetrahedra of a TetMesh.

A tetrahedron (a, b, c, d) of a right-handed TetMesh has the volume

    V = (b - a) . ((c - a) x (d - a)) / 6 > 0

and the faces (b c d), (a d c), (a b d), (a c b), counter-clockwise seen from outside
(UsdGeomTetMesh).  The faces that only one tetrahedron has are the surface.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gf_usd.core.arrays import Floats, Ints, cross
from gf_usd.core.mesh.topology import tet_surface, weld
from gf_usd.core.units import percent_text

EDGES = np.array([(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)])
FLAT = 1e-9  # of the cube of its longest edge: volume below which a tetrahedron is degenerate
STRETCHED = 1e-4  # relative edge length difference up to which a rest shape matches the points


class BrokenTets(Exception):
    """The tetrahedra are invalid; the text is the reason."""


@dataclass(frozen=True, kw_only=True)
class Tets:
    """A TetMesh as authored, in local space."""

    points: Floats  # (V, 3), finite
    tets: Ints  # (n, 4) into points
    surface: Ints  # (T, 3) into points; empty: not authored
    left_handed: bool
    rest_points: Floats  # (R, 3) of the rest shape; empty: as points
    rest_tets: Ints  # (n, 4) into rest_points; empty: as tets


def surface_of(body: Tets, say: Callable[[str], None]) -> Ints:
    """Triangles (T, 3) of the surface, counter-clockwise seen from outside.

    They are the authored ones, in their order, where they are authored with consistent winding.

    say : called with notes on assumptions.

    Raises BrokenTets for indices out of range, inverted or overlapping tetrahedra, and an authored
    surface that is not the boundary of the tetrahedra.
    """
    points, tets = body.points, body.tets
    _require_range("tetVertexIndices", tets, len(points))
    _require_range("surfaceFaceVertexIndices", body.surface, len(points))
    volumes = signed_volumes(points, tets)
    handed = -1.0 if body.left_handed else 1.0
    sign = _sign(volumes * handed, _flat(points, tets), "its points", say) * handed
    _check_rest_shape(body, sign, say)
    wound = tets if sign > 0.0 else tets[:, [0, 2, 1, 3]]
    if len(body.surface):
        return _authored(body.surface, boundary(wound), say)
    # Tetrahedra that share no points may have coincident ones.
    one, _ = weld(points)
    inner = boundary(one[wound])
    return inner if len(inner) else boundary(wound)


def signed_volumes(points: Floats, tets: Ints) -> Floats:
    """(n,) signed volumes of tetrahedra (n, 4)."""
    a, b, c, d = np.moveaxis(np.asarray(points, np.float64)[tets], 1, 0)
    return np.einsum("ij,ij->i", b - a, cross(c - a, d - a)) / 6.0


def boundary(tets: Ints) -> Ints:
    """(T, 3) faces that only one of the tetrahedra (n, 4) has, facing outward.

    Raises BrokenTets where more than two tetrahedra share a face.
    """
    faces, crowded = tet_surface(tets)
    if crowded:
        raise BrokenTets(f"{crowded} faces belong to more than two tetrahedra")
    return faces


def _require_range(name: str, indices: Ints, count: int) -> None:
    outside = (indices < 0) | (indices >= count)
    if outside.any():
        raise BrokenTets(
            f"{int(outside.sum())} {name} do not refer to any of its {count} points; the first "
            f"is {indices[outside][0]}"
        )


def _flat(points: Floats, tets: Ints) -> Floats:
    """(n,) volume below which each tetrahedron is degenerate."""
    corners = np.asarray(points, np.float64)[tets]
    edges = np.linalg.norm(corners[:, EDGES[:, 0]] - corners[:, EDGES[:, 1]], axis=2)
    return FLAT * edges.max(axis=1, initial=0.0) ** 3


def _sign(volumes: Floats, least: Floats, where: str, say: Callable[[str], None]) -> float:
    """1 where the tetrahedra match the authored orientation, -1 where all are opposite to it.

    volumes : (n,) signed, positive for the authored orientation; least : (n,) volumes below which
    they are degenerate.
    """
    flat = np.abs(volumes) <= least
    inverted = (volumes < 0.0) & ~flat
    if flat.any():
        first = int(np.flatnonzero(flat)[0])
        say(
            f"{int(flat.sum())} of {len(volumes)} tetrahedra have no volume at {where}, for "
            f"example number {first}"
        )
    if flat.all():
        raise BrokenTets(f"all of its {len(volumes)} tetrahedra have no volume at {where}")
    if inverted[~flat].all():
        say(f"the winding of its tetrahedra contradicts its orientation at {where} and is reversed")
        return -1.0
    if inverted.any():
        first = int(np.flatnonzero(inverted)[0])
        raise BrokenTets(
            f"{int(inverted.sum())} of {len(volumes)} tetrahedra are inverted at {where}:"
            f" number {first} has a volume of {volumes[first]:.3g} stage units cubed"
        )
    return 1.0


def _check_rest_shape(body: Tets, sign: float, say: Callable[[str], None]) -> None:
    """Raise BrokenTets for an invalid rest shape; note where it differs from the points."""
    if not len(body.rest_points):
        return
    rest = body.rest_points
    tets = body.rest_tets if len(body.rest_tets) else body.tets
    if len(tets) != len(body.tets):
        raise BrokenTets(f"it has {len(body.tets)} tetrahedra but its rest shape has {len(tets)}")
    if not len(body.rest_tets) and len(rest) != len(body.points):
        raise BrokenTets(f"it has {len(body.points)} points but {len(rest)} restShapePoints")
    if not np.isfinite(rest).all():
        raise BrokenTets("some of its restShapePoints are not finite (NaN or infinity)")
    _require_range("tetrahedra of the rest shape", tets, len(rest))
    _sign(signed_volumes(rest, tets) * sign, _flat(rest, tets), "its rest shape", say)
    now, then = (
        np.linalg.norm(corners[:, EDGES[:, 0]].astype(np.float64) - corners[:, EDGES[:, 1]], axis=2)
        for corners in (body.points[body.tets], rest[tets])
    )
    change = float(np.abs(now - then).max() / max(then.max(), np.finfo(float).tiny))
    if change > STRETCHED:
        say(
            f"its rest shape differs from its points (an edge by {percent_text(change)} of the"
            " longest one): the bake starts at its points, free of stress"
        )


def _authored(surface: Ints, outward: Ints, say: Callable[[str], None]) -> Ints:
    """The authored triangles, facing outward."""
    order = {tuple(sorted(row)): k for k, row in enumerate(outward.tolist())}
    rows = [order.get(tuple(sorted(row)), -1) for row in surface.tolist()]
    foreign, missing = rows.count(-1), len(set(order.values()) - set(rows))
    if foreign or missing or len(rows) != len(order):
        raise BrokenTets(
            f"{foreign} of its {len(surface)} surfaceFaceVertexIndices are not faces of the "
            f"surface of its tetrahedra, and {missing} of the {len(outward)} faces of that "
            f"surface are missing"
        )
    # An even permutation of the corners preserves the winding.
    same = np.array([_even(a, b) for a, b in zip(surface.tolist(), outward[rows].tolist())])
    if same.all():
        return surface
    if same.any():
        say(
            f"{int((~same).sum())} of its {len(surface)} surfaceFaceVertexIndices are wound "
            f"inward and are reversed"
        )
    return np.where(same[:, None], surface, surface[:, ::-1])


def _even(a: list[int], b: list[int]) -> bool:
    turn = b.index(a[0])
    return a == b[turn:] + b[:turn]
