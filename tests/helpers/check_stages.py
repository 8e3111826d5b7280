"""A small stage with everything that the rules look at, and nothing wrong with it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, UsdShade, UsdVol, Vt

RATE = 30.0  # time codes per second; not the default 24, so that a mix-up shows
CODES = np.arange(1.0, 13.0)
CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)
FACES = [0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4, 1, 5, 7, 3]
GRID = np.array([[x, y, z] for x in (-0.5, 0, 0.5) for y in (-0.5, 0, 0.5) for z in (-0.5, 0, 0.5)])
Types = Sdf.ValueTypeNames


def motion(rest: np.ndarray, code: float) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities [1/s] of a falling, slowly swelling body: smooth by construction."""
    t = (code - CODES[0]) / RATE
    swell, rate = 1.0 + 0.1 * np.sin(3.0 * t), 0.3 * np.cos(3.0 * t)
    x = rest * swell + np.array([0.0, 8.0 - 4.905 * t * t, 0.0])
    v = rest * rate + np.array([0.0, -9.81 * t, 0.0])
    return x, v


def vec3(values: np.ndarray) -> Vt.Vec3fArray:
    return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(values, np.float32))


def floats(values: np.ndarray | list[float]) -> Vt.FloatArray:
    return Vt.FloatArray.FromNumpy(np.asarray(values, np.float32))


def box(points: np.ndarray, margin: float = 0.0) -> Vt.Vec3fArray:
    return vec3(np.stack([points.min(axis=0) - margin, points.max(axis=0) + margin]))


def good_stage(path: Path) -> Usd.Stage:
    """A mesh, its Gaussians and their twin of points, with materials, over 12 frames."""
    stage = Usd.Stage.CreateNew(str(path))
    stage.SetTimeCodesPerSecond(RATE)
    stage.SetFramesPerSecond(RATE)
    stage.SetStartTimeCode(CODES[0])
    stage.SetEndTimeCode(CODES[-1])
    UsdGeom.SetStageUpAxis(stage, "Y")
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    root = UsdGeom.Xform.Define(stage, "/Body")
    stage.SetDefaultPrim(root.GetPrim())
    root.GetPrim().ApplyAPI("GaussianFleshBakeAPI")
    root.GetPrim().GetAttribute("gaussianFlesh:solver").Set("totalLagrangian")
    materials = [_material(stage, name) for name in ("Rubber", "Steel")]
    _mesh(stage)
    _gaussians(stage, materials)
    _points(stage, materials)
    return stage


def _material(stage: Usd.Stage, name: str) -> Sdf.Path:
    prim = UsdShade.Material.Define(stage, f"/Body/{name}").GetPrim()
    UsdPhysics.MaterialAPI.Apply(prim).CreateDensityAttr(1100.0)
    prim.ApplyAPI("GaussianFleshMaterialAPI")
    prim.GetAttribute("gaussianFlesh:law").Set("neoHookean")
    prim.GetAttribute("physics:youngsModulus").Set(1e6)
    prim.GetAttribute("physics:poissonsRatio").Set(0.4)
    return prim.GetPath()


def _mesh(stage: Usd.Stage) -> None:
    mesh = UsdGeom.Mesh.Define(stage, "/Body/Mesh")
    mesh.CreateSubdivisionSchemeAttr("none")
    mesh.CreateFaceVertexCountsAttr([4] * 6)
    mesh.CreateFaceVertexIndicesAttr(FACES)
    mesh.CreateNormalsAttr(vec3(CUBE / np.sqrt(3.0)))
    mesh.SetNormalsInterpolation("vertex")
    for code in CODES:
        x, v = motion(CUBE, code)
        mesh.CreatePointsAttr().Set(vec3(x), code)
        mesh.CreateVelocitiesAttr().Set(vec3(v), code)
        mesh.CreateExtentAttr().Set(box(x), code)


def _gaussians(stage: Usd.Stage, materials: list[Sdf.Path]) -> None:
    field = UsdVol.ParticleField3DGaussianSplat.Define(stage, "/Body/Gaussians")
    prim, count = field.GetPrim(), len(GRID)
    _particles(prim, materials)
    identity = Vt.QuatfArray(count, Gf.Quatf(1.0))
    prim.GetAttribute("opacities").Set(floats(np.full(count, 0.5)))
    prim.GetAttribute("scales").Set(vec3(np.full((count, 3), 0.1)))
    prim.GetAttribute("orientations").Set(identity)
    prim.GetAttribute("radiance:sphericalHarmonicsDegree").Set(1)
    prim.GetAttribute("radiance:sphericalHarmonicsCoefficients").Set(vec3(np.ones((4 * count, 3))))
    for code in CODES:
        x, v = motion(GRID, code)
        prim.GetAttribute("positions").Set(vec3(x), code)
        prim.GetAttribute("gaussianFlesh:velocities").Set(vec3(v), code)
        field.CreateExtentAttr().Set(box(x, 0.3), code)


def _points(stage: Usd.Stage, materials: list[Sdf.Path]) -> None:
    points = UsdGeom.Points.Define(stage, "/Body/Points")
    _particles(points.GetPrim(), materials)
    points.CreateWidthsAttr(floats(np.full(len(GRID), 0.2)))
    points.SetWidthsInterpolation("vertex")
    for code in CODES:
        x, v = motion(GRID, code)
        points.CreatePointsAttr().Set(vec3(x), code)
        points.CreateVelocitiesAttr().Set(vec3(v), code)
        points.CreateExtentAttr().Set(box(x, 0.1), code)


def _particles(prim: Usd.Prim, materials: list[Sdf.Path]) -> None:
    count = len(GRID)
    prim.ApplyAPI("GaussianFleshParticlesAPI")
    ours = {
        "restPositions": vec3(GRID),
        "restOrientations": Vt.QuatfArray(count, Gf.Quatf(1.0)),
        "restScales": vec3(np.full((count, 3), 0.1)),
        "restVolumes": floats(np.full(count, 8.0 / count)),
        "masses": floats(np.full(count, 8800.0 / count)),
        "materialIndices": Vt.IntArray([i % 2 for i in range(count)]),
        "youngsModulus": floats(np.full(count, 1e6)),
        "poissonsRatio": floats(np.full(count, 0.4)),
        "densities": floats(np.full(count, 1100.0)),
    }
    for name, value in ours.items():
        prim.GetAttribute(f"gaussianFlesh:{name}").Set(value)
    prim.GetAttribute("gaussianFlesh:vonMisesStress").Set(floats(np.zeros(count)), CODES[0])
    prim.GetRelationship("gaussianFlesh:materials").SetTargets(materials)
    prim.GetRelationship("gaussianFlesh:sourceMeshes").SetTargets(["/Body/Mesh"])
