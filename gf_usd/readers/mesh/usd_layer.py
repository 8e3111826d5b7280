"""Authoring of the USD layer of a mesh file: a root prim with its nodes, meshes and materials.

    /duck (Xform, kind component, the default prim)
        /duck/body (Mesh)        /duck/arm (Xform) /duck/arm/hand (Mesh)
        /duck/Materials (Scope)

Mesh files contain polygons, so that subdivisionScheme is none, with and without normals.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
from pxr import Gf, Kind, Sdf, Usd, UsdGeom, UsdShade, UsdSkel, Vt

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import free_name, prim_name
from gf_usd.readers.mesh.data import FileMaterial, FileMesh, FileNode, MeshFile, Picture, Slot
from gf_usd.readers.mesh.skeletons import (
    bind_to_skeleton,
    write_shapes,
    write_skeletons,
    write_weights,
)

MATERIALS, GROUPS = "Materials", "groups"

Types = Sdf.ValueTypeNames


def write_layer(
    file: MeshFile, path: Path, textures: Path, *, meters_per_unit: float, up_axis: str
) -> None:
    """Write a mesh file as the USD layer `path`; embedded images go into the folder `textures`.

    Images are referenced by absolute paths, since the final location of the layer is not known.
    """
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, meters_per_unit)
    UsdGeom.SetStageUpAxis(stage, up_axis)
    kind = UsdSkel.Root if file.skeletons else UsdGeom.Xform
    root = kind.Define(stage, f"/{_identifier(file.path.stem)}").GetPrim()
    _name(root, file.path.stem)
    Usd.ModelAPI(root).SetKind(Kind.Tokens.component)
    stage.SetDefaultPrim(root)
    pictures = _Pictures(textures)
    materials = []
    if file.materials:
        scope = UsdGeom.Scope.Define(stage, root.GetPath().AppendChild(MATERIALS)).GetPrim()
        for material in file.materials:
            name = free_child_name(scope, _identifier(material.name))
            made = write_material(
                stage, scope.GetPath().AppendChild(name), material, pictures.place
            )
            _name(made.GetPrim(), material.name)
            materials.append(made)
    skeletons = write_skeletons(stage, root, file.skeletons, file.fps, _free)
    weights: list[dict[str, Floats]] = [{} for _ in skeletons]  # of the blend shapes of each
    for node in file.nodes:
        _write_node(stage, root, node, file, materials, skeletons, weights)
    for skeleton, shapes in zip(skeletons, weights, strict=True):
        if shapes:
            write_weights(skeleton, shapes)
    stage.GetRootLayer().Save()


class _Pictures:
    """The path of each image; embedded ones are written on first use."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._written: dict[bytes, str] = {}
        self._names: set[str] = set()

    def place(self, picture: Picture) -> str:
        if picture.path is not None:
            return picture.path.absolute().as_posix()
        data = picture.data or b""
        if data not in self._written:
            self._folder.mkdir(exist_ok=True)
            name = self._free(re.sub(r"[^\w.-]", "_", picture.name).lstrip("."))
            (self._folder / name).write_bytes(data)
            self._written[data] = (self._folder / name).absolute().as_posix()
        return self._written[data]

    def _free(self, name: str) -> str:
        stem, dot, suffix = name.rpartition(".")
        # File names are case-insensitive on Windows and macOS.
        stem = free_name(stem, lambda stem: f"{stem}{dot}{suffix}".lower() in self._names)
        wanted = f"{stem}{dot}{suffix}"
        self._names.add(wanted.lower())
        return wanted


def _write_node(
    stage: Usd.Stage,
    parent: Usd.Prim,
    node: FileNode,
    file: MeshFile,
    materials: list,
    skeletons: list[UsdSkel.Skeleton],
    weights: list[dict[str, Floats]],
) -> None:
    path = parent.GetPath().AppendChild(free_child_name(parent, _identifier(node.name)))
    alone = node.mesh is not None and not node.children
    made = (UsdGeom.Mesh if alone else UsdGeom.Xform).Define(stage, path)
    _name(made.GetPrim(), node.name)
    if node.matrix is not None:
        made.AddTransformOp().Set(Gf.Matrix4d(*np.asarray(node.matrix).reshape(-1).tolist()))
    if node.mesh is not None:
        mesh = made
        if not alone:
            name = free_child_name(made.GetPrim(), _identifier(node.mesh.name))
            mesh = UsdGeom.Mesh.Define(stage, path.AppendChild(name))
            _name(mesh.GetPrim(), node.mesh.name)
        _write_mesh(mesh, node.mesh, file, materials)
        if (skin := node.mesh.skin) is not None:
            bind_to_skeleton(mesh, skin, skeletons[skin.skeleton])
            if node.mesh.shapes:
                write_shapes(mesh, node.mesh.shapes, weights[skin.skeleton], _free)
    for child in node.children:
        _write_node(stage, made.GetPrim(), child, file, materials, skeletons, weights)


