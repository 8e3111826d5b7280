"""The USD layer of a mesh file: a root with a node or mesh for each of its own.

    /duck (Xform, kind component, the default prim)
        /duck/body (Mesh)        /duck/arm (Xform) /duck/arm/hand (Mesh)
        /duck/Materials (Scope)

Polygons are what a mesh file means, so subdivisionScheme is none, with normals or without.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from pxr import Gf, Kind, Sdf, Tf, Usd, UsdGeom, Vt

from gf_usd.assets.mesh_data import FileMesh, FileNode, MeshFile, Picture
from gf_usd.assets.usd_source_look import ST, bind, free_name, write_material
from gf_usd.model import Floats, Ints

MATERIALS, GROUPS = "Materials", "groups"
Types = Sdf.ValueTypeNames


def write_layer(
    file: MeshFile, path: Path, textures: Path, *, meters_per_unit: float, up_axis: str
) -> None:
    """Write a mesh file as the USD layer `path`; embedded pictures go into the folder `textures`.

    Pictures are referred to by their absolute paths: where the layer ends up is not known yet.
    """
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, meters_per_unit)
    UsdGeom.SetStageUpAxis(stage, up_axis)
    root = UsdGeom.Xform.Define(stage, f"/{_identifier(file.path.stem)}").GetPrim()
    _name(root, file.path.stem)
    Usd.ModelAPI(root).SetKind(Kind.Tokens.component)
    stage.SetDefaultPrim(root)
    pictures = _Pictures(textures)
    materials = []
    if file.materials:
        scope = UsdGeom.Scope.Define(stage, root.GetPath().AppendChild(MATERIALS)).GetPrim()
        for material in file.materials:
            name = free_name(scope, _identifier(material.name))
            made = write_material(
                stage, scope.GetPath().AppendChild(name), material, pictures.place
            )
            _name(made.GetPrim(), material.name)
            materials.append(made)
    for node in file.nodes:
        _write_node(stage, root, node, file, materials)
    stage.GetRootLayer().Save()


class _Pictures:
    """Where each picture is; embedded ones are written when they are first asked for."""

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
        wanted, count = name, 1
        # Windows and macOS hold names that differ in case for one.
        while wanted.lower() in self._names:
            count += 1
            wanted = f"{stem}_{count}{dot}{suffix}"
        self._names.add(wanted.lower())
        return wanted


def _write_node(
    stage: Usd.Stage, parent: Usd.Prim, node: FileNode, file: MeshFile, materials: list
) -> None:
    path = parent.GetPath().AppendChild(free_name(parent, _identifier(node.name)))
    alone = node.mesh is not None and not node.children
    made = (UsdGeom.Mesh if alone else UsdGeom.Xform).Define(stage, path)
    _name(made.GetPrim(), node.name)
    if node.matrix is not None:
        made.AddTransformOp().Set(Gf.Matrix4d(*np.asarray(node.matrix).reshape(-1).tolist()))
    if node.mesh is not None:
        mesh = made
        if not alone:
            name = free_name(made.GetPrim(), _identifier(node.mesh.name))
            mesh = UsdGeom.Mesh.Define(stage, path.AppendChild(name))
            _name(mesh.GetPrim(), node.mesh.name)
        _write_mesh(mesh, node.mesh, file, materials)
    for child in node.children:
        _write_node(stage, made.GetPrim(), child, file, materials)


def _write_mesh(prim: UsdGeom.Mesh, mesh: FileMesh, file: MeshFile, materials: list) -> None:
    points = Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(mesh.points, np.float32))
    prim.CreatePointsAttr(points)
    prim.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(points))
    prim.CreateFaceVertexCountsAttr(_ints(mesh.counts))
    prim.CreateFaceVertexIndicesAttr(_ints(mesh.indices))
    prim.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    _write_normals(prim, mesh)
    _write_uvs(prim, mesh)
    if mesh.colours is not None:
        kind = UsdGeom.Tokens.uniform if mesh.colours_per_face else UsdGeom.Tokens.vertex
        colours = Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(mesh.colours, np.float32))
        prim.CreateDisplayColorPrimvar(kind).Set(colours)
    if mesh.materials is not None:
        numbers = [int(n) for n in np.unique(mesh.materials) if n >= 0]
        faces = [(n, np.flatnonzero(mesh.materials == n).tolist()) for n in numbers]
        if faces:
            bind(prim, materials, faces)
        if any(file.materials[n].double_sided for n in numbers):
            prim.CreateDoubleSidedAttr(True)
    for name, indices in mesh.groups:
        UsdGeom.Subset.CreateGeomSubset(
            prim,
            free_name(prim.GetPrim(), _identifier(name)),
            UsdGeom.Tokens.face,
            _ints(indices),
            GROUPS,
        )


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
    """(V,) the one value that each point has at all its corners; None where there is a seam."""
    first = np.full(len(mesh.points), -1)
    first[mesh.indices] = corner_values
    if (first < 0).any() or (first[mesh.indices] != corner_values).any():
        return None
    return first


def _ints(values: Ints | Floats) -> Vt.IntArray:
    return Vt.IntArray.FromNumpy(np.ascontiguousarray(values, np.int32))


def _identifier(name: str) -> str:
    return Tf.MakeValidIdentifier(name.strip() or "unnamed")


def _name(prim: Usd.Prim, name: str) -> None:
    """Keep a name that could not be a prim's."""
    if name.strip() and prim.GetName() != name:
        prim.SetDisplayName(name)
