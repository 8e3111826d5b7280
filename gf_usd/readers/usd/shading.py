"""Diffuse colors of a mesh: displayColor and bound materials (constants, textures, primvars)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdShade

from gf_usd.core.arrays import Floats, Ints, triple
from gf_usd.core.asset import SurfaceMaterial, Texture
from gf_usd.readers.notes import Notes
from gf_usd.readers.usd.primvars import Corners, primvar_at_corners

GRAY = (0.18, 0.18, 0.18)  # the fallback of UsdPreviewSurface's diffuseColor
MAX_TRANSFORMS = 16  # UsdTransform2d nodes in a chain; a longer one is taken for a cycle


@dataclass(frozen=True, kw_only=True)
class TexturePlace:
    """Texture coordinates: those of a primvar, transformed by u' = A u + b."""

    primvar: str  # empty: constant coordinates
    fallback: Floats  # (2,) where the primvar is missing
    linear: Floats  # (2, 2) A
    offset: Floats  # (2,) b

    def __call__(self, uvs: Floats) -> Floats:
        """(..., 2) transformed texture coordinates of primvar values (..., 2)."""
        return uvs @ self.linear.T + self.offset


@dataclass(frozen=True, kw_only=True)
class BoundShading:
    """A bound material, and the primvars of the mesh that it reads."""

    material: SurfaceMaterial
    place: TexturePlace | None = None  # of material.texture
    color_primvar: str = ""  # the diffuse color is this primvar of the mesh
    understood: bool = True  # False: unsupported shader; the color is a fallback


