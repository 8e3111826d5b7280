"""Container of glTF 2.0 files, .gltf and .glb: JSON, buffers and images, with validation.

Khronos glTF 2.0, sections 3.6 (buffers) and 4 (GLB).  The JSON is validated against the part of
the glTF schema that is used here (`FILE`), in which all keys are optional, so that the other
modules need not check types.
"""

from __future__ import annotations

import base64
import binascii
import json
import struct
from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from PIL import Image

from gf_usd.core.errors import InputError
from gf_usd.readers.mesh.data import REPAIR, Picture, refuse_pointer
from gf_usd.readers.notes import Notes

MAGIC = b"glTF"
JSON_CHUNK, BIN_CHUNK = 0x4E4F534A, 0x004E4942
DRACO = "KHR_draco_mesh_compression"
# Extensions that a file may require and that are supported, or do not affect geometry; material
# extensions are handled separately.
UNDERSTOOD = {"KHR_mesh_quantization", "KHR_texture_transform", "EXT_texture_webp", DRACO}
MATERIAL_EXTENSIONS = "KHR_materials_"


@dataclass(frozen=True, kw_only=True)
class Gltf:
    """A file and its buffers."""

    path: Path
    tree: dict[str, Any]
    buffers: tuple[bytes, ...]
    inputs: tuple[Path, ...]  # every file read

    def rows(self, key: str) -> list[dict[str, Any]]:
        """A top-level array of the file: nodes, meshes, materials and so on."""
        return self.tree.get(key, [])

    def row(self, key: str, index: int | None) -> dict[str, Any]:
        """An element of a top-level array by index; InputError where it is out of range."""
        rows = self.rows(key)
        if index is None or index >= len(rows):
            raise InputError(
                f"{self.path}: it refers to index {index!r}, but the number of its {key} is "
                f"{len(rows)}",
                REPAIR,
            )
        return rows[index]

    def view(self, index: int | None) -> bytes:
        """The bytes of a buffer view."""
        view = self.row("bufferViews", index)
        self.row("buffers", view.get("buffer"))
        start, length = view.get("byteOffset", 0), view.get("byteLength", 0)
        data = self.buffers[view["buffer"]][start : start + length]
        if len(data) != length:
            raise InputError(
                f"{self.path}: buffer view {index} refers to bytes {start} to {start + length} "
                f"of a buffer with a length of {len(self.buffers[view['buffer']])}",
                REPAIR,
            )
        return data


def open_gltf(path: Path) -> Gltf:
    """Read a .gltf or .glb file and its buffers.

    Raises InputError for a file that is damaged, of another version, or requires an unsupported
    extension, and for buffers that are missing or too short.
    """
    data = path.read_bytes()
    refuse_pointer(path, data)
    text, chunk = _unpack(path, data) if data.startswith(MAGIC) else (data, b"")
    try:
        tree = json.loads(text.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"{path} is not a valid glTF file: its JSON cannot be parsed: {error}", REPAIR
        ) from error
    if not isinstance(tree, dict) or not isinstance(tree.get("asset"), dict):
        raise InputError(
            f"{path} is not a glTF file: it has no 'asset'", "check the type of the file"
        )
    version = tree["asset"].get("version", "")
    # before the types of glTF 2: glTF 1 refers to rows by name, not by number
    if not str(version).startswith("2."):
        raise InputError(
            f"{path} is glTF {version or 'without a version'}; only glTF 2 can be read",
            "export it as glTF 2, or convert it in a program that reads both",
        )
    require_types(path, tree)
    _require_understood(path, tree)
    found = Gltf(path=path, tree=tree, buffers=(), inputs=(path,))
    buffers, inputs = [], [path]
    for number, row in enumerate(found.rows("buffers")):
        uri = row.get("uri")
        content = chunk
        if uri is not None:
            content, file = resolve(path, uri)
            inputs += [file] if file else []
        length = row.get("byteLength", 0)
        if len(content) < length:
            raise InputError(
                f"{path}: buffer {number} holds {len(content)} of the {length} bytes that it "
                f"declares",
                "the file was truncated or altered: " + REPAIR,
            )
        buffers.append(content)
    return Gltf(path=path, tree=tree, buffers=tuple(buffers), inputs=tuple(inputs))


