"""The creature as a USD layer: a SkelRoot with a skinned mesh and two motions as variants."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Kind, Sdf, Usd, UsdGeom, UsdShade, UsdSkel, Vt

from tools.samples.creature import creature, creature_atlas, creature_quads
from tools.samples.creature_rig import FPS, FRAMES, JOINTS, joint_paths, motion, offsets, weights
from tools.samples.creature_texture import write_texture
from tools.samples.implicit import unit_normals
from tools.samples.quads import Quads
from tools.samples.usd import LICENCE, VERSION, Look, Sample, define_mesh, rounded

DECIMALS = 5  # of weights, rotations and translations
FIRST = 1  # time code of the first frame
MOTIONS = ("walk", "jump")


def write_creature(path: Path) -> Quads:
    """Write the layer, and its texture as PNG next to it; returns the mesh."""
    mesh = creature_quads()
    atlas = creature_atlas(mesh)
    texture = path.with_suffix(".png")
    write_texture(texture, mesh, atlas)
    joints, weight = weights(mesh.points, mesh.faces)

    stage = Usd.Stage.CreateInMemory(path.name)
    layer = stage.GetRootLayer()
    layer.documentation = (
        "A rigged creature, 71 cm tall: one watertight quad mesh, 15 joints, a walk cycle and a"
        " jump of 32 frames (variant set motion). Y up, facing +Z."
    )
    layer.customLayerData = {"license": LICENCE, "madeBy": "gf-usd tools/make_samples.py"}
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    stage.SetTimeCodesPerSecond(FPS)
    stage.SetFramesPerSecond(FPS)
    stage.SetStartTimeCode(FIRST)
    stage.SetEndTimeCode(FIRST + FRAMES - 1)

    root = UsdSkel.Root.Define(stage, "/Creature")
    stage.SetDefaultPrim(root.GetPrim())
    model = Usd.ModelAPI(root)
    model.SetKind(Kind.Tokens.component)
    model.SetAssetName("Creature")
    model.SetAssetIdentifier(Sdf.AssetPath(f"./{path.name}"))
    model.SetAssetVersion(VERSION)
    skeleton = define_skeleton(stage, root.GetPath().AppendChild("Skeleton"))

    UsdGeom.Scope.Define(stage, root.GetPath().AppendChild("Geom"))
    sample = Sample(
        name="Creature", doc="", meters_per_unit=0.01, atlas=atlas,
        mesh=Quads(points=mesh.points, faces=mesh.faces, parts=np.full(len(mesh.faces), "coat")),
        normals=unit_normals(creature, mesh.points),
        looks={"coat": Look(color=(0.12, 0.43, 0.40), roughness=0.6)},
    )  # fmt: skip
    body = define_mesh(stage, root.GetPath().AppendPath("Geom/Body"), sample)
    binding = UsdSkel.BindingAPI.Apply(body.GetPrim())
    binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    indices = binding.CreateJointIndicesPrimvar(False, joints.shape[1])
    indices.Set(Vt.IntArray.FromNumpy(joints.astype(np.int32).ravel()))
    shares = binding.CreateJointWeightsPrimvar(False, joints.shape[1])
    shares.Set(Vt.FloatArray.FromNumpy(normalized(weight).ravel()))
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1.0))
    UsdGeom.Scope.Define(stage, root.GetPath().AppendChild("Materials"))
    material = define_textured(stage, root.GetPath().AppendPath("Materials/Coat"), texture.name)
    UsdShade.MaterialBindingAPI.Apply(body.GetPrim()).Bind(material)

    UsdGeom.Scope.Define(stage, root.GetPath().AppendChild("Motion"))
    variants = root.GetPrim().GetVariantSets().AddVariantSet("motion")
    for name in MOTIONS:
        animation = root.GetPath().AppendPath(f"Motion/{name.capitalize()}")
        moved = motion(name, mesh.points, joints, weight)
        define_animation(stage, animation, moved.rotations, moved.translations)
        variants.AddVariant(name)
        variants.SetVariantSelection(name)
        with variants.GetVariantEditContext():
            UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets(
                [animation]
            )
    variants.SetVariantSelection(MOTIONS[0])
    layer.Export(str(path))
    return mesh


def normalized(weight: NDArray[np.float64]) -> NDArray[np.float32]:
    """Weights rounded to DECIMALS whose sums stay 1 to half a unit of the last."""
    out: NDArray[np.float64] = np.round(weight, DECIMALS)
    out[:, 0] += 1.0 - out.sum(axis=1)
    return rounded(out, DECIMALS)


def define_skeleton(stage: Usd.Stage, path: Sdf.Path) -> UsdSkel.Skeleton:
    """Joints with bind and rest transforms, which are translations."""
    skeleton = UsdSkel.Skeleton.Define(stage, path)
    skeleton.CreateJointsAttr(joint_paths())
    skeleton.CreateBindTransformsAttr([Gf.Matrix4d().SetTranslate(j.at) for j in JOINTS])
    skeleton.CreateRestTransformsAttr(
        [Gf.Matrix4d().SetTranslate([round(float(x), DECIMALS) for x in row]) for row in offsets()]
    )
    return skeleton


def define_animation(
    stage: Usd.Stage, path: Sdf.Path, rotations: np.ndarray, translations: np.ndarray
) -> None:
    """Time samples of all joints from FIRST on."""
    animation = UsdSkel.Animation.Define(stage, path)
    animation.CreateJointsAttr(joint_paths())
    animation.CreateScalesAttr([Gf.Vec3h(1.0)] * len(JOINTS))
    turned, moved = animation.CreateRotationsAttr(), animation.CreateTranslationsAttr()
    for k, (turns, places) in enumerate(zip(rotations, translations)):
        quats = [Gf.Quatf(*(float(v) for v in rounded(q[[3, 0, 1, 2]], DECIMALS))) for q in turns]
        turned.Set(Vt.QuatfArray(quats), FIRST + k)
        moved.Set(Vt.Vec3fArray.FromNumpy(rounded(places, DECIMALS)), FIRST + k)


def define_textured(stage: Usd.Stage, path: Sdf.Path, texture: str) -> UsdShade.Material:
    """A UsdPreviewSurface whose diffuse color is the texture."""
    values = Sdf.ValueTypeNames
    material = UsdShade.Material.Define(stage, path)
    surface = UsdShade.Shader.Define(stage, path.AppendChild("Surface"))
    surface.CreateIdAttr("UsdPreviewSurface")
    surface.CreateInput("roughness", values.Float).Set(0.6)
    reader = UsdShade.Shader.Define(stage, path.AppendChild("Coordinates"))
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", values.String).Set("st")
    image = UsdShade.Shader.Define(stage, path.AppendChild("Texture"))
    image.CreateIdAttr("UsdUVTexture")
    image.CreateInput("file", values.Asset).Set(Sdf.AssetPath(f"./{texture}"))
    image.CreateInput("sourceColorSpace", values.Token).Set("sRGB")
    image.CreateInput("wrapS", values.Token).Set("clamp")
    image.CreateInput("wrapT", values.Token).Set("clamp")
    st = image.CreateInput("st", values.Float2)
    st.ConnectToSource(reader.CreateOutput("result", values.Float2))
    color = surface.CreateInput("diffuseColor", values.Color3f)
    color.ConnectToSource(image.CreateOutput("rgb", values.Float3))
    material.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", values.Token))
    return material
