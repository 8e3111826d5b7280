"""Blend shapes of meshes with a skeleton: their offsets, and the weights of an animation.

A mesh in the bind pose has the shapes at the weights of the first frame of the animation:
`SkinnedPlacement`.  What an animation of the weights w_k adds to a point are offsets D_k of the
shapes, and of their in-betweens, in proportion to weights that UsdSkel derives:

    X(t) = X + sum_k (w_k(t) - w_k(0)) D_k
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom, UsdSkel

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import StageFacts
from gf_usd.core.stage import BlendShapes
from gf_usd.readers.notes import Notes
from gf_usd.readers.usd.select import named_prim
from gf_usd.readers.usd.skeleton.skins import SkinnedPlacement, Skins
from gf_usd.readers.usd.stage import open_stage, reading

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix


def read_blend_shapes(
    file: Path, paths: Sequence[str], facts: StageFacts, *, first: float, times: Sequence[float]
) -> dict[str, BlendShapes]:
    """The blend shapes of some meshes whose weights change, by prim path.

    Those that do not match the points of their mesh are left out, as in its rest pose.

    file, facts : as in `read_skeleton`; first : time code of the first frame of the animation;
    times : (F,) time codes, of which those before `first` have its weights.
    """
    with reading(file):
        stage = open_stage(file)
        time = Usd.TimeCode(first)
        skins = Skins(time, UsdGeom.XformCache(time), Notes(), bind=True)
        codes = np.maximum(np.append(first, times), first).tolist()
        out = {}
        for path in paths:
            place = skins.placement(named_prim(stage, facts.path, path))
            found = None if place is None else _changing(place, codes)
            if place is not None and found is not None:
                names, offsets, weights = found
                to_world = place.bind_matrix[:3, :3] @ place.matrix[:3, :3] * facts.units.length
                moved = (offsets @ to_world).reshape(len(offsets), -1)
                out[path] = BlendShapes(names=names, offsets=_sparse(moved), weights=weights)
    return out


def _changing(
    place: SkinnedPlacement, codes: Sequence[float]
) -> tuple[tuple[str, ...], NDArray[np.float64], NDArray[np.float64]] | None:
    """Names of the shapes whose weights change, offsets (K, V, 3) in the space of the mesh, and
    weights (F, K) less those at the first of the time codes, of which they are for the others.
    """
    animation, mapper = place.skeleton.GetAnimQuery(), place.skin.GetBlendShapeMapper()
    if not (place.skin.HasBlendShapes() and animation and mapper is not None):
        return None
    if not animation.BlendShapeWeightsMightBeTimeVarying():
        return None
    prim = place.skin.GetPrim()
    query = UsdSkel.BlendShapeQuery(UsdSkel.BindingAPI(prim))
    points = UsdGeom.PointBased(prim).GetPointsAttr().Get(place.time)
    every = np.zeros((len(codes), query.GetNumSubShapes()))
    shape_of = np.zeros(query.GetNumSubShapes(), int)
    for row, code in enumerate(codes):
        weights = animation.ComputeBlendShapeWeights(Usd.TimeCode(code))
        parts = query.ComputeSubShapeWeights(mapper.Remap(weights)) if weights else None
        if parts is None:
            return None
        values, shapes, subs = (np.asarray(part) for part in parts)
        np.add.at(every[row], subs, values)
        shape_of[subs] = shapes
    changes = every[1:] - every[0]
    known = _offsets(query, np.flatnonzero(np.any(changes != 0.0, axis=0)), len(points))
    rows = [k for k, offsets in known.items() if offsets.any()]
    if not rows:
        return None
    names = [str(name) for name in place.skin.GetBlendShapeOrder()]
    used = dict.fromkeys(names[shape_of[k]] for k in rows)
    return tuple(used), np.stack([known[k] for k in rows]), changes[:, rows]


def _offsets(
    query: UsdSkel.BlendShapeQuery, rows: Ints, count: int
) -> dict[int, NDArray[np.float64]]:
    """(count, 3) offsets of the points by each of some sub-shapes that match them, by its row."""
    indices, out = query.ComputeBlendShapePointIndices(), {}
    every = query.ComputeSubShapePointOffsets()
    for k in rows.tolist():
        given = np.asarray(every[k], np.float64).reshape(-1, 3)
        of_points = np.asarray(indices[query.GetBlendShapeIndex(k)], int)
        if not len(of_points):
            of_points = np.arange(count)
        if len(of_points) == len(given) and (of_points >= 0).all() and (of_points < count).all():
            out[k] = np.zeros((count, 3))
            np.add.at(out[k], of_points, given)
    return out


def _sparse(offsets: Floats) -> csr_matrix:
    """Offsets (K, 3 V) as a matrix (3 V, K)."""
    from scipy.sparse import csr_matrix

    return csr_matrix(offsets.T)
