"""The pictures of a glTF file: files beside it, or bytes inside it."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from PIL import Image

from gf_usd.assets.gltf import Gltf, resolve
from gf_usd.assets.mesh_data import Picture
from gf_usd.assets.notes import Notes
from gf_usd.errors import InputError

# What USD itself opens; anything else becomes a PNG.
KINDS = {b"\x89PNG": ".png", b"\xff\xd8\xff": ".jpg"}
WEBP = "EXT_texture_webp"


class GltfImages:
    """Pictures by number, each looked up once."""

    def __init__(self, gltf: Gltf, notes: Notes) -> None:
        self.files: list[Path] = []
        self._gltf = gltf
        self._notes = notes
        self._found: dict[int, Picture | None] = {}

    def of(self, texture: dict[str, Any], material: str) -> Picture | None:
        """The picture of a texture; None (and a note) where there is none that can be read."""
        webp = texture.get("extensions", {}).get(WEBP, {})
        number = webp.get("source", texture.get("source"))
        if number is None:
            self._notes.add("a texture of it has no picture that is read: without it", material)
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
    """The same picture as PNG; None where Pillow does not know it."""
    try:
        picture = Image.open(BytesIO(data))
        out = BytesIO()
        picture.convert("RGBA" if "A" in picture.getbands() else "RGB").save(out, "PNG")
    except (OSError, ValueError, SyntaxError, EOFError, Image.DecompressionBombError):
        return None
    return out.getvalue()