class ShadingReader:
    """The materials of a stage at one time, cached.

    textures : cache of decoded textures, which may be shared between times of one stage.
    """

    def __init__(
        self,
        time: Usd.TimeCode,
        notes: Notes,
        textures: dict[tuple[object, ...], Texture] | None = None,
    ) -> None:
        self._time = time
        self._notes = notes
        self._found: dict[Sdf.Path, BoundShading] = {}
        self._textures = {} if textures is None else textures

    def bound(self, prim: Usd.Prim) -> BoundShading | None:
        """The shading bound to a mesh or subset, including inherited and collection bindings."""
        for purpose in (UsdShade.Tokens.preview, UsdShade.Tokens.full):
            material = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial(purpose)[0]
            if material:
                break
        else:
            return None
        path = material.GetPath()
        if path not in self._found:
            self._found[path] = self._read(material)
        return self._found[path]

    def _read(self, material: UsdShade.Material) -> BoundShading:
        path = str(material.GetPath())
        shader = material.ComputeSurfaceSource()[0]
        if not shader or shader.GetShaderId() != "UsdPreviewSurface":
            kind = self._kind(material, shader)
            self._notes.add(f"{kind} is not supported: displayColor or gray is used", path)
            return BoundShading(material=SurfaceMaterial(path=path, color=GRAY), understood=False)
        diffuse = shader.GetInput("diffuseColor")
        color = _color(self._value(diffuse), GRAY)
        source = self._source(diffuse)
        if source is None:
            return BoundShading(material=SurfaceMaterial(path=path, color=color))
        node, output = source
        if node.GetShaderId() == "UsdUVTexture":
            return self._textured(path, node, output, color)
        if node.GetShaderId() == "UsdPrimvarReader_float3":
            name = str(self._input(node, "varname") or "")
            color = _color(self._input(node, "fallback"), color)
            return BoundShading(
                material=SurfaceMaterial(path=path, color=color), color_primvar=name
            )
        self._notes.add(
            f"diffuseColor comes from {node.GetShaderId() or 'an unknown shader'}, which is not "
            f"supported: a constant color is used",
            path,
        )
        return BoundShading(material=SurfaceMaterial(path=path, color=color))

    def _kind(self, material: UsdShade.Material, shader: UsdShade.Shader) -> str:
        """Name of an unsupported surface shader, for messages."""
        if shader:
            return f"shader {shader.GetShaderId() or shader.GetImplementationSource()}"
        contexts = [output.GetBaseName() for output in material.GetSurfaceOutputs()]
        named = [name.removesuffix(":surface") for name in contexts if name != "surface"]
        return f"a {' and '.join(named)} shader" if named else "a material without a surface shader"

    def _textured(
        self, path: str, node: UsdShade.Shader, output: str, color: tuple[float, float, float]
    ) -> BoundShading:
        from gf_usd.readers.usd.texture import (
            Unreadable,
            load_texture,  # many assets have none
        )

        authored = self._input(node, "fallback")
        constant = SurfaceMaterial(path=path, color=_color(authored, color))
        asset = self._input(node, "file")
        if not isinstance(asset, Sdf.AssetPath) or not asset.path:
            self._notes.add("its texture names no file: a constant color is used", path)
            return BoundShading(material=constant)
        options = {
            "space": str(self._input(node, "sourceColorSpace") or "auto"),
            "wraps": (str(self._input(node, "wrapS")), str(self._input(node, "wrapT"))),
            "scale": np.array(_color(self._input(node, "scale"), (1.0, 1.0, 1.0))),
            "bias": np.array(_color(self._input(node, "bias"), (0.0, 0.0, 0.0))),
            "channel": output if output in ("r", "g", "b", "a") else "rgb",
        }
        key = (asset.resolvedPath or asset.path, *(str(value) for value in options.values()))
        try:
            if key not in self._textures:
                self._textures[key] = load_texture(asset, **options)
        except Unreadable as error:
            self._notes.add(f"{error}: a constant color is used", path)
            return BoundShading(material=constant)
        material = SurfaceMaterial(path=path, color=color, texture=self._textures[key])
        return BoundShading(material=material, place=self._place(path, node.GetInput("st")))

    def _place(self, path: str, st: UsdShade.Input) -> TexturePlace:
        """The texture coordinates of an `st` input, through UsdTransform2d nodes."""
        linear, offset = np.eye(2), np.zeros(2)
        for _ in range(MAX_TRANSFORMS):
            source = self._source(st)
            if source is None:
                break
            node = source[0]
            if node.GetShaderId() == "UsdTransform2d":
                own, shift = self._transform(node)
                # The node nearest to the texture is applied last.
                linear, offset = linear @ own, linear @ shift + offset
                st = node.GetInput("in")
                continue
            if node.GetShaderId() == "UsdPrimvarReader_float2":
                return TexturePlace(
                    primvar=str(self._input(node, "varname") or ""),
                    fallback=_pair(self._input(node, "fallback"), 0.0),
                    linear=linear,
                    offset=offset,
                )
            self._notes.add(
                f"its texture coordinates come from {node.GetShaderId()}, which is not supported",
                path,
            )
            break
        return TexturePlace(
            primvar="", fallback=_pair(self._value(st), 0.0), linear=linear, offset=offset
        )

    def _transform(self, node: UsdShade.Shader) -> tuple[Floats, Floats]:
        """u' = R(rotation) diag(scale) u + translation of a UsdTransform2d."""
        angle = np.deg2rad(float(self._input(node, "rotation") or 0.0))
        cos, sin = np.cos(angle), np.sin(angle)
        scale = _pair(self._input(node, "scale"), 1.0)
        return np.array([[cos, -sin], [sin, cos]]) * scale, _pair(
            self._input(node, "translation"), 0.0
        )

    def _input(self, node: UsdShade.Shader, name: str) -> Any:
        return self._value(node.GetInput(name))

    def _value(self, shader_input: UsdShade.Input) -> Any:
        """The value of an input, resolved through node graphs; None where it has none."""
        if not shader_input:
            return None
        for attribute in shader_input.GetValueProducingAttributes():
            if not UsdShade.Output.IsOutput(attribute):
                return attribute.Get(self._time)
        return shader_input.Get(self._time)

    def _source(self, shader_input: UsdShade.Input) -> tuple[UsdShade.Shader, str] | None:
        """The shader and output connected to an input, resolved through node graphs; or None."""
        if not shader_input:
            return None
        for attribute in shader_input.GetValueProducingAttributes():
            if UsdShade.Output.IsOutput(attribute):
                output = UsdShade.Output(attribute)
                return UsdShade.Shader(attribute.GetPrim()), output.GetBaseName()
        return None


def _color(value: object, otherwise: tuple[float, float, float]) -> tuple[float, float, float]:
    """The first three components of a color of three or four."""
    if value is None:
        return otherwise
    numbers = np.asarray(value, dtype=np.float64).reshape(-1)
    if len(numbers) < 3 or not np.isfinite(numbers[:3]).all():
        return otherwise
    return triple(numbers)


