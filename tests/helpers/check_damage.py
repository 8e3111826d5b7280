"""Small damages to a good stage, for the tests of the check."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from check_stages import CODES, CUBE, GRID, box, motion, vec3
from pxr import Sdf, Usd, UsdGeom, Vt

Break = Callable[[Usd.Stage], None]
GAUSSIANS, POINTS, MESH, RUBBER = "/Body/Gaussians", "/Body/Points", "/Body/Mesh", "/Body/Rubber"
OURS = "gaussianFlesh:"
MIDDLE = float(CODES[5])


def put(path: str, name: str, value: object, code: float | None = None) -> Break:
    """A break that sets one attribute, at its default or at one sample."""

    def apply(stage: Usd.Stage) -> None:
        attribute = stage.GetPrimAtPath(path).GetAttribute(name)
        assert attribute, f"{path} has no {name}"
        attribute.Set(value) if code is None else attribute.Set(value, code)

    return apply


def spoil(path: str, name: str, change: Callable[[np.ndarray], np.ndarray]) -> Break:
    """A break that changes every sample of an array of vectors."""

    def apply(stage: Usd.Stage) -> None:
        attribute = stage.GetPrimAtPath(path).GetAttribute(name)
        for code in attribute.GetTimeSamples():
            attribute.Set(vec3(change(np.array(attribute.Get(code), np.float64))), code)

    return apply


def with_nan(values: np.ndarray) -> np.ndarray:
    values = np.array(values, np.float64)
    values[1] = np.nan
    return values


def apply_api(path: str, type_name: str, api: str) -> Break:
    def apply(stage: Usd.Stage) -> None:
        prim = stage.DefinePrim(path, type_name)
        prim.SetMetadata("apiSchemas", Sdf.TokenListOp.Create(prependedItems=[api]))

    return apply


def target(path: str, name: str, *targets: str) -> Break:
    def apply(stage: Usd.Stage) -> None:
        stage.GetPrimAtPath(path).GetRelationship(name).SetTargets(list(targets))

    return apply


def metadata(key: str, value: object) -> Break:
    return lambda stage: stage.GetRootLayer().pseudoRoot.SetInfo(key, value)


def normals_by(interpolation: str) -> Break:
    return lambda stage: UsdGeom.Mesh.Get(stage, MESH).SetNormalsInterpolation(interpolation)


def primvar_normals(stage: Usd.Stage) -> None:
    primvar = UsdGeom.PrimvarsAPI(stage.GetPrimAtPath(MESH)).CreatePrimvar(
        "normals", Sdf.ValueTypeNames.Normal3fArray, "faceVarying"
    )
    primvar.Set(vec3(CUBE))
    primvar.SetIndices(Vt.IntArray([0, 1, 2]))


def half(names: tuple[str, ...]) -> Break:
    """Cut every sample of these arrays to its first elements."""

    def apply(stage: Usd.Stage) -> None:
        for name in names:
            attribute = stage.GetPrimAtPath(MESH).GetAttribute(name)
            attribute.Set(attribute.Get(MIDDLE)[:7], MIDDLE)

    return apply


def lone_extent(stage: Usd.Stage) -> None:
    """An extent only for the first frame: the body falls out of it."""
    extent = stage.GetPrimAtPath(MESH).GetAttribute("extent")
    value = extent.Get(CODES[0])
    extent.Clear()
    extent.Set(value)


def no_extent(stage: Usd.Stage) -> None:
    stage.GetPrimAtPath(GAUSSIANS).RemoveProperty("extent")


def thin_extent(stage: Usd.Stage) -> None:
    """Around the points, but not around their balls of width 0.2."""
    extent = stage.GetPrimAtPath(POINTS).GetAttribute("extent")
    for code in CODES:
        extent.Set(box(motion(GRID, code)[0], 0.05), code)


def late_samples(stage: Usd.Stage) -> None:
    stage.SetEndTimeCode(CODES[-1] - 3)


def no_range(stage: Usd.Stage) -> None:
    layer = stage.GetRootLayer()
    layer.ClearStartTimeCode()
    layer.ClearEndTimeCode()


def bare_mesh(stage: Usd.Stage) -> None:
    mesh = UsdGeom.Mesh.Define(stage, "/Body/Mesh2")
    mesh.CreateFaceVertexCountsAttr([3])
    mesh.CreateFaceVertexIndicesAttr([0, 1, 2])


def grow(mesh: Usd.Prim) -> None:
    """One point more in one sample, inside the extent and moving along with the others."""
    for name in ("points", "velocities"):
        attribute = mesh.GetAttribute(name)
        values = np.array(attribute.Get(MIDDLE))
        attribute.Set(vec3(np.vstack([values, values.mean(axis=0)])), MIDDLE)
