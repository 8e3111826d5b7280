"""A tin can under a press and a star of foil: stages whose bakes keep their dents."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, UsdShade, Vt

from tools.samples.bowl import revolved, vertex_normals
from tools.samples.usd import Look, define_material

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

FPS = 24
AROUND = 96
RADIUS, HEIGHT, WALL = 1.0, 2.6, 0.13  # [m] outside, of the can, of its wall
RIB, RIBS = 0.035, 5  # [m] depth, and how many
WAIT, DOWN, HOLD, UP = 2, 26, 3, 12  # [frames]
PLATE, LEFT = 0.2, 1.15  # [m] thickness of the press, what it leaves of the can's height
TIN = Look(color=(0.56, 0.10, 0.06), roughness=0.3, clearcoat=0.6)
POINTS, REACH, WAIST, FOIL = 5, 1.0, 0.46, 0.06  # [m] of tips and of corners between, thickness
FINE = 14  # edges of the mesh from the middle of the star to a corner
GOLD = Look(color=(0.80, 0.52, 0.10), roughness=0.3, clearcoat=0.6)
BALL = 0.45  # [m] radius of what the star falls on
LEAN = (-82.0, 0.0, 6.0)  # [deg] how the star falls


def can() -> tuple[Floats, Ints, Ints]:
    """points (V, 3) [m], counts, indices of an open can with ribs, standing on y = 0."""
    y = np.linspace(WALL, HEIGHT, 45)
    share = (y - WALL) / (HEIGHT - WALL)
    inward = RIB * np.sin(np.pi * RIBS * share) ** 2 * (share > 0.0) * (share < 1.0)
    inside = np.stack([RADIUS - WALL - inward, y], 1)
    outside = np.stack([RADIUS - inward, y], 1)
    floor = np.stack([np.linspace(0.0, RADIUS - WALL, 14)[:-1], np.full(13, WALL)], 1)
    under = np.stack([np.linspace(RADIUS, 0.0, 16), np.zeros(16)], 1)
    line = np.concatenate([floor, inside, outside[::-1], under])
    return revolved(line, AROUND)


def star() -> tuple[Floats, Ints, Ints]:
    """points (V, 3) [m], counts, indices of a flat star about the origin, in the plane z = 0."""
    angle = np.pi * (0.5 + np.arange(2 * POINTS) / POINTS)
    reach = np.where(np.arange(2 * POINTS) % 2 == 0, REACH, WAIST)
    corners = np.stack([reach * np.cos(angle), reach * np.sin(angle)], 1)
    flat: dict[tuple[float, float], int] = {}
    faces = []

    def number(p: Floats) -> int:
        return flat.setdefault((round(float(p[0]), 9), round(float(p[1]), 9)), len(flat))

    for k in range(2 * POINTS):
        a, b = corners[k] / FINE, corners[(k + 1) % (2 * POINTS)] / FINE
        for i in range(FINE):
            for j in range(FINE - i):
                faces.append([number(i * a + j * b), number((i + 1) * a + j * b),
                              number(i * a + (j + 1) * b)])  # fmt: skip
                if i + j < FINE - 1:
                    faces.append([number((i + 1) * a + j * b), number((i + 1) * a + (j + 1) * b),
                                  number(i * a + (j + 1) * b)])  # fmt: skip
    top, plane = np.array(faces), np.array(list(flat))
    edges = np.concatenate([top[:, [0, 1]], top[:, [1, 2]], top[:, [2, 0]]])
    known = {tuple(edge) for edge in edges.tolist()}
    rim = np.array([edge for edge in edges.tolist() if (edge[1], edge[0]) not in known])
    n = len(plane)
    sides = np.concatenate(
        [np.stack([rim[:, 1], rim[:, 0], rim[:, 0] + n], 1),
         np.stack([rim[:, 1], rim[:, 0] + n, rim[:, 1] + n], 1)]
    )  # fmt: skip
    all_faces = np.concatenate([top, top[:, ::-1] + n, sides])
    points = np.concatenate(
        [np.column_stack([plane, np.full(n, z)]) for z in (0.5 * FOIL, -0.5 * FOIL)]
    )
    return points, np.full(len(all_faces), 3), all_faces.ravel()


def write_can(path: Path) -> None:
    """The can, to stand on a floor at y = 0, and a plate that presses it and goes up again."""
    stage = _stage(path, "Can", WAIT + DOWN + HOLD + UP + 1)
    _body(stage, "/Can/Tin", can(), TIN)
    high, low = HEIGHT + 0.5 * PLATE + 0.05, LEFT + 0.5 * PLATE
    press = _plate(stage, "/Can/Press", [0.0, high, 0.0], [2.8, PLATE, 2.8])
    at = np.cumsum([1, WAIT, DOWN, HOLD, UP])
    for frame in range(1, int(at[-1]) + 1):
        y = np.interp(frame, at, [high, high, low, low, high])
        press.Set(Gf.Vec3d(0.0, round(float(y), 5), 0.0), frame)
    stage.GetRootLayer().Save()


def write_star(path: Path) -> None:
    """The star, all but flat, above a ball that stands on y = 0."""
    stage = _stage(path, "Star", 0)
    body = UsdGeom.Xform.Define(stage, "/Star/Body")
    body.AddTranslateOp().Set(Gf.Vec3d(0.0, 3.0 * BALL, 0.0))
    body.AddRotateXYZOp().Set(Gf.Vec3f(*LEAN))
    _body(stage, "/Star/Body/Foil", star(), GOLD)
    ball = UsdGeom.Sphere.Define(stage, "/Star/Ball")
    ball.CreateRadiusAttr(BALL)
    ball.CreateExtentAttr([Gf.Vec3f(-BALL), Gf.Vec3f(BALL)])
    ball.AddTranslateOp().Set(Gf.Vec3d(0.08, BALL, 0.05))
    ball.CreateDisplayColorAttr([Gf.Vec3f(0.30, 0.32, 0.35)])
    UsdPhysics.CollisionAPI.Apply(ball.GetPrim())
    stage.GetRootLayer().Save()


def _stage(path: Path, name: str, frames: int) -> Usd.Stage:
    stage = Usd.Stage.CreateNew(str(path))
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, f"/{name}").GetPrim())
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetTimeCodesPerSecond(FPS)
    stage.SetFramesPerSecond(FPS)
    if frames:
        stage.SetStartTimeCode(1)
        stage.SetEndTimeCode(frames)
    return stage


def _body(stage: Usd.Stage, path: str, shape: tuple[Floats, Ints, Ints], look: Look) -> None:
    points, counts, indices = shape
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points.astype(np.float32)))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(counts.astype(np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(indices.astype(np.int32)))
    normals = vertex_normals(points, counts, indices)
    mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(normals.astype(np.float32)))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    mesh.CreateDisplayColorAttr([Gf.Vec3f(*look.color)])
    prim = mesh.GetPrim()
    prim.AddAppliedSchema("GaussianFleshBakeAPI")
    uniform = Sdf.VariabilityUniform
    prim.CreateAttribute("gaussianFlesh:enabled", Sdf.ValueTypeNames.Bool, False, uniform).Set(True)
    material = define_material(stage, Sdf.Path(f"{path}Look"), look)
    UsdShade.MaterialBindingAPI.Apply(prim).Bind(material)


def _plate(
    stage: Usd.Stage, path: str, at: Sequence[float], size: Sequence[float]
) -> UsdGeom.XformOp:
    """A kinematic collider; returns what moves it."""
    cube = UsdGeom.Cube.Define(stage, path)
    cube.CreateSizeAttr(1.0)
    cube.CreateExtentAttr([Gf.Vec3f(-0.5), Gf.Vec3f(0.5)])
    move = cube.AddTranslateOp()
    move.Set(Gf.Vec3d(*at))
    cube.AddScaleOp().Set(Gf.Vec3f(*size))
    cube.CreateDisplayColorAttr([Gf.Vec3f(0.34, 0.36, 0.38)])
    UsdPhysics.CollisionAPI.Apply(cube.GetPrim())
    UsdPhysics.RigidBodyAPI.Apply(cube.GetPrim()).CreateKinematicEnabledAttr(True)
    return move
