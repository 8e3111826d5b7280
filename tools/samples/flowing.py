"""Two stages of what flows: a sand castle that the duck runs into, and a snowball on a bowl.

What each body is made of stands in the stage, as a preset; the duck is referenced.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Kind, Sdf, Usd, UsdGeom, UsdPhysics, Vt

from tools.samples.bowl import bowl, revolved

Floats = NDArray[np.float64]
Types = Sdf.ValueTypeNames
AROUND = 24  # sectors of a tower
# [cm] a tower: radius at its foot and its top, height; where its middle stands
KEEP = (5.2, 4.2, 13.0)
TOWER = (3.8, 3.0, 9.0)
CORNERS = ((-8.0, -8.0), (8.0, -8.0), (-8.0, 8.0), (8.0, 8.0))
START = (1.0, 4.0, 34.0)  # [cm] of the duck, which is turned toward the castle
SPEED = (0.0, 50.0, 650.0)  # [cm/s], in its own frame
SAND, SNOW, METAL = (0.55, 0.43, 0.26), (0.86, 0.89, 0.93), (0.62, 0.66, 0.68)
BALL = 1.1  # [m] radius of the snowball
FALL = 4.0  # [m/s]


def write_sandcastle(path: Path, duck: str) -> None:
    """Write the stage of the castle; ``duck``: the layer of the duck, as the stage names it."""
    stage = _stage(path, "SandCastle", "A rubber duck runs into a sand castle. Centimeters, Y up.")
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    castle = UsdGeom.Xform.Define(stage, "/SandCastle/Castle").GetPrim()
    _made_of(castle, "wet-sand")
    places = ((0.0, 0.0, KEEP), *((x, z, TOWER) for x, z in CORNERS))
    for number, (x, z, (foot, top, height)) in enumerate(places):
        line = np.array([(0.0, height), (top, height), (foot, 0.0), (0.0, 0.0)])
        mesh = _revolved(stage, f"/SandCastle/Castle/Tower{number}", line, AROUND, SAND)
        mesh.AddTranslateOp().Set(Gf.Vec3d(x, 0.0, z))
    swimmer = UsdGeom.Xform.Define(stage, "/SandCastle/Duck")
    prim = swimmer.GetPrim()
    prim.GetReferences().AddReference(duck)
    swimmer.AddTranslateOp().Set(Gf.Vec3d(*START))
    swimmer.AddRotateYOp().Set(180.0)
    _made_of(prim, "rubber")
    UsdPhysics.RigidBodyAPI.Apply(prim).CreateVelocityAttr(Gf.Vec3f(*SPEED))
    stage.GetRootLayer().Save()


def write_snowball(path: Path) -> None:
    """Write the stage of the snowball."""
    stage = _stage(path, "Snowball", "A snowball bursts on the rim of a bowl. Meters, Y up.")
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    ball = UsdGeom.Sphere.Define(stage, "/Snowball/Ball")
    ball.CreateRadiusAttr(BALL)
    ball.CreateExtentAttr([Gf.Vec3f(-BALL), Gf.Vec3f(BALL)])
    ball.CreateDisplayColorAttr([Gf.Vec3f(*SNOW)])
    ball.AddTranslateOp().Set(Gf.Vec3d(2.6, 3.6, 0.0))
    _made_of(ball.GetPrim(), "powder-snow")
    UsdPhysics.RigidBodyAPI.Apply(ball.GetPrim()).CreateVelocityAttr(Gf.Vec3f(0.0, -FALL, 0.0))
    points, counts, indices, _ = bowl()
    mesh = _mesh(stage, "/Snowball/Bowl", points, counts, indices, METAL)
    UsdPhysics.CollisionAPI.Apply(mesh.GetPrim())
    UsdPhysics.MeshCollisionAPI.Apply(mesh.GetPrim()).CreateApproximationAttr(
        UsdPhysics.Tokens.none
    )
    ground = UsdGeom.Cube.Define(stage, "/Snowball/Ground")
    ground.CreateSizeAttr(1.0)
    ground.CreateExtentAttr([Gf.Vec3f(-0.5), Gf.Vec3f(0.5)])
    ground.AddTranslateOp().Set(Gf.Vec3d(0.0, -0.43, 0.0))
    ground.AddScaleOp().Set(Gf.Vec3f(30.0, 0.5, 30.0))
    ground.CreateDisplayColorAttr([Gf.Vec3f(0.34, 0.36, 0.38)])
    UsdPhysics.CollisionAPI.Apply(ground.GetPrim())
    stage.GetRootLayer().Save()


def _stage(path: Path, name: str, doc: str) -> Usd.Stage:
    path.unlink(missing_ok=True)
    stage = Usd.Stage.CreateNew(str(path))
    layer = stage.GetRootLayer()
    layer.documentation = doc
    layer.customLayerData = {"license": "Apache-2.0", "madeBy": "gf-usd tools/make_samples.py"}
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    stage.SetTimeCodesPerSecond(24)
    stage.SetFramesPerSecond(24)
    root = UsdGeom.Xform.Define(stage, f"/{name}")
    stage.SetDefaultPrim(root.GetPrim())
    Usd.ModelAPI(root).SetKind(Kind.Tokens.assembly)
    UsdPhysics.Scene.Define(stage, f"/{name}/Physics")
    return stage


def _made_of(prim: Usd.Prim, preset: str) -> None:
    prim.AddAppliedSchema("GaussianFleshBakeAPI")
    uniform = Sdf.VariabilityUniform
    prim.CreateAttribute("gaussianFlesh:enabled", Types.Bool, False, uniform).Set(True)
    prim.CreateAttribute("gaussianFlesh:material", Types.Token, False, uniform).Set(preset)


def _revolved(
    stage: Usd.Stage, path: str, line: Floats, around: int, color: tuple[float, float, float]
) -> UsdGeom.Mesh:
    return _mesh(stage, path, *revolved(line, around), color)


def _mesh(
    stage: Usd.Stage,
    path: str,
    points: Floats,
    counts: NDArray[np.int64],
    indices: NDArray[np.int64],
    color: tuple[float, float, float],
) -> UsdGeom.Mesh:
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    values = Vt.Vec3fArray.FromNumpy((np.round(points, 4) + 0.0).astype(np.float32))
    mesh.CreatePointsAttr(values)
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(counts.astype(np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(indices.astype(np.int32)))
    mesh.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(values))
    mesh.CreateDisplayColorAttr([Gf.Vec3f(*color)])
    return mesh
