"""Conversion of glTF materials to UsdPreviewSurface.

Supported are the metallic-roughness factors and the textures of base color, metallic-roughness,
normal, emission and occlusion; of the older specular-glossiness extension, only the diffuse part.
Alpha is not read.  Texture transforms of the coordinate set are applied to the coordinates.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.readers.mesh.data import FileMaterial, Slot
from gf_usd.readers.mesh.gltf.container import Gltf, GltfImages
from gf_usd.readers.mesh.gltf.primitives import Primitive
from gf_usd.readers.notes import Notes

WRAPS = {10497: "repeat", 33071: "clamp", 33648: "mirror"}
GLOSSY, TRANSFORM = "KHR_materials_pbrSpecularGlossiness", "KHR_texture_transform"
WHITE = (1.0, 1.0, 1.0)


class GltfMaterials:
    """The materials of a file, converted on first use by a primitive."""

    def __init__(self, gltf: Gltf, notes: Notes) -> None:
        self._gltf = gltf
        self._notes = notes
        self._images = GltfImages(gltf, notes)
        self._made: dict[tuple[int | None, bool], FileMaterial] = {}

    @property
    def used(self) -> tuple[FileMaterial, ...]:
        """The converted materials, in order of their indices."""
        return tuple(self._made.values())

    @property
    def inputs(self) -> tuple[Path, ...]:
        """The image files of the materials."""
        return tuple(self._images.files)

    def index(self, number: int | None, colored: bool) -> int:
        """Index into `used` of the material of a primitive; -1: none."""
        if number is None and not colored:
            return -1
        row = {} if number is None else self._gltf.row("materials", number)
        textured = "index" in _base(row)[1]
        if colored and textured:
            self._notes.add("its vertex colors, which multiply a texture, are left out", _name(row))
        key = (number, colored and not textured)
        if key not in self._made:
            self._made[key] = self._material(row, key[1])
        return list(self._made).index(key)

    def uvs(self, primitive: Primitive) -> Floats | None:
        """(V, 2) texture coordinates of a primitive, v upward; None without coordinates."""
        row = self._row_of(primitive)
        coordinates, transform = _placing(_reference(row))
        found = primitive.attributes.get(f"TEXCOORD_{coordinates}")
        if found is None:
            if _reference(row):
                self._notes.add(
                    "a mesh that uses its texture has no texture coordinates", _name(row)
                )
            return None
        if not np.isfinite(found).all():
            self._notes.add("texture coordinates that are not finite are left out", _name(row))
            return None
        u, v = _transformed(found[:, :2], transform).T
        return np.stack([u, 1.0 - v], axis=1)

    def colors(self, primitive: Primitive) -> Floats | None:
        """(V, 3) linear vertex colors, COLOR_0 times the base color; None without COLOR_0."""
        found = primitive.attributes.get("COLOR_0")
        if found is None or not np.isfinite(found).all():
            return None
        factor, _ = _base(self._row_of(primitive))
        return np.clip(found[:, :3], 0.0, 1.0) * np.asarray(factor[:3])

    def _row_of(self, primitive: Primitive) -> dict[str, Any]:
        if primitive.material is None:
            return {}
        return self._gltf.row("materials", primitive.material)

    def _material(self, row: dict[str, Any], mesh_colors: bool) -> FileMaterial:
        factor, base = _base(row)
        pbr = row.get("pbrMetallicRoughness", {})
        r, g, b = factor[:3]
        values: dict[str, float | tuple[float, float, float]] = {"diffuseColor": (r, g, b)}
        glossy = GLOSSY in row.get("extensions", {}) and not pbr
        metal = 0.0 if glossy else float(pbr.get("metallicFactor", 1.0))
        rough = 0.5 if glossy else float(pbr.get("roughnessFactor", 1.0))
        values["metallic"], values["roughness"] = metal, rough
        glow = tuple(row.get("emissiveFactor", (0.0, 0.0, 0.0)))
        if any(glow):
            values["emissiveColor"] = glow
        surface = pbr.get("metallicRoughnessTexture", {})
        bump = row.get("normalTexture", {})
        k = float(bump.get("scale", 1.0))
        texture_slots = [
            self._slot(row, "diffuseColor", base, scale=(r, g, b)),
            self._slot(row, "roughness", surface, "g", srgb=False, scale=(rough,) * 3),
            self._slot(row, "metallic", surface, "b", srgb=False, scale=(metal,) * 3),
            self._slot(
                row, "normal", bump, srgb=False, scale=(2.0 * k, 2.0 * k, 2.0), bias=(-k, -k, -1.0)
            ),
            self._slot(row, "occlusion", row.get("occlusionTexture", {}), "r", srgb=False),
        ]
        if any(glow):
            texture_slots.append(
                self._slot(row, "emissiveColor", row.get("emissiveTexture", {}), scale=glow)
            )
        return FileMaterial(
            name=_name(row) or "material",
            values=values,
            texture_slots=tuple(slot for slot in texture_slots if slot is not None),
            mesh_colors=mesh_colors,
            double_sided=bool(row.get("doubleSided")),
        )

    def _slot(
        self,
        row: dict[str, Any],
        name: str,
        info: dict[str, Any],
        channel: str = "rgb",
        *,
        srgb: bool = True,
        scale: tuple[float, ...] = WHITE,
        bias: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> Slot | None:
        """The texture of an input; None where there is none or it cannot be converted."""
        if "index" not in info:
            return None
        if _placing(info) != _placing(_reference(row)):
            self._notes.add(
                f"its {name} texture has a different placement from its first texture and is "
                f"left out",
                _name(row),
            )
            return None
        texture = self._gltf.row("textures", info["index"])
        picture = self._images.of(texture, _name(row))
        if picture is None:
            return None
        sampler = {}
        if "sampler" in texture:
            sampler = self._gltf.row("samplers", texture["sampler"])
        wraps = [WRAPS.get(sampler.get(key, 10497), "repeat") for key in ("wrapS", "wrapT")]
        return Slot(
            input=name,
            picture=picture,
            channel=channel,
            srgb=srgb,
            scale=(scale[0], scale[1], scale[2]),
            bias=bias,
            wraps=(wraps[0], wraps[1]),
        )


def _name(row: dict[str, Any]) -> str:
    return str(row.get("name", ""))


def _base(row: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
    """Base color factor and texture."""
    glossy = row.get("extensions", {}).get(GLOSSY)
    if glossy is not None and "pbrMetallicRoughness" not in row:
        return glossy.get("diffuseFactor", WHITE), glossy.get("diffuseTexture", {})
    pbr = row.get("pbrMetallicRoughness", {})
    return pbr.get("baseColorFactor", WHITE), pbr.get("baseColorTexture", {})


def _reference(row: dict[str, Any]) -> dict[str, Any]:
    """The texture whose coordinate set is used: that of the base color, else the first one."""
    pbr = row.get("pbrMetallicRoughness", {})
    for info in (
        _base(row)[1],
        pbr.get("metallicRoughnessTexture", {}),
        row.get("normalTexture", {}),
        row.get("emissiveTexture", {}),
        row.get("occlusionTexture", {}),
    ):
        if "index" in info:
            return info
    return {}


def _placing(info: dict[str, Any]) -> tuple[int, dict[str, Any]]:
    """Coordinate set and transform of a texture."""
    transform = dict(info.get("extensions", {}).get(TRANSFORM, {}))
    coordinates = transform.pop("texCoord", info.get("texCoord", 0))
    return coordinates, transform


def _transformed(uvs: Floats, transform: dict[str, Any]) -> Floats:
    """uv' = R S uv + offset, R counter-clockwise as seen with v downward."""
    scale = np.asarray(transform.get("scale", (1.0, 1.0)), np.float64)
    angle = float(transform.get("rotation", 0.0))
    offset = np.asarray(transform.get("offset", (0.0, 0.0)), np.float64)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return (uvs * scale) @ turn.T + offset
