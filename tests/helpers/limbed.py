"""Bodies with limbs, as stages: the zero surfaces of signed distances, watertight."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import igl
import numpy as np
from pxr import Usd, UsdGeom, Vt

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.mesh.measures import signed_volume

Distance = Callable[[Floats], Floats]  # (n, 3) [m] -> (n,) [m], below 0 inside
Mesh = tuple[Floats, Ints]


def cone(a: tuple, b: tuple, start: float, end: float) -> Distance:
    """A limb from a to b whose radius goes from `start` to `end` [m], with round ends."""
    first, axis = np.array(a, float), np.array(b, float) - a

    def distance(X: Floats) -> Floats:
        t = np.clip((X - first) @ axis / (axis @ axis), 0.0, 1.0)
        return np.linalg.norm(X - first - t[:, None] * axis, axis=1) - (start + t * (end - start))

    return distance


def box(middle: tuple, size: tuple, rounding: float) -> Distance:
    """A box of a size [m] whose edges are rounded."""
    half = 0.5 * np.array(size) - rounding

    def distance(X: Floats) -> Floats:
        q = np.abs(X - np.array(middle)) - half
        return np.linalg.norm(np.maximum(q, 0.0), axis=1) + np.minimum(q.max(1), 0.0) - rounding

    return distance


def union(*parts: Distance) -> Distance:
    """What is inside any of them."""
    return lambda X: np.min([part(X) for part in parts], axis=0)


def surface(of: Distance, low: tuple, high: tuple, step: float) -> Mesh:
    """Points and outward triangles of the zero surface in a box, on a lattice of `step` [m]."""
    axes = [np.arange(a - step, b + 2.0 * step, step) for a, b in zip(low, high)]
    z, y, x = np.meshgrid(*axes[::-1], indexing="ij")
    X = np.stack([x.ravel(), y.ravel(), z.ravel()], 1)
    nx, ny, nz = map(len, axes)
    made: Any = igl.marching_cubes(of(X), X, nx, ny, nz, 0.0)
    points, triangles, _ = made
    triangles = triangles.astype(np.int64)
    return points, triangles if signed_volume(points, triangles) > 0.0 else triangles[:, ::-1]


def hand() -> list[Mesh]:
    """A palm and five fingers, which nearly touch."""
    fingers = [
        cone((x, 0.9, 0.0), (1.15 * x, 0.9 + length, 0.0), 0.09, 0.07)
        for x, length in ((-0.36, 0.55), (-0.12, 0.7), (0.12, 0.75), (0.36, 0.65))
    ]
    thumb = cone((0.35, 0.3, 0.0), (0.8, 0.75, 0.1), 0.11, 0.09)
    palm = box((0.0, 0.5, 0.0), (0.95, 0.95, 0.26), 0.1)
    return [surface(union(palm, thumb, *fingers), (-0.6, 0.0, -0.2), (1.0, 1.8, 0.3), 0.025)]


def table() -> list[Mesh]:
    """A top of 8 cm on four legs of 9 cm."""
    legs = [box((x, 0.36, z), (0.09, 0.72, 0.09), 0.02) for x in (-0.5, 0.5) for z in (-0.3, 0.3)]
    top = box((0.0, 0.72, 0.0), (1.2, 0.08, 0.8), 0.02)
    return [surface(union(top, *legs), (-0.6, 0.0, -0.4), (0.6, 0.8, 0.4), 0.015)]


def octopus() -> list[Mesh]:
    """A ball on eight arms that grow thin."""
    turns = np.arange(8) * np.pi / 4.0
    arms = [
        cone((0.3 * c, 0.5, 0.3 * s), (1.1 * c, 0.1, 1.1 * s), 0.14, 0.05)
        for c, s in zip(np.cos(turns), np.sin(turns))
    ]
    head = cone((0.0, 0.7, 0.0), (0.0, 0.8, 0.0), 0.45, 0.45)
    return [surface(union(head, *arms), (-1.2, 0.0, -1.2), (1.2, 1.3, 1.2), 0.03)]


def rings() -> list[Mesh]:
    """A chain of five thin rings that do not touch, each a body."""

    def ring(k: int) -> Distance:
        def distance(X: Floats) -> Floats:
            at = X - [0.42 * k, 0.4, 0.0]
            x, across, through = at[:, 0], at[:, 1 + k % 2], at[:, 2 - k % 2]
            return np.hypot(np.hypot(x, across) - 0.3, through) - 0.05

        return distance

    return [
        surface(ring(k), (0.42 * k - 0.36, 0.04, -0.36), (0.42 * k + 0.36, 0.76, 0.36), 0.02)
        for k in range(5)
    ]


LIMBED = {"hand": hand, "table": table, "octopus": octopus, "rings": rings}


def write_limbed(name: str, path: Path) -> Path:
    """A stage of one of `LIMBED`, in meters, Y up, a Mesh for each of its parts."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    root = UsdGeom.Xform.Define(stage, f"/{name.title()}")
    stage.SetDefaultPrim(root.GetPrim())
    for k, (points, triangles) in enumerate(LIMBED[name]()):
        mesh = UsdGeom.Mesh.Define(stage, root.GetPath().AppendChild(f"Part{k}"))
        mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points.astype(np.float32)))
        mesh.CreateFaceVertexCountsAttr(np.full(len(triangles), 3, np.int32))
        mesh.CreateFaceVertexIndicesAttr(triangles.astype(np.int32).ravel())
        mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        low_high = np.stack([points.min(0), points.max(0)]).astype(np.float32)
        mesh.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(low_high))
    stage.GetRootLayer().Save()
    return path
