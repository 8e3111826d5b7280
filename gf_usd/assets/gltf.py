"""glTF 2.0 files, text and binary: the container, and what it refers to.

The standard: Khronos glTF 2.0, sections 3.6 (buffers) and 4 (GLB).
"""

from __future__ import annotations

import base64
import binascii
import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from gf_usd.assets.gltf_schema import require_types
from gf_usd.assets.mesh_data import REPAIR, refuse_pointer
from gf_usd.errors import InputError

MAGIC = b"glTF"
JSON_CHUNK, BIN_CHUNK = 0x4E4F534A, 0x004E4942
DRACO = "KHR_draco_mesh_compression"
# Extensions without which a file may ask not to be read, and which change no shape that is read
# here (looks of materials apart).
UNDERSTOOD = {"KHR_mesh_quantization", "KHR_texture_transform", "EXT_texture_webp", DRACO}
LOOKS = "KHR_materials_"


@dataclass(frozen=True, kw_only=True)
class Gltf:
    """A file and its buffers."""

    path: Path
    tree: dict[str, Any]
    buffers: tuple[bytes, ...]
    inputs: tuple[Path, ...]  # every file read

    def rows(self, key: str) -> list[dict[str, Any]]:
        """One of the lists of the file: nodes, meshes, materials and so on."""
        return self.tree.get(key, [])

    def row(self, key: str, index: int | None) -> dict[str, Any]:
        """One of them by its number; InputError where there is none."""
        rows = self.rows(key)
        if index is None or index >= len(rows):
            raise InputError(
                f"{self.path}: it names number {index!r} of its {len(rows)} {key}", REPAIR
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
                f"{self.path}: buffer view {index} wants bytes {start} to {start + length} of a "
                f"buffer of {len(self.buffers[view['buffer']])}",
                REPAIR,
            )
        return data


def open_gltf(path: Path) -> Gltf:
    """Read a .gltf or .glb file and its buffers.

    Raises InputError for a file that is damaged, of another version, that needs an extension which
    is not read, or whose buffers are missing or too short.
    """
    data = path.read_bytes()
    refuse_pointer(path, data)
    text, chunk = _unpack(path, data) if data.startswith(MAGIC) else (data, b"")
    try:
        tree = json.loads(text.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is not a glTF file: its JSON: {error}", REPAIR) from error
    if not isinstance(tree, dict) or not isinstance(tree.get("asset"), dict):
        raise InputError(f"{path} is not a glTF file: it has no 'asset'", "check what it really is")
    require_types(path, tree)
    version = tree["asset"].get("version", "")
    if not version.startswith("2."):
        raise InputError(f"{path} is glTF {version or 'without a version'}", "export it as glTF 2")
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
                f"{path}: buffer {number} holds {len(content)} bytes of {length}",
                "it was cut off or altered: " + REPAIR,
            )
        buffers.append(content)
    return Gltf(path=path, tree=tree, buffers=tuple(buffers), inputs=tuple(inputs))


def resolve(path: Path, uri: str) -> tuple[bytes, Path | None]:
    """The bytes that a URI of the file `path` means, and the file they came from, if one.

    Raises InputError for a missing file and for broken base64.
    """
    if uri.startswith("data:"):
        try:
            return base64.b64decode(uri.partition("base64,")[2], validate=True), None
        except binascii.Error as error:
            raise InputError(f"{path}: embedded data is broken: {error}", REPAIR) from error
    file = path.parent / unquote(uri)
    try:
        content = file.read_bytes()
    except (OSError, ValueError) as error:
        raise InputError(
            f"{path} needs {uri}, which cannot be read",
            f"bring {uri} along, or export the asset as one .glb file",
        ) from error
    refuse_pointer(file, content)
    return content, file


def _unpack(path: Path, data: bytes) -> tuple[bytes, bytes]:
    """The JSON and the binary chunk of a GLB file."""
    hint = "it was cut off or altered: " + REPAIR
    if len(data) < 20:
        raise InputError(f"{path} is cut off: {len(data)} bytes", hint)
    version, length = struct.unpack_from("<II", data, 4)
    if version != 2:
        raise InputError(f"{path} is binary glTF {version}", "export it as glTF 2")
    if length > len(data):
        raise InputError(f"{path} is cut off: {len(data)} bytes of {length}", hint)
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
    strange = [name for name in required if name not in UNDERSTOOD and not name.startswith(LOOKS)]
    if strange:
        raise InputError(
            f"{path} can only be read with the extension {strange[0]}",
            "export it again without this extension (compression, for example, turned off)",
        )