def resolve(path: Path, uri: str) -> tuple[bytes, Path | None]:
    """The bytes of a URI in the file `path`, and the file they were read from, if any.

    Raises InputError for a missing file and for invalid base64.
    """
    if uri.startswith("data:"):
        try:
            return base64.b64decode(uri.partition("base64,")[2], validate=True), None
        except binascii.Error as error:
            raise InputError(f"{path}: embedded data is invalid: {error}", REPAIR) from error
    file = path.parent / unquote(uri)
    try:
        content = file.read_bytes()
    except (OSError, ValueError) as error:
        raise InputError(
            f"{path} needs {uri}, which cannot be read",
            f"supply {uri} with the asset, or export the asset as a single .glb file",
        ) from error
    refuse_pointer(file, content)
    return content, file


def _unpack(path: Path, data: bytes) -> tuple[bytes, bytes]:
    """The JSON and the binary chunk of a GLB file."""
    hint = "the file was truncated or altered: " + REPAIR
    if len(data) < 20:
        raise InputError(f"{path} is truncated: {len(data)} bytes", hint)
    version, length = struct.unpack_from("<II", data, 4)
    if version != 2:
        raise InputError(f"{path} is binary glTF {version}", "export it as glTF 2")
    if length > len(data):
        raise InputError(f"{path} is truncated: it has {len(data)} of {length} bytes", hint)
    chunks: dict[int, bytes] = {}
    at = 12
    while at + 8 <= length:
        size, kind = struct.unpack_from("<II", data, at)
        if at + 8 + size > length:
            raise InputError(f"{path}: a chunk of {size} bytes does not fit in the file", hint)
        chunks.setdefault(kind, data[at + 8 : at + 8 + size])
        at += 8 + size
    if JSON_CHUNK not in chunks:
        raise InputError(f"{path} has no JSON chunk", hint)
    return chunks[JSON_CHUNK], chunks.get(BIN_CHUNK, b"")


def _require_understood(path: Path, tree: dict[str, Any]) -> None:
    required = tree.get("extensionsRequired", [])
    strange = [
        name
        for name in required
        if name not in UNDERSTOOD and not name.startswith(MATERIAL_EXTENSIONS)
    ]
    if strange:
        raise InputError(
            f"{path} requires the extension {strange[0]}, which is not supported",
            "export it again without this extension (for example, with compression turned off)",
        )


# Image types that USD supports; others are converted to PNG.
KINDS = {b"\x89PNG": ".png", b"\xff\xd8\xff": ".jpg"}
WEBP = "EXT_texture_webp"


class GltfImages:
    """The images of a file by index, cached."""

    def __init__(self, gltf: Gltf, notes: Notes) -> None:
        self.files: list[Path] = []
        self._gltf = gltf
        self._notes = notes
        self._found: dict[int, Picture | None] = {}

    def of(self, texture: dict[str, Any], material: str) -> Picture | None:
        """The image of a texture; None, with a note, where it is missing or cannot be read."""
        webp = texture.get("extensions", {}).get(WEBP, {})
        number = webp.get("source", texture.get("source"))
        if number is None:
            self._notes.add("one of its textures has no supported image and is left out", material)
            return None
        if number not in self._found:
            self._found[number] = self._picture(number, material)
        return self._found[number]

    def _picture(self, number: Any, material: str) -> Picture | None:
        row = self._gltf.row("images", number)
        uri = row.get("uri", "")
        name = str(row.get("name") or f"image{number}")
        file: Path | None = None
        if uri:
            name = name if uri.startswith("data:") else Path(unquote(uri)).name
            try:
                data, file = resolve(self._gltf.path, uri)
            except InputError as error:
                self._notes.add(f"a texture is left out: {error.message}", material)
                return None
        else:
            data = self._gltf.view(row.get("bufferView"))
        kind = next((end for start, end in KINDS.items() if data.startswith(start)), "")
        if file is not None:
            self.files.append(file)
            if kind:
                return Picture(name=file.name, path=file)
        if not kind:
            png = _as_png(data)
            if png is None:
                self._notes.add(
                    f"picture {name} is of a kind that is not read: without it", material
                )
                return None
            data, kind = png, ".png"
        stem = name[: -len(kind)] if name.lower().endswith(kind) else name
        return Picture(name=f"{stem}{kind}", data=data)


