"""Ten ducks of three materials that fall into a rocking bowl: a stage to bake with its physics.

The duck is a reference to duck.usda; the stage has its materials, obstacles and gravity as
attributes of UsdPhysics and of the schema of gf-usd.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pxr import Gf, Kind, Sdf, Usd, UsdGeom, UsdLux, UsdPhysics, UsdShade

from tools.samples.bowl import bowl, rocking
from tools.samples.usd import collide, define_plain

FPS, FRAMES = 24, 97
SCALE = 0.2  # of a duck in centimeters in a stage in meters: it is two meters long
G = 9.81
BOWL_HEIGHT, GROUND = 1.2, 60.0  # [m]
FIRST, LAST = 0.4, 1.55  # [s] of the fall of the first duck and of the last one
RING, TURN = 1.7, 137.5  # [m] from the middle, [deg] from duck to duck
BEAK, EYES = (0.88, 0.17, 0.012), (0.006, 0.006, 0.008)
Types = Sdf.ValueTypeNames


@dataclass(frozen=True, kw_only=True)
class Stuff:
    """A soft material and the color of the ducks that are made of it."""

    name: str
    density: float  # [kg/m^3]
    young: float  # [Pa]
    poisson: float
    damping: float  # [s]
    friction: float
    restitution: float
    color: tuple[float, float, float]


STUFFS = (
    Stuff(
        name="Rubber", density=1100.0, young=4e5, poisson=0.3, damping=6e-4, friction=0.6,
        restitution=0.6, color=(0.93, 0.60, 0.015),
    ),
    Stuff(
        name="Jelly", density=1000.0, young=6e4, poisson=0.42, damping=4e-3, friction=0.5,
        restitution=0.3, color=(0.80, 0.05, 0.16),
    ),
    Stuff(
        name="Hard", density=1200.0, young=2e6, poisson=0.3, damping=2e-4, friction=0.5,
        restitution=0.7, color=(0.03, 0.22, 0.62),
    ),
)  # fmt: skip
# From the first duck to the last: what is soft lies below, what is hard falls among the others.
MADE_OF = (1, 0, 1, 0, 2, 1, 0, 2, 0, 0)


def write_ten_ducks(path: Path, duck: str) -> None:
    """Write the stage; ``duck``: the layer of the duck, as the stage refers to it."""
    path.unlink(missing_ok=True)
    stage = Usd.Stage.CreateNew(str(path))
    layer = stage.GetRootLayer()
    layer.documentation = "Ten ducks of three materials fall into a rocking bowl. Meters, Y up."
    layer.customLayerData = {"license": "Apache-2.0", "madeBy": "gf-usd tools/make_samples.py"}
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    stage.SetTimeCodesPerSecond(FPS)
    stage.SetFramesPerSecond(FPS)
    stage.SetStartTimeCode(1)
    stage.SetEndTimeCode(FRAMES)
    root = UsdGeom.Xform.Define(stage, "/TenDucks")
    stage.SetDefaultPrim(root.GetPrim())
    Usd.ModelAPI(root).SetKind(Kind.Tokens.assembly)
    UsdPhysics.Scene.Define(stage, "/TenDucks/Physics").CreateGravityMagnitudeAttr(G)
    UsdGeom.Scope.Define(stage, "/TenDucks/Materials")
    materials = [_material(stage, stuff) for stuff in STUFFS]
    _ducks(stage, materials, duck)
    _bowl(stage)
    _ground(stage)
    _light_and_camera(stage)
    layer.Save()


def _material(stage: Usd.Stage, stuff: Stuff) -> UsdShade.Material:
    material = UsdShade.Material.Define(stage, f"/TenDucks/Materials/{stuff.name}")
    prim = material.GetPrim()
    physics = UsdPhysics.MaterialAPI.Apply(prim)
    prim.AddAppliedSchema("GaussianFleshMaterialAPI")
    physics.CreateDensityAttr(stuff.density)
    physics.CreateStaticFrictionAttr(stuff.friction)
    physics.CreateDynamicFrictionAttr(stuff.friction)
    physics.CreateRestitutionAttr(stuff.restitution)
    prim.CreateAttribute("physics:youngsModulus", Types.Float, False).Set(stuff.young)
    prim.CreateAttribute("physics:poissonsRatio", Types.Float, False).Set(stuff.poisson)
    uniform = Sdf.VariabilityUniform
    law = prim.CreateAttribute("gaussianFlesh:law", Types.Token, False, uniform)
    law.Set("neoHookean")
    damping = prim.CreateAttribute("gaussianFlesh:dampingTime", Types.Float, False, uniform)
    damping.Set(stuff.damping)
    return material


def _ducks(stage: Usd.Stage, materials: list[UsdShade.Material], duck: str) -> None:
    group = UsdGeom.Xform.Define(stage, "/TenDucks/Ducks")
    Usd.ModelAPI(group).SetKind(Kind.Tokens.group)
    group.GetPrim().AddAppliedSchema("GaussianFleshBakeAPI")
    on = group.GetPrim().CreateAttribute(
        "gaussianFlesh:enabled", Types.Bool, False, Sdf.VariabilityUniform
    )
    on.Set(True)
    rng = np.random.default_rng(10)
    for number, made_of in enumerate(MADE_OF):
        path = group.GetPath().AppendChild(f"Duck{number + 1:02d}")
        xform = UsdGeom.Xform.Define(stage, path)
        prim = xform.GetPrim()
        prim.GetReferences().AddReference(duck)
        seconds = np.interp(number, [0, len(MADE_OF) - 1], [FIRST, LAST])
        angle = np.radians(TURN * number)
        reach = RING if number else 0.2
        height = BOWL_HEIGHT + 0.6 + 0.5 * G * seconds**2
        place = np.round([reach * np.cos(angle), height, reach * np.sin(angle)], 3)
        turns = np.round(rng.uniform((-35.0, 0.0, -35.0), (35.0, 360.0, 35.0)), 1)
        xform.AddTranslateOp().Set(Gf.Vec3d(*place))
        xform.AddRotateXYZOp().Set(Gf.Vec3f(*turns))
        xform.AddScaleOp().Set(Gf.Vec3f(SCALE))
        stuff = STUFFS[made_of]
        binding = UsdShade.MaterialBindingAPI.Apply(prim)
        binding.Bind(materials[made_of], materialPurpose="physics")
        if made_of:
            _paint(stage, path, stuff.color)


def _paint(stage: Usd.Stage, path: Sdf.Path, color: tuple[float, float, float]) -> None:
    surface = stage.OverridePrim(path.AppendPath("Materials/Body/Surface"))
    shader = UsdShade.Shader(surface)
    shader.CreateInput("diffuseColor", Types.Color3f).Set(Gf.Vec3f(*color))
    body = UsdGeom.Gprim(stage.OverridePrim(path.AppendPath("Geom/Body")))
    body.CreateDisplayColorAttr([Gf.Vec3f(*part) for part in (color, BEAK, EYES)])


def _bowl(stage: Usd.Stage) -> None:
    mesh = define_plain(stage, "/TenDucks/Bowl", *bowl(), (0.62, 0.66, 0.68))
    collide(mesh.GetPrim(), kinematic=True)
    lift, turns = rocking(np.arange(FRAMES) / FPS)
    move, turn = mesh.AddTranslateOp(), mesh.AddRotateXZYOp()
    for frame in range(FRAMES):
        x, z = np.round(turns[frame], 4) + 0.0
        move.Set(Gf.Vec3d(0.0, BOWL_HEIGHT + round(float(lift[frame]), 4), 0.0), frame + 1)
        turn.Set(Gf.Vec3f(float(x), 0.0, float(z)), frame + 1)


def _ground(stage: Usd.Stage) -> None:
    ground = UsdGeom.Cube.Define(stage, "/TenDucks/Ground")
    ground.CreateSizeAttr(1.0)
    ground.CreateExtentAttr([Gf.Vec3f(-0.5), Gf.Vec3f(0.5)])
    ground.AddTranslateOp().Set(Gf.Vec3d(0.0, -0.25, 0.0))
    ground.AddScaleOp().Set(Gf.Vec3f(GROUND, 0.5, GROUND))
    ground.CreateDisplayColorAttr([Gf.Vec3f(0.34, 0.36, 0.38)])
    collide(ground.GetPrim())


def _light_and_camera(stage: Usd.Stage) -> None:
    UsdGeom.Scope.Define(stage, "/TenDucks/Lights")
    sun = UsdLux.DistantLight.Define(stage, "/TenDucks/Lights/Sun")
    sun.CreateIntensityAttr(2.5)
    sun.CreateAngleAttr(1.5)
    sun.AddRotateXYZOp().Set(Gf.Vec3f(-50.0, 35.0, 0.0))
    UsdLux.DomeLight.Define(stage, "/TenDucks/Lights/Sky").CreateIntensityAttr(0.6)
    camera = UsdGeom.Camera.Define(stage, "/TenDucks/Camera")
    camera.CreateFocalLengthAttr(30.0)
    camera.CreateHorizontalApertureAttr(36.0)
    camera.CreateVerticalApertureAttr(20.25)
    camera.CreateClippingRangeAttr(Gf.Vec2f(0.1, 200.0))
    camera.AddTranslateOp().Set(Gf.Vec3d(0.0, 7.4, 17.0))
    camera.AddRotateXYZOp().Set(Gf.Vec3f(-12.0, 0.0, 0.0))