def _pair(value: object, otherwise: float) -> Floats:
    if value is None:
        return np.full(2, otherwise)
    numbers = np.asarray(value, dtype=np.float64).reshape(-1)
    return numbers[:2] if len(numbers) >= 2 else np.full(2, otherwise)


@dataclass(frozen=True, kw_only=True)
class Colors:
    """The fields of `Surface` for its colors."""

    colors: Floats | None  # (T, 3, 3) linear
    uvs: Floats | None  # (T, 3, 2)
    indices: Ints | None  # (T,) into materials, -1 none
    materials: tuple[SurfaceMaterial, ...]


def colors(
    prim: Usd.Prim, corners: Corners, shadings: ShadingReader, time: Usd.TimeCode, notes: Notes
) -> Colors:
    """The colors of a mesh by triangle; fields are None where nothing is authored."""
    display = primvar_at_corners(prim, "displayColor", 3, corners, time, notes)
    bound, of_face = _bindings(prim, corners.n_faces, shadings, time, notes)
    indices = of_face[corners.faces]
    uvs: Floats | None = None
    materials: list[SurfaceMaterial] = []
    rows = np.full(len(bound) + 1, -1)  # the last is for faces without a material
    for i, shading in enumerate(bound):
        mine = indices == i
        if shading.color_primvar and mine.any():
            named = primvar_at_corners(prim, shading.color_primvar, 3, corners, time, notes)
            if named is not None:
                display = np.full(named.shape, 0.5) if display is None else display.copy()
                display[mine] = named[mine]
                continue
        if not shading.understood and display is not None:
            continue
        if shading.place is not None and mine.any():
            uvs = np.zeros((*corners.triangles.shape, 2)) if uvs is None else uvs
            uvs[mine] = _texture_coordinates(prim, shading, corners, time, notes)[mine]
        rows[i] = len(materials)
        materials.append(shading.material)
    return Colors(
        colors=display,
        uvs=uvs,
        indices=rows[indices] if materials else None,
        materials=tuple(materials),
    )


def _texture_coordinates(
    prim: Usd.Prim, shading: BoundShading, corners: Corners, time: Usd.TimeCode, notes: Notes
) -> Floats:
    """(T, 3, 2) texture coordinates of a shading."""
    place = shading.place
    assert place is not None
    found = None
    if place.primvar:
        found = primvar_at_corners(prim, place.primvar, 2, corners, time, notes)
        if found is None:
            notes.add(
                f"has no usable primvar {place.primvar}, which the texture of "
                f"<{shading.material.path}> reads: a single point of the texture is used",
                str(prim.GetPath()),
            )
    if found is None:
        found = np.broadcast_to(place.fallback, (*corners.triangles.shape, 2))
    return place(found)


def _bindings(
    prim: Usd.Prim, n_faces: int, shadings: ShadingReader, time: Usd.TimeCode, notes: Notes
) -> tuple[list[BoundShading], Ints]:
    """The shadings bound to a mesh or its subsets, and (P,) the index of each face's; -1: none."""
    found: list[BoundShading] = []
    of_face = np.full(n_faces, -1)

    def bind(shading: BoundShading | None, faces: Ints | slice) -> None:
        if shading is not None:
            if shading not in found:
                found.append(shading)
            of_face[faces] = found.index(shading)

    bind(shadings.bound(prim), slice(None))
    if prim.IsA(UsdGeom.Mesh):
        for subset in UsdShade.MaterialBindingAPI(prim).GetMaterialBindSubsets():
            if subset.GetElementTypeAttr().Get() != UsdGeom.Tokens.face:
                continue
            values = subset.GetIndicesAttr().Get(time)
            faces = np.asarray([] if values is None else values, dtype=np.int64).reshape(-1)
            inside = (faces >= 0) & (faces < n_faces)
            if not inside.all():
                notes.add(
                    f"{int((~inside).sum())} of its {len(faces)} indices do not refer to any of "
                    f"the {n_faces} faces: ignored",
                    str(subset.GetPath()),
                )
            bind(shadings.bound(subset.GetPrim()), faces[inside])
    return found, of_face
