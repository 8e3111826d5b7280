"""The types of what is read from a glTF file, so that its readers need not ask.

A small part of the schema of glTF 2.0: only the keys that are read here, all of them optional.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from gf_usd.assets.mesh_data import REPAIR
from gf_usd.errors import InputError


class Wrong(Exception):
    """A value that is not of its type: (where, what is wanted)."""

    def __init__(self, where: str, wanted: str) -> None:
        super().__init__(where, wanted)
        self.where, self.wanted = where, wanted


Check = Callable[[Any, str], None]


def _of(wanted: str, right: Callable[[Any], bool]) -> Check:
    def check(value: Any, where: str) -> None:
        if not right(value):
            raise Wrong(where, wanted)

    return check


def _is_number(value: Any) -> bool:
    # NaN is not below anything either.
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e38


def _is_index(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 2**53


number = _of("a finite number", _is_number)
index = _of("a whole number of 0 or more", _is_index)
text = _of("a text", lambda value: isinstance(value, str))
flag = _of("true or false", lambda value: isinstance(value, bool))


def numbers(count: int, least: int | None = None) -> Check:
    """A list of so many finite numbers."""
    low = count if least is None else least
    return _of(
        f"a list of {count} numbers",
        lambda value: (
            isinstance(value, list) and low <= len(value) <= count and all(map(_is_number, value))
        ),
    )


def rows(item: Check) -> Check:
    """A list of such things."""

    def check(value: Any, where: str) -> None:
        if not isinstance(value, list):
            raise Wrong(where, "a list")
        for i, entry in enumerate(value):
            item(entry, f"{where}[{i}]")

    return check


def table(**keys: Check) -> Check:
    """An object; keys that are not named may hold anything."""

    def check(value: Any, where: str) -> None:
        if not isinstance(value, dict):
            raise Wrong(where, "an object")
        for key, inner in keys.items():
            if key in value:
                inner(value[key], f"{where}.{key}" if where else key)

    return check


def _indices(value: Any, where: str) -> None:
    table()(value, where)
    for key, entry in value.items():
        index(entry, f"{where}.{key}")


TRANSFORM = table(offset=numbers(2), scale=numbers(2), rotation=number, texCoord=index)
TEXTURE_INFO = table(
    index=index, texCoord=index, scale=number, extensions=table(KHR_texture_transform=TRANSFORM)
)
METALLIC = table(
    baseColorFactor=numbers(4, 3),
    baseColorTexture=TEXTURE_INFO,
    metallicFactor=number,
    roughnessFactor=number,
    metallicRoughnessTexture=TEXTURE_INFO,
)
GLOSSY = table(diffuseFactor=numbers(4, 3), diffuseTexture=TEXTURE_INFO)
MATERIAL = table(
    pbrMetallicRoughness=METALLIC,
    normalTexture=TEXTURE_INFO,
    occlusionTexture=TEXTURE_INFO,
    emissiveTexture=TEXTURE_INFO,
    emissiveFactor=numbers(3),
    extensions=table(KHR_materials_pbrSpecularGlossiness=GLOSSY),
)
DRACO = table(KHR_draco_mesh_compression=table(bufferView=index, attributes=_indices))
PRIMITIVE = table(attributes=_indices, indices=index, mode=index, material=index, extensions=DRACO)
NODE = table(
    children=rows(index),
    mesh=index,
    skin=index,
    matrix=numbers(16),
    translation=numbers(3),
    rotation=numbers(4),
    scale=numbers(3),
)
FILE = table(
    scene=index,
    scenes=rows(table(nodes=rows(index))),
    nodes=rows(NODE),
    meshes=rows(table(primitives=rows(PRIMITIVE))),
    skins=rows(table(joints=rows(index), inverseBindMatrices=index)),
    materials=rows(MATERIAL),
    textures=rows(
        table(source=index, sampler=index, extensions=table(EXT_texture_webp=table(source=index)))
    ),
    samplers=rows(table(wrapS=index, wrapT=index)),
    images=rows(table(uri=text, bufferView=index)),
    accessors=rows(
        table(
            bufferView=index,
            byteOffset=index,
            componentType=index,
            count=index,
            type=text,
            normalized=flag,
        )
    ),
    bufferViews=rows(table(buffer=index, byteOffset=index, byteLength=index, byteStride=index)),
    buffers=rows(table(uri=text, byteLength=index)),
    extensionsRequired=rows(text),
    asset=table(version=text),
)


def require_types(path: Path, tree: Any) -> None:
    """Raise InputError (with the place in the file) where a value is not of its type."""
    try:
        FILE(tree, "")
    except Wrong as wrong:
        raise InputError(
            f"{path}: {wrong.where or 'the file'} is not {wrong.wanted}", REPAIR
        ) from None
