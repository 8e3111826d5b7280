"""Materials of a mesh file as UsdPreviewSurface networks."""

from __future__ import annotations

from collections.abc import Callable

from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade

from gf_usd.assets.mesh_data import FileMaterial, Picture, Slot

Types = Sdf.ValueTypeNames
INPUTS = {
    "diffuseColor": Types.Color3f,
    "emissiveColor": Types.Color3f,
    "roughness": Types.Float,
    "metallic": Types.Float,
    "normal": Types.Normal3f,
    "occlusion": Types.Float,
}
ST = "st"  # primvar of the texture coordinates


def write_material(
    stage: Usd.Stage, path: Sdf.Path, material: FileMaterial, place: Callable[[Picture], str]
) -> UsdShade.Material:
    """Define one material; `place` gives the asset path of a picture."""
    made = UsdShade.Material.Define(stage, path)
    surface = _shader(stage, path.AppendChild("surface"), "UsdPreviewSurface")
    made.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
    for name, value in material.values.items():
        surface.CreateInput(name, INPUTS[name]).Set(
            Gf.Vec3f(*value) if isinstance(value, tuple) else value
        )
    if material.mesh_colours:
        reader = _shader(stage, path.AppendChild("colours"), "UsdPrimvarReader_float3")
        reader.CreateInput("varname", Types.String).Set("displayColor")
        _connect(surface, "diffuseColor", reader, "result", Types.Float3)
    if material.slots:
        reader = _shader(stage, path.AppendChild(ST), "UsdPrimvarReader_float2")
        reader.CreateInput("varname", Types.String).Set(ST)
        reader.CreateOutput("result", Types.Float2)
        for slot in material.slots:
            _texture(stage, path, surface, reader, slot, place(slot.picture))
    return made


def _texture(
    stage: Usd.Stage,
    path: Sdf.Path,
    surface: UsdShade.Shader,
    reader: UsdShade.Shader,
    slot: Slot,
    file: str,
) -> None:
    node = _shader(stage, path.AppendChild(f"{slot.input}_texture"), "UsdUVTexture")
    node.CreateInput("file", Types.Asset).Set(Sdf.AssetPath(file))
    node.CreateInput("sourceColorSpace", Types.Token).Set("sRGB" if slot.srgb else "raw")
    for name, wrap in zip(("wrapS", "wrapT"), slot.wraps):
        node.CreateInput(name, Types.Token).Set(wrap)
    if slot.scale != (1.0, 1.0, 1.0):
        node.CreateInput("scale", Types.Float4).Set(Gf.Vec4f(*slot.scale, 1.0))
    if slot.bias != (0.0, 0.0, 0.0):
        node.CreateInput("bias", Types.Float4).Set(Gf.Vec4f(*slot.bias, 0.0))
    source = reader
    if (slot.uv_scale, slot.uv_offset) != ((1.0, 1.0), (0.0, 0.0)):
        source = _shader(stage, path.AppendChild(f"{slot.input}_place"), "UsdTransform2d")
        source.CreateInput("scale", Types.Float2).Set(Gf.Vec2f(*slot.uv_scale))
        source.CreateInput("translation", Types.Float2).Set(Gf.Vec2f(*slot.uv_offset))
        _connect(source, "in", reader, "result", Types.Float2)
    _connect(node, "st", source, "result", Types.Float2)
    kind = Types.Float3 if slot.channel == "rgb" else Types.Float
    _connect(surface, slot.input, node, slot.channel, kind)


def _shader(stage: Usd.Stage, path: Sdf.Path, kind: str) -> UsdShade.Shader:
    shader = UsdShade.Shader.Define(stage, path)
    shader.CreateIdAttr(kind)
    if kind == "UsdPreviewSurface":
        shader.CreateOutput("surface", Types.Token)
    return shader


def _connect(
    target: UsdShade.Shader,
    name: str,
    source: UsdShade.Shader,
    output: str,
    kind: Sdf.ValueTypeName,
) -> None:
    source.CreateOutput(output, kind)
    target.CreateInput(name, INPUTS.get(name, kind)).ConnectToSource(
        source.ConnectableAPI(), output
    )


def bind(
    mesh: UsdGeom.Mesh, materials: list[UsdShade.Material], faces: list[tuple[int, list[int]]]
) -> None:
    """Bind materials to a mesh, or to sets of its faces where there are several.

    `faces`: (number of the material, its faces); they cover every face where one set is all.
    """
    api = UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim())
    total = len(mesh.GetFaceVertexCountsAttr().Get())
    covered = sum(len(indices) for _, indices in faces)
    if len(faces) == 1 and covered == total:
        api.Bind(materials[faces[0][0]])
        return
    for number, indices in faces:
        name = free_name(mesh.GetPrim(), materials[number].GetPath().name)
        subset = api.CreateMaterialBindSubset(name, indices)
        UsdShade.MaterialBindingAPI.Apply(subset.GetPrim()).Bind(materials[number])
    family = UsdGeom.Tokens.partition if covered == total else UsdGeom.Tokens.nonOverlapping
    UsdGeom.Subset.SetFamilyType(mesh, UsdShade.Tokens.materialBind, family)


def free_name(parent: Usd.Prim, name: str) -> str:
    """`name`, or with a number where the prim has such a child."""
    taken = {child.GetName() for child in parent.GetAllChildren()}
    wanted, count = name, 1
    while name in taken:
        count += 1
        name = f"{wanted}_{count}"
    return name
