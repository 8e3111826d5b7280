"""Stages for the film of a character with and without flesh."""

from __future__ import annotations

from pathlib import Path

from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel


def repeat_cycle(source: Path, target: Path, times: int) -> int:
    """A layer over a character whose animation is repeated; returns the frames of one cycle.

    The second cycle of a bake of it is periodic: what the first pose set in motion has died out.
    """
    stage = Usd.Stage.CreateNew(str(target))
    root = stage.GetRootLayer()
    root.subLayerPaths.append(str(source.resolve()))
    below = Sdf.Layer.FindOrOpen(str(source))
    root.defaultPrim = below.defaultPrim
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    stage.SetTimeCodesPerSecond(below.timeCodesPerSecond)
    first = below.startTimeCode
    cycle = round(below.endTimeCode - first) + 1
    stage.SetStartTimeCode(first)
    stage.SetEndTimeCode(first + times * cycle - 1)
    [skeleton] = [p for p in stage.Traverse() if p.IsA(UsdSkel.Skeleton)]
    animation = UsdSkel.BindingAPI(skeleton).GetInheritedAnimationSource()
    for attribute in animation.GetAttributes():
        samples = [(t, attribute.Get(t)) for t in attribute.GetTimeSamples()]
        for turn in range(times):
            for time, value in samples:
                attribute.Set(value, time + turn * cycle)
    root.Save()
    return cycle


def side_by_side(
    left: Path, right: Path, target: Path, *, apart: float, height: float, away: float
) -> None:
    """A stage with two characters, `apart` [units], and a camera `away` at which both are seen."""
    stage = Usd.Stage.CreateNew(str(target))
    source = Usd.Stage.Open(str(right))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.GetStageUpAxis(source))
    UsdGeom.SetStageMetersPerUnit(stage, UsdGeom.GetStageMetersPerUnit(source))
    stage.SetTimeCodesPerSecond(source.GetTimeCodesPerSecond())
    stage.SetStartTimeCode(source.GetStartTimeCode())
    stage.SetEndTimeCode(source.GetEndTimeCode())
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
    for name, path, x in (("Left", left, -0.5 * apart), ("Right", right, 0.5 * apart)):
        place = UsdGeom.Xform.Define(stage, f"/World/{name}")
        place.AddTranslateOp().Set(Gf.Vec3d(x, 0.0, 0.0))
        place.AddRotateYOp().Set(18.0)
        stage.OverridePrim(f"/World/{name}/Asset").GetReferences().AddReference(str(path))
    camera = UsdGeom.Camera.Define(stage, "/World/Camera")
    eye, to = Gf.Vec3d(0.0, 1.1 * height, away), Gf.Vec3d(0.0, 0.5 * height, 0.0)
    view = Gf.Matrix4d().SetLookAt(eye, to, Gf.Vec3d(0.0, 1.0, 0.0))
    camera.AddTransformOp().Set(view.GetInverse())
    camera.CreateFocalLengthAttr(35.0)
    stage.GetRootLayer().Save()
