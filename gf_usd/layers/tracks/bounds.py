"""Bounds that the source authors above its meshes and that the simulated motion invalidates."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Protocol

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdSkel, Vt

from gf_usd.core.arrays import Floats
from gf_usd.layers.stage import Clock


class Boxed(Protocol):
    """A track of the cache with a bounding box."""

    path: Sdf.Path
    low: Floats  # (3,) corner of the last sample, in the space of the track
    high: Floats

    def to_world(self, time_code: float) -> Floats:
        """From that space to the world (4, 4), stage units."""
        ...


class SkelBound:
    """The extent of one SkelRoot, per frame.

    USD does not compute bounds below a SkelRoot but uses its extent, and cannot compute that extent
    once the meshes below are no longer skinned.
    """

    def __init__(
        self,
        cache: Usd.Stage,
        root: Usd.Prim,
        tracks: Sequence[Boxed],
        clock: Clock,
        margin: float = 0.0,
    ) -> None:
        self._margin = margin
        self._root = root
        self._tracks = [t for t in tracks if t.path.HasPrefix(root.GetPath())]
        self._clock = clock
        baked = {t.path for t in self._tracks}
        below = Usd.PrimRange(root, Usd.TraverseInstanceProxies())
        self._others = any(p.IsA(UsdGeom.Gprim) and p.GetPath() not in baked for p in below)
        over = cache.OverridePrim(root.GetPath())
        self._extent = over.CreateAttribute("extent", Sdf.ValueTypeNames.Float3Array, False)

    def write(self, time_code: float) -> None:
        """Author the union of the boxes, after they were written at this time code."""
        source_time = self._clock.source_time(time_code)
        cache = UsdGeom.XformCache(source_time)
        to_root = np.linalg.inv(np.array(cache.GetLocalToWorldTransform(self._root)))
        boxes = []
        for track in self._tracks:
            forward = track.to_world(time_code) @ to_root
            box = _corners(track.low, track.high) @ forward[:3, :3] + forward[3, :3]
            wider = self._margin * np.linalg.norm(to_root[:3, :3], 2)
            boxes += [box - wider, box + wider] if wider else [box]
        if self._others:
            # other prims are still posed by the skeleton, so the source's extent is right for them
            extent = UsdGeom.Boundable.ComputeExtentFromPlugins(
                UsdGeom.Boundable(self._root), source_time
            )
            if extent is not None and len(extent) == 2:
                boxes.append(np.array(extent, np.float64))
        corners = np.concatenate(boxes)
        box = np.stack([corners.min(axis=0), corners.max(axis=0)]).astype(np.float32)
        self._extent.Set(Vt.Vec3fArray.FromNumpy(box), time_code)


def skel_bounds(
    cache: Usd.Stage,
    source: Usd.Stage,
    tracks: Sequence[Boxed],
    clock: Clock,
    margin: float = 0.0,
) -> list[SkelBound]:
    """One for each SkelRoot above a baked prim.

    margin : [stage units] by which the prims below may exceed their own boxes.
    """
    roots = [p for p in _above(source, tracks) if p.IsA(UsdSkel.Root)]
    return [SkelBound(cache, root, tracks, clock, margin) for root in roots]


def block_hints(cache: Usd.Stage, source: Usd.Stage, tracks: Sequence[Boxed]) -> None:
    """Block every authored extentsHint above a baked prim.

    Bounds are then computed from the extents below.  Where the payload is not loaded, the source's
    hint is still used.
    """
    for prim in _above(source, tracks):
        hint = prim.GetAttribute("extentsHint")
        if hint.HasAuthoredValue():
            over = cache.OverridePrim(prim.GetPath())
            over.CreateAttribute("extentsHint", hint.GetTypeName(), False).Block()


def _above(source: Usd.Stage, tracks: Iterable[Boxed]) -> list[Usd.Prim]:
    paths = {p for track in tracks for p in track.path.GetParentPath().GetPrefixes()}
    return [source.GetPrimAtPath(path) for path in sorted(paths)]


def _corners(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    box = np.stack([low, high]).astype(np.float64)
    return np.array([[box[i, 0], box[j, 1], box[k, 2]] for i, j, k in np.ndindex(2, 2, 2)])