def _as_png(data: bytes) -> bytes | None:
    """The image as PNG; None where Pillow cannot read it."""
    try:
        picture = Image.open(BytesIO(data))
        out = BytesIO()
        picture.convert("RGBA" if "A" in picture.getbands() else "RGB").save(out, "PNG")
    except (OSError, ValueError, SyntaxError, EOFError, Image.DecompressionBombError):
        return None
    return out.getvalue()


class Wrong(Exception):
    """A value of the wrong type: (location, expected type)."""

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
    # comparisons with NaN are false
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e38


def _is_index(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 2**53


number = _of("a finite number", _is_number)
index = _of("an integer of 0 or more", _is_index)
text = _of("a text", lambda value: isinstance(value, str))
flag = _of("true or false", lambda value: isinstance(value, bool))


def numbers(count: int, least: int | None = None) -> Check:
    """A check for a list of finite numbers, of one of some lengths."""
    low = count if least is None else least
    return _of(
        f"a list of {count} numbers",
        lambda value: (
            isinstance(value, list) and low <= len(value) <= count and all(map(_is_number, value))
        ),
    )


def rows(item: Check) -> Check:
    """A check for a list of elements."""

    def check(value: Any, where: str) -> None:
        if not isinstance(value, list):
            raise Wrong(where, "a list")
        for i, entry in enumerate(value):
            item(entry, f"{where}[{i}]")

    return check


def table(**keys: Check) -> Check:
    """A check for an object; the values of other keys are not checked."""

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
DRACO_SCHEMA = table(KHR_draco_mesh_compression=table(bufferView=index, attributes=_indices))
PRIMITIVE = table(
    attributes=_indices,
    indices=index,
    mode=index,
    material=index,
    targets=rows(_indices),
    extensions=DRACO_SCHEMA,
)
WEIGHTS = rows(number)  # of morph targets
NODE = table(
    children=rows(index),
    mesh=index,
    skin=index,
    matrix=numbers(16),
    translation=numbers(3),
    rotation=numbers(4),
    scale=numbers(3),
    weights=WEIGHTS,
)
SPARSE = table(
    count=index,
    indices=table(bufferView=index, byteOffset=index, componentType=index),
    values=table(bufferView=index, byteOffset=index),
)
FILE = table(
    scene=index,
    scenes=rows(table(nodes=rows(index))),
    nodes=rows(NODE),
    meshes=rows(table(primitives=rows(PRIMITIVE), weights=WEIGHTS)),
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
            sparse=SPARSE,
        )
    ),
    bufferViews=rows(table(buffer=index, byteOffset=index, byteLength=index, byteStride=index)),
    buffers=rows(table(uri=text, byteLength=index)),
    extensionsRequired=rows(text),
    asset=table(version=text),
)


def require_types(path: Path, tree: Any, schema: Check = FILE) -> None:
    """Raise InputError, with the JSON location, for a value of the wrong type."""
    try:
        schema(tree, "")
    except Wrong as wrong:
        raise InputError(
            f"{path}: {wrong.where or 'the file'} is not {wrong.wanted}", REPAIR
        ) from None