def _write_mesh(prim: UsdGeom.Mesh, mesh: FileMesh, file: MeshFile, materials: list) -> None:
    points = Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(mesh.points, np.float32))
    prim.CreatePointsAttr(points)
    prim.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(points))
    prim.CreateFaceVertexCountsAttr(_ints(mesh.counts))
    prim.CreateFaceVertexIndicesAttr(_ints(mesh.indices))
    prim.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    _write_normals(prim, mesh)
    _write_uvs(prim, mesh)
    if mesh.colors is not None:
        kind = UsdGeom.Tokens.uniform if mesh.colors_per_face else UsdGeom.Tokens.vertex
        colors = Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(mesh.colors, np.float32))
        prim.CreateDisplayColorPrimvar(kind).Set(colors)
    if mesh.materials is not None:
        numbers = [int(n) for n in np.unique(mesh.materials) if n >= 0]
        faces = [(n, np.flatnonzero(mesh.materials == n).tolist()) for n in numbers]
        if faces:
            bind(prim, materials, faces)
        if any(file.materials[n].double_sided for n in numbers):
            prim.CreateDoubleSidedAttr(True)
    for name, indices in mesh.groups:
        made = UsdGeom.Subset.CreateGeomSubset(
            prim,
            free_child_name(prim.GetPrim(), _identifier(name)),
            UsdGeom.Tokens.face,
            _ints(indices),
            GROUPS,
        )
        _name(made.GetPrim(), name)


def _write_normals(prim: UsdGeom.Mesh, mesh: FileMesh) -> None:
    if mesh.normals is None:
        return
    values, interpolation = mesh.normals, UsdGeom.Tokens.vertex
    if mesh.normal_indices is not None:
        per_point = _one_a_point(mesh, mesh.normal_indices)
        if per_point is None:
            values, interpolation = values[mesh.normal_indices], UsdGeom.Tokens.faceVarying
        else:
            values = values[per_point]
    prim.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(values, np.float32)))
    prim.SetNormalsInterpolation(interpolation)


def _write_uvs(prim: UsdGeom.Mesh, mesh: FileMesh) -> None:
    if mesh.uvs is None:
        return
    values, indices, interpolation = mesh.uvs, None, UsdGeom.Tokens.vertex
    if mesh.uv_indices is not None:
        per_point = _one_a_point(mesh, mesh.uv_indices)
        if per_point is None:
            indices, interpolation = mesh.uv_indices, UsdGeom.Tokens.faceVarying
        else:
            values = values[per_point]
    primvar = UsdGeom.PrimvarsAPI(prim).CreatePrimvar(ST, Types.TexCoord2fArray, interpolation)
    primvar.Set(Vt.Vec2fArray.FromNumpy(np.ascontiguousarray(values, np.float32)))
    if indices is not None:
        primvar.SetIndices(_ints(indices))


def _one_a_point(mesh: FileMesh, corner_values: Ints) -> Ints | None:
    """(V,) value of each point, where all its corners have the same; None where there are seams."""
    first = np.full(len(mesh.points), -1)
    first[mesh.indices] = corner_values
    if (first < 0).any() or (first[mesh.indices] != corner_values).any():
        return None
    return first


def _ints(values: Ints | Floats) -> Vt.IntArray:
    return Vt.IntArray.FromNumpy(np.ascontiguousarray(values, np.int32))


def _identifier(name: str) -> str:
    return prim_name(name.strip() or "unnamed")


def _name(prim: Usd.Prim, name: str) -> None:
    """Store a name that is not a valid prim name as displayName."""
    if name.strip() and prim.GetName() != name:
        prim.SetDisplayName(name)


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
    """Define one material; `place` returns the asset path of an image."""
    made = UsdShade.Material.Define(stage, path)
    surface = _shader(stage, path.AppendChild("surface"), "UsdPreviewSurface")
    made.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
    for name, value in material.values.items():
        surface.CreateInput(name, INPUTS[name]).Set(
            Gf.Vec3f(*value) if isinstance(value, tuple) else value
        )
    if material.mesh_colors:
        reader = _shader(stage, path.AppendChild("colors"), "UsdPrimvarReader_float3")
        reader.CreateInput("varname", Types.String).Set("displayColor")
        _connect(surface, "diffuseColor", reader, "result", Types.Float3)
    if material.texture_slots:
        reader = _shader(stage, path.AppendChild(ST), "UsdPrimvarReader_float2")
        reader.CreateInput("varname", Types.String).Set(ST)
        reader.CreateOutput("result", Types.Float2)
        for slot in material.texture_slots:
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
    """Bind one material to a mesh, or several to face subsets.

    faces : (index of the material, its faces) of each.
    """
    api = UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim())
    total = len(mesh.GetFaceVertexCountsAttr().Get())
    covered = sum(len(indices) for _, indices in faces)
    if len(faces) == 1 and covered == total:
        api.Bind(materials[faces[0][0]])
        return
    for number, indices in faces:
        name = free_child_name(mesh.GetPrim(), materials[number].GetPath().name)
        subset = api.CreateMaterialBindSubset(name, indices)
        UsdShade.MaterialBindingAPI.Apply(subset.GetPrim()).Bind(materials[number])
    family = UsdGeom.Tokens.partition if covered == total else UsdGeom.Tokens.nonOverlapping
    UsdGeom.Subset.SetFamilyType(mesh, UsdShade.Tokens.materialBind, family)


def free_child_name(parent: Usd.Prim, name: str) -> str:
    """`name`, with a number appended where the prim has such a child."""
    return _free(name, {child.GetName() for child in parent.GetAllChildren()})


def _free(name: str, taken: set[str]) -> str:
    """A valid and unused prim name made from `name`."""
    return free_name(_identifier(name), taken.__contains__)
